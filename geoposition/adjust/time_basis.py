"""How a slow error depends on time: polynomials about an instant, or values at knots.

A basis is linear in its coefficients, so that one matrix serves residuals and Jacobians; the
same coefficients make the curve that a corrected model carries on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geoposition.arrays import FloatArray, read_only, require_increasing
from geoposition.errors import ArgumentError
from geoposition.interpolation import Curve, LagrangeCurve, PolynomialCurve, SplineCurve
from geoposition.timescale import Epoch

_LEAST_FOR_CUBIC = 4


class TimeBasis(Protocol):
    """Functions of time whose combination is a correction."""

    @property
    def labels(self) -> tuple[str, ...]:
        """A short name of each function."""
        ...

    @property
    def powers(self) -> tuple[int, ...]:
        """Powers of seconds in the denominator of each coefficient's unit."""
        ...

    @property
    def epoch(self) -> Epoch:
        """Instant from which the basis counts its seconds."""
        ...

    def values(self, times_s: FloatArray) -> FloatArray:
        """Functions (n, m) at `times_s` (n,) from `epoch`."""
        ...

    def curve(self, coefficients: FloatArray, epoch: Epoch, span_s: tuple[float, float]) -> Curve:
        """Curve of `coefficients` (m, k), over seconds from another `epoch`."""
        ...


@dataclass(frozen=True, slots=True)
class PolynomialBasis:
    """1, s, s², ... with s the seconds from `epoch`. *Source*: T 2.8."""

    epoch: Epoch
    degree: int

    def __post_init__(self) -> None:
        if not 0 <= self.degree <= 5:
            raise ArgumentError(f"polynomial in time: degree 0 .. 5 expected, got {self.degree}")

    @property
    def labels(self) -> tuple[str, ...]:
        """`0`, `1`, `2`: the powers."""
        return tuple(str(k) for k in range(self.degree + 1))

    @property
    def powers(self) -> tuple[int, ...]:
        """The powers themselves."""
        return tuple(range(self.degree + 1))

    def values(self, times_s: FloatArray) -> FloatArray:
        """Powers (n, degree + 1) of `times_s` (n,)."""
        return np.vander(times_s, self.degree + 1, increasing=True)

    def curve(self, coefficients: FloatArray, epoch: Epoch, span_s: tuple[float, float]) -> Curve:
        """Return the polynomial, over seconds from `epoch`, within `span_s`."""
        return PolynomialCurve(read_only(coefficients), self.epoch - epoch, 1.0, span_s)


@dataclass(frozen=True, slots=True, eq=False)
class KnotBasis:
    """Values at `knots_s` (m,) from `epoch`: joined by straight lines, or by a cubic spline.

    Straight lines with `smooth` false. A cubic needs four knots. Beyond the knots there is
    nothing: they must enclose all lines of the images, margins included.
    """

    epoch: Epoch
    knots_s: FloatArray
    smooth: bool = False

    def __post_init__(self) -> None:
        knots = require_increasing(read_only(self.knots_s), "knots")
        least = _LEAST_FOR_CUBIC if self.smooth else 2
        if len(knots) < least:
            raise ArgumentError(f"knots: at least {least} expected, got {len(knots)}")
        object.__setattr__(self, "knots_s", knots)

    @property
    def labels(self) -> tuple[str, ...]:
        """`k0`, `k1`, ...: the knots."""
        return tuple(f"k{i}" for i in range(len(self.knots_s)))

    @property
    def powers(self) -> tuple[int, ...]:
        """Zeros: the coefficients are values."""
        return (0,) * len(self.knots_s)

    def values(self, times_s: FloatArray) -> FloatArray:
        """Cardinal functions (n, m) at `times_s` (n,), held at the ends."""
        inside = np.clip(times_s, self.knots_s[0], self.knots_s[-1])
        identity = np.eye(len(self.knots_s))
        if self.smooth:
            return SplineCurve.through(self.knots_s, identity).value(inside)
        return LagrangeCurve(self.knots_s, identity, 2).value(inside)

    def curve(self, coefficients: FloatArray, epoch: Epoch, span_s: tuple[float, float]) -> Curve:
        """Return the curve through the knots, over seconds from `epoch`; its span is theirs."""
        knots = self.knots_s + (self.epoch - epoch)
        if self.smooth:
            return SplineCurve.through(knots, coefficients)
        return LagrangeCurve(knots, read_only(coefficients), 2)
