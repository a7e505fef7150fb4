"""The rigorous push-broom model: camera, ephemeris and attitude together (T 2.1–2.2, P 9)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, as_components
from geoposition.attitude import Attitude
from geoposition.camera import Camera
from geoposition.corrections import Corrections
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import has_result
from geoposition.pushbroom import project, sight
from geoposition.pushbroom.lanes import ModelTable
from geoposition.pushbroom.pose_table import direction_table, margin_px, pose_table
from geoposition.rays import Rays
from geoposition.sensor_model import GroundPoints, ImagePoints

_START_GRID = 21
_START_LEVELS = 5
"""So many determine a cubic in the height; fewer leave it loose between the levels."""
_START_HEIGHT_MARGIN_M = 500.0


@dataclass(frozen=True, slots=True, eq=False)
class PushbroomModel:
    """Rigorous model of one push-broom image; a `SensorModel`.

    Ephemeris and attitude are Earth-fixed. `corrections` says what the camera's apparent
    directions still lack. The model answers for the image and a margin around it (5 % of its
    size, at least 100 px), as far as ephemeris and attitude reach: nothing is extrapolated.
    """

    camera: Camera
    ephemeris: Ephemeris
    attitude: Attitude
    corrections: Corrections
    height_range_m: tuple[float, float]
    _table: ModelTable = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        low, high = self.height_range_m
        if not -20e3 < low <= high < 100e3:
            raise ArgumentError(f"height range: metres, low to high, expected; got {low} .. {high}")
        object.__setattr__(self, "_table", _compile(self))

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (lines, samples)."""
        return self.camera.shape

    @property
    def covered_lines(self) -> tuple[float, float]:
        """First and last line for which there is a pose, the margin included."""
        return self._table.first_line, self._table.last_line

    def image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> GroundPoints:
        """Locate `image_px` (..., 2) on the surface of ellipsoidal height `height_m` (...)."""
        points, heights, step, shape = _flat(image_px, height_m)
        geodetic = np.empty((len(points), 3))
        flags: FlagArray = np.empty(len(points), dtype=np.uint8)
        sight.direct(self._table, points, heights, step, geodetic, flags)
        return GroundPoints(geodetic.reshape(*shape, 3), flags.reshape(shape))

    def ground_to_image(self, geodetic: ArrayLike) -> ImagePoints:
        """Project `geodetic` (..., 3) = (lon_rad, lat_rad, height_m) into the image."""
        points = as_components(geodetic, 3, "ground points")
        flat = _frozen(points.reshape(-1, 3))
        image = np.empty((len(flat), 2))
        flags: FlagArray = np.empty(len(flat), dtype=np.uint8)
        project.inverse(self._table, flat, image, flags)
        shape = points.shape[:-1]
        return ImagePoints(image.reshape(*shape, 2), flags.reshape(shape))

    def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
        """Lines of sight from the camera through the point of height `height_m` (...)."""
        points, heights, step, shape = _flat(image_px, height_m)
        origin, direction = np.empty((len(points), 3)), np.empty((len(points), 3))
        flags: FlagArray = np.empty(len(points), dtype=np.uint8)
        sight.rays(self._table, points, heights, step, origin, direction, flags)
        return Rays(origin.reshape(*shape, 3), direction.reshape(*shape, 3), flags.reshape(shape))


def _flat(
    image_px: ArrayLike, height_m: ArrayLike
) -> tuple[FloatArray, FloatArray, int, tuple[int, ...]]:
    """Points (n, 2), heights, and 0 or 1 as the step of the heights; the common shape."""
    points = as_components(image_px, 2, "image points")
    heights = np.asarray(height_m, dtype=np.float64)
    if heights.ndim == 0:
        return _frozen(points.reshape(-1, 2)), _frozen(heights.reshape(1)), 0, points.shape[:-1]
    try:
        shape = np.broadcast_shapes(points.shape[:-1], heights.shape)
    except ValueError:
        raise ArgumentError(
            f"heights: shape {heights.shape} does not fit image points {points.shape[:-1]}"
        ) from None
    flat = _frozen(np.broadcast_to(points, (*shape, 2)).reshape(-1, 2))
    return flat, _frozen(np.broadcast_to(heights, shape).reshape(-1)), 1, shape


def _frozen(array: FloatArray) -> FloatArray:
    """Return a contiguous read-only view: of one type always, so that kernels compile once."""
    view = np.ascontiguousarray(array).view()
    view.setflags(write=False)
    return view


