"""From the solved equations to what is told of each point, before and after."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geoposition.adjust.adjustment import PointResults, Status
from geoposition.adjust.factors import GraphSolution
from geoposition.adjust.linear import Equations, Linear, linearise, taken
from geoposition.adjust.point_sets import Group, PointSet
from geoposition.adjust.robust import redundancy, statistics
from geoposition.arrays import BoolArray, FloatArray
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes

_MOST_STEPS = 4
_STEP_M = 1e-3
_FARTHEST_M = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Alone:
    """Points (n, 3), ECEF, from the images alone, NaN where undetermined; equations there."""

    ecef_m: FloatArray
    linear: Linear


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
    n = len(points)
    out = _empty(points)
    still = GraphSolution(np.zeros(len(z)), solution.covariance, solution.info_root)
    zero = np.zeros(len(z))
    tie = points.role == "tie"
    for g, group in enumerate(several):
        at = group.points
        # Ties already are where the images put them, but for a known height.
        known = points.known_root.shape[1] > 0
        alone = intersected(equations, points, group, z, 1 if tie and not known else _MOST_STEPS)
        linear = linearise(equations, points, group, z) if known else alone.linear
        strong = linear.strong
        out.statistic[at] = statistics([linear], still, [used[g]])[0]
        out.redundancy[at] = redundancy([linear], solution.covariance, [used[g]])[0]
        out.freedom[at], out.limit[at] = linear.r.shape[1], limits[g]
        if points.role == "check":
            out.status[at[strong]] = Status.CHECK
        else:
            out.status[at[strong]] = np.where(used[g], Status.USED, Status.REJECTED)[strong]
        found = np.isfinite(alone.ecef_m[:, 0])
        geodetic = ecef_to_geodetic(np.where(found[:, None], alone.ecef_m, points.ecef_m[at]))
        axes = enu_axes(geodetic)
        covariance = axes.transpose(0, 2, 1) @ alone.linear.point_covariance(solution.covariance)
        out.geodetic[at[found]] = geodetic[found]
        out.covariance_enu_m2[at[found]] = (covariance @ axes)[found]
        given = points.known_ecef_m[at]
        place = alone.ecef_m if tie else given
        if not tie:
            first = intersected(equations, points, group, zero, _MOST_STEPS)
            out.error_enu_m[at] = _enu(alone.ecef_m - given, given)
            out.error_before_enu_m[at] = _enu(first.ecef_m - given, given)
        _residuals(out.residual_px, equations, points, group, z, place)
    back = np.argsort(points.source)
    rows = ("point", "product", "image_px", "residual_px", "residual_before_px")
    assert len(out.status) == n
    return replace(out, **{name: getattr(out, name)[back] for name in rows})


def intersected(
    equations: Equations, points: PointSet, group: Group, z: FloatArray, steps: int
) -> Alone:
    """Points of `group` from the images alone; one in a single image keeps its height."""
    at = group.points
    ecef = points.ecef_m.copy()
    linear = linearise(equations, points, group, z, known=False)
    zero = np.zeros(len(z))
    for count in range(steps):
        step = linear.step_m(zero)
        near = np.linalg.norm(step, axis=1) < _FARTHEST_M
        ecef[at[near]] += step[near]
        if count == steps - 1 or not np.any(near) or np.max(np.abs(step[near])) < _STEP_M:
            break
        linear = linearise(equations, replace(points, ecef_m=ecef), group, z, known=False)
    return Alone(np.where(linear.strong[:, None], ecef[at], np.nan), linear)


def _residuals(
    out: FloatArray,
    equations: Equations,
    points: PointSet,
    group: Group,
    z: FloatArray,
    ecef_m: FloatArray,
) -> None:
    """Observed less projected ground `ecef_m` (n, 3) of the group's points, into their rows."""
    theta = equations.theta(z)
    for a, image in enumerate(group.images):
        rows = group.rows[:, a]
        sights = taken(points.sights, rows)
        out[rows] = equations.images[image].evaluate(sights, ecef_m, theta)[0]


def _enu(off: FloatArray, at_ecef: FloatArray) -> FloatArray:
    axes = enu_axes(ecef_to_geodetic(at_ecef))
    return np.asarray(np.einsum("nji,nj->ni", axes, off))


def _empty(points: PointSet) -> PointResults:
    """Results of points of which nothing is known yet, rows in the set's order."""
    n, m = len(points), len(points.product)

    def nan(*shape: int) -> FloatArray:
        return np.full(shape, np.nan)

    return PointResults(
        ids=points.ids,
        status=np.full(n, Status.UNUSABLE, dtype=np.uint8),
        statistic=nan(n),
        freedom=np.zeros(n, dtype=np.int64),
        limit=nan(n),
        redundancy=np.zeros(n),
        geodetic=nan(n, 3),
        error_enu_m=nan(n, 3),
        error_before_enu_m=nan(n, 3),
        covariance_enu_m2=nan(n, 3, 3),
        point=points.point,
        product=points.product,
        image_px=points.image_px,
        residual_px=nan(m, 2),
        residual_before_px=points.first_residual_px,
    )


def nothing() -> PointResults:
    """Results of no points."""
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
