"""Location of image points on terrain, for any `SensorModel`.

A model's ray is straight and exact at one height only (refraction bends it, light takes time,
a rational polynomial has no rays at all). Two ways lead to the point that is exact at its own
height. Many points on a raster: the bending is fitted over the chunk, smooth as it is, the
raster follows the bent rays, and some of the found points are compared with the model itself.
Otherwise, or where they do not agree to `LATERAL_TOLERANCE_M`: rays are taken at a guessed
height, crossed, taken again at the height found, until what is left is below that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, IntArray, as_components
from geoposition.constants import WGS84_A_M
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.rays import Rays
from geoposition.sensor_model import GroundPoints, SensorModel
from geoposition.terrain import ConstantTerrain, Terrain
from geoposition.terrain.bending import fit_bend
from geoposition.terrain.extremes import finite_extremes
from geoposition.terrain.raster import RasterTerrain
from geoposition.terrain.series import Bend

Progress: TypeAlias = Callable[[int, int], None]

LATERAL_TOLERANCE_M: Final = 1e-4
_MOST_PASSES: Final = 12
_SAMPLE: Final = 64
_MANY: Final = 5000
"""Fewer points are located one by one: the fit costs more than it saves."""
_FEW: Final = 500
_LEAST_RATE: Final = 1e-9
"""Metres aside per metre of height that any model is supposed to bend, against division by 0."""


def locate(
    model: SensorModel,
    image_px: ArrayLike,
    terrain: Terrain,
    progress: Progress | None = None,
    chunk: int = 131_072,
) -> GroundPoints:
    """Locate `image_px` (..., 2) = (line, sample) on `terrain`: first crossings from above.

    Flags: the model's own where it has no ray, `OUTSIDE_IMAGE` kept with its result, the
    terrain's (`NODATA`, `OUTSIDE_TERRAIN`, `NO_INTERSECTION`), and `NOT_CONVERGED` where the
    found height and the ray never agree (a bent ray that just touches a ridge).

    Parameters
    ----------
    progress
        Called as progress(done, total) after each chunk.
    chunk
        Points worked on at a time; bounds the memory.
    """
    points = as_components(image_px, 2, "image points")
    if chunk < 1:
        raise ArgumentError(f"chunk: at least 1 point expected, got {chunk}")
    if isinstance(terrain, ConstantTerrain):
        return model.image_to_ground(points, terrain.height_m)
    shape = points.shape[:-1]
    flat = points.reshape(-1, 2)
    geodetic = np.empty((len(flat), 3))
    flag: FlagArray = np.empty(len(flat), dtype=np.uint8)
    guess_m = 0.5 * (model.height_range_m[0] + model.height_range_m[1])
    bend = None
    if isinstance(terrain, RasterTerrain) and len(flat) >= _MANY:
        bend = _fitted(model, flat, terrain, guess_m)
    for start in range(0, len(flat), chunk):
        part = slice(start, min(start + chunk, len(flat)))
        result = None
        if isinstance(terrain, RasterTerrain) and part.stop - part.start >= _FEW:
            if bend is not None:
                result = _locate_bent(model, flat[part], terrain, bend)
            if result is None and bend is not None and chunk < len(flat):
                # the fit over all points does not do here: one for this chunk may
                bend_here = _fitted(model, flat[part], terrain, guess_m)
                if bend_here is not None:
                    result = _locate_bent(model, flat[part], terrain, bend_here)
        if result is None:
            result = _locate(model, flat[part], terrain, guess_m)
        geodetic[part], flag[part] = result
        if progress is not None:
            progress(part.stop, len(flat))
    return GroundPoints(geodetic.reshape(*shape, 3), flag.reshape(shape))


def _fitted(
    model: SensorModel, image_px: FloatArray, terrain: RasterTerrain, guess_m: float
) -> Bend | None:
    """Fit how rays bend over the box of `image_px` and the heights that some of them find."""
    pick = np.linspace(0, len(image_px) - 1, _SAMPLE).astype(np.int64)
    few, _ = _locate(model, image_px[pick], terrain, guess_m)
    known = few[np.isfinite(few[:, 2]), 2]
    if not known.size:
        return None
    low, high = float(known.min()), float(known.max())
    slack = 0.3 * (high - low) + 50.0
    return fit_bend(model, image_px, 0.5 * (low + high), low - slack, high + slack)


def _locate_bent(
    model: SensorModel, image_px: FloatArray, terrain: RasterTerrain, bend: Bend
) -> tuple[FloatArray, FlagArray] | None:
    """Follow rays of fitted bending; none where the model does not confirm the result."""
    bend = bend._replace(image_px=np.ascontiguousarray(image_px))
    rays = model.rays(image_px, bend.height_m)
    crossing = terrain.first_crossing(rays, bend=bend)
    geodetic, flag = crossing.geodetic, crossing.flag
    check = _witnesses(geodetic[:, 2])
    if check.size:
        exact = model.image_to_ground(image_px[check], geodetic[check, 2]).geodetic
        if not np.max(_apart_m(exact, geodetic[check])) <= LATERAL_TOLERANCE_M:
            return None
    aside = rays.flag == Flag.OUTSIDE_IMAGE
    if aside.any():
        flag[aside & (flag == Flag.OK)] = Flag.OUTSIDE_IMAGE
    return geodetic, flag


def _witnesses(height_m: FloatArray) -> IntArray:
    """Pick some of the found points: spread over all, and the lowest and highest."""
    low, high, known = finite_extremes(height_m)
    if known == len(height_m):
        spread = np.linspace(0, known - 1, _SAMPLE).astype(np.int64)
    elif known:
        found = np.flatnonzero(np.isfinite(height_m))
        spread = found[np.linspace(0, known - 1, _SAMPLE).astype(np.int64)]
    else:
        return np.zeros(0, dtype=np.int64)
    return np.concatenate([[low, high], spread])


def _locate(
    model: SensorModel, image_px: FloatArray, terrain: Terrain, guess_m: float
) -> tuple[FloatArray, FlagArray]:
    rays = model.rays(image_px, guess_m)
    crossing = terrain.first_crossing(rays)
    geodetic = np.array(crossing.geodetic)
    flag: FlagArray = np.array(crossing.flag)
    rate = _bending_rate(model, image_px, guess_m, geodetic)
    away_m = np.abs(geodetic[:, 2] - guess_m)
    open_ = np.flatnonzero(away_m * rate > LATERAL_TOLERANCE_M)
    for _ in range(_MOST_PASSES - 1):
        if not open_.size:
            break
        height_m = geodetic[open_, 2]
        crossing = terrain.first_crossing(model.rays(image_px[open_], height_m), height_m)
        geodetic[open_], flag[open_] = crossing.geodetic, crossing.flag
        away_m = np.abs(crossing.geodetic[:, 2] - height_m)
        open_ = open_[away_m * rate > LATERAL_TOLERANCE_M]
    flag[open_] = Flag.NOT_CONVERGED
    geodetic[open_] = np.nan
    ok = flag == Flag.OK
    own = np.broadcast_to(rays.flag, ok.shape)
    flag[ok] = own[ok]
    return geodetic, flag


def _bending_rate(
    model: SensorModel, image_px: FloatArray, guess_m: float, geodetic: FloatArray
) -> float:
    """Metres aside per metre of height of the rays of `guess_m`, at worst of a few points.

    At the height found, or 100 m from the guess where that is nearer.
    """
    found = np.flatnonzero(np.isfinite(geodetic[:, 2]))
    if not found.size:
        return _LEAST_RATE
    pick = found[np.linspace(0, len(found) - 1, min(_SAMPLE, len(found))).astype(np.int64)]
    away_m = geodetic[pick, 2] - guess_m
    away_m = np.where(np.abs(away_m) < 100.0, 100.0, away_m)
    there = model.image_to_ground(image_px[pick], guess_m + away_m)
    straight = model.rays(image_px[pick], guess_m)
    aside_m = _distance_m(straight, geodetic_to_ecef(there.geodetic))
    rate = float(np.nanmax(aside_m / np.abs(away_m), initial=0.0))
    # the bending of a quadratic grows; twice the chord's rate covers its tangent's
    return max(2.0 * rate, _LEAST_RATE)


def _apart_m(a: FloatArray, b: FloatArray) -> FloatArray:
    """Distance of geodetic points close to each other, right to a percent."""
    lon, lat, height = np.moveaxis(a - b, -1, 0)
    lon = np.remainder(lon + np.pi, 2.0 * np.pi) - np.pi
    east, north = lon * np.cos(a[..., 1]) * WGS84_A_M, lat * WGS84_A_M
    distance: FloatArray = np.sqrt(east**2 + north**2 + height**2)
    return distance


def _distance_m(rays: Rays, points_ecef_m: FloatArray) -> FloatArray:
    offset = points_ecef_m - rays.origin_ecef_m
    along = np.sum(offset * rays.direction_ecef, axis=-1, keepdims=True)
    distance: FloatArray = np.linalg.norm(offset - along * rays.direction_ecef, axis=-1)
    return distance
