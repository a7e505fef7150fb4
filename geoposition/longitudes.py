"""Longitudes across ±180°: made to follow each other, so that means and ranges are right."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray

_TURN: Final = 2.0 * math.pi


def unbroken(lon_rad: FloatArray) -> FloatArray:
    """Longitudes (...) within half a turn of their mean direction, which is within ±180°.

    Some may lie beyond ±180°; NaN stays.
    """
    east, north = np.sin(lon_rad), np.cos(lon_rad)
    known = np.isfinite(lon_rad)
    if not known.any():
        return np.array(lon_rad)
    middle = math.atan2(float(east[known].mean()), float(north[known].mean()))
    return near(lon_rad, middle)


def near(lon_rad: FloatArray, middle_rad: float) -> FloatArray:
    """Longitudes (...) moved by whole turns to within half a turn of `middle_rad`."""
    moved: FloatArray = lon_rad - _TURN * np.rint((lon_rad - middle_rad) / _TURN)
    return moved


def middle_of(geodetic: FloatArray) -> FloatArray:
    """Median (lon_rad, lat_rad, height_m) of points (n, 3), those with NaN left out."""
    known = geodetic[np.isfinite(geodetic).all(axis=-1)]
    if not len(known):
        return np.full(3, np.nan)
    lon = float(np.median(unbroken(known[:, 0])))
    lat, height = np.median(known[:, 1:], axis=0)
    return np.array([math.remainder(lon, _TURN), lat, height])
