"""Means, mean squares and quantiles of errors, without the matching's own, and how well known."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from geoposition.arrays import BoolArray, FloatArray
from geoposition.calib_fields.intervals import Cells, Estimate

LEAST_POINTS: Final = 12
_CE: Final = 0.9
_NOISE_DOUBT: Final = 0.15
"""Relative uncertainty of the standard deviations that the matching states."""
_DENSITY: Final = 0.06
"""Share to either side of a quantile over which the density is taken."""
_FOLDS: Final = 8


def chess_board(place: FloatArray) -> BoolArray:
    """Choose half of the points: the dark fields of a chess board over the image."""
    low, size = place.min(axis=0), np.maximum(np.ptp(place, axis=0), 1.0)
    field = np.minimum(((place - low) / size * _FOLDS).astype(np.int64), _FOLDS - 1)
    held: BoolArray = field.sum(axis=1) % 2 == 1
    if not 0.2 < held.mean() < 0.8:
        held = np.arange(len(place)) % 2 == 1
    return held


def absolute_errors(
    cells: Cells, shift: FloatArray, noise_m2: FloatArray, reference_m: float
) -> tuple[dict[str, Estimate], dict[str, float]]:
    """Bias, RMSE and CE90 of shifts (n, 2) on the ground; and as measured, noise included."""
    estimates, raw = {}, {}
    for k, axis in enumerate("en"):
        mean = cells.mean(shift[:, k])
        estimates[f"bias_{axis}_m"] = mean.widened(reference_m)
        square = _mean_square(cells, shift[:, k], noise_m2[k])
        # what a constant error of the reference does to a mean square
        moved = float(np.hypot(2.0 * mean.mean * reference_m, np.sqrt(2.0) * reference_m**2))
        estimates[f"rmse_{axis}_m"] = square.widened(moved)
        raw[f"rmse_{axis}_m"] = float(np.sqrt(np.mean(shift[:, k] ** 2)))
    raw["ce90_m"] = float(np.quantile(np.hypot(*shift.T), _CE))
    estimates["ce90_m"] = _circular(cells, shift, noise_m2).widened(reference_m)
    return estimates, raw


def relative_errors(
    cells: Cells, residual: FloatArray, noise_px2: FloatArray, freedom: float
) -> tuple[dict[str, Estimate], dict[str, float]]:
    """Mx, My and the relative accuracy of residuals (n, 2); and as measured, noise included.

    `freedom` is the share of the variance that the fit behind the residuals has left.
    """
    estimates, raw = {}, {}
    for k, axis in enumerate("xy"):
        estimates[f"m_{axis}"] = _mean_square(cells, residual[:, k], noise_px2[k], freedom)
        raw[f"m_{axis}"] = float(np.sqrt(np.mean(residual[:, k] ** 2)))
    estimates["relative_px"] = _mean_square(
        cells, np.hypot(*residual.T), float(noise_px2.sum()), freedom
    )
    raw["relative_px"] = float(np.hypot(raw["m_x"], raw["m_y"]))
    return estimates, raw


def matching_noise(
    stated: FloatArray, residual: FloatArray, place: FloatArray, window_px: float
) -> FloatArray:
    """Variance (2,) of the matching: as stated, or less where neighbours agree better than that.

    Neighbours share lines as far as they can, so that a vibration does not count, but no pixels.
    """
    near = cKDTree(place).query_ball_point(place, 2.5 * window_px)
    first, second = [], []
    for k, others in enumerate(near):
        away = place[others] - place[k]
        apart = np.flatnonzero(np.abs(away).max(axis=1) >= window_px)
        if apart.size:
            first.append(k)
            second.append(others[apart[int(np.argmin(np.abs(away[apart, 0])))]])
    said: FloatArray = stated.mean(axis=0)
    if len(first) < LEAST_POINTS:
        return said
    difference = residual[first] - residual[second]
    result: FloatArray = np.minimum(said, 0.5 * np.mean(difference**2, axis=0))
    return result


def _mean_square(cells: Cells, error: FloatArray, own: float, freedom: float = 1.0) -> Estimate:
    """Mean square of errors without the matching's `own` variance."""
    found = cells.mean(error**2)
    doubt = 2.0 * _NOISE_DOUBT * own
    mean = max(found.mean / freedom - own, 0.0)
    return Estimate(mean, float(np.hypot(found.sigma, doubt)), found.freedom, squared=True)


def _circular(cells: Cells, shift: FloatArray, own: FloatArray) -> Estimate:
    """CE90 of errors drawn together to their scatter without the matching's."""
    middle = shift.mean(axis=0)
    scatter = np.maximum(shift.var(axis=0), 1e-12)
    shrink = np.sqrt(np.maximum(scatter - own, 0.0) / scatter)
    size = np.hypot(*(middle + shrink * (shift - middle)).T)
    radius = float(np.quantile(size, _CE))
    # deviation of a quantile: that of the share below it, over the density there
    below = cells.mean((size <= radius).astype(np.float64))
    low, high = np.quantile(size, [_CE - _DENSITY, _CE + _DENSITY])
    sampled = below.sigma * float(high - low) / (2.0 * _DENSITY)
    # where all sizes are alike the mean's own deviation is left
    moved = max(cells.mean(shift[:, k]).sigma for k in (0, 1))
    doubt = _NOISE_DOUBT * float(own.mean()) / max(radius, float(np.sqrt(own.mean())), 1e-12)
    return Estimate(radius, float(np.sqrt(sampled**2 + moved**2 + doubt**2)), below.freedom)


def held_out_mean(cells: Cells, left_out: FloatArray, held: BoolArray) -> Estimate:
    """Mean over held-out points; the fit's own deviation counts as much as theirs.

    Which points are held out is chance, so that smooth errors are scatter here.
    """
    there, here = cells.mean(left_out, held, 0), cells.mean(left_out, ~held, 0)
    sigma = float(np.hypot(there.sigma, here.sigma))
    return Estimate(there.mean, sigma, min(there.freedom, here.freedom))
