"""Ground points of image points seen by several models, rigorous and RPC alike.

For each point: a first height from the parallax (`triangulate_start`); lines of sight exact at
that height, intersected by least squares; once more, at the height found, where it moved by
more than `RAY_TOLERANCE_M` (at most three more times). Then Gauss–Newton on the image residuals
themselves, with all models' own projections, until a step is below `STEP_TOLERANCE_M`. The
residuals reported are those of the final point. Weights are the image points' covariances,
carried to the ground by `triangulate_scale`.

A line of sight used a metre off its height is wrong by some 0.2 mm (refraction), one of an RPC
by less than that; so the first Gauss–Newton step is tiny, and costs nothing beyond the
projection that the residuals need anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.intersect import MIN_CONVERGENCE_RAD
from geoposition.observations import Ids, TiePoints
from geoposition.sensor_model import SensorModel
from geoposition.triangulate.dense import triangulate_pairs
from geoposition.triangulate.solve import (
    RAY_TOLERANCE_M,
    STEP_TOLERANCE_M,
    Part,
    Scene,
    image_scales,
    inverse_roots,
    solve_part,
)

__all__ = [
    "BLUNDER_FACTOR",
    "RAY_TOLERANCE_M",
    "STEP_TOLERANCE_M",
    "IntersectedPoints",
    "triangulate",
    "triangulate_pairs",
]

Progress = Callable[[int, int], None]

BLUNDER_FACTOR: Final = 10.0
"""How many times the usual deviation makes a residual a blunder."""

_CHUNK: Final = 1 << 17
_FEWEST_FOR_BLUNDERS: Final = 20
_PER_POINT: Final = (
    "geodetic",
    "covariance_enu_m2",
    "residual_px",
    "rays",
    "convergence_rad",
    "flag",
)
_PER_ROW: Final = ("image_residual_px", "redundancy")


@dataclass(frozen=True, slots=True, eq=False)
class IntersectedPoints:
    """Intersected ground points (n), and what their observations (m rows) say of them.

    `ids` (n,), in the order of the tie points; `geodetic` (n, 3) = (lon_rad, lat_rad, height_m);
    `covariance_enu_m2` (n, 3, 3) from the image points' stated errors alone: the models' own
    errors are not in it; `residual_px` (n,) the root mean square over the point's rays of the
    length of the image residual; `rays` (n,) used; `convergence_rad` (n,) the largest angle
    between two of them; `flag` (n,). NaN where there is no result; a `BLUNDER` keeps its
    residuals alone.

    Per row of the tie points: `image_residual_px` (m, 2) observed − projected, `redundancy`
    (m, 2, 2) how an error of the observation shows in its residual, `point` (m,) the index of
    its ground point.
    """

    ids: Ids
    geodetic: FloatArray
    covariance_enu_m2: FloatArray
    residual_px: FloatArray
    rays: IntArray
    convergence_rad: FloatArray
    flag: FlagArray
    image_residual_px: FloatArray
    redundancy: FloatArray
    point: IntArray

    @property
    def sigma_enu_m(self) -> FloatArray:
        """Standard deviations east, north, up (n, 3)."""
        return np.sqrt(np.diagonal(self.covariance_enu_m2, axis1=1, axis2=2))


def triangulate(
    models: Sequence[SensorModel],
    ties: TiePoints,
    sigma_px: ArrayLike = 0.5,
    *,
    min_convergence_rad: float = MIN_CONVERGENCE_RAD,
    blunder_factor: float = BLUNDER_FACTOR,
    progress: Progress | None = None,
) -> IntersectedPoints:
    """Intersect the tie points of `models` by least squares of their image residuals.

    `sigma_px`, one number or (line, sample), is the standard deviation of the image points;
    `ties.covariance_px2` goes before it. An image point that a model cannot use is left out and
    the others are used. Flags: as in `intersect_rays`; `NOT_CONVERGED`; `BLUNDER` where a
    residual differs from its image's median residual (hence not by a common bias) by more than
    `blunder_factor` times the median difference, and by three `sigma_px`; none with infinity.
    """
    ties.require_products(len(models))
    sigma = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), (2,))
    if not np.all((sigma > 0.0) & np.isfinite(sigma)):
        raise ArgumentError(f"sigma_px: positive pixels expected, got {sigma}")
    grouping = ties.grouped()
    n, rows = len(grouping.ids), len(ties)
    point = np.empty(rows, dtype=np.int64)
    point[grouping.order] = np.repeat(np.arange(n), np.diff(grouping.start))
    out = IntersectedPoints(
        ids=grouping.ids,
        geodetic=np.full((n, 3), np.nan),
        covariance_enu_m2=np.full((n, 3, 3), np.nan),
        residual_px=np.full(n, np.nan),
        rays=np.zeros(n, dtype=np.int64),
        convergence_rad=np.full(n, np.nan),
        flag=np.empty(n, dtype=np.uint8),
        image_residual_px=np.full((rows, 2), np.nan),
        redundancy=np.full((rows, 2, 2), np.nan),
        point=point,
    )
    if n == 0:
        return out
    scene = Scene(tuple(models), image_scales(models, ties), min_convergence_rad)
    for first in range(0, n, _CHUNK):
        points = slice(first, min(first + _CHUNK, n))
        start = grouping.start[first : points.stop + 1]
        order = grouping.order[start[0] : start[-1]]
        if ties.covariance_px2 is None:
            root = np.diag(1.0 / sigma)[None]
        else:
            root = inverse_roots(ties.covariance_px2[order])
        part = Part(start - start[0], ties.product[order], ties.image_px[order], root)
        result = solve_part(scene, part)
        for name in _PER_POINT:
            getattr(out, name)[points] = getattr(result, name)
        for name in _PER_ROW:
            getattr(out, name)[order] = getattr(result, name)
        if progress is not None:
            progress(points.stop, n)
    _flag_blunders(out, ties, float(sigma.max()), blunder_factor)
    return out


def _flag_blunders(out: IntersectedPoints, ties: TiePoints, sigma_px: float, factor: float) -> None:
    """Flag points with an observation whose residual is far from what its image's others have."""
    bad = np.zeros(len(out.ids), dtype=bool)
    for k in np.unique(ties.product):
        rows = ties.of_product(int(k))
        rows = rows[np.isfinite(out.image_residual_px[rows, 0])]
        if len(rows) < _FEWEST_FOR_BLUNDERS:
            continue
        off = out.image_residual_px[rows]
        distance = np.hypot(*(off - np.median(off, axis=0)).T)
        bad[
            out.point[rows[distance > max(factor * float(np.median(distance)), 3.0 * sigma_px)]]
        ] = True
    out.flag[bad] = Flag.BLUNDER
    out.geodetic[bad] = np.nan
    out.covariance_enu_m2[bad] = np.nan
