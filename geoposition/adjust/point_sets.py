"""Points of one role (control, check or tie) as the solution needs them: by sets of images.

Points seen by the same images have equations of the same shape, so they are handled together;
a set of images is also what one factor of the graph joins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from geoposition.adjust.scale_field import ScaleField, scale_fields
from geoposition.adjust.sights import Sights
from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.flags import Flag, has_result
from geoposition.longitudes import middle_of
from geoposition.observations import ControlPoints, Ids, TiePoints
from geoposition.sensor_model import SensorModel
from geoposition.triangulate import triangulate

Role = Literal["control", "check", "tie"]

_HEIGHT_MOVED_M: Final = 1.0
"""A line of sight used this far from its height is wrong by some 0.2 mm (refraction)."""


@dataclass(frozen=True, slots=True, eq=False)
class PointSet:
    """Points (n) of one role and their observations (rows), sorted by point.

    `start` (n + 1) delimits each point's rows; `source` (rows) are the rows of the given table.
    `root` (rows or 1, 2, 2) is L⁻¹ of the image points' covariance, one for all where they are
    equal. What is known of a point itself stands in `known_root` (n, k, 3), acting on ECEF
    metres, and `known_ecef_m` (n, 3): k is 3 for control, 1 for a height, 0 for nothing.
    `ecef_m` (n, 3) is where the point is now, `sights` has the lines of sight of all rows;
    `first_residual_px` (rows, 2) are the residuals with the models as they came; `fields` the
    images' scales, from which sights are made again.
    """

    role: Role
    ids: Ids
    start: IntArray
    product: IntArray
    source: IntArray
    image_px: FloatArray
    root: FloatArray
    known_root: FloatArray
    known_ecef_m: FloatArray
    ecef_m: FloatArray
    sights: Sights
    point_flag: FlagArray
    first_residual_px: FloatArray
    fields: Mapping[int, ScaleField]

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def point(self) -> IntArray:
        """Point of each row."""
        return np.repeat(np.arange(len(self.ids)), np.diff(self.start))

    @property
    def usable(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Rows with a line of sight, of points that can be used."""
        rows = has_result(self.sights.flag)
        return np.asarray(rows & has_result(self.point_flag)[self.point])

    def moved_to(self, ecef_m: FloatArray, models: Sequence[SensorModel]) -> PointSet:
        """Return the set with its points elsewhere; far from before, lines of sight are new."""
        old, new = ecef_to_geodetic(self.ecef_m)[:, 2], ecef_to_geodetic(ecef_m)[:, 2]
        sights = self.sights
        if np.any(np.abs(new - old) > _HEIGHT_MOVED_M):
            sights = all_sights(models, self.fields, self.product, self.image_px, new[self.point])
        return replace(self, ecef_m=ecef_m, sights=sights)


def all_sights(
    models: Sequence[SensorModel],
    fields: Mapping[int, ScaleField],
    product: IntArray,
    image_px: FloatArray,
    height_m: FloatArray,
) -> Sights:
    """Lines of sight of rows that belong to several images."""
    n = len(product)
    out = Sights(
        image_px,
        np.full((n, 3), np.nan),
        np.full((n, 3), np.nan),
        np.full((n, 2, 3), np.nan),
        np.full(n, Flag.BAD_INPUT, dtype=np.uint8),
    )
    for image in np.unique(product):
        rows = np.flatnonzero(product == image)
        k = int(image)
        some = Sights.of(models[k], fields[k], image_px[rows], height_m[rows])
        for name in ("origin_ecef_m", "direction_ecef", "scale", "flag"):
            getattr(out, name)[rows] = getattr(some, name)
    return out


def of_control(
    role: Role,
    models: Sequence[SensorModel],
    control: ControlPoints,
    sigma_px: ArrayLike,
    fields: Mapping[int, ScaleField] | None = None,
) -> PointSet:
    """Control or check points: all that have a ground position, measured in images or not.

    Control brings its ground covariance along; check points bring nothing, but a point seen in
    one image only has its height. `fields` are made here unless given.
    """
    image = control.image
    if image is None:
        raise ArgumentError(f"{role} points: measurements in images expected")
    image.require_products(len(models))
    order_of = {value: i for i, value in enumerate(control.ids.tolist())}
    point = np.array([order_of[value] for value in image.ids.tolist()], dtype=np.int64)
    order = np.lexsort((image.product, point))
    counts = np.bincount(point, minlength=len(control))
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    ecef = geodetic_to_ecef(control.geodetic)
    axes = enu_axes(control.geodetic)
    if role == "control":
        inverse = np.linalg.inv(np.linalg.cholesky(control.covariance_enu_m2))
        known_root = inverse @ axes.transpose(0, 2, 1)
    else:
        known_root = np.empty((len(control), 0, 3))
    product, px = image.product[order], image.image_px[order]
    scales = scale_fields(models, product) if fields is None else fields
    heights = np.repeat(control.geodetic[:, 2], counts)
    flag = np.where(counts > 0, Flag.OK, Flag.TOO_FEW_RAYS).astype(np.uint8)
    return PointSet(
        role=role,
        ids=control.ids,
        start=start,
        product=product,
        source=order.astype(np.int64),
        image_px=px,
        root=_roots(image, order, sigma_px),
        known_root=np.ascontiguousarray(known_root),
        known_ecef_m=ecef,
        ecef_m=ecef.copy(),
        sights=all_sights(models, scales, product, px, heights),
        point_flag=flag,
        first_residual_px=_misfit_px(models, product, px, np.repeat(control.geodetic, counts, 0)),
        fields=scales,
    )


