"""When each line was taken: a constant rate, or a table; forward and reverse scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, read_only, require_finite
from geoposition.errors import ArgumentError
from geoposition.timescale import Epoch


@dataclass(frozen=True, slots=True)
class ConstantLineRate:
    """Line (0-based) taken at `first_line_s` + line × `line_period_s` from `epoch`.

    The period is negative for a reverse scan.
    """

    epoch: Epoch
    first_line_s: float
    line_period_s: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.first_line_s) and np.isfinite(self.line_period_s)):
            raise ArgumentError("line timing: finite times expected")
        if self.line_period_s == 0:
            raise ArgumentError("line timing: a line period other than 0 expected")

    @property
    def knots_line(self) -> FloatArray:
        """None: the rate is constant."""
        return np.empty(0)

    def time_s(self, line: ArrayLike) -> FloatArray:
        """Seconds from `epoch` of `line` (...)."""
        return self.first_line_s + np.asarray(line, dtype=np.float64) * self.line_period_s

    def line_at(self, time_s: ArrayLike) -> FloatArray:
        """Line (...) taken at `time_s` (...)."""
        return (np.asarray(time_s, dtype=np.float64) - self.first_line_s) / self.line_period_s


@dataclass(frozen=True, slots=True, eq=False)
class LineTimeTable:
    """Line times linear between the entries `lines` (n,), `times_s` (n,), and beyond the ends.

    Lines increase strictly; times increase or, in a reverse scan, decrease strictly.
    """

    epoch: Epoch
    lines: FloatArray
    times_s: FloatArray

    def __post_init__(self) -> None:
        lines = require_finite(read_only(self.lines), "line table: lines")
        times = require_finite(read_only(self.times_s), "line table: times")
        if lines.ndim != 1 or lines.shape != times.shape or len(lines) < 2:
            raise ArgumentError("line table: two or more pairs of line and time expected")
        if np.any(np.diff(lines) <= 0):
            raise ArgumentError("line table: strictly increasing lines expected")
        steps = np.diff(times)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise ArgumentError("line table: strictly monotonic times expected")
        object.__setattr__(self, "lines", lines)
        object.__setattr__(self, "times_s", times)

    @property
    def knots_line(self) -> FloatArray:
        """Inner entries, where the line rate jumps."""
        return self.lines[1:-1]

    def time_s(self, line: ArrayLike) -> FloatArray:
        """Seconds from `epoch` of `line` (...)."""
        return _piecewise_linear(line, self.lines, self.times_s)

    def line_at(self, time_s: ArrayLike) -> FloatArray:
        """Line (...) taken at `time_s` (...)."""
        order = slice(None) if self.times_s[-1] > self.times_s[0] else slice(None, None, -1)
        return _piecewise_linear(time_s, self.times_s[order], self.lines[order])


def _piecewise_linear(at: ArrayLike, x: FloatArray, y: FloatArray) -> FloatArray:
    """Linear interpolation, continued beyond the ends with the end slopes."""
    at = np.asarray(at, dtype=np.float64)
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    result: FloatArray = y[k] + (at - x[k]) * (y[k + 1] - y[k]) / (x[k + 1] - x[k])
    return result
