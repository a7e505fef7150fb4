"""Compiled loops for what follows from the RPC's derivatives: Jacobians and lines of sight."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange, uint64

from geoposition.arrays import FloatArray
from geoposition.constants import WGS84_A_M, WGS84_E2
from geoposition.rpc.kernel_base import (
    BLOCK,
    INLINE,
    LINE_DEN,
    LINE_NUM,
    PARALLEL,
    SAMP_DEN,
    SAMP_NUM,
    TASK,
    U1,
    U2,
    U3,
    KernelParameters,
    cubic,
    cubic_gradient,
    wrapped,
)


@njit(**INLINE)
def _ratio_gradient(
    c: FloatArray, num: int, den: int, L: float, P: float, H: float
) -> tuple[float, float, float]:
    """Differentiate the ratio of two cubics by L, P, H."""
    n_lon, n_lat, n_height = cubic_gradient(c, num, L, P, H)
    d_lon, d_lat, d_height = cubic_gradient(c, den, L, P, H)
    inverse = 1.0 / cubic(c, den, L, P, H)
    ratio = cubic(c, num, L, P, H) * inverse
    return (
        (n_lon - ratio * d_lon) * inverse,
        (n_lat - ratio * d_lat) * inverse,
        (n_height - ratio * d_height) * inverse,
    )


@njit(**PARALLEL)
def differentiate_points(
    geodetic: FloatArray, c: FloatArray, p: KernelParameters, jacobian: FloatArray
) -> None:
    """d(line, sample)/d(lon_rad, lat_rad, height_m) at `geodetic` (n, 3), into (n, 2, 3)."""
    for i in prange(geodetic.shape[0]):
        L = wrapped(geodetic[i, 0] - p.lon_off_rad) * p.lon_unit
        P = (geodetic[i, 1] - p.lat_off_rad) * p.lat_unit
        H = (geodetic[i, 2] - p.height_off_m) * p.height_unit
        x = _ratio_gradient(c, LINE_NUM, LINE_DEN, L, P, H)
        y = _ratio_gradient(c, SAMP_NUM, SAMP_DEN, L, P, H)
        units = (p.lon_unit, p.lat_unit, p.height_unit)
        for k in range(3):
            jacobian[i, 0, k] = p.line_scale_px * x[k] * units[k]
            jacobian[i, 1, k] = p.samp_scale_px * y[k] * units[k]


@njit(**INLINE)
def _slope_of_sight(
    c: FloatArray, p: KernelParameters, lon_rad: float, lat_rad: float, height_m: float
) -> tuple[float, float]:
    """Change of longitude and latitude per metre of height along which the image point stays."""
    L = wrapped(lon_rad - p.lon_off_rad) * p.lon_unit
    P = (lat_rad - p.lat_off_rad) * p.lat_unit
    H = (height_m - p.height_off_m) * p.height_unit
    x_lon, x_lat, x_height = _ratio_gradient(c, LINE_NUM, LINE_DEN, L, P, H)
    y_lon, y_lat, y_height = _ratio_gradient(c, SAMP_NUM, SAMP_DEN, L, P, H)
    inverse = p.height_unit / (x_lon * y_lat - x_lat * y_lon)
    return (
        (x_lat * y_height - y_lat * x_height) * inverse / p.lon_unit,
        (y_lon * x_height - x_lon * y_height) * inverse / p.lat_unit,
    )


@njit(**PARALLEL)
def sight_lines(
    geodetic: FloatArray,
    c: FloatArray,
    p: KernelParameters,
    altitude_m: float,
    origin_ecef_m: FloatArray,
    direction_ecef: FloatArray,
) -> None:
    """Tangents of the curves of constant image point through `geodetic` (3n), pointing down.

    All arrays are flattened (3n). An origin is where the tangent is `altitude_m` above the
    horizontal plane of its point. NaN in, NaN out.
    """
    n = geodetic.size // 3
    for task in prange((n + TASK - 1) // TASK):
        lon = np.zeros(BLOCK)
        lat = np.zeros(BLOCK)
        h = np.zeros(BLOCK)
        lon_slope = np.zeros(BLOCK)
        lat_slope = np.zeros(BLOCK)
        for begin in range(task * TASK, min(n, (task + 1) * TASK), BLOCK):
            m = min(BLOCK, n - begin)
            source = geodetic[3 * begin : 3 * (begin + m)]
            origin = origin_ecef_m[3 * begin : 3 * (begin + m)]
            direction = direction_ecef[3 * begin : 3 * (begin + m)]
            for i in range(uint64(m)):
                lon[i] = source[U3 * i]
                lat[i] = source[U3 * i + U1]
                h[i] = source[U3 * i + U2]
            for i in range(BLOCK):
                lon_slope[i], lat_slope[i] = _slope_of_sight(c, p, lon[i], lat[i], h[i])
            for i in range(uint64(m)):
                sin_lon = math.sin(lon[i])
                cos_lon = math.cos(lon[i])
                sin_lat = math.sin(lat[i])
                cos_lat = math.cos(lat[i])
                w2 = 1.0 - WGS84_E2 * sin_lat * sin_lat
                normal_m = WGS84_A_M / math.sqrt(w2)
                polar_m = normal_m * (1.0 - WGS84_E2)
                across_m = (normal_m + h[i]) * cos_lat
                east = across_m * lon_slope[i]
                north = (polar_m / w2 + h[i]) * lat_slope[i]
                # Per metre of height, in ECEF; its length is one over cos(zenith angle).
                t_x = -sin_lon * east - sin_lat * cos_lon * north + cos_lat * cos_lon
                t_y = cos_lon * east - sin_lat * sin_lon * north + cos_lat * sin_lon
                t_z = cos_lat * north + sin_lat
                shrink = 1.0 / math.sqrt(t_x * t_x + t_y * t_y + t_z * t_z)
                origin[U3 * i] = across_m * cos_lon + altitude_m * t_x
                origin[U3 * i + U1] = across_m * sin_lon + altitude_m * t_y
                origin[U3 * i + U2] = (polar_m + h[i]) * sin_lat + altitude_m * t_z
                direction[U3 * i] = -t_x * shrink
                direction[U3 * i + U1] = -t_y * shrink
                direction[U3 * i + U2] = -t_z * shrink
