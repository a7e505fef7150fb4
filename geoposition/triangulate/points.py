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

from geoposition.arrays import BoolArray, FlagArray, FloatArray, IntArray
from geoposition.error_budget.model_error import ModelError
from geoposition.errors import ArgumentError
from geoposition.flags import Flag, has_result
from geoposition.intersect import MIN_CONVERGENCE_RAD
from geoposition.observations import Ids, TiePoints
from geoposition.sensor_model import SensorModel
from geoposition.triangulate.blunders import Observed, find_blunders
from geoposition.triangulate.dense import triangulate_pairs
from geoposition.triangulate.part import (
    Part,
    Scene,
    error_fields,
    image_scales,
    inverse_roots,
)
from geoposition.triangulate.solve import RAY_TOLERANCE_M, STEP_TOLERANCE_M, solve_part

__all__ = [
    "BLUNDER_FACTOR",
    "RAY_TOLERANCE_M",
    "STEP_TOLERANCE_M",
    "WEAK_CONVERGENCE_RAD",
    "IntersectedPoints",
    "triangulate",
    "triangulate_pairs",
]

Progress = Callable[[int, int], None]

BLUNDER_FACTOR: Final = 10.0
"""How many times the usual deviation makes a residual a blunder."""
WEAK_CONVERGENCE_RAD: Final = 0.05
"""Rays that converge by less, a base of 1/20 of the height, are weak: errors of an image point
are some forty times as large in height as in plan."""

_CHUNK: Final = 1 << 17
_PER_POINT: Final = (
    "geodetic",
    "covariance_enu_m2",
    "residual_px",
    "rays",
    "convergence_rad",
    "flag",
    "systematic_enu_m2",
)
_PER_ROW: Final = ("image_residual_px", "redundancy")
_LOST_WITH_BLUNDER: Final = ("geodetic", "covariance_enu_m2", "systematic_enu_m2")


@dataclass(frozen=True, slots=True, eq=False)
class IntersectedPoints:
    """Intersected ground points (n), and what their observations (m rows) say of them.

    `ids` (n,), in the order of the tie points; `geodetic` (n, 3) = (lon_rad, lat_rad, height_m);
    `covariance_enu_m2` (n, 3, 3) from the image points' errors and, where they were stated, the
    models' own; `systematic_enu_m2` (n, 3, 3) is the models' part of it, which is common to
    neighbouring points and does not average out. `residual_px` (n,) is the root mean square
    over the point's rays of the length of the image residual; `rays` (n,) used;
    `convergence_rad` (n,) the largest angle between two of them; `flag` (n,). NaN where there is
    no result; a `BLUNDER` keeps its residuals alone.

    Per row of the tie points: `image_residual_px` (m, 2) observed − projected, `redundancy`
    (m, 2, 2) how an error of the observation shows in its residual, `point` (m,) the index of
    its ground point, `rejected` (m,) whether it was found wrong and left out: it has no residual
    then, and its point is what the others give.
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
    systematic_enu_m2: FloatArray
    rejected: BoolArray

    @property
    def sigma_enu_m(self) -> FloatArray:
        """Standard deviations east, north, up (n, 3), of all stated errors."""
        return np.sqrt(np.diagonal(self.covariance_enu_m2, axis1=1, axis2=2))

    @property
    def random_enu_m2(self) -> FloatArray:
        """Covariance (n, 3, 3) from the image points alone: what differs from point to point."""
        return self.covariance_enu_m2 - self.systematic_enu_m2

    @property
    def weak(self) -> BoolArray:
        """Points (n,) whose rays meet, but at less than `WEAK_CONVERGENCE_RAD`."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sin(self.convergence_rad) < np.sin(WEAK_CONVERGENCE_RAD))


