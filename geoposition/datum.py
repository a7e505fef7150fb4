"""Coordinates of other people's maps: projected and geographic systems, heights above the geoid.

The only door to pyproj. Nothing is fetched: PROJ's network is off, and where a transformation
would need a grid that is not there, it is refused rather than done roughly. Geoid grids are
files that the user names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Final

import numpy as np
import pyproj
import pyproj.network
import rasterio
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray
from pyproj.enums import TransformDirection
from pyproj.exceptions import CRSError, ProjError
from rasterio.errors import RasterioError

from geoposition.arrays import FloatArray, as_components
from geoposition.errors import ArgumentError, MissingFileError, ProductError

_WGS84_3D: Final = "EPSG:4979"

# Coordinate reference systems ---------------------------------------------------------------


def to_crs(crs: str | int, geodetic: ArrayLike) -> FloatArray:
    """Coordinates (..., 3) in `crs` of WGS 84 points (..., 3) = (lon_rad, lat_rad, height_m).

    `crs` is whatever PROJ understands: an EPSG number, "EPSG:32631", WKT. The result is
    (easting, northing, height) in the units of `crs`, for geographic ones longitude and
    latitude in degrees, always in this order; (x, y, z) for a geocentric one. NaN where the
    transformation has no answer. An unknown system, or one that cannot be reached without
    grids that are absent (heights above a geoid: use `Geoid`), is an `ArgumentError`.
    """
    points = as_components(geodetic, 3, "geodetic")
    lon_deg, lat_deg = np.degrees(points[..., 0]), np.degrees(points[..., 1])
    return _run(crs, TransformDirection.FORWARD, lon_deg, lat_deg, points[..., 2])


def from_crs(crs: str | int, coordinates: ArrayLike) -> FloatArray:
    """WGS 84 points (..., 3) = (lon_rad, lat_rad, height_m) of `coordinates` (..., 3) in `crs`.

    The inverse of `to_crs`, with the same order, units and errors.
    """
    points = as_components(coordinates, 3, "coordinates")
    geodetic = _run(crs, TransformDirection.INVERSE, *np.moveaxis(points, -1, 0))
    geodetic[..., :2] = np.radians(geodetic[..., :2])
    return geodetic


def utm_epsg(lon_rad: float, lat_rad: float) -> int:
    """EPSG number of the WGS 84 UTM zone of a point, the zones of Norway and Svalbard included.

    Beyond 80° S and 84° N there is no zone: `ArgumentError`.
    """
    lon, lat = math.degrees(lon_rad), math.degrees(lat_rad)
    if not (math.isfinite(lon) and -80.0 <= lat <= 84.0):
        raise ArgumentError(
            f"UTM: latitude within 80° S and 84° N expected, got {lat:.3f}°; the polar "
            f"systems are EPSG:32661 and EPSG:32761"
        )
    lon = (lon + 180.0) % 360.0 - 180.0
    zone = int((lon + 180.0) // 6.0) % 60 + 1
    if 56.0 <= lat < 64.0 and 3.0 <= lon < 12.0:
        zone = 32
    elif lat >= 72.0 and 0.0 <= lon < 42.0:
        zone = 31 + 2 * int((lon + 3.0) // 12.0)
    return (32600 if lat >= 0.0 else 32700) + zone


def _run(
    crs: str | int, direction: TransformDirection, x: FloatArray, y: FloatArray, z: FloatArray
) -> FloatArray:
    try:
        out = _transformer(crs).transform(x, y, z, direction=direction)
    except ProjError as error:
        raise ArgumentError(f"coordinates in {_short(crs)}: {error}") from None
    result = np.stack([np.asarray(part, dtype=np.float64) for part in out], axis=-1)
    result[~np.all(np.isfinite(result), axis=-1)] = np.nan
    return result


@lru_cache(maxsize=32)
def _transformer(crs: str | int) -> pyproj.Transformer:
    pyproj.network.set_network_enabled(False)  # type: ignore[attr-defined]
    try:
        target = pyproj.CRS.from_user_input(crs)
    except CRSError:
        raise ArgumentError(f"unknown coordinate reference system {_short(crs)}") from None
    if len(target.axis_info) < 2:
        raise ArgumentError(f"{_short(crs)}: a horizontal coordinate reference system expected")
    try:
        return pyproj.Transformer.from_crs(_WGS84_3D, target, always_xy=True, allow_ballpark=False)
    except ProjError:
        raise ArgumentError(
            f"{_short(crs)} cannot be reached from WGS 84 with the grids at hand; for heights "
            f"above a geoid name the horizontal system and a geoid file"
        ) from None


def _short(crs: str | int) -> str:
    text = " ".join(str(crs).split())
    return repr(text if len(text) <= 60 else f"{text[:57]}...")


# The geoid ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Geoid:
    """A grid of geoid undulations: orthometric height + undulation = ellipsoidal height.

    `undulation_grid_m` (rows, columns), NaN where unknown, with nodes at latitude
    `lat0_rad` + row `lat_step_rad` and longitude `lon0_rad` + column `lon_step_rad`, both
    steps positive. `wraps` when the columns go around the globe.
    """

    undulation_grid_m: NDArray[np.float32]
    lon0_rad: float
    lat0_rad: float
    lon_step_rad: float
    lat_step_rad: float
    wraps: bool

    @classmethod
    def from_file(cls, path: str | PathLike[str]) -> Geoid:
        """Read any raster GDAL can, in geographic coordinates: .gtx, GeoTIFF, .bin, ...

        `MissingFileError` when it is not there, `ProductError` when it is no such grid.
        """
        if not Path(path).is_file():
            raise MissingFileError(path, "", "a geoid grid expected, there is no such file")
        try:
            with rasterio.open(path) as raster:
                band = raster.read(1, masked=True)
                scale, offset = raster.scales[0], raster.offsets[0]
                transform, crs = raster.transform, raster.crs
        except RasterioError:
            raise ProductError(
                path, "", "a geoid grid expected, not readable as a raster"
            ) from None
        if crs is not None and not crs.is_geographic:
            raise ProductError(path, "", "a geoid grid in longitude and latitude expected")
        if transform.b or transform.d or transform.a <= 0 or not transform.e or min(band.shape) < 2:
            raise ProductError(path, "geotransform", "a regular grid, not rotated, expected")
        grid = np.where(np.ma.getmaskarray(band), np.nan, band.data * scale + offset)
        rows, columns = grid.shape
        lat0_deg, lat_step_deg = transform.f + 0.5 * transform.e, transform.e
        if lat_step_deg < 0:
            grid = grid[::-1]
            lat0_deg, lat_step_deg = lat0_deg + (rows - 1) * lat_step_deg, -lat_step_deg
        if abs(lat0_deg) > 91 or abs(lat0_deg + (rows - 1) * lat_step_deg) > 91:
            raise ProductError(path, "geotransform", "latitudes in degrees expected")
        grid = np.ascontiguousarray(grid, dtype=np.float32)
        grid.setflags(write=False)
        return cls(
            undulation_grid_m=grid,
            lon0_rad=math.radians(transform.c + 0.5 * transform.a),
            lat0_rad=math.radians(lat0_deg),
            lon_step_rad=math.radians(transform.a),
            lat_step_rad=math.radians(lat_step_deg),
            wraps=abs(columns * transform.a - 360.0) < 0.5 * transform.a,
        )

    def undulation_m(self, geodetic: ArrayLike) -> FloatArray:
        """Undulation (...) at `geodetic` (..., 2 or 3), bilinear between nodes; NaN outside.

        Longitudes are taken modulo a turn. *Source*: as PROJ's `vgridshift`.
        """
        points = np.asarray(geodetic, dtype=np.float64)
        if points.ndim == 0 or points.shape[-1] not in (2, 3):
            raise ArgumentError(f"geodetic: shape (..., 2 or 3) expected, got {points.shape}")
        lon = np.ascontiguousarray(points[..., 0]).reshape(-1)
        lat = np.ascontiguousarray(points[..., 1]).reshape(-1)
        out = np.empty(lon.shape)
        _undulations(
            self.undulation_grid_m,
            self.lon0_rad,
            self.lat0_rad,
            self.lon_step_rad,
            self.lat_step_rad,
            self.wraps,
            lon,
            lat,
            out,
        )
        return out.reshape(points.shape[:-1])

    def ellipsoidal_from_orthometric(self, points: ArrayLike) -> FloatArray:
        """Points (..., 3) with ellipsoidal instead of orthometric heights; NaN outside."""
        return self._shifted(points, 1.0)

    def orthometric_from_ellipsoidal(self, points: ArrayLike) -> FloatArray:
        """Points (..., 3) with orthometric instead of ellipsoidal heights; NaN outside."""
        return self._shifted(points, -1.0)

    def _shifted(self, points: ArrayLike, sign: float) -> FloatArray:
        shifted = as_components(points, 3, "points").copy()
        shifted[..., 2] += sign * self.undulation_m(shifted)
        return shifted


@njit(cache=True, error_model="numpy")
def undulation_scalar(
    grid_m: NDArray[np.float32],
    lon0_rad: float,
    lat0_rad: float,
    lon_step_rad: float,
    lat_step_rad: float,
    wraps: bool,
    lon_rad: float,
    lat_rad: float,
) -> float:
    """Undulation at one point for other kernels; the arguments are the fields of `Geoid`."""
    rows, columns = grid_m.shape
    turn = 2.0 * math.pi
    x = (lon_rad - lon0_rad) / lon_step_rad
    x -= math.floor((lon_rad - lon0_rad) / turn + 1e-13) * (turn / lon_step_rad)
    y = (lat_rad - lat0_rad) / lat_step_rad
    last_x = float(columns) if wraps else columns - 1.0
    tolerance = 1e-8  # of a step: points on the edge, in rounding's reach
    if not (-tolerance <= x <= last_x + tolerance and -tolerance <= y <= rows - 1.0 + tolerance):
        return math.nan
    column = min(max(math.floor(x), 0), columns - (1 if wraps else 2))
    row = min(max(math.floor(y), 0), rows - 2)
    u = min(max(x - column, 0.0), 1.0)
    v = min(max(y - row, 0.0), 1.0)
    right = column + 1
    if right == columns:
        right = 0
    south = (1.0 - u) * grid_m[row, column] + u * grid_m[row, right]
    north = (1.0 - u) * grid_m[row + 1, column] + u * grid_m[row + 1, right]
    undulation_m: float = (1.0 - v) * south + v * north
    return undulation_m


@njit(cache=True, parallel=True, error_model="numpy")
def _undulations(
    grid_m: NDArray[np.float32],
    lon0_rad: float,
    lat0_rad: float,
    lon_step_rad: float,
    lat_step_rad: float,
    wraps: bool,
    lon_rad: FloatArray,
    lat_rad: FloatArray,
    out: FloatArray,
) -> None:
    for i in prange(lon_rad.size):
        out[i] = undulation_scalar(
            grid_m, lon0_rad, lat0_rad, lon_step_rad, lat_step_rad, wraps, lon_rad[i], lat_rad[i]
        )
