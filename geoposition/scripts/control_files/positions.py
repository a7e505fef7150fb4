"""From a file's own system to WGS 84: projections, geoid heights, heights from a DEM."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray
from geoposition.datum import Geoid, from_crs
from geoposition.ellipsoid import enu_axes
from geoposition.errors import ArgumentError, ProductError
from geoposition.flags import has_result
from geoposition.scripts.control_files.parts import WGS84, GroundTable
from geoposition.terrain import RasterTerrain

_GEOGRAPHIC: Final = ("EPSG:4326", "EPSG:4979", "OGC:CRS84")


@dataclass(frozen=True, slots=True)
class Heights:
    """Where heights come from: `geoid` makes the file's ellipsoidal, `dem` gives missing ones."""

    geoid: Path | None = None
    dem: Path | None = None
    dem_geoid: Path | None = None


def geodetic_of(ground: GroundTable, heights: Heights) -> FloatArray:
    """WGS 84 positions (n, 3), radians and metres above the ellipsoid.

    A point without a usable position is a `ProductError` that names it: one wrong number among
    control is a mistake to mend, not to skip.
    """
    bad = np.flatnonzero(~np.isfinite(ground.xyz[:, :2]).all(axis=1))
    if len(bad):
        raise ground.refuse(int(bad[0]), "lon, lat, height expected, some is no number")
    missing = ~np.isfinite(ground.xyz[:, 2])
    if np.any(missing) and heights.dem is None:
        raise ground.refuse(
            int(np.argmax(missing)), "lon, lat, height expected, no height (or a DEM to take it)"
        )
    xyz = np.where(np.isfinite(ground.xyz), ground.xyz, 0.0)
    if ground.crs in _GEOGRAPHIC:
        wrong = np.flatnonzero((np.abs(xyz[:, 0]) > 360.0) | (np.abs(xyz[:, 1]) > 90.0))
        if len(wrong):
            row = int(wrong[0])
            raise ground.refuse(
                row,
                f"longitude and latitude in degrees expected, got {xyz[row, 0]:.10g} and "
                f"{xyz[row, 1]:.10g}: name the coordinate system (crs)",
            )
        geodetic = np.column_stack([np.radians(xyz[:, :2]), xyz[:, 2]])
    else:
        try:
            geodetic = from_crs(ground.crs, xyz)
        except ArgumentError as error:
            raise ProductError(ground.path, "crs", str(error)) from None
        lost = np.flatnonzero(~np.isfinite(geodetic).all(axis=1))
        if len(lost):
            raise ground.refuse(int(lost[0]), "a position inside its coordinate system expected")
    if heights.geoid is not None:
        given = ~missing
        geodetic[given] = Geoid.from_file(heights.geoid).ellipsoidal_from_orthometric(
            geodetic[given]
        )
    if np.any(missing):
        assert heights.dem is not None
        terrain = RasterTerrain(heights.dem, heights.dem_geoid)
        found = terrain.height_at(geodetic[missing])
        geodetic[missing, 2] = np.where(has_result(found.flag), found.height_m, np.nan)
    unknown = np.flatnonzero(~np.isfinite(geodetic[:, 2]))
    if len(unknown):
        row = int(unknown[0])
        where = "the DEM" if missing[row] else "the geoid grid"
        raise ground.refuse(row, f"a place inside {where} expected")
    return geodetic


def covariance_enu_m2(
    ground: GroundTable, geodetic: FloatArray, default_sigma_m: ArrayLike
) -> FloatArray:
    """Covariances (n, 3, 3), east, north, up; `default_sigma_m` where the file has none."""
    known = np.isfinite(ground.sigma_m)
    negative = np.flatnonzero(np.any(known & (ground.sigma_m <= 0.0), axis=1))
    if len(negative):
        raise ground.refuse(int(negative[0]), "positive standard deviations expected")
    default = np.broadcast_to(np.asarray(default_sigma_m, dtype=np.float64), ground.sigma_m.shape)
    sigma = np.where(known, ground.sigma_m, default)
    covariance = np.zeros((len(sigma), 3, 3))
    covariance[:, [0, 1, 2], [0, 1, 2]] = sigma**2
    if ground.sigma_axes == "ecef":
        axes = enu_axes(geodetic)
        covariance = axes.transpose(0, 2, 1) @ covariance @ axes
        # Rounding leaves it lopsided by its last digits.
        covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    return covariance


def is_geographic(crs: str) -> bool:
    """Whether x and y are longitude and latitude of WGS 84, in degrees."""
    return crs in _GEOGRAPHIC or crs == WGS84