def triangulate(
    models: Sequence[SensorModel],
    ties: TiePoints,
    sigma_px: ArrayLike = 0.5,
    *,
    errors: Sequence[ModelError | None] | None = None,
    min_convergence_rad: float = MIN_CONVERGENCE_RAD,
    blunder_factor: float = BLUNDER_FACTOR,
    progress: Progress | None = None,
) -> IntersectedPoints:
    """Intersect the tie points of `models` by least squares of their image residuals.

    `sigma_px`, one number or (line, sample), is the standard deviation of the image points;
    `ties.covariance_px2` goes before it. `errors`, one or None for each model, are the models'
    own: they enter weights and covariances. An image point that a model cannot use is left out
    and the others are used.

    Of three rays or more a wrong one is found, left out and `rejected`; its point has the flag
    of the others. Flags: as in `intersect_rays`; `NOT_CONVERGED`; `BLUNDER` where which ray is
    wrong cannot be told: two rays whose residual differs from its image's median residual
    (hence not by a common bias) by more than `blunder_factor` times the median difference and
    by three `sigma_px`, or several that do not agree. Infinity looks for none. See `blunders`.
    """
    if errors is not None and len(errors) != len(models):
        raise ArgumentError(f"errors: one for each of {len(models)} models expected")
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
        systematic_enu_m2=np.full((n, 3, 3), np.nan),
        rejected=np.zeros(rows, dtype=np.bool_),
    )
    if n == 0:
        return out
    fields = image_scales(models, ties)
    own = error_fields(models, errors or [None] * len(models), fields)
    scene = Scene(tuple(models), fields, min_convergence_rad, own)
    task = _Task(scene, ties, _noise(ties, sigma), out)
    _solve_points(task, grouping.start, grouping.order, np.arange(n), progress)
    if np.isfinite(blunder_factor):
        _leave_out_blunders(task, blunder_factor)
    return out


def _noise(ties: TiePoints, sigma_px: FloatArray) -> FloatArray:
    """Covariance (1 or observations, 2, 2) of the image points."""
    if ties.covariance_px2 is not None:
        return ties.covariance_px2
    return np.diag(sigma_px**2)[None]


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What all passes over the points share."""

    scene: Scene
    ties: TiePoints
    noise_px2: FloatArray
    out: IntersectedPoints


def _solve_points(
    task: _Task, start: IntArray, order: IntArray, points: IntArray, progress: Progress | None
) -> None:
    """Solve `points`: those of the i-th are the tie points' rows `order[start[i]:start[i + 1]]`."""
    n = len(points)
    for first in range(0, n, _CHUNK):
        last = min(first + _CHUNK, n)
        begin = start[first : last + 1]
        rows = order[begin[0] : begin[-1]]
        noise = task.noise_px2 if len(task.noise_px2) == 1 else task.noise_px2[rows]
        part = Part(
            begin - begin[0],
            task.ties.product[rows],
            task.ties.image_px[rows],
            inverse_roots(noise),
        )
        result = solve_part(task.scene, part)
        for name in _PER_POINT:
            getattr(task.out, name)[points[first:last]] = getattr(result, name)
        for name in _PER_ROW:
            getattr(task.out, name)[rows] = getattr(result, name)
        if progress is not None:
            progress(last, n)


def _leave_out_blunders(task: _Task, factor: float) -> None:
    """Find wrong rays, solve their points without them, and look again."""
    out = task.out
    tested = has_result(out.flag)
    while tested.any():
        used = np.isfinite(out.image_residual_px[:, 0]) & has_result(out.flag)[out.point]
        seen = Observed(
            out.point,
            task.ties.product,
            out.image_residual_px,
            out.redundancy,
            used,
            task.noise_px2,
        )
        verdict = find_blunders(seen, len(out.ids), factor, tested)
        out.flag[verdict.points] = Flag.BLUNDER
        for name in _LOST_WITH_BLUNDER:
            getattr(out, name)[verdict.points] = np.nan
        out.rejected[verdict.rays] = True
        tested[:] = False
        tested[out.point[verdict.rays]] = True
        again = np.flatnonzero(tested)
        if len(again) == 0:
            return
        rows = np.flatnonzero(tested[out.point])
        for name in _PER_ROW:
            getattr(out, name)[rows] = np.nan
        rows = rows[~out.rejected[rows]]
        rows = rows[np.lexsort((task.ties.product[rows], out.point[rows]))]
        counts = np.bincount(out.point[rows], minlength=len(out.ids))[again]
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        _solve_points(task, start, rows, again, None)
        tested &= has_result(out.flag)
