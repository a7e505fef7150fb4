"""Least-squares points of some image points: lines of sight first, then image residuals."""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import FlagArray, FloatArray
from geoposition.flags import Flag, has_result
from geoposition.rays import Rays
from geoposition.triangulate import kernels
from geoposition.triangulate.part import Part, PartResult, Scene
from geoposition.triangulate.start import height_range_m
from geoposition.triangulate.weights import model_covariances, systematic_part, with_errors

RAY_TOLERANCE_M: Final = 1.0
"""How far the height may move before lines of sight are made anew."""
STEP_TOLERANCE_M: Final = 1e-3
"""A Gauss–Newton step below this leaves less than a micrometre."""
MORE_RAYS: Final = 3
"""How often lines of sight are made anew at most."""

_MOST_STEPS: Final = 6


def _first_heights(scene: Scene, part: Part) -> FloatArray:
    """Heights (n,) from the parallax between each point's first and last image."""
    n = len(part.start) - 1
    height = np.full(n, float(np.mean(height_range_m(list(scene.models)))))
    several = np.flatnonzero(np.diff(part.start) >= 2)
    first, last = part.start[several], part.start[several + 1] - 1
    code = part.product[first] * len(scene.models) + part.product[last]
    for pair in np.unique(code):
        a, b = divmod(int(pair), len(scene.models))
        guess = scene.start_of(a, b)
        if guess is None:
            continue
        mine = code == pair
        height[several[mine]] = guess.heights_m(
            part.image_px[first[mine]], part.image_px[last[mine]]
        )
    return height


def _rays(scene: Scene, part: Part, height_m: FloatArray) -> Rays:
    """Lines of sight of all observations, each at its point's height."""
    m = len(part.product)
    out = Rays(np.empty((m, 3)), np.empty((m, 3)), np.empty(m, dtype=np.uint8))
    height = height_m[part.point]
    for k in range(len(scene.models)):
        rows = np.flatnonzero(part.product == k)
        if len(rows) == 0:
            continue
        rays = scene.models[k].rays(part.image_px[rows], height[rows])
        out.origin_ecef_m[rows] = rays.origin_ecef_m
        out.direction_ecef[rows] = rays.direction_ecef
        out.flag[rows] = rays.flag
    return out


def _weighted_rows(scene: Scene, part: Part, height_m: FloatArray) -> FloatArray:
    rows = np.empty((len(part.product), 2, 3))
    kernels.fill_rows(
        part.product,
        part.image_px,
        part.point,
        height_m,
        scene.fields,
        part.root,
        part.root_step,
        rows,
    )
    return rows


def _project(scene: Scene, part: Part, geodetic: FloatArray, ray_flag: FlagArray) -> FloatArray:
    """Observed − projected image points; an observation that cannot be projected is flagged."""
    residual = np.full((len(part.product), 2), np.nan)
    usable = has_result(ray_flag) & np.isfinite(geodetic[:, 2])[part.point]
    ground = geodetic[part.point]
    for k in range(len(scene.models)):
        rows = np.flatnonzero((part.product == k) & usable)
        if len(rows) == 0:
            continue
        seen = scene.models[k].ground_to_image(ground[rows])
        residual[rows] = part.image_px[rows] - seen.image_px
        ray_flag[rows] = np.where(has_result(seen.flag), ray_flag[rows], seen.flag)
    return residual


