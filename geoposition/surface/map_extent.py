"""The extent of ground points on a map, where the map does not break between them.

A system in degrees breaks at ±180°, where it is continued beyond, and at the poles, where it is
of no use. A projected one may break anywhere: at ±180° a Mercator map of the world does.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.datum import to_crs
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import GeometryError
from geoposition.longitudes import middle_of, near, unbroken
from geoposition.surface.dsm import is_geographic

_HALF_TURN_DEG: Final = 180.0
_MOST_STRETCH: Final = 50.0
_STEP_RAD: Final = 1e-6
_POLAR: Final = "a polar system (EPSG:3413, 3031, 32661, 32761) shows it whole"


def map_extent(crs: str, geodetic: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest map coordinates (2,), (2,) of ground points (n, 3).

    Degrees of longitude follow each other, so that they may lie beyond ±180°.

    Raises
    ------
    GeometryError
        The map breaks within the points, or shows none of them.
    """
    place = to_crs(crs, geodetic)[:, :2]
    if is_geographic(crs):
        place[:, 0] = np.degrees(unbroken(np.radians(place[:, 0])))
    if not np.isfinite(place).all(axis=1).any():
        raise GeometryError(f"the scene cannot be shown in {crs[:60]}")
    low, high = np.nanmin(place, axis=0), np.nanmax(place, axis=0)
    if is_geographic(crs):
        if high[0] - low[0] > _HALF_TURN_DEG:
            raise GeometryError(
                f"the scene lies around a pole, where longitudes are of no use: {_POLAR}"
            )
        return low, high
    true_m = float(np.linalg.norm(np.ptp(geodetic_to_ecef(_known(geodetic)), axis=0)))
    units_per_m = _scale(crs, middle_of(geodetic))
    extent = float(np.hypot(*(high - low)))
    if not extent <= _MOST_STRETCH * units_per_m * max(true_m, 1.0):
        raise GeometryError(
            f"the map {crs[:60]} breaks within the scene: a UTM zone goes across ±180° of "
            f"longitude; around a pole {_POLAR}"
        )
    return low, high


def near_degrees(place: FloatArray, middle_deg: float) -> FloatArray:
    """Map coordinates (n, 2 or 3) in degrees, longitudes moved by whole turns to `middle_deg`."""
    moved = place.copy()
    moved[:, 0] = np.degrees(near(np.radians(place[:, 0]), float(np.radians(middle_deg))))
    return moved


def _known(geodetic: FloatArray) -> FloatArray:
    return geodetic[np.isfinite(geodetic).all(axis=-1)]


def _scale(crs: str, middle: FloatArray) -> float:
    """Units of the map per metre at a point, the smaller of east and north: one may break."""
    steps = np.array([[0.0, 0.0, 0.0], [_STEP_RAD, 0.0, 0.0], [0.0, _STEP_RAD, 0.0]])
    points = middle + steps * (1.0 if middle[1] < 0.0 else -1.0)  # never over a pole
    place = to_crs(crs, points)[:, :2]
    ecef_m = geodetic_to_ecef(points)
    metres = np.linalg.norm(ecef_m[1:] - ecef_m[0], axis=1)
    units = np.linalg.norm(place[1:] - place[0], axis=1)
    return float(np.min(units / np.maximum(metres, 1e-9)))
