"""Slow part of a series by a smoothing spline of stated cut-off, at any epochs.

A cubic smoothing spline minimises sum (y − f)² + p ∫ f''². Over samples `dt` apart it passes a
line of frequency f with the gain 1 / (1 + p dt (2 pi f)⁴): half at the cut-off, without phase,
and without asking for even steps. The remainder is a high-pass of the same cut-off.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

from geoposition.arrays import FloatArray, require_finite, require_increasing
from geoposition.errors import ArgumentError

_STEPS_PER_PERIOD: Final = 100
"""Samples per period of the cut-off that the spline is fitted to, at most four times as many."""


def low_pass(times_s: ArrayLike, values: ArrayLike, cutoff_hz: float) -> FloatArray:
    """Slow part of `values` (n,) or (n, k) at strictly increasing `times_s` (n,).

    `cutoff_hz` is the frequency of half gain. At the ends the spline runs on as a straight line,
    and the gain there is not quite as stated. *Source*: Reinsch 1967, Numer. Math. 10, 177–183.
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "low-pass times")
    series = require_finite(np.asarray(values, dtype=np.float64), "low-pass values")
    if series.ndim not in (1, 2) or len(series) != len(times):
        raise ArgumentError(f"low-pass values: {len(times)} rows expected, got {series.shape}")
    if not 0.0 < cutoff_hz < np.inf:
        raise ArgumentError("low-pass: a positive cut-off frequency expected")
    if len(times) < 3:
        return series.copy()
    columns = series.reshape(len(times), -1)
    size = int(_STEPS_PER_PERIOD * (times[-1] - times[0]) * cutoff_hz)
    if 4 * size < len(times) and size >= 16:
        # Far below the sampling rate block means say the same, and the equations stay sound.
        edges = np.linspace(0, len(times), size + 1).astype(np.int64)
        counts = np.diff(edges)
        knots = np.add.reduceat(times, edges[:-1]) / counts
        means = np.add.reduceat(columns, edges[:-1], axis=0) / counts[:, None]
        curve = CubicSpline(knots, _smoothed(knots, means, cutoff_hz), bc_type="natural")
        return np.asarray(curve(times).reshape(series.shape))
    return _smoothed(times, columns, cutoff_hz).reshape(series.shape)


def low_pass_gain(frequency_hz: ArrayLike, cutoff_hz: float) -> FloatArray:
    """Gain of `low_pass` for lines at `frequency_hz` (...), far from both ends."""
    ratio = np.asarray(frequency_hz, dtype=np.float64) / cutoff_hz
    return np.asarray(1.0 / (1.0 + ratio**4))


def _smoothed(times: FloatArray, columns: FloatArray, cutoff_hz: float) -> FloatArray:
    # In mean steps the numbers stay near 1, whatever the rate.
    step = (times[-1] - times[0]) / (len(times) - 1)
    penalty = (2.0 * np.pi * cutoff_hz * step) ** -4
    gaps = np.diff(times) / step
    # Second divided differences Q (n, n − 2) as three diagonals.
    before, after = 1.0 / gaps[:-1], 1.0 / gaps[1:]
    here = -(before + after)
    bands = np.zeros((3, len(times) - 2))
    bands[2] = (gaps[:-1] + gaps[1:]) / 3.0 + penalty * (before**2 + here**2 + after**2)
    bands[1, 1:] = gaps[1:-1] / 6.0 + penalty * (here[:-1] * before[1:] + after[:-1] * here[1:])
    bands[0, 2:] = penalty * after[:-2] * before[2:]
    bends = (
        before[:, None] * columns[:-2]
        + here[:, None] * columns[1:-1]
        + after[:, None] * columns[2:]
    )
    curvature = solveh_banded(bands, bends, check_finite=False, overwrite_ab=True)
    rough = np.zeros_like(columns)
    rough[:-2] += before[:, None] * curvature
    rough[1:-1] += here[:, None] * curvature
    rough[2:] += after[:, None] * curvature
    return np.asarray(columns - penalty * rough)
