"""Compiled forward intersection: two rays in closed form, any number by least squares.

A ray's perpendicular misfit at P is (1 − u uᵀ)(P − O). Its weighted squares, summed over the
rays, are least where
    sum w_i (1 − u_i u_iᵀ) (P − O_i) = 0 .
For two rays that point divides their common perpendicular in the ratio of the variances.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.constants import WGS84_A_M, WGS84_B_M, WGS84_E2
from geoposition.ellipsoid import ecef_to_geodetic_scalar
from geoposition.flags import Flag

_OK = int(Flag.OK)
_OUTSIDE_IMAGE = int(Flag.OUTSIDE_IMAGE)
_NO_INTERSECTION = int(Flag.NO_INTERSECTION)
_WEAK_GEOMETRY = int(Flag.WEAK_GEOMETRY)
_TOO_FEW_RAYS = int(Flag.TOO_FEW_RAYS)

# NaN must keep its meaning, so only the reorderings of fast-math that respect it.
_FAST = {"contract", "arcp", "nsz", "reassoc"}

LANES = 128
_TASK = 32 * LANES
# Rows of the work array of a block of points.
_X, _Y, _Z, _LON, _LAT, _HEIGHT, _FAR = 0, 1, 2, 3, 4, 5, 6
_ROWS = 7

_AXIS_RATIO = WGS84_B_M / WGS84_A_M
_SECOND_E2_B = WGS84_E2 / (1.0 - WGS84_E2) * WGS84_B_M
_NEAR = 0.1
_LEAST_RADIUS_M = 6.2e6


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _small_atan(t: float) -> float:
    """Arc tangent for |t| ≤ `_NEAR`, to rounding: the first term left out is t^17 / 17."""
    q = t * t
    return t * (
        1.0
        - q
        * (
            1.0 / 3.0
            - q
            * (
                1.0 / 5.0
                - q * (1.0 / 7.0 - q * (1.0 / 9.0 - q * (1.0 / 11.0 - q * (1.0 / 13.0 - q / 15.0))))
            )
        )
    )


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _write_geodetic(w: FloatArray, n: int, out: FloatArray) -> None:
    """Geodetic coordinates of the points in rows x, y, z of `w` (rows, LANES), into `out` (n, 3).

    As `ellipsoid.ecef_to_geodetic_scalar`, in loops without branches: the points of a block lie
    near each other, so their angles come as small differences from one of them. Those that do
    not are done one by one.
    """
    at = 0
    while at < n - 1 and not w[_X, at] * w[_X, at] >= 0.0:
        at += 1
    lon0, lat0, _ = ecef_to_geodetic_scalar(w[_X, at], w[_Y, at], w[_Z, at])
    sl, cl, sp, cp = math.sin(lon0), math.cos(lon0), math.sin(lat0), math.cos(lat0)
    for i in range(n):
        x, y, z = w[_X, i], w[_Y, i], w[_Z, i]
        p2 = x * x + y * y
        p = math.sqrt(p2)
        r = math.sqrt(p2 + z * z)
        s = _AXIS_RATIO * z * (r + _SECOND_E2_B)
        c = p * r
        scale = 1.0 / math.sqrt(s * s + c * c)
        s *= scale
        c *= scale
        bend = WGS84_E2 * WGS84_A_M * s * c
        f = p * s - _AXIS_RATIO * z * c - bend
        per_slope = 1.0 / (p * c + _AXIS_RATIO * z * s - WGS84_E2 * WGS84_A_M * (c * c - s * s))
        step = -f * per_slope
        step -= 1.5 * bend * step * step * per_slope
        s, c = s + step * c, c - step * s
        scale = 1.0 / math.sqrt(s * s + c * c)
        s *= scale
        c *= scale
        c_lat = _AXIS_RATIO * c
        norm = 1.0 / math.sqrt(s * s + c_lat * c_lat)
        t_lon = (y * cl - x * sl) / (x * cl + y * sl)
        t_lat = (s * cp - c_lat * sp) / (c_lat * cp + s * sp)
        w[_LON, i] = lon0 + _small_atan(t_lon)
        w[_LAT, i] = lat0 + _small_atan(t_lat)
        w[_HEIGHT, i] = ((p - WGS84_A_M * c) * c_lat + (z - WGS84_B_M * s) * s) * norm
        # Behind the axis, or deep down, the differences mean nothing.
        w[_FAR, i] = max(abs(t_lon), abs(t_lat)) + (x * cl + y * sl < 0.0) + (r < _LEAST_RADIUS_M)
    for i in range(n):
        lon, lat, height = w[_LON, i], w[_LAT, i], w[_HEIGHT, i]
        if not w[_FAR, i] <= _NEAR or abs(lon) > math.pi:
            lon, lat, height = ecef_to_geodetic_scalar(w[_X, i], w[_Y, i], w[_Z, i])
        out[i, 0] = lon
        out[i, 1] = lat
        out[i, 2] = height


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def intersect_two(
    origin_a: FloatArray,
    direction_a: FloatArray,
    flag_a: FlagArray,
    origin_b: FloatArray,
    direction_b: FloatArray,
    flag_b: FlagArray,
    share_b: float,
    min_sine: float,
    geodetic: FloatArray,
    miss_m: FloatArray,
    flags: FlagArray,
) -> None:
    """Fill `geodetic` (n, 3), `miss_m` (n,) and `flags` (n,) for n pairs of rays.

    The point lies `share_b` of the way from ray a to ray b; the miss is the rays' distance.
    """
    total = len(flags)
    for task in prange((total + _TASK - 1) // _TASK):
        w = np.empty((_ROWS, LANES))
        for first in range(task * _TASK, min(total, (task + 1) * _TASK), LANES):
            n = min(LANES, total - first)
            for lane in range(n):
                i = first + lane
                ax, ay, az = direction_a[i, 0], direction_a[i, 1], direction_a[i, 2]
                bx, by, bz = direction_b[i, 0], direction_b[i, 1], direction_b[i, 2]
                dx = origin_b[i, 0] - origin_a[i, 0]
                dy = origin_b[i, 1] - origin_a[i, 1]
                dz = origin_b[i, 2] - origin_a[i, 2]
                # The common perpendicular; its length is the sine of the convergence angle.
                nx = ay * bz - az * by
                ny = az * bx - ax * bz
                nz = ax * by - ay * bx
                sine2 = nx * nx + ny * ny + nz * nz
                per_sine2 = 1.0 / sine2
                cx = dy * nz - dz * ny
                cy = dz * nx - dx * nz
                cz = dx * ny - dy * nx
                range_a = -(cx * bx + cy * by + cz * bz) * per_sine2
                range_b = -(cx * ax + cy * ay + cz * az) * per_sine2
                gap = (dx * nx + dy * ny + dz * nz) * per_sine2
                step = share_b * gap
                flag = max(flag_a[i], flag_b[i])
                if flag <= _OUTSIDE_IMAGE:
                    if not sine2 >= min_sine * min_sine:
                        flag = _WEAK_GEOMETRY
                    elif not (range_a > 0.0 and range_b > 0.0):
                        flag = _NO_INTERSECTION
                none = 0.0 if flag <= _OUTSIDE_IMAGE else np.nan
                w[_X, lane] = origin_a[i, 0] + range_a * ax + step * nx + none
                w[_Y, lane] = origin_a[i, 1] + range_a * ay + step * ny
                w[_Z, lane] = origin_a[i, 2] + range_a * az + step * nz
                miss_m[i] = abs(gap) * math.sqrt(sine2) + none
                flags[i] = flag
            _write_geodetic(w, n, geodetic[first : first + n])


Symmetric = tuple[float, float, float, float, float, float]
"""A symmetric matrix (3, 3) as xx, xy, xz, yy, yz, zz."""


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def invert_symmetric(m: Symmetric) -> tuple[bool, Symmetric]:
    """Inverse of a positive symmetric matrix, and whether there is one."""
    xx, xy, xz, yy, yz, zz = m
    axx = yy * zz - yz * yz
    axy = xz * yz - xy * zz
    axz = xy * yz - xz * yy
    determinant = xx * axx + xy * axy + xz * axz
    d = 1.0 / determinant
    inverse = (
        axx * d,
        axy * d,
        axz * d,
        (xx * zz - xz * xz) * d,
        (xy * xz - xx * yz) * d,
        (xx * yy - xy * xy) * d,
    )
    return determinant > 0.0, inverse


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def times(m: Symmetric, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Product of a symmetric matrix and a vector."""
    xx, xy, xz, yy, yz, zz = m
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def write_enu(m: Symmetric, lon_rad: float, lat_rad: float, out: FloatArray) -> None:
    """Turn the covariance `m` from ECEF to east, north, up at a place, into `out` (3, 3)."""
    sl, cl, sp, cp = math.sin(lon_rad), math.cos(lon_rad), math.sin(lat_rad), math.cos(lat_rad)
    ex, ey, _ = times(m, -sl, cl, 0.0)
    nx, ny, nz = times(m, -sp * cl, -sp * sl, cp)
    ux, uy, uz = times(m, cp * cl, cp * sl, sp)
    out[0, 0] = cl * ey - sl * ex
    out[0, 1] = cl * ny - sl * nx
    out[0, 2] = cl * uy - sl * ux
    out[1, 1] = cp * nz - sp * (cl * nx + sl * ny)
    out[1, 2] = cp * uz - sp * (cl * ux + sl * uy)
    out[2, 2] = sp * uz + cp * (cl * ux + sl * uy)
    out[1, 0] = out[0, 1]
    out[2, 0] = out[0, 2]
    out[2, 1] = out[1, 2]


