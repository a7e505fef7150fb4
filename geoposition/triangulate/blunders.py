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
    images with are tested only where there are few points at all, against the stated noise.
    """
    rays = np.bincount(seen.point[seen.used], minlength=points)
    group = _by_images(seen, points)
    counts = np.bincount(group[rays >= 2], minlength=int(group.max(initial=0)) + 1)
    few = bool(counts.max(initial=0) < _FEWEST)
    order = np.flatnonzero(seen.used)
    order = order[np.lexsort((seen.product[order], seen.point[order]))]
    bad_rays, bad_points = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for one in np.unique(group[(rays >= 2) & tested]):
        rows = order[group[seen.point[order]] == one]
        several = int(rays[seen.point[rows[0]]])
        rows = rows.reshape(-1, several)
        enough = len(rows) >= _FEWEST
        if not enough and (several == 2 or not few):
            continue
        judge = _of_several if several > 2 else _of_two
        ray, whole = judge(seen, rows, factor, enough)
        mine = tested[seen.point[rows[:, 0]]]
        bad_rays.append(rows[mine & (ray >= 0), ray[mine & (ray >= 0)]])
        bad_points.append(seen.point[rows[mine & whole, 0]])
    return Verdict(np.concatenate(bad_rays), np.concatenate(bad_points))


def _by_images(seen: Observed, points: int) -> IntArray:
    """Give each set of images a number; that of each point (points,)."""
    products = int(seen.product.max(initial=-1)) + 1
    sees = np.zeros((points, products), dtype=np.bool_)
    sees[seen.point[seen.used], seen.product[seen.used]] = True
    return np.unique(np.packbits(sees, axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def _counted(seen: Observed, rows: IntArray, enough: bool) -> FloatArray:
    """Residuals (points, rays, 2) from their images' medians."""
    residual = seen.residual_px[rows]
    return residual - np.median(residual, axis=0) if enough else residual


def _of_two(
    seen: Observed, rows: IntArray, factor: float, enough: bool
) -> tuple[IntArray, BoolArray]:
    """Of two rays neither can be told: ray −1, and whether the point is a blunder."""
    distance = np.hypot(*np.moveaxis(_counted(seen, rows, enough), -1, 0))
    noise = np.broadcast_to(seen.covariance_px2, (len(seen.point), 2, 2))[rows]
    sigma = np.sqrt(np.max(np.diagonal(noise, axis1=2, axis2=3), axis=-1))
    limit = np.maximum(factor * np.median(distance, axis=0), _LEAST_SIGMAS * sigma)
    return np.full(len(rows), -1), (distance > limit).any(axis=1)


def _of_several(
    seen: Observed, rows: IntArray, factor: float, enough: bool
) -> tuple[IntArray, BoolArray]:
    """Ray to leave out (points,), −1 for none, and points without an answer."""
    residual = _counted(seen, rows, enough)
    noise = np.broadcast_to(seen.covariance_px2, (len(seen.point), 2, 2))[rows]
    plain = np.linalg.solve(noise, residual[..., None])[..., 0]
    squares = np.sum(residual * plain, axis=(1, 2))
    own = seen.redundancy[rows] @ noise
    own = 0.5 * (own + own.swapaxes(-1, -2))
    blind = ~(np.linalg.det(own) > 1e-6 * np.linalg.det(noise))
    own[blind] = np.eye(2)
    less = np.sum(residual * np.linalg.solve(own, residual[..., None])[..., 0], axis=-1)
    less[blind] = 0.0

    freedom = 2 * rows.shape[1] - 3
    usual = float(np.median(squares) / chi2.median(freedom)) if enough else 1.0
    sigmas = 0.5 * factor
    limit = max(sigmas**2 * usual, _LEAST_SIGMAS**2)
    chance = float(chi2.sf(sigmas**2, 2))
    agree = max(float(chi2.isf(chance, freedom - 2)) * usual, _LEAST_SIGMAS**2)

    ranked = np.argsort(less, axis=1)
    worst = ranked[:, -1]
    at = np.arange(len(rows))
    bad = less[at, worst] > limit
    settled = squares - less[at, worst] <= agree
    doubtful = squares - less[at, ranked[:, -2]] <= agree
    # With four rays or more another one may be wrong as well: the next look tells.
    clear = bad & ~doubtful & (settled | (rows.shape[1] > 3))
    return np.where(clear, worst, -1), bad & ~clear
