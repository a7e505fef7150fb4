"""Lines in a series: found above a local noise floor, then refined by least squares.

The strongest line is fitted and taken out before the next one is sought, so neither leakage nor
the ghosts of uneven sampling count as lines; in the end all are adjusted together. A line is
a sin(2 pi f (t − t0) + phase), t0 the first epoch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FloatArray
from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.signal.noise_floor import (
    SMALLEST_BLOCK,
    false_alarm_probability,
    noise_floor,
)
from geoposition.sensors.attitude_determination.signal.spectrum import is_even, periodogram

_ITERATIONS: Final = 8
_CHUNK: Final = 8192
"""Samples adjusted at once: their rows stay in the cache."""
_ONE_LINE_BINS: Final = 2.0
"""Lines nearer than so many bins of the whole span are one line."""
_APART_BINS: Final = 8
_LEAKAGE: Final = 1e-3
"""Of one periodogram, lines are taken together if farther apart and not fainter than this."""


@dataclass(frozen=True, slots=True)
class Line:
    """One sinusoid in the units of the series, with standard deviations.

    `false_alarm` is the probability that noise alone brings such a peak anywhere in the band;
    `noise_density` the one-sided density (unit²/Hz) around it.
    """

    frequency_hz: float
    amplitude: float
    phase_rad: float
    sigma_frequency_hz: float
    sigma_amplitude: float
    sigma_phase_rad: float
    false_alarm: float
    noise_density: float


def find_lines(
    times_s: FloatArray,
    values: FloatArray,
    *,
    lowest_hz: float,
    highest_hz: float,
    false_alarm: float = 1e-3,
    most: int = 20,
) -> tuple[Line, ...]:
    """Lines of a detrended series `values` (n,) at increasing `times_s` (n,), strongest first.

    Sought between `lowest_hz` and `highest_hz`; `false_alarm` is the probability of any false
    line in white or slowly coloured noise. Standard deviations are those of least squares with
    the noise density found around the line: the Cramér–Rao bound of a single tone. *Source*:
    Rife & Boorstyn 1974, IEEE Trans. Inf. Theory 20, 591–598.
    """
    times = np.ascontiguousarray(times_s - times_s[0])
    data = np.ascontiguousarray(values - np.mean(values))
    span = float(times[-1]) * len(times) / (len(times) - 1)
    even = is_even(times)
    if even:
        times = np.linspace(0.0, times[-1], len(times))
    found = _Fit(np.empty(0), np.empty((0, 2)), np.empty((1, 1)))
    alarms: list[float] = []
    residual = data
    while True:
        grid, power = periodogram(times, residual, highest_hz)
        grid, power = grid[grid >= lowest_hz], power[grid >= lowest_hz]
        if len(grid) < 2 * SMALLEST_BLOCK:
            raise ArgumentError(f"lines: {span:.4g} s are too short for so narrow a band")
        bins = span * float(grid[1] - grid[0]) * len(grid)
        # Where a line was taken out the noise went with it.
        taken = _near(grid, found.frequency_hz, _ONE_LINE_BINS / span)
        floor, worth = noise_floor(grid[~taken], power[~taken], len(grid) / bins)
        floor, worth = (np.interp(grid, grid[~taken], known) for known in (floor, worth))
        ratio = np.where(taken, 0.0, power / floor)
        alarm = false_alarm_probability(ratio, worth, bins)
        new = _candidates(power, alarm, false_alarm, _APART_BINS * len(grid) / bins, even)
        new = new[: most - len(alarms)]
        if len(new) == 0:
            break
        alarms += [float(alarm[i]) for i in new]
        start = [_parabola(grid, power, i) for i in new]
        found = _adjust(times, data, np.append(found.frequency_hz, start), span)
        residual = data - _sum_of_lines(times, found.frequency_hz, found.parts)
    variance = np.interp(found.frequency_hz, grid, floor)
    return _lines(found, variance, alarms, 2.0 * span / len(times))


def _candidates(
    power: FloatArray, alarm: FloatArray, limit: float, apart: float, even: bool
) -> list[int]:
    """Bins of new lines, strongest first; of uneven series one at a time, for it has ghosts."""
    inner = np.zeros(len(power), dtype=bool)
    inner[1:-1] = (power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])
    inner[[0, -1]] = True
    significant = np.flatnonzero(inner & (alarm < limit))
    chosen: list[int] = []
    for i in significant[np.argsort(-power[significant])].tolist():
        # Fainter ones, or those close by, may be leakage: the next round tells.
        clear = not chosen or (
            even
            and power[i] > _LEAKAGE * power[chosen[0]]
            and min(abs(i - other) for other in chosen) > apart
        )
        if clear:
            chosen.append(i)
    return chosen


def _near(grid: FloatArray, frequencies: FloatArray, width: float) -> BoolArray:
    near = np.zeros(len(grid), dtype=bool)
    for frequency in frequencies:
        near |= np.abs(grid - frequency) < width
    return near


def _parabola(grid: FloatArray, power: FloatArray, best: int) -> float:
    if not 0 < best < len(grid) - 1:
        return float(grid[best])
    a, b, c = np.log(np.maximum(power[best - 1 : best + 2], np.finfo(float).tiny))
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend < 0.0 else 0.0
    return float(grid[best] + np.clip(shift, -0.5, 0.5) * (grid[1] - grid[0]))


# Least squares over (sine, cosine, frequency) of every line, and a constant ------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Lines (k,): frequencies, sine and cosine parts (k, 2), normal matrix (3 k + 1) squared."""

    frequency_hz: FloatArray
    parts: FloatArray
    normal: FloatArray