def _compile(model: PushbroomModel) -> ModelTable:
    """Build the tables, then fit the start of the inverse location to the direct one."""
    camera, corrections = model.camera, model.corrections
    refraction = corrections.refraction
    pose = pose_table(camera, model.ephemeris, model.attitude)
    directions = direction_table(camera)
    bare = ModelTable(
        lines=camera.shape[0],
        samples=camera.shape[1],
        first_line=pose.first_line,
        last_line=pose.last_line,
        margin_px=margin_px(camera.shape[1]),
        pose_knots=pose.cubic.knots,
        pose_coefficients=pose.cubic.coefficients,
        pose_bins=pose.cubic.bins,
        pose_bin_origin=pose.cubic.bin_origin,
        pose_bin_scale=pose.cubic.bin_scale,
        pose_seconds=pose.seconds,
        ccd_first_sample=directions.first_sample,
        ccd_last_sample=directions.last_sample,
        ccd_start=directions.start,
        ccd_knots=directions.knots,
        ccd_coefficients=directions.coefficients,
        ccd_bins=directions.bins,
        ccd_bin_start=directions.bin_start,
        ccd_bin_origin=directions.bin_origin,
        ccd_bin_scale=directions.bin_scale,
        aberration=float(corrections.velocity_aberration),
        light_time=float(corrections.light_time),
        refraction_m=refraction.refractivity * refraction.scale_height_m if refraction else 0.0,
        scale_height_m=refraction.scale_height_m if refraction else 1.0,
        mean_range_m=0.0,
        R_local_ecef=np.eye(3),
        centre_ecef_m=np.zeros(3),
        extent_m=1.0,
        start=np.zeros((20, 2)),
    )
    return _with_start(bare, model.height_range_m)


def _with_start(table: ModelTable, height_range_m: tuple[float, float]) -> ModelTable:
    """Fit line and sample as cubics of local coordinates over the image and its margin."""
    margin = table.margin_px
    line = np.linspace(table.first_line, table.last_line, _START_GRID)
    sample = np.linspace(-margin, table.samples - 1 + margin, _START_GRID)
    heights = np.array(height_range_m)
    if heights[1] - heights[0] < _START_HEIGHT_MARGIN_M:
        heights = heights + np.array([-1, 1]) * _START_HEIGHT_MARGIN_M
    heights = np.linspace(heights[0], heights[1], _START_LEVELS)
    grid = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1).reshape(-1, 2)
    image = _frozen(np.tile(grid, (_START_LEVELS, 1)))
    height = _frozen(np.repeat(heights, len(grid)))
    origin, direction = np.empty((len(image), 3)), np.empty((len(image), 3))
    geodetic = np.empty((len(image), 3))
    flags: FlagArray = np.empty(len(image), dtype=np.uint8)
    sight.direct(table, image, height, 1, geodetic, flags)
    seen = has_result(flags)
    if seen.sum() < 40:
        raise GeometryError(
            "rigorous model: its lines of sight miss the Earth; "
            "wrong quaternion order, frame or look angles?"
        )
    sight.rays(table, image, height, 1, origin, direction, flags)
    ground = geodetic_to_ecef(geodetic[seen])
    image, origin = image[seen], origin[seen]
    centre = ground[np.argmin(np.sum((ground - ground.mean(axis=0)) ** 2, axis=1))]
    R_ecef_enu = enu_axes(_geodetic_of(centre, geodetic[seen], ground))
    local = (ground - centre) @ R_ecef_enu
    extent = float(np.max(np.abs(local)))
    start = np.linalg.lstsq(cubic_terms(local / extent), image, rcond=None)[0]
    mean_range = float(np.mean(np.linalg.norm(ground - origin, axis=1)))
    return table._replace(
        mean_range_m=mean_range,
        R_local_ecef=np.ascontiguousarray(R_ecef_enu.T),
        centre_ecef_m=centre,
        extent_m=extent,
        start=np.ascontiguousarray(start),
    )


def _geodetic_of(point: FloatArray, geodetic: FloatArray, ecef: FloatArray) -> FloatArray:
    result: FloatArray = geodetic[np.argmin(np.sum((ecef - point) ** 2, axis=1))]
    return result


def cubic_terms(p: FloatArray) -> FloatArray:
    """Return the 20 monomials of a cubic in p (..., 3), in the order the kernel evaluates them."""
    e, n, u = p[..., 0], p[..., 1], p[..., 2]
    one = np.ones_like(e)
    terms = [one, e, n, u, e * e, n * n, u * u, e * n, e * u, n * u]
    terms += [e**3, e * e * n, e * e * u, n**3, n * n * e, n * n * u, u**3, u * u * e, u * u * n]
    return np.stack([*terms, e * n * u], axis=-1)