def solve_part(scene: Scene, part: Part) -> PartResult:
    """Intersect the points of `part`, each with all the observations that can be used."""
    n, rows_of_part = len(part.start) - 1, len(part.product)
    out = PartResult(
        geodetic=np.full((n, 3), np.nan),
        covariance_enu_m2=np.full((n, 3, 3), np.nan),
        residual_px=np.full(n, np.nan),
        rays=np.zeros(n, dtype=np.int64),
        convergence_rad=np.full(n, np.nan),
        flag=np.full(n, Flag.TOO_FEW_RAYS, dtype=np.uint8),
        image_residual_px=np.full((rows_of_part, 2), np.nan),
        redundancy=np.full((rows_of_part, 2, 2), np.nan),
        systematic_enu_m2=np.full((n, 3, 3), np.nan),
    )
    ray_flag = np.empty(rows_of_part, dtype=np.uint8)
    height = _first_heights(scene, part)
    systematic_px2 = model_covariances(scene, part, height)
    noisy = part
    if systematic_px2 is not None:
        part = with_errors(noisy, systematic_px2)
    todo = np.arange(n)
    for _ in range(1 + MORE_RAYS):
        some, rows = part.of_points(todo)
        rays = _rays(scene, some, height[todo])
        position, angle = np.empty((len(todo), 3)), np.empty(len(todo))
        flag = np.empty(len(todo), dtype=np.uint8)
        kernels.from_rays(
            some.start,
            _weighted_rows(scene, some, height[todo]),
            rays.origin_ecef_m,
            rays.direction_ecef,
            rays.flag,
            scene.min_convergence_rad,
            np.empty((len(rows), 2)),
            position,
            angle,
            flag,
        )
        out.geodetic[todo], out.flag[todo], out.convergence_rad[todo] = position, flag, angle
        ray_flag[rows] = rays.flag
        moved = np.abs(position[:, 2] - height[todo]) > RAY_TOLERANCE_M
        height[todo] = np.where(np.isfinite(position[:, 2]), position[:, 2], height[todo])
        todo = todo[moved]
        if len(todo) == 0:
            break
    if systematic_px2 is not None:
        # Once more, at the heights found.
        systematic_px2 = model_covariances(scene, part, height)
        assert systematic_px2 is not None
        part = with_errors(noisy, systematic_px2)
    out.image_residual_px[:] = _least_residuals(
        scene, part, height, out.geodetic, out.flag, ray_flag
    )
    weighted = _weighted_rows(scene, part, height)
    kernels.finish(
        part.start,
        weighted,
        part.root,
        part.root_step,
        ray_flag,
        out.image_residual_px,
        out.geodetic,
        out.covariance_enu_m2,
        out.redundancy,
        out.residual_px,
        out.rays,
        out.flag,
    )
    lost = ~has_result(out.flag)
    out.geodetic[lost] = np.nan
    out.systematic_enu_m2[~lost] = 0.0
    if systematic_px2 is not None:
        used = has_result(ray_flag) & ~lost[part.point]
        out.systematic_enu_m2[:] = systematic_part(part, weighted, used, systematic_px2, out)
    out.image_residual_px[lost[part.point] | ~has_result(ray_flag)] = np.nan
    return out


def _least_residuals(
    scene: Scene,
    part: Part,
    height_m: FloatArray,
    geodetic: FloatArray,
    flags: FlagArray,
    ray_flag: FlagArray,
) -> FloatArray:
    """Gauss–Newton in the images: moves `geodetic`, updates both flags; the residuals."""
    residual = np.full((len(part.product), 2), np.nan)
    todo = np.flatnonzero(has_result(flags))
    for _ in range(_MOST_STEPS):
        some, rows = part.of_points(todo)
        position, flag, some_flag = geodetic[todo], flags[todo], ray_flag[rows]
        misfit = _project(scene, some, position, some_flag)
        step = np.empty(len(todo))
        kernels.image_step(
            some.start,
            _weighted_rows(scene, some, height_m[todo]),
            some.root,
            some.root_step,
            some_flag,
            misfit,
            position,
            step,
            flag,
        )
        geodetic[todo], flags[todo], ray_flag[rows], residual[rows] = (
            position,
            flag,
            some_flag,
            misfit,
        )
        todo = todo[~(step <= STEP_TOLERANCE_M) & has_result(flag)]
        if len(todo) == 0:
            return residual
    flags[todo] = Flag.NOT_CONVERGED
    return residual
