"""Angles of ground points, by series about the scene's middle.

A scene is small: sines, cosines and arc sines of differences from its middle are short series,
which unlike the library's functions compile to vector instructions. A point too far for the
series gets the library's; no result depends on the other points.
"""

from __future__ import annotations

import math

from numba import njit

from geoposition.arrays import FloatArray
from geoposition.constants import WGS84_E2
from geoposition.pushbroom.lanes import (
    BX,
    FAST,
    GX,
    GY,
    GZ,
    HEIGHT,
    LANES,
    LINE,
    NX,
    NY,
    NZ,
    RADIUS,
    SAMPLE,
    ModelTable,
    full_vectors,
)

_TWO_PI = 2.0 * math.pi
_SMALL = 0.1
"""Radians up to which the series are right to rounding."""


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _middle(m: ModelTable) -> tuple[float, float]:
    """Longitude and (geocentric) latitude of the scene's middle; 0, 0 while there is none."""
    x, y, z = m.centre_ecef_m[0], m.centre_ecef_m[1], m.centre_ecef_m[2]
    return math.atan2(y, x), math.atan2(z, math.sqrt(x * x + y * y))


@njit(cache=True, error_model="numpy", fastmath=FAST, inline="always")
def _small_arcsine(s: float) -> float:
    """Arc sine by its series, right to rounding up to `_SMALL`."""
    q = s * s
    tail = 231.0 / 13312.0 + q * (143.0 / 10240.0)
    tail = 35.0 / 1152.0 + q * (63.0 / 2816.0 + q * tail)
    value: float = s * (1.0 + q * (1.0 / 6.0 + q * (3.0 / 40.0 + q * (5.0 / 112.0 + q * tail))))
    return value


@njit(cache=True, error_model="numpy", fastmath=FAST)
def write_geodetic(m: ModelTable, w: FloatArray, n: int, geodetic: FloatArray) -> None:
    """Longitude, latitude and height of the ground rows, into `geodetic` (n, 3).

    Angles are reckoned from the scene's middle: its points are within a series' reach, which
    unlike atan2 compiles to vector instructions. Points beyond it get their atan2.
    """
    lon_0, lat_0 = _middle(m)
    sin_lon, cos_lon = math.sin(lon_0), math.cos(lon_0)
    sin_lat, cos_lat = math.sin(lat_0), math.cos(lat_0)
    for i in range(full_vectors(n)):
        gx, gy, gz = w[GX * LANES + i], w[GY * LANES + i], w[GZ * LANES + i]
        radius, h = w[RADIUS * LANES + i], w[HEIGHT * LANES + i]
        p = math.sqrt(gx * gx + gy * gy)
        east = (gy * cos_lon - gx * sin_lon) / p
        ahead = gx * cos_lon + gy * sin_lon
        p *= 1.0 - WGS84_E2 * radius / (radius + h)
        north = (gz * cos_lat - p * sin_lat) / math.sqrt(p * p + gz * gz)
        lon = lon_0 + _small_arcsine(east)
        lon = lon - _TWO_PI if lon > math.pi else lon
        lon = lon + _TWO_PI if lon < -math.pi else lon
        w[NX * LANES + i] = lon
        w[NY * LANES + i] = lat_0 + _small_arcsine(north)
        far = max(abs(east), abs(north))
        w[NZ * LANES + i] = 1.0 if ahead < 0.0 else far
        w[BX * LANES + i] = p
    for i in range(n):
        if not w[NZ * LANES + i] <= _SMALL:  # at a pole NaN
            gx, gy, gz = w[GX * LANES + i], w[GY * LANES + i], w[GZ * LANES + i]
            w[NX * LANES + i] = math.atan2(gy, gx)
            w[NY * LANES + i] = math.atan2(gz, w[BX * LANES + i])
    for i in range(n):
        # gx is NaN where there is no result, and so is all that follows from it.
        geodetic[i, 0] = w[NX * LANES + i]
        geodetic[i, 1] = w[NY * LANES + i]
        geodetic[i, 2] = w[HEIGHT * LANES + i] + 0.0 * w[GX * LANES + i]


@njit(cache=True, error_model="numpy", fastmath=FAST)
def fill_normals(m: ModelTable, w: FloatArray, n: int) -> None:
    """Fill the normals at the longitudes and latitudes in rows `LINE`, `SAMPLE`.

    Reckoned from the scene's middle, by the series of sine and cosine of the differences.
    """
    lon_0, lat_0 = _middle(m)
    sin_lon_0, cos_lon_0 = math.sin(lon_0), math.cos(lon_0)
    sin_lat_0, cos_lat_0 = math.sin(lat_0), math.cos(lat_0)
    for i in range(full_vectors(n)):
        d = w[LINE * LANES + i] - lon_0
        b = w[SAMPLE * LANES + i] - lat_0
        far = max(abs(d), abs(b))
        q = d * d
        s = d * (1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q / 362880.0))))
        c = 1.0 + q * (
            -0.5 + q * (1.0 / 24.0 + q * (-1.0 / 720.0 + q * (1.0 / 40320.0 - q / 3628800.0)))
        )
        sin_lon = sin_lon_0 * c + cos_lon_0 * s
        cos_lon = cos_lon_0 * c - sin_lon_0 * s
        q = b * b
        s = b * (1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q / 362880.0))))
        c = 1.0 + q * (
            -0.5 + q * (1.0 / 24.0 + q * (-1.0 / 720.0 + q * (1.0 / 40320.0 - q / 3628800.0)))
        )
        cos_lat = cos_lat_0 * c - sin_lat_0 * s
        w[NX * LANES + i] = cos_lat * cos_lon
        w[NY * LANES + i] = cos_lat * sin_lon
        w[NZ * LANES + i] = sin_lat_0 * c + cos_lat_0 * s
        w[BX * LANES + i] = far
    for i in range(n):
        if not w[BX * LANES + i] <= _SMALL:
            lon, lat = w[LINE * LANES + i], w[SAMPLE * LANES + i]
            w[NX * LANES + i] = math.cos(lat) * math.cos(lon)
            w[NY * LANES + i] = math.cos(lat) * math.sin(lon)
            w[NZ * LANES + i] = math.sin(lat)
