"""Sinusoids in a series: the strongest lines with frequency, amplitude, phase and uncertainties.

Lines are taken one by one from the periodogram of what is left, then all are refined together by
least squares. The standard deviations are those of the least-squares solution with the residual
taken as white: the Cramér–Rao bound for such noise.

*Source*: Rife & Boorstyn 1974, IEEE Trans. Inf. Theory 20(5), 591–598.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError

_OVERSAMPLING: Final = 8
_LEAST: Final = 16
_ITERATIONS: Final = 30
_SETTLED_CYCLES: Final = 1e-7


@dataclass(frozen=True, slots=True)
class Sinusoid:
    """amplitude · cos(2 pi frequency t + phase), with standard deviations."""

    frequency_hz: float
    amplitude: float
    phase_rad: float
    sigma_frequency_hz: float
    sigma_amplitude: float
    sigma_phase_rad: float

    def at(self, times_s: FloatArray) -> FloatArray:
        """Values (n,) at `times_s` (n,)."""
        angle = 2.0 * np.pi * self.frequency_hz * times_s + self.phase_rad
        return np.asarray(self.amplitude * np.cos(angle))


def amplitude_spectrum(times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequencies (m,) and amplitudes (m, k) of `values` (n, k) at even `times_s`; Hann window.

    A pure line reaches its own amplitude, within 15 % where it falls between two frequencies.
    NaN count as zero after the mean and trend have been removed.
    """
    rest = detrended(times_s, values)
    window = np.hanning(len(times_s))[:, None]
    step = (times_s[-1] - times_s[0]) / (len(times_s) - 1)
    spectrum = np.abs(np.fft.rfft(rest * window, axis=0)) * (2.0 / window.sum())
    return np.fft.rfftfreq(len(times_s), step), spectrum


def detrended(times_s: FloatArray, values: FloatArray) -> FloatArray:
    """`values` (n, k) less their straight lines; 0 where they are NaN."""
    design = np.vander((times_s - times_s.mean()) / max(np.ptp(times_s), 1e-12), 2)
    out = np.zeros_like(values)
    for k in range(values.shape[1]):
        known = np.isfinite(values[:, k])
        if known.sum() > 2:
            line = np.linalg.lstsq(design[known], values[known, k], rcond=None)[0]
            out[known, k] = values[known, k] - design[known] @ line
    return out


