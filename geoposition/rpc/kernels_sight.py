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
from geoposition.sines import fill_sines


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
        sin_lon = np.zeros(BLOCK)
        cos_lon = np.zeros(BLOCK)
        sin_lat = np.zeros(BLOCK)
        cos_lat = np.zeros(BLOCK)
        o = np.zeros((3, BLOCK))
        d = np.zeros((3, BLOCK))
        for begin in range(task * TASK, min(n, (task + 1) * TASK), BLOCK):
            m = min(BLOCK, n - begin)
            source = geodetic[3 * begin : 3 * (begin + m)]
            origin = origin_ecef_m[3 * begin : 3 * (begin + m)]
            direction = direction_ecef[3 * begin : 3 * (begin + m)]
            for i in range(uint64(m)):
                lon[i] = source[U3 * i]
                lat[i] = source[U3 * i + U1]
                h[i] = source[U3 * i + U2]
            fill_sines(lon, m, sin_lon, cos_lon)
            fill_sines(lat, m, sin_lat, cos_lat)
            for i in range(BLOCK):
                lon_slope[i], lat_slope[i] = _slope_of_sight(c, p, lon[i], lat[i], h[i])
            for i in range(BLOCK):
                w2 = 1.0 - WGS84_E2 * sin_lat[i] * sin_lat[i]
                normal_m = WGS84_A_M / math.sqrt(w2)
                polar_m = normal_m * (1.0 - WGS84_E2)
                across_m = (normal_m + h[i]) * cos_lat[i]
                east = across_m * lon_slope[i]
                north = (polar_m / w2 + h[i]) * lat_slope[i]
                # Per metre of height, in ECEF; its length is one over cos(zenith angle).
                outward = cos_lat[i] - sin_lat[i] * north
                t_x = cos_lon[i] * outward - sin_lon[i] * east
                t_y = sin_lon[i] * outward + cos_lon[i] * east
                t_z = cos_lat[i] * north + sin_lat[i]
                shrink = 1.0 / math.sqrt(t_x * t_x + t_y * t_y + t_z * t_z)
                o[0, i] = across_m * cos_lon[i] + altitude_m * t_x
                o[1, i] = across_m * sin_lon[i] + altitude_m * t_y
                o[2, i] = (polar_m + h[i]) * sin_lat[i] + altitude_m * t_z
                d[0, i] = -t_x * shrink
                d[1, i] = -t_y * shrink
                d[2, i] = -t_z * shrink
            for i in range(uint64(m)):
                origin[U3 * i] = o[0, i]
                origin[U3 * i + U1] = o[1, i]
                origin[U3 * i + U2] = o[2, i]
                direction[U3 * i] = d[0, i]
                direction[U3 * i + U1] = d[1, i]
                direction[U3 * i + U2] = d[2, i]