def _adjust(times: FloatArray, data: FloatArray, start_hz: FloatArray, span: float) -> _Fit:
    k = len(start_hz)
    f = np.ascontiguousarray(start_hz)
    normal, right = _normal_equations(times, data, f, np.zeros((k, 2)))
    linear = np.arange(3 * k + 1) % 3 != 2
    parts = np.linalg.lstsq(normal[np.ix_(linear, linear)], right[linear], rcond=1e-13)[0]
    parts = np.ascontiguousarray(parts[:-1].reshape(k, 2))
    for _ in range(_ITERATIONS):
        normal, right = _normal_equations(times, data, f, parts)
        step = np.linalg.lstsq(normal, right, rcond=1e-13)[0][:-1].reshape(k, 3)
        shift = np.clip(step[:, 2], -0.5 / span, 0.5 / span)
        f = f + shift
        parts = np.ascontiguousarray(parts + step[:, :2])
        # Quadratic convergence: after so small a step the next is nothing.
        if np.max(np.abs(shift)) * span < 1e-4:
            break
    return _Fit(f, parts, normal)


def _lines(
    fit: _Fit, variance: FloatArray, alarms: list[float], density_of_variance: float
) -> tuple[Line, ...]:
    inverse = np.linalg.pinv(fit.normal, rcond=1e-15, hermitian=True)
    lines = []
    for i, (frequency, (sine, cosine)) in enumerate(zip(fit.frequency_hz, fit.parts, strict=True)):
        amplitude = float(np.hypot(sine, cosine))
        # Rows: frequency, amplitude, phase by sine part, cosine part, frequency.
        jacobian = np.array(
            [
                [0.0, 0.0, 1.0],
                [sine / amplitude, cosine / amplitude, 0.0],
                [-cosine / amplitude**2, sine / amplitude**2, 0.0],
            ]
        )
        block = variance[i] * inverse[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        sigma = np.sqrt(np.einsum("ij,jk,ik->i", jacobian, block, jacobian))
        lines.append(
            Line(
                float(frequency),
                amplitude,
                float(np.arctan2(cosine, sine)),
                float(sigma[0]),
                float(sigma[1]),
                float(sigma[2]),
                alarms[i],
                float(variance[i] * density_of_variance),
            )
        )
    return tuple(sorted(lines, key=lambda line: -line.amplitude))


def _normal_equations(
    times: FloatArray, data: FloatArray, f: FloatArray, parts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Sum the normal matrix and right side over (sine, cosine, f) of all lines, and 1."""
    size = 3 * len(f) + 1
    normal, right = np.zeros((size, size)), np.zeros(size)
    for part, sine, cosine in _sines(times, f):
        t = times[part]
        rows = np.empty((size, len(t)))
        slope = parts[:, :1] * cosine - parts[:, 1:] * sine
        rows[0:-1:3], rows[1:-1:3] = sine, cosine
        rows[2:-1:3] = 2.0 * np.pi * t * slope
        rows[-1] = 1.0
        residual = data[part] - (parts[:, 0] @ sine + parts[:, 1] @ cosine)
        normal += rows @ rows.T
        right += rows @ residual
    return normal, right


def _sum_of_lines(times: FloatArray, f: FloatArray, parts: FloatArray) -> FloatArray:
    result = np.empty(len(times))
    for part, sine, cosine in _sines(times, f):
        result[part] = parts[:, 0] @ sine + parts[:, 1] @ cosine
    return result


def _sines(times: FloatArray, f: FloatArray) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
    """Sines and cosines (k, m) of all lines, chunk by chunk."""
    first = times[:_CHUNK]
    table = np.exp(2j * np.pi * np.outer(f, first))
    # Of steps even to rounding, the first chunk's waves serve the others, turned on.
    even = _unevenness(times) < 1e-6
    for start in range(0, len(times), _CHUNK):
        part = slice(start, start + _CHUNK)
        t = times[part]
        if even:
            wave = np.exp(2j * np.pi * f * (t[0] - first[0]))[:, None] * table[:, : len(t)]
        else:
            wave = np.exp(2j * np.pi * np.outer(f, t))
        yield part, np.ascontiguousarray(wave.imag), np.ascontiguousarray(wave.real)


def _unevenness(times: FloatArray) -> float:
    step = (times[-1] - times[0]) / (len(times) - 1)
    return float(np.ptp(np.diff(times)) / step)