def of_ties(
    models: Sequence[SensorModel],
    ties: TiePoints,
    sigma_px: ArrayLike,
    height_m: FloatArray | None = None,
    height_sigma_m: FloatArray | None = None,
    fields: Mapping[int, ScaleField] | None = None,
) -> PointSet:
    """Tie points, where they intersect now; by point, in the order they first appear.

    `height_m` and `height_sigma_m` (n), NaN where unknown, are the ground's known heights.
    """
    ties.require_products(len(models))
    grouping = ties.grouped()
    start, order, n = grouping.start, grouping.order, len(grouping.ids)
    found = triangulate(models, ties, sigma_px, blunder_factor=np.inf)
    product, px = ties.product[order], ties.image_px[order]
    flag = found.flag.copy()
    geodetic = found.geodetic.copy()
    lost = ~has_result(flag)
    if np.any(~lost):
        geodetic[lost] = middle_of(geodetic[~lost])
    else:
        geodetic[lost] = 0.0
    k = 0
    known_root = np.empty((n, 0, 3))
    known = geodetic.copy()
    if height_m is not None and height_sigma_m is not None:
        k = 1
        has = np.isfinite(height_m) & np.isfinite(height_sigma_m) & (height_sigma_m > 0.0)
        up = enu_axes(geodetic)[:, :, 2]
        weight = np.where(has, 1.0 / np.where(has, height_sigma_m, 1.0), 0.0)
        known_root = (up * weight[:, None])[:, None, :]
        known[has, 2] = height_m[has]
    counts = np.diff(start)
    ecef = geodetic_to_ecef(geodetic)
    scales = scale_fields(models, product) if fields is None else fields
    return PointSet(
        role="tie",
        ids=grouping.ids,
        start=start,
        product=product,
        source=order,
        image_px=px,
        root=_roots(ties, order, sigma_px),
        known_root=np.ascontiguousarray(known_root),
        known_ecef_m=geodetic_to_ecef(known) if k else ecef,
        ecef_m=ecef,
        sights=all_sights(models, scales, product, px, np.repeat(geodetic[:, 2], counts)),
        point_flag=flag,
        first_residual_px=found.image_residual_px[order],
        fields=scales,
    )


def _misfit_px(
    models: Sequence[SensorModel], product: IntArray, image_px: FloatArray, geodetic: FloatArray
) -> FloatArray:
    """Observed less projected (rows, 2) of the ground of each row."""
    out = np.full(image_px.shape, np.nan)
    for image in np.unique(product):
        rows = np.flatnonzero(product == image)
        out[rows] = image_px[rows] - models[int(image)].ground_to_image(geodetic[rows]).image_px
    return out


def _roots(image: TiePoints, order: IntArray, sigma_px: ArrayLike) -> FloatArray:
    if image.covariance_px2 is not None:
        roots = np.linalg.inv(np.linalg.cholesky(image.covariance_px2[order]))
        return np.ascontiguousarray(roots, dtype=np.float64)
    sigma = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), (2,))
    if not np.all((sigma > 0.0) & np.isfinite(sigma)):
        raise ArgumentError(f"sigma_px: positive pixels expected, got {sigma}")
    return np.diag(1.0 / sigma)[None]


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Points (n) of a set seen by the same `images` (m): `points` (n), their `rows` (n, m)."""

    images: tuple[int, ...]
    points: IntArray
    rows: IntArray


def groups(points: PointSet, images: int) -> list[Group]:
    """Split the usable observations by the images that see each point.

    A point that its observations do not determine (one image, nothing known) is left out.
    """
    rows = np.flatnonzero(points.usable)
    if len(rows) == 0:
        return []
    point = points.point[rows]
    counts = np.bincount(point, minlength=len(points))
    first = np.concatenate([[0], np.cumsum(counts)])
    least = 2 if points.known_root.shape[1] < 3 and points.role != "check" else 1
    result = []
    for m in np.unique(counts[counts >= least]):
        these = np.flatnonzero(counts == m)
        own = rows[first[these][:, None] + np.arange(m)]
        seen = points.product[own]
        code, inverse = _codes(seen, images)
        order = np.argsort(inverse, kind="stable")
        ends = np.cumsum(np.bincount(inverse))
        for index, part in enumerate(np.split(order, ends[:-1])):
            images_of = tuple(int(i) for i in code[index])
            result.append(Group(images_of, these[part], own[part]))
    return result


def _codes(seen: IntArray, images: int) -> tuple[IntArray, IntArray]:
    """Distinct rows of `seen` (n, m) and which of them each row is."""
    m = seen.shape[1]
    if (images + 1) ** m < 2**62:
        code = seen @ (images + 1) ** np.arange(m, dtype=np.int64)
        _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
        return seen[first], inverse
    rows, inverse = np.unique(seen, axis=0, return_inverse=True)
    return rows, inverse.reshape(-1)
