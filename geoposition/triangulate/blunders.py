"""Wrong image points found: the ray that is to blame, where three or more can tell.

Leaving an observation out changes the point, and the observation's deleted residual is R⁻¹ v,
v its residual and R its redundancy. With the image noise C, T = vᵀ (R C)⁻¹ v is by how much the
weighted squares sink without it (data snooping with a test of two degrees of freedom). The
worst one goes where the others then agree, and no other ray's going would make the rest agree;
where two could be to blame, or there are two rays only, the point as a whole is a blunder.

Models disagree by constants as well, which are no blunders: residuals are counted from their
medians, over the points seen by the same images. Their scale is the usual size of what is left.

*Source*: Baarda 1968, A testing procedure for use in geodetic networks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from geoposition.arrays import BoolArray, FloatArray, IntArray

_FEWEST: Final = 20
"""Points seen by the same images from which medians and scales are taken."""
_LEAST_SIGMAS: Final = 3.0
"""No residual below so many stated sigmas is a blunder, however well the others agree."""


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """What the tests look at, per observation (m): point, product, residual, redundancy.

    `used` (m,) are those that took part; `covariance_px2` (1 or m, 2, 2) the image noise.
    """

    point: IntArray
    product: IntArray
    residual_px: FloatArray
    redundancy: FloatArray
    used: BoolArray
    covariance_px2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Rows of the observations to leave out, and points that are blunders as a whole."""

    rays: IntArray
    points: IntArray


def find_blunders(seen: Observed, points: int, factor: float, tested: BoolArray) -> Verdict:
    """Test the points of the mask `tested` (points,); the others count in medians alone.

    `factor` is how many times the usual size of a residual makes one a blunder; for a ray of
    three or more, half of it counts in standard deviations. Points that few others share their
    images with are measured by all the others, or, where there are few at all, by the noise
    that was stated; with two rays they are not tested.
    """
    rays = np.bincount(seen.point[seen.used], minlength=points)
    group = _by_images(seen, points)
    counts = np.bincount(group[rays >= 2], minlength=int(group.max(initial=0)) + 1)
    order = np.flatnonzero(seen.used & (rays >= 2)[seen.point])
    order = order[np.lexsort((seen.product[order], seen.point[order]))]
    common = _common_medians(seen, order) if counts.max(initial=0) >= _FEWEST else None
    usual = 1.0
    bad_rays, bad_points = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    # The largest groups first: the small ones borrow their scale.
    for one in np.argsort(-counts, kind="stable"):
        rows = order[group[seen.point[order]] == one]
        if len(rows) == 0:
            continue
        several = int(rays[seen.point[rows[0]]])
        rows = rows.reshape(-1, several)
        mine = tested[seen.point[rows[:, 0]]]
        enough = len(rows) >= _FEWEST
        if not mine.any() or (several == 2 and not enough):
            continue
        residual = seen.residual_px[rows]
        if enough:
            residual = residual - np.median(residual, axis=0)
        elif common is not None:
            residual = residual - common[seen.product[rows[0]]]
        noise = np.broadcast_to(seen.covariance_px2, (len(seen.point), 2, 2))[rows]
        if several == 2:
            ray, whole = _of_two(residual, noise, factor)
        else:
            own, usual = seen.redundancy[rows] @ noise, _usual(residual, noise, usual, enough)
            ray, whole = _of_several(residual, noise, own, factor, usual)
        bad_rays.append(rows[mine & (ray >= 0), ray[mine & (ray >= 0)]])
        bad_points.append(seen.point[rows[mine & whole, 0]])
    return Verdict(np.concatenate(bad_rays), np.concatenate(bad_points))


def _by_images(seen: Observed, points: int) -> IntArray:
    """Give each set of images a number; that of each point (points,)."""
    products = int(seen.product.max(initial=-1)) + 1
    sees = np.zeros((points, products), dtype=np.bool_)
    sees[seen.point[seen.used], seen.product[seen.used]] = True
    return np.unique(np.packbits(sees, axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def _common_medians(seen: Observed, rows: IntArray) -> FloatArray:
    """Median residual (products, 2) of each image, over all points."""
    out = np.zeros((int(seen.product.max()) + 1, 2))
    for k in np.unique(seen.product[rows]):
        out[k] = np.median(seen.residual_px[rows[seen.product[rows] == k]], axis=0)
    return out


def _whitened_squares(residual_px: FloatArray, noise_px2: FloatArray) -> FloatArray:
    """Weighted squares (points, rays)."""
    plain = np.linalg.solve(noise_px2, residual_px[..., None])[..., 0]
    return np.asarray(np.sum(residual_px * plain, axis=-1), dtype=np.float64)


def _usual(residual: FloatArray, noise: FloatArray, before: float, enough: bool) -> float:
    """Variance of the residuals against the stated noise; of few points it is not told."""
    if not enough:
        return before
    squares = _whitened_squares(residual, noise).sum(axis=1)
    return float(np.median(squares) / chi2.median(2 * residual.shape[1] - 3))


def _of_two(residual: FloatArray, noise: FloatArray, factor: float) -> tuple[IntArray, BoolArray]:
    """Of two rays neither can be told: ray −1, and whether the point is a blunder."""
    distance = np.hypot(residual[..., 0], residual[..., 1])
    sigma = np.sqrt(np.max(np.diagonal(noise, axis1=2, axis2=3), axis=-1))
    limit = np.maximum(factor * np.median(distance, axis=0), _LEAST_SIGMAS * sigma)
    return np.full(len(residual), -1), (distance > limit).any(axis=1)


def _of_several(
    residual: FloatArray, noise: FloatArray, own: FloatArray, factor: float, usual: float
) -> tuple[IntArray, BoolArray]:
    """Ray to leave out (points,), −1 for none, and points without an answer.

    `own` (points, rays, 2, 2) are the residuals' own covariances, R C.
    """
    squares = _whitened_squares(residual, noise).sum(axis=1)
    own = 0.5 * (own + own.swapaxes(-1, -2))
    blind = ~(np.linalg.det(own) > 1e-6 * np.linalg.det(noise))
    own[blind] = np.eye(2)
    less = _whitened_squares(residual, own)
    less[blind] = 0.0

    rays = residual.shape[1]
    sigmas = 0.5 * factor
    limit = max(sigmas**2 * usual, _LEAST_SIGMAS**2)
    chance = float(chi2.sf(sigmas**2, 2))
    agree = max(float(chi2.isf(chance, 2 * rays - 5)) * usual, _LEAST_SIGMAS**2)

    ranked = np.argsort(less, axis=1)
    worst, at = ranked[:, -1], np.arange(len(residual))
    bad = less[at, worst] > limit
    settled = squares - less[at, worst] <= agree
    doubtful = squares - less[at, ranked[:, -2]] <= agree
    # With four rays or more another one may be wrong as well: the next look tells.
    clear = bad & ~doubtful & (settled | (rays > 3))
    return np.where(clear, worst, -1), bad & ~clear
