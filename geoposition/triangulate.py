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
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition import triangulate_kernels as kernels
from geoposition.arrays import FlagArray, FloatArray, IntArray, as_components
from geoposition.errors import ArgumentError
from geoposition.flags import Flag, has_result
from geoposition.intersect import MIN_CONVERGENCE_RAD, PairIntersections, intersect_pairs
from geoposition.observations import Ids, TiePoints
from geoposition.rays import Rays
from geoposition.sensor_model import SensorModel
from geoposition.triangulate_scale import image_scale
from geoposition.triangulate_start import HeightStart, height_range_m, height_start

Progress = Callable[[int, int], None]

RAY_TOLERANCE_M: Final = 1.0
"""How far the height may move before lines of sight are made anew."""
STEP_TOLERANCE_M: Final = 1e-3
"""A Gauss–Newton step below this leaves less than a micrometre."""
BLUNDER_FACTOR: Final = 10.0
"""How many times the usual deviation makes a residual a blunder."""

_MORE_RAYS: Final = 3
_MOST_STEPS: Final = 6
_CHUNK: Final = 1 << 17
_FEWEST_FOR_BLUNDERS: Final = 20


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
    `blunder_factor` times the median difference, and three sigmas; none with infinity.
    """
    ties.require_products(len(models))
    sigma = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), (2,))
    if not np.all((sigma > 0.0) & np.isfinite(sigma)):
        raise ArgumentError(f"sigma_px: positive pixels expected, got {sigma_px}")
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
        flag=np.full(n, Flag.TOO_FEW_RAYS, dtype=np.uint8),
        image_residual_px=np.full((rows, 2), np.nan),
        redundancy=np.full((rows, 2, 2), np.nan),
        point=point,
    )
    if n == 0:
        return out
    scene = _Scene(tuple(models), _fields(models, ties), min_convergence_rad)
    root = np.diag(1.0 / sigma)[None] if ties.covariance_px2 is None else None
    for first in range(0, n, _CHUNK):
        points = slice(first, min(first + _CHUNK, n))
        start = grouping.start[first : points.stop + 1]
        order = grouping.order[start[0] : start[-1]]
        inverse_root = root if root is not None else _inverse_roots(ties, order)
        part = _Part(
            start=start - start[0],
            product=ties.product[order],
            image_px=ties.image_px[order],
            root=inverse_root,
        )
        _intersect(scene, part, out, points, order)
        if progress is not None:
            progress(points.stop, n)
    _flag_blunders(out, ties, float(sigma.max()), blunder_factor)
    return out


def triangulate_pairs(
    first: SensorModel,
    second: SensorModel,
    first_px: ArrayLike,
    second_px: ArrayLike,
    min_convergence_rad: float = MIN_CONVERGENCE_RAD,
) -> PairIntersections:
    """Intersect dense matches of two images: row i of `first_px` (n, 2) with that of `second_px`.

    The fast way for millions: midpoints of the lines of sight, without image residuals and
    covariance. Lines of sight are exact within `RAY_TOLERANCE_M` of the point's height.
    """
    a = np.ascontiguousarray(as_components(first_px, 2, "image points")).reshape(-1, 2)
    b = np.ascontiguousarray(as_components(second_px, 2, "image points")).reshape(-1, 2)
    if len(a) != len(b):
        raise ArgumentError(f"a pair: as many points in both expected, got {len(a)}, {len(b)}")
    n = len(a)
    out = PairIntersections(np.empty((n, 3)), np.empty(n), np.empty(n, dtype=np.uint8))
    guess = height_start(first, second)
    middle = float(np.mean(height_range_m([first, second])))
    for begin in range(0, n, _CHUNK):
        end = min(begin + _CHUNK, n)
        part_a, part_b = a[begin:end], b[begin:end]
        height = np.full(end - begin, middle) if guess is None else guess.heights_m(part_a, part_b)
        found = _pairs(first, second, part_a, part_b, height, min_convergence_rad)
        out.geodetic[begin:end], out.miss_m[begin:end] = found.geodetic, found.miss_m
        out.flag[begin:end] = found.flag
        for _ in range(_MORE_RAYS):
            moved = np.flatnonzero(
                np.abs(out.geodetic[begin:end, 2] - height) > RAY_TOLERANCE_M
            )
            if len(moved) == 0:
                break
            height[moved] = out.geodetic[begin + moved, 2]
            found = _pairs(
                first, second, part_a[moved], part_b[moved], height[moved], min_convergence_rad
            )
            out.geodetic[begin + moved], out.miss_m[begin + moved] = found.geodetic, found.miss_m
            out.flag[begin + moved] = found.flag
    return out


def _pairs(
    first: SensorModel,
    second: SensorModel,
    first_px: FloatArray,
    second_px: FloatArray,
    height_m: FloatArray,
    min_convergence_rad: float,
) -> PairIntersections:
    return intersect_pairs(
        first.rays(first_px, height_m),
        second.rays(second_px, height_m),
        min_convergence_rad=min_convergence_rad,
    )


@dataclass(frozen=True, slots=True)
class _Scene:
    """The models, their image scales, and the height cubics of the pairs met so far."""

    models: tuple[SensorModel, ...]
    fields: FloatArray
    min_convergence_rad: float
    starts: dict[tuple[int, int], HeightStart | None] = field(default_factory=dict)

    def start_of(self, first: int, second: int) -> HeightStart | None:
        """Return the height cubic of two models, fitted when first asked for."""
        if (first, second) not in self.starts:
            fitted = height_start(self.models[first], self.models[second])
            self.starts[first, second] = fitted
        return self.starts[first, second]


@dataclass(frozen=True, slots=True)
class _Part:
    """Observations of some points, by point; `root` (1 or observations, 2, 2) is L⁻¹."""

    start: IntArray
    product: IntArray
    image_px: FloatArray
    root: FloatArray

    @property
    def root_step(self) -> int:
        return 0 if len(self.root) == 1 else 1

    @property
    def point(self) -> IntArray:
        """Point of each observation."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    def of_points(self, points: IntArray) -> tuple[_Part, IntArray]:
        """Return the part with `points` alone, and its observations' rows in this one."""
        counts = np.diff(self.start)[points]
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        rows = np.repeat(self.start[points] - start[:-1], counts) + np.arange(start[-1])
        root = self.root if self.root_step == 0 else self.root[rows]
        return _Part(start, self.product[rows], self.image_px[rows], root), rows


