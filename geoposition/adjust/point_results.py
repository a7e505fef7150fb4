"""From the solved equations to what is told of each point, before and after."""

from __future__ import annotations

import numpy as np

from geoposition.adjust.adjustment import PointResults, Status
from geoposition.adjust.linear import Equations, linearise
from geoposition.adjust.point_sets import Group, PointSet
from geoposition.adjust.robust import redundancy, statistics
from geoposition.adjust.solve import Solved
from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes
from geoposition.flags import has_result
from geoposition.adjust.factors import GraphSolution

_STEPS = 3


def results_of(
    equations: Equations,
    points: PointSet,
    several: tuple[Group, ...],
    z: FloatArray,
    solution: GraphSolution,
    used: list[BoolArray],
    limits: list[FloatArray],
) -> PointResults:
    """Results of one set; `used` and `limits` per group."""
    n, m = len(points), len(points.product)
    nan = np.full((n, 3), np.nan)
    status = np.full(n, Status.UNUSABLE, dtype=np.uint8)
    statistic, limit = np.full(n, np.nan), np.full(n, np.nan)
    freedom, redundant = np.zeros(n, dtype=np.int64), np.zeros(n)
    ground, cov = nan.copy(), np.full((n, 3, 3), np.nan)
    after, before = nan.copy(), nan.copy()
    given = points.role != "tie"
    still = GraphSolution(np.zeros(len(z)), solution.covariance, solution.info_root)
    for g, group in enumerate(several):
        at = group.points
        linear = linearise(equations, points, group, z)
        q = linear.r.shape[1]
        statistic[at] = statistics([linear], still, [used[g]])[0] if q else 0.0
        redundant[at] = redundancy([linear], solution.covariance, [used[g]])[0] if q else 0.0
        freedom[at], limit[at] = q, limits[g]
        good = used[g] & linear.strong
        status[at[linear.strong]] = np.where(good, Status.USED, Status.REJECTED)[linear.strong]
        if points.role == "check":
            status[at[linear.strong]] = Status.CHECK
        alone, found = _intersected(equations, points, group, z)
        determined = alone.strong & np.isfinite(found[:, 0])
        ground[at[determined]] = ecef_to_geodetic(found[determined])
        covariance = alone.point_covariance(solution.covariance)
        axes = enu_axes(ecef_to_geodetic(np.where(determined[:, None], found, points.ecef_m[at])))
        turned = axes.transpose(0, 2, 1) @ covariance @ axes
        cov[at[determined]] = turned[determined]
        if given:
            after[at] = _enu(found - points.known_ecef_m[at], points.known_ecef_m[at])
            _, first = _intersected(equations, points, group, np.zeros(len(z)))
            before[at] = _enu(first - points.known_ecef_m[at], points.known_ecef_m[at])
            after[at[~determined]] = np.nan
    residual, residual_before = _image_residuals(equations, points, several, z, ground)
    back = np.argsort(points.source)
    return PointResults(
        ids=points.ids,
        status=status,
        statistic=statistic,
        freedom=freedom,
        limit=limit,
        redundancy=redundant,
        geodetic=ground,
        error_enu_m=after,
        error_before_enu_m=before,
        covariance_enu_m2=cov,
        point=points.point[back],
        product=points.product[back],
        image_px=points.image_px[back],
        residual_px=residual[back],
        residual_before_px=residual_before[back],
    )


def _intersected(equations: Equations, points: PointSet, group: Group, z: FloatArray):  # type: ignore[no-untyped-def]
    """Points from images alone, ECEF, with their last linear equations."""
    at = group.points
    ecef = points.ecef_m.copy()
    linear = linearise(equations, points, group, z, known=False)
    for _ in range(_STEPS):
        step = linear.step_m(np.zeros(len(z)))
        ecef[at] += np.where(np.abs(step) < 1e6, step, 0.0)
        moved = _placed(points, ecef)
        linear = linearise(equations, moved, group, z, known=False)
        if np.max(np.abs(step), initial=0.0) < 1e-4:
            break
    found = np.where(linear.strong[:, None], ecef[at], np.nan)
    return linear, found


def _placed(points: PointSet, ecef_m: FloatArray) -> PointSet:
    return PointSet(
        points.role,
        points.ids,
        points.start,
        points.product,
        points.source,
        points.image_px,
        points.root,
        points.known_root,
        points.known_ecef_m,
        ecef_m,
        points.sights,
        points.point_flag,
    )


def _enu(off: FloatArray, at_ecef: FloatArray) -> FloatArray:
    axes = enu_axes(ecef_to_geodetic(at_ecef))
    return np.asarray(np.einsum("nji,nj->ni", axes, off))


def _image_residuals(
    equations: Equations,
    points: PointSet,
    several: tuple[Group, ...],
    z: FloatArray,
    ground: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Residuals (rows, 2) of given, or of intersected, positions: after and before."""
    out = np.full((2, len(points.product), 2), np.nan)
    for which, at in enumerate((z, np.zeros(len(z)))):
        for group in several:
            place = points.ecef_m
            if points.role == "tie" and which == 1:
                _, found = _intersected(equations, points, group, at)
                place = points.ecef_m.copy()
                place[group.points] = found
            elif points.role != "tie":
                place = points.known_ecef_m
            for a, image in enumerate(group.images):
                rows: IntArray = group.rows[:, a]
                some = points.sights
                taken = type(some)(
                    some.image_px[rows],
                    some.origin_ecef_m[rows],
                    some.direction_ecef[rows],
                    some.scale[rows],
                    some.flag[rows],
                )
                residual, _, _ = equations.images[image].evaluate(
                    taken, place[points.point[rows]], equations.theta(at)
                )
                out[which, rows] = residual
    return out[0], out[1]


def nothing(role_ids: np.ndarray | None = None) -> PointResults:  # type: ignore[type-arg]
    """Results of no points."""
    del role_ids
    none, three = np.empty(0), np.empty((0, 3))
    whole = np.empty(0, dtype=np.int64)
    return PointResults(
        ids=whole,
        status=np.empty(0, dtype=np.uint8),
        statistic=none,
        freedom=whole,
        limit=none,
        redundancy=none,
        geodetic=three,
        error_enu_m=three,
        error_before_enu_m=three,
        covariance_enu_m2=np.empty((0, 3, 3)),
        point=whole,
        product=whole,
        image_px=np.empty((0, 2)),
        residual_px=np.empty((0, 2)),
        residual_before_px=np.empty((0, 2)),
    )