def strongest(
    times_s: FloatArray,
    values: FloatArray,
    count: int,
    lowest_hz: float | None = None,
    significance: float = 4.0,
) -> tuple[Sinusoid, ...]:
    """Up to `count` lines of `values` (n,) at even `times_s` (n,), NaN left out; strongest first.

    A line is taken while its amplitude is over `significance` of its standard deviations and its
    frequency at least `lowest_hz`, by default two periods in the series. Lines
    closer than one period of the series are one.
    """
    known = np.isfinite(values)
    if known.sum() < _LEAST:
        raise ArgumentError(f"lines: at least {_LEAST} values expected, got {known.sum()}")
    span = float(times_s[-1] - times_s[0])
    step = span / (len(times_s) - 1)
    lowest = 2.0 / span if lowest_hz is None else lowest_hz
    rest = detrended(times_s, values[:, None])[:, 0]
    series = np.where(known, rest, 0.0)
    size = _OVERSAMPLING * len(times_s)
    grid = np.fft.rfftfreq(size, step)
    allowed = (grid >= lowest) & (grid <= 0.5 / step - 0.5 / span)
    found: list[float] = []
    fit = _Fit.of(times_s[known], rest[known], ())
    while len(found) < count and allowed.any():
        left = series.copy()
        left[known] = fit.residual
        power = np.abs(np.fft.rfft(left, size)) * allowed
        trial = _Fit.of(times_s[known], rest[known], [*found, float(grid[np.argmax(power)])])
        newest = trial.lines[-1]
        if not newest.amplitude > significance * newest.sigma_amplitude:
            break
        tried = np.array([line.frequency_hz for line in trial.lines])
        if len(tried) > 1 and np.min(np.diff(np.sort(tried))) < 1.0 / span:
            allowed &= np.abs(grid - grid[np.argmax(power)]) > 0.5 / span
            continue
        fit, found = trial, tried.tolist()
        for line in fit.lines:
            allowed &= np.abs(grid - line.frequency_hz) > 1.0 / span
    return tuple(sorted(fit.lines, key=lambda line: -line.amplitude))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    lines: tuple[Sinusoid, ...]
    residual: FloatArray

    @classmethod
    def of(cls, times: FloatArray, values: FloatArray, frequencies: Sequence[float]) -> _Fit:
        if not frequencies:
            return cls((), values)
        # about the middle frequency and phase are uncorrelated, and a small step is small
        middle = 0.5 * (times[0] + times[-1])
        t = times - middle
        span = max(float(np.ptp(times)), 1e-12)

        def design(f: FloatArray) -> FloatArray:
            angle = 2.0 * np.pi * np.outer(t, f)
            return np.concatenate([np.cos(angle), np.sin(angle), np.ones((len(t), 1))], axis=1)

        start = np.array(frequencies) * span
        cycles, m = start.copy(), len(start)
        for _ in range(_ITERATIONS):
            columns = design(cycles / span)
            solution = _solved(columns, values)
            a, b = solution[:m], solution[m : 2 * m]
            # the third parameter of a line is its number of cycles in the span
            turn = 2.0 * np.pi * t[:, None] / span
            slope = turn * (b * columns[:, :m] - a * columns[:, m : 2 * m])
            full = np.concatenate([columns, slope], axis=1)
            rest = values - columns @ solution
            step = _solved(full, rest)[2 * m + 1 :]
            moved = np.clip(cycles + np.clip(step, -0.2, 0.2), start - 0.5, start + 0.5)
            settled = np.max(np.abs(moved - cycles)) < _SETTLED_CYCLES
            if settled:
                break
            cycles = moved
        f = cycles / span
        freedom = max(len(t) - full.shape[1], 1)
        covariance = np.linalg.pinv(full.T @ full) * float(rest @ rest) / freedom
        lines = tuple(_line(k, m, f, a, b, covariance, span, middle) for k in range(m))
        return cls(lines, rest)


def _solved(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Least-squares solution; the columns are few and of like size, so normal equations do."""
    normal = columns.T @ columns
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    solved = np.linalg.lstsq(scale[:, None] * normal * scale, scale * (columns.T @ values), None)
    return np.asarray(scale * solved[0])


def _line(
    k: int,
    m: int,
    f: FloatArray,
    a: FloatArray,
    b: FloatArray,
    covariance: FloatArray,
    span: float,
    middle: float,
) -> Sinusoid:
    """Line `k`: a cos + b sin about the middle, as amplitude and phase at t = 0."""
    pick = np.array([k, m + k, 2 * m + 1 + k])
    own = covariance[np.ix_(pick, pick)]
    amplitude = float(np.hypot(a[k], b[k]))
    size = max(amplitude, 1e-300)
    unit = np.array([a[k], b[k]]) / size
    # phase at t = 0: atan2(−b, a) − 2 pi f middle
    gradient = np.array([b[k] / size**2, -a[k] / size**2, -2.0 * np.pi * middle / span])
    phase = np.arctan2(-b[k], a[k]) - 2.0 * np.pi * f[k] * middle
    return Sinusoid(
        float(f[k]),
        amplitude,
        float(np.remainder(phase + np.pi, 2.0 * np.pi) - np.pi),
        float(np.sqrt(own[2, 2])) / span,
        float(np.sqrt(unit @ own[:2, :2] @ unit)),
        float(np.sqrt(max(gradient @ own @ gradient, 0.0))),
    )
