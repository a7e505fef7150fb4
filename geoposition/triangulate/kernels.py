"""Compiled least squares of image points: from lines of sight, then from image residuals.

An observation's two rows are A = L⁻¹ J, J = d(line, sample)/d(ground), L Lᵀ its covariance.
Both steps solve sum Aᵀ A dP = sum Aᵀ y; y is A (O − P) for a line of sight through O, and
L⁻¹ (observed − projected) for an image residual.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.ellipsoid import ecef_to_geodetic_scalar, geodetic_to_ecef_scalar
from geoposition.flags import Flag
from geoposition.intersect_kernels import (
    Symmetric,
    invert_symmetric,
    largest_angle,
    point_flag,
    times,
    write_enu,
)

_OUTSIDE_IMAGE = int(Flag.OUTSIDE_IMAGE)
_NO_INTERSECTION = int(Flag.NO_INTERSECTION)
_WEAK_GEOMETRY = int(Flag.WEAK_GEOMETRY)

_FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def fill_rows(
    product: IntArray,
    image_px: FloatArray,
    point: IntArray,
    height_m: FloatArray,
    fields: FloatArray,
    root: FloatArray,
    root_step: int,
    rows: FloatArray,
) -> None:
    """Rows A (n, 2, 3) of n observations; `root` holds L⁻¹ (2, 2), `root_step` 0 if one for all."""
    for k in prange(len(product)):
        f = fields[product[k]]
        a = (image_px[k, 0] - f[0, 0]) * f[0, 3]
        b = (image_px[k, 1] - f[0, 1]) * f[0, 4]
        c = (height_m[point[k]] - f[0, 2]) * f[0, 5]
        w = root[k * root_step]
        for j in range(3):
            line = sample = 0.0
            for row in range(2):
                m = 3 * row + j
                value = (
                    f[2, m]
                    + a * (f[3, m] + a * f[6, m] + b * f[9, m] + c * f[10, m])
                    + b * (f[4, m] + b * f[7, m] + c * f[11, m])
                    + c * (f[5, m] + c * f[8, m])
                )
                if row == 0:
                    line = value
                else:
                    sample = value
            rows[k, 0, j] = w[0, 0] * line
            rows[k, 1, j] = w[1, 0] * line + w[1, 1] * sample


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _solve(
    begin: int, end: int, rows: FloatArray, right: FloatArray, ray_flags: FlagArray
) -> tuple[bool, float, float, float, Symmetric]:
    xx = xy = xz = yy = yz = zz = 0.0
    rx = ry = rz = 0.0
    for k in range(begin, end):
        if ray_flags[k] > _OUTSIDE_IMAGE:
            continue
        for i in range(2):
            ax, ay, az, y = rows[k, i, 0], rows[k, i, 1], rows[k, i, 2], right[k, i]
            xx += ax * ax
            xy += ax * ay
            xz += ax * az
            yy += ay * ay
            yz += ay * az
            zz += az * az
            rx += ax * y
            ry += ay * y
            rz += az * y
    solvable, inverse = invert_symmetric((xx, xy, xz, yy, yz, zz))
    dx, dy, dz = times(inverse, rx, ry, rz)
    return solvable, dx, dy, dz, inverse


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def from_rays(
    start: IntArray,
    rows: FloatArray,
    origin: FloatArray,
    direction: FloatArray,
    ray_flags: FlagArray,
    min_convergence_rad: float,
    right: FloatArray,
    geodetic: FloatArray,
    convergence_rad: FloatArray,
    flags: FlagArray,
) -> None:
    """Points of lines of sight, weighted by the rows; `right` (observations, 2) is work space.

    The rows lose what little they have along the lines of sight.
    """
    min_sine = math.sin(min_convergence_rad)
    for i in prange(len(flags)):
        begin, end = start[i], start[i + 1]
        _, flag = point_flag(begin, end, ray_flags)
        flags[i] = flag
        geodetic[i, 0] = np.nan
        geodetic[i, 1] = np.nan
        geodetic[i, 2] = np.nan
        convergence_rad[i] = np.nan
        if flag > _OUTSIDE_IMAGE:
            continue
        angle = largest_angle(begin, end, direction, ray_flags)
        convergence_rad[i] = angle
        if not math.sin(angle) >= min_sine:
            flags[i] = _WEAK_GEOMETRY
            continue
        first = begin
        while ray_flags[first] > _OUTSIDE_IMAGE:
            first += 1
        x, y, z = origin[first, 0], origin[first, 1], origin[first, 2]
        for k in range(begin, end):
            ux, uy, uz = direction[k, 0], direction[k, 1], direction[k, 2]
            dx, dy, dz = origin[k, 0] - x, origin[k, 1] - y, origin[k, 2] - z
            for j in range(2):
                along = rows[k, j, 0] * ux + rows[k, j, 1] * uy + rows[k, j, 2] * uz
                rows[k, j, 0] -= along * ux
                rows[k, j, 1] -= along * uy
                rows[k, j, 2] -= along * uz
                right[k, j] = rows[k, j, 0] * dx + rows[k, j, 1] * dy + rows[k, j, 2] * dz
        solvable, dx, dy, dz, _ = _solve(begin, end, rows, right, ray_flags)
        # Again from the solution, where nothing large cancels.
        x += dx
        y += dy
        z += dz
        for k in range(begin, end):
            dx, dy, dz = origin[k, 0] - x, origin[k, 1] - y, origin[k, 2] - z
            for j in range(2):
                right[k, j] = rows[k, j, 0] * dx + rows[k, j, 1] * dy + rows[k, j, 2] * dz
        solvable, dx, dy, dz, _ = _solve(begin, end, rows, right, ray_flags)
        x += dx
        y += dy
        z += dz
        ahead = True
        for k in range(begin, end):
            if ray_flags[k] <= _OUTSIDE_IMAGE:
                ahead = ahead and (
                    (x - origin[k, 0]) * direction[k, 0]
                    + (y - origin[k, 1]) * direction[k, 1]
                    + (z - origin[k, 2]) * direction[k, 2]
                    > 0.0
                )
        lon, lat, height = ecef_to_geodetic_scalar(x, y, z)
        if not solvable:
            flags[i] = _WEAK_GEOMETRY
        elif not ahead or math.isnan(height):
            flags[i] = _NO_INTERSECTION
        else:
            geodetic[i, 0] = lon
            geodetic[i, 1] = lat
            geodetic[i, 2] = height


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def image_step(
    start: IntArray,
    rows: FloatArray,
    root: FloatArray,
    root_step: int,
    ray_flags: FlagArray,
    residual_px: FloatArray,
    geodetic: FloatArray,
    step_m: FloatArray,
    flags: FlagArray,
) -> None:
    """Move `geodetic` (n, 3) so that the whitened image residuals become least.

    `residual_px` (observations, 2) is observed − projected, and follows the move as the rows
    say. Points without a result are left alone.
    """
    right = np.empty(residual_px.shape)
    for i in prange(len(flags)):
        step_m[i] = 0.0
        begin, end = start[i], start[i + 1]
        if flags[i] > _OUTSIDE_IMAGE:
            continue
        _, flag = point_flag(begin, end, ray_flags)
        flags[i] = flag
        if flag > _OUTSIDE_IMAGE:
            continue
        for k in range(begin, end):
            w = root[k * root_step]
            right[k, 0] = w[0, 0] * residual_px[k, 0]
            right[k, 1] = w[1, 0] * residual_px[k, 0] + w[1, 1] * residual_px[k, 1]
        solvable, dx, dy, dz, _ = _solve(begin, end, rows, right, ray_flags)
        if not solvable:
            flags[i] = _WEAK_GEOMETRY
            continue
        x, y, z = geodetic_to_ecef_scalar(geodetic[i, 0], geodetic[i, 1], geodetic[i, 2])
        lon, lat, height = ecef_to_geodetic_scalar(x + dx, y + dy, z + dz)
        geodetic[i, 0] = lon
        geodetic[i, 1] = lat
        geodetic[i, 2] = height
        step_m[i] = math.sqrt(dx * dx + dy * dy + dz * dz)
        for k in range(begin, end):
            w = root[k * root_step]
            a = rows[k, 0, 0] * dx + rows[k, 0, 1] * dy + rows[k, 0, 2] * dz
            b = rows[k, 1, 0] * dx + rows[k, 1, 1] * dy + rows[k, 1, 2] * dz
            line = a / w[0, 0]
            residual_px[k, 0] -= line
            residual_px[k, 1] -= (b - w[1, 0] * line) / w[1, 1]


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def finish(
    start: IntArray,
    rows: FloatArray,
    root: FloatArray,
    root_step: int,
    ray_flags: FlagArray,
    residual_px: FloatArray,
    geodetic: FloatArray,
    covariance: FloatArray,
    redundancy: FloatArray,
    rms_px: FloatArray,
    rays: IntArray,
    flags: FlagArray,
) -> None:
    """Covariance (n, 3, 3) in ENU, redundancy (observations, 2, 2), RMS residual, ray count.

    All outputs must come filled with NaN; points without a result keep it.
    """
    for i in prange(len(flags)):
        begin, end = start[i], start[i + 1]
        rays[i], _ = point_flag(begin, end, ray_flags)
        if flags[i] > _OUTSIDE_IMAGE:
            continue
        solvable, _, _, _, c = _solve(begin, end, rows, residual_px, ray_flags)
        if not solvable:
            flags[i] = _WEAK_GEOMETRY
            continue
        write_enu(c, geodetic[i, 0], geodetic[i, 1], covariance[i])
        total = 0.0
        for k in range(begin, end):
            if ray_flags[k] > _OUTSIDE_IMAGE:
                continue
            total += residual_px[k, 0] ** 2 + residual_px[k, 1] ** 2
            px, py, pz = times(c, rows[k, 0, 0], rows[k, 0, 1], rows[k, 0, 2])
            qx, qy, qz = times(c, rows[k, 1, 0], rows[k, 1, 1], rows[k, 1, 2])
            # 1 − A C Aᵀ, back from whitened to plain pixels: L (...) L⁻¹.
            h00 = 1.0 - (rows[k, 0, 0] * px + rows[k, 0, 1] * py + rows[k, 0, 2] * pz)
            h01 = -(rows[k, 0, 0] * qx + rows[k, 0, 1] * qy + rows[k, 0, 2] * qz)
            h11 = 1.0 - (rows[k, 1, 0] * qx + rows[k, 1, 1] * qy + rows[k, 1, 2] * qz)
            w = root[k * root_step]
            g00 = h00 * w[0, 0] + h01 * w[1, 0]
            g01 = h01 * w[1, 1]
            g10 = h01 * w[0, 0] + h11 * w[1, 0]
            g11 = h11 * w[1, 1]
            redundancy[k, 0, 0] = g00 / w[0, 0]
            redundancy[k, 0, 1] = g01 / w[0, 0]
            redundancy[k, 1, 0] = (g10 - w[1, 0] * g00 / w[0, 0]) / w[1, 1]
            redundancy[k, 1, 1] = (g11 - w[1, 0] * g01 / w[0, 0]) / w[1, 1]
        rms_px[i] = math.sqrt(total / rays[i])