@njit(cache=True, error_model="numpy")
def point_flag(start: int, end: int, ray_flags: FlagArray) -> tuple[int, int]:
    """Rays that can be used, and the flag their observations give the point.

    Where fewer than two are left, the reason is that of the first one lost, if one was.
    """
    used = 0
    lost = _TOO_FEW_RAYS
    flag = _OK
    for k in range(start, end):
        if ray_flags[k] <= _OUTSIDE_IMAGE:
            used += 1
            flag = max(flag, ray_flags[k])
        elif lost == _TOO_FEW_RAYS:
            lost = ray_flags[k]
    return used, flag if used >= 2 else lost


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def largest_angle(start: int, end: int, direction: FloatArray, ray_flags: FlagArray) -> float:
    """Largest angle in radians between any two usable rays of a point."""
    largest2 = 0.0
    for j in range(start, end):
        if ray_flags[j] > _OUTSIDE_IMAGE:
            continue
        for k in range(j + 1, end):
            if ray_flags[k] > _OUTSIDE_IMAGE:
                continue
            dx = direction[j, 0] - direction[k, 0]
            dy = direction[j, 1] - direction[k, 1]
            dz = direction[j, 2] - direction[k, 2]
            largest2 = max(largest2, dx * dx + dy * dy + dz * dz)
    return 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(largest2)))


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _solve_bundle(
    begin: int,
    end: int,
    origin: FloatArray,
    direction: FloatArray,
    ray_flags: FlagArray,
    weight: FloatArray,
    x: float,
    y: float,
    z: float,
) -> tuple[bool, float, float, float, Symmetric]:
    """Least-squares point of the usable rays, reckoned from (x, y, z), and its covariance."""
    xx = xy = xz = yy = yz = zz = 0.0
    rx = ry = rz = 0.0
    for k in range(begin, end):
        if ray_flags[k] > _OUTSIDE_IMAGE:
            continue
        w = weight[k]
        ux, uy, uz = direction[k, 0], direction[k, 1], direction[k, 2]
        dx, dy, dz = origin[k, 0] - x, origin[k, 1] - y, origin[k, 2] - z
        along = ux * dx + uy * dy + uz * dz
        rx += w * (dx - along * ux)
        ry += w * (dy - along * uy)
        rz += w * (dz - along * uz)
        xx += w * (uy * uy + uz * uz)
        yy += w * (ux * ux + uz * uz)
        zz += w * (ux * ux + uy * uy)
        xy -= w * ux * uy
        xz -= w * ux * uz
        yz -= w * uy * uz
    solvable, inverse = invert_symmetric((xx, xy, xz, yy, yz, zz))
    dx, dy, dz = times(inverse, rx, ry, rz)
    return solvable, x + dx, y + dy, z + dz, inverse


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def intersect_many(
    start: IntArray,
    origin: FloatArray,
    direction: FloatArray,
    ray_flags: FlagArray,
    weight: FloatArray,
    min_convergence_rad: float,
    geodetic: FloatArray,
    covariance: FloatArray,
    residual_m: FloatArray,
    rays: IntArray,
    convergence_rad: FloatArray,
    flags: FlagArray,
) -> None:
    """Least-squares points of rays `start[i]` .. `start[i + 1]`; `weight` is 1 / sigma².

    `covariance` (n, 3, 3) is east, north, up; `residual_m` belongs to the rays. All outputs
    must come filled with NaN.
    """
    min_sine = math.sin(min_convergence_rad)
    for i in prange(len(flags)):
        begin, end = start[i], start[i + 1]
        used, flag = point_flag(begin, end, ray_flags)
        rays[i] = used
        flags[i] = flag
        if flag > _OUTSIDE_IMAGE:
            continue
        angle = largest_angle(begin, end, direction, ray_flags)
        convergence_rad[i] = angle
        # Rays in a line, one against the other, are as weak as parallel ones.
        if not math.sin(angle) >= min_sine:
            flags[i] = _WEAK_GEOMETRY
            continue
        first = begin
        while ray_flags[first] > _OUTSIDE_IMAGE:
            first += 1
        x, y, z = origin[first, 0], origin[first, 1], origin[first, 2]
        solvable, x, y, z, inverse = _solve_bundle(
            begin, end, origin, direction, ray_flags, weight, x, y, z
        )
        # Again from the solution, where nothing large cancels.
        solvable, x, y, z, inverse = _solve_bundle(
            begin, end, origin, direction, ray_flags, weight, x, y, z
        )
        lon, lat, height = ecef_to_geodetic_scalar(x, y, z)
        if not solvable or math.isnan(height):
            flags[i] = _WEAK_GEOMETRY
            continue
        ahead = True
        for k in range(begin, end):
            if ray_flags[k] > _OUTSIDE_IMAGE:
                continue
            dx, dy, dz = x - origin[k, 0], y - origin[k, 1], z - origin[k, 2]
            along = dx * direction[k, 0] + dy * direction[k, 1] + dz * direction[k, 2]
            ahead = ahead and along > 0.0
            dx -= along * direction[k, 0]
            dy -= along * direction[k, 1]
            dz -= along * direction[k, 2]
            residual_m[k] = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not ahead:
            flags[i] = _NO_INTERSECTION
            for k in range(begin, end):
                residual_m[k] = np.nan
            continue
        geodetic[i, 0] = lon
        geodetic[i, 1] = lat
        geodetic[i, 2] = height
        write_enu(inverse, lon, lat, covariance[i])
