"""Least squares of gyro errors from the differences between star and gyro turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from geoposition.arrays import BoolArray, FloatArray, read_only
from geoposition.sensors.attitude_determination.checks.gyro_intervals import PARAMETERS, Intervals

_PRIOR: Final = np.repeat([1e-2, 1e-4, 0.3, 10.0], [3, 3, 9, 1])
"""Far wider than any gyro's errors (rad/s, rad/s², 1, s): what is not observable stays finite."""
_OBSERVED: Final = 0.5
"""A parameter is known if its sigma is less than this part of the prior."""
_PASSES: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class GyroFit:
    """Gyro errors `value` (16,) with `sigma`: bias, drift, S by rows, lag; NaN where unseen.

    `residuals_rad` and `suspicious` belong to the intervals of each head.
    """

    value: FloatArray
    sigma: FloatArray
    residuals_rad: tuple[FloatArray, ...]
    suspicious: tuple[BoolArray, ...]


def fit_gyro_errors(parts: list[Intervals], threshold: float) -> GyroFit:
    """Generalised least squares, with noise levels and blunders found on the way.

    Intervals off by more than `threshold` of the usual scatter are suspicious and count for
    nothing. Of an interval's variance 2 s is the star's, shared with its neighbours by −s, the
    rest the gyro's own walk.
    """
    star_noise, walk = 1.0, 0.0
    suspicious = [np.zeros(len(part.first), dtype=bool) for part in parts]
    value, covariance = np.zeros(PARAMETERS), np.eye(PARAMETERS)
    white: list[FloatArray] = []
    for _ in range(_PASSES):
        normal, right = np.diag(_PRIOR**-2), np.zeros(PARAMETERS)
        for part, bad in zip(parts, suspicious, strict=True):
            factor = _banded_noise(part, star_noise, walk, bad)
            design = part.whiten @ part.design
            seen = np.einsum("ij,nj->ni", part.whiten, part.difference_rad)
            for axis in range(3):
                solved = cho_solve_banded((factor, True), design[:, axis])
                normal += design[:, axis].T @ solved
                right += solved.T @ seen[:, axis]
        # Parameters differ by ten orders of magnitude: in units of the prior they are alike.
        scaled = normal * np.outer(_PRIOR, _PRIOR)
        covariance = np.linalg.inv(scaled) * np.outer(_PRIOR, _PRIOR)
        value = covariance @ right
        white = [
            np.einsum("ij,nj->ni", part.whiten, part.difference_rad - part.design @ value)
            for part in parts
        ]
        star_noise, walk = _noise_levels(parts, white, suspicious)
        usual = np.sqrt(2.0 * star_noise + walk)
        suspicious = [np.max(np.abs(r), axis=1) > threshold * usual for r in white]
        if all(np.all(bad) for bad in suspicious):
            suspicious = [np.zeros(len(bad), dtype=bool) for bad in suspicious]
    residuals = [part.difference_rad - part.design @ value for part in parts]
    value, sigma = _gyro_errors(value, np.sqrt(np.diag(covariance)))
    known = np.sqrt(np.diag(covariance)) < _OBSERVED * _PRIOR
    return GyroFit(
        read_only(np.where(known, value, np.nan)),
        read_only(np.where(known, sigma, np.nan)),
        tuple(residuals),
        tuple(suspicious),
    )


def _gyro_errors(value: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """From true = (I − E) measured − b, which the design has, to measured = (I + S) true + bias."""
    through = np.linalg.inv(np.eye(3) - value[6:15].reshape(3, 3))
    result, spread = value.copy(), sigma.copy()
    result[6:15] = (through - np.eye(3)).ravel()
    spread[6:15] = np.sqrt(through**2 @ sigma[6:15].reshape(3, 3) ** 2 @ through**2).ravel()
    for part in (slice(0, 3), slice(3, 6)):
        result[part] = through @ value[part]
        spread[part] = np.sqrt(through**2 @ sigma[part] ** 2)
    return result, spread


def _banded_noise(part: Intervals, star_noise: float, walk: float, bad: BoolArray) -> FloatArray:
    bands = np.zeros((2, len(part.first)))
    bands[0] = np.where(bad, 1e8, 1.0) * (2.0 * star_noise + walk)
    bands[1, :-1] = np.where(part.chained, -star_noise, 0.0)
    return np.asarray(cholesky_banded(bands, lower=True))


def _noise_levels(
    parts: list[Intervals], white: list[FloatArray], suspicious: list[BoolArray]
) -> tuple[float, float]:
    """Star's and gyro's variance in whitened units, from neighbouring intervals, robustly."""
    alone, summed = [], []
    for part, residual, bad in zip(parts, white, suspicious, strict=True):
        alone.append(residual[~bad].ravel())
        pair = part.chained & ~bad[1:] & ~bad[:-1]
        # In the sum of two neighbours the star sample between them drops out.
        summed.append((residual[1:] + residual[:-1])[pair].ravel())
    single = _robust_variance(np.concatenate(alone))
    double = _robust_variance(np.concatenate(summed)) if sum(map(len, summed)) > 10 else single
    walk = max(0.0, double - single)
    star = max(0.5 * (single - walk), 1e-3 * single, 1e-12)
    return star, min(walk, single)


def _robust_variance(values: FloatArray) -> float:
    if len(values) == 0:
        return 1.0
    return float((1.4826 * np.median(np.abs(values))) ** 2)
