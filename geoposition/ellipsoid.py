"""The WGS 84 ellipsoid: geodetic and Earth-centred coordinates, local axes, curvature.

The scalar functions are compiled, for use inside other kernels; the array functions run them
in parallel. Geodetic points are (lon_rad, lat_rad, height_m), heights above the ellipsoid.

The inverse solves, for the reduced latitude b of the foot point,
    p sin b − sqrt(1 − e²) z cos b = e² a sin b cos b,
in the tangent of the remaining angle. From Bowring's (1985) start, within 3e-5 rad at every
height, one second-order step leaves less than 1e-17 rad; where the start is worse (deep inside
the Earth) the step is repeated. What remains is the rounding of the coordinates themselves.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components
from geoposition.constants import WGS84_A_M, WGS84_B_M, WGS84_E2

_AXIS_RATIO: Final = WGS84_B_M / WGS84_A_M
_SECOND_E2_B: Final = WGS84_E2 / (1.0 - WGS84_E2) * WGS84_B_M
_STEP_IS_ENOUGH: Final = 1e-4
CENTRE_RADIUS_M: Final = 100e3
"""Within this of the Earth's centre the foot point is ill-defined: the answer is NaN."""


@njit(cache=True, error_model="numpy")
def geodetic_to_ecef_scalar(
    lon_rad: float, lat_rad: float, height_m: float
) -> tuple[float, float, float]:
    """Return ECEF (x, y, z) in metres of one geodetic point."""
    sin_lat = math.sin(lat_rad)
    cos_lat = math.cos(lat_rad)
    normal = WGS84_A_M / math.sqrt(1.0 - WGS84_E2 * sin_lat * sin_lat)
    p = (normal + height_m) * cos_lat
    return (
        p * math.cos(lon_rad),
        p * math.sin(lon_rad),
        (normal * (1.0 - WGS84_E2) + height_m) * sin_lat,
    )


@njit(cache=True, error_model="numpy")
def ecef_to_geodetic_scalar(x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
    """Return (lon_rad, lat_rad, height_m) of one ECEF point; NaN near the Earth's centre.

    On the axis the longitude is 0. *Source*: Bowring 1985, Survey Review 28(218), eq. 8, for
    the start; the step is the module's.
    """
    p2 = x_m * x_m + y_m * y_m
    r = math.sqrt(p2 + z_m * z_m)
    if not (r >= CENTRE_RADIUS_M and r < math.inf):
        return math.nan, math.nan, math.nan
    p = math.sqrt(p2)
    s = _AXIS_RATIO * z_m * (r + _SECOND_E2_B)
    c = p * r
    for _ in range(10):
        scale = 1.0 / math.sqrt(s * s + c * c)
        s *= scale
        c *= scale
        bend = WGS84_E2 * WGS84_A_M * s * c
        f = p * s - _AXIS_RATIO * z_m * c - bend
        slope = p * c + _AXIS_RATIO * z_m * s - WGS84_E2 * WGS84_A_M * (c * c - s * s)
        step = -f / slope
        step -= 1.5 * bend * step * step / slope
        s, c = s + step * c, c - step * s
        if abs(step) * WGS84_A_M < _STEP_IS_ENOUGH * r:
            break
    scale = 1.0 / math.sqrt(s * s + c * c)
    s *= scale
    c *= scale
    c_lat = _AXIS_RATIO * c
    norm = math.sqrt(s * s + c_lat * c_lat)
    # from the foot point, not from the centre: small differences, no large terms to cancel
    height = ((p - WGS84_A_M * c) * c_lat + (z_m - WGS84_B_M * s) * s) / norm
    return math.atan2(y_m, x_m), math.atan2(s, c_lat), height


@njit(cache=True, parallel=True, error_model="numpy")
def _geodetic_to_ecef(points: FloatArray, out: FloatArray) -> None:
    for i in prange(points.shape[0]):
        x, y, z = geodetic_to_ecef_scalar(points[i, 0], points[i, 1], points[i, 2])
        out[i, 0] = x
        out[i, 1] = y
        out[i, 2] = z


@njit(cache=True, parallel=True, error_model="numpy")
def _ecef_to_geodetic(points: FloatArray, out: FloatArray) -> None:
    for i in prange(points.shape[0]):
        lon, lat, height = ecef_to_geodetic_scalar(points[i, 0], points[i, 1], points[i, 2])
        out[i, 0] = lon
        out[i, 1] = lat
        out[i, 2] = height


def geodetic_to_ecef(geodetic: ArrayLike) -> FloatArray:
    """ECEF metres (..., 3) of `geodetic` (..., 3) = (lon_rad, lat_rad, height_m); NaN stays NaN.

    *Source*: IERS Conventions (2010), section 4.2.6.
    """
    points = as_components(geodetic, 3, "geodetic")
    out = np.empty(points.shape)
    _geodetic_to_ecef(np.ascontiguousarray(points).reshape(-1, 3), out.reshape(-1, 3))
    return out


def ecef_to_geodetic(ecef_m: ArrayLike) -> FloatArray:
    """(lon_rad, lat_rad, height_m) (..., 3) of ECEF points (..., 3).

    Longitudes are in (−pi, pi]. Right to the rounding of the coordinates (4 nm, there and
    back, at the Earth's surface) from the poles to the equator and at all heights; NaN within
    `CENTRE_RADIUS_M` of the centre and where the input is not finite.
    """
    points = as_components(ecef_m, 3, "ecef_m")
    out = np.empty(points.shape)
    _ecef_to_geodetic(np.ascontiguousarray(points).reshape(-1, 3), out.reshape(-1, 3))
    return out


def enu_axes(geodetic: ArrayLike) -> FloatArray:
    """`R_ecef_enu` (..., 3, 3): columns are the east, north and up axes in ECEF.

    `geodetic` (..., 3) gives the places; the height does not matter.
    """
    points = as_components(geodetic, 3, "geodetic")
    sin_lon, cos_lon = np.sin(points[..., 0]), np.cos(points[..., 0])
    sin_lat, cos_lat = np.sin(points[..., 1]), np.cos(points[..., 1])
    axes = np.empty((*points.shape[:-1], 3, 3))
    axes[..., 0, 0], axes[..., 1, 0], axes[..., 2, 0] = -sin_lon, cos_lon, 0.0
    axes[..., 0, 1] = -sin_lat * cos_lon
    axes[..., 1, 1] = -sin_lat * sin_lon
    axes[..., 2, 1] = cos_lat
    axes[..., 0, 2] = cos_lat * cos_lon
    axes[..., 1, 2] = cos_lat * sin_lon
    axes[..., 2, 2] = sin_lat
    return axes


def meridian_radius_m(lat_rad: ArrayLike) -> FloatArray:
    """Radius of curvature along the meridian, M, at geodetic latitudes (...).

    *Source*: M = a (1 − e²) / (1 − e² sin² lat)^(3/2).
    """
    w2 = 1.0 - WGS84_E2 * np.sin(np.asarray(lat_rad, dtype=np.float64)) ** 2
    return np.asarray(WGS84_A_M * (1.0 - WGS84_E2) / (w2 * np.sqrt(w2)))


def normal_radius_m(lat_rad: ArrayLike) -> FloatArray:
    """Radius of curvature across the meridian, N, at geodetic latitudes (...).

    *Source*: N = a / sqrt(1 − e² sin² lat).
    """
    w2 = 1.0 - WGS84_E2 * np.sin(np.asarray(lat_rad, dtype=np.float64)) ** 2
    return np.asarray(WGS84_A_M / np.sqrt(w2))