def _fields(models: Sequence[SensorModel], ties: TiePoints) -> FloatArray:
    """Image scales of the models that were used at all."""
    used = np.unique(ties.product)
    fields = np.zeros((len(models), *image_scale(models[int(used[0])]).shape))
    for k in used:
        fields[k] = image_scale(models[int(k)])
    return fields


def _inverse_roots(ties: TiePoints, order: IntArray) -> FloatArray:
    assert ties.covariance_px2 is not None
    return np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(ties.covariance_px2[order])))


def _first_heights(scene: _Scene, part: _Part) -> FloatArray:
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


def _rays(scene: _Scene, part: _Part, height_m: FloatArray) -> Rays:
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


def _weighted_rows(scene: _Scene, part: _Part, height_m: FloatArray) -> FloatArray:
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


def _project(
    scene: _Scene, part: _Part, geodetic: FloatArray, ray_flag: FlagArray
) -> FloatArray:
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


def _intersect(
    scene: _Scene, part: _Part, out: IntersectedPoints, points: slice, order: IntArray
) -> None:
    """Fill the rows `points` of `out`, and the rows `order` of what belongs to observations."""
    n = len(part.start) - 1
    geodetic, flags = out.geodetic[points], out.flag[points]
    ray_flag = np.empty(len(part.product), dtype=np.uint8)
    height = _first_heights(scene, part)
    todo = np.arange(n)
    for _ in range(1 + _MORE_RAYS):
        some, rows = part.of_points(todo)
        rays = _rays(scene, some, height[todo])
        ray_flag[rows] = rays.flag
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
        geodetic[todo], flags[todo] = position, flag
        out.convergence_rad[points][todo] = angle
        moved = np.abs(position[:, 2] - height[todo]) > RAY_TOLERANCE_M
        height[todo] = np.where(has_result(flag), position[:, 2], height[todo])
        todo = todo[moved]
        if len(todo) == 0:
            break
    residual = _least_residuals(scene, part, height, geodetic, flags, ray_flag)
    redundancy = np.full((len(order), 2, 2), np.nan)
    kernels.finish(
        part.start,
        _weighted_rows(scene, part, height),
        part.root,
        part.root_step,
        ray_flag,
        residual,
        geodetic,
        out.covariance_enu_m2[points],
        redundancy,
        out.residual_px[points],
        out.rays[points],
        flags,
    )
    lost = ~has_result(flags)
    geodetic[lost] = np.nan
    residual[lost[part.point] | ~has_result(ray_flag)] = np.nan
    out.image_residual_px[order] = residual
    out.redundancy[order] = redundancy


def _least_residuals(
    scene: _Scene,
    part: _Part,
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


def _flag_blunders(
    out: IntersectedPoints, ties: TiePoints, sigma_px: float, factor: float
) -> None:
    """Flag points with an observation whose residual is far from what its image's others have."""
    bad = np.zeros(len(out.ids), dtype=bool)
    for k in np.unique(ties.product):
        rows = ties.of_product(int(k))
        rows = rows[np.isfinite(out.image_residual_px[rows, 0])]
        if len(rows) < _FEWEST_FOR_BLUNDERS:
            continue
        off = out.image_residual_px[rows]
        distance = np.hypot(*(off - np.median(off, axis=0)).T)
        bad[out.point[rows[distance > max(factor * float(np.median(distance)), 3.0 * sigma_px)]]] = True
    out.flag[bad] = Flag.BLUNDER
    out.geodetic[bad] = np.nan
    out.covariance_enu_m2[bad] = np.nan
