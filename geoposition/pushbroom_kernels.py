"""Compiled push-broom geometry: line of sight, direct and inverse location.

Scalar functions on the tables of `pose_table`, and parallel loops over points around them. The
formulas of the corrections are in `corrections`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.constants import EARTH_RATE_RAD_S, SPEED_OF_LIGHT_M_S, WGS84_A_M, WGS84_E2
from geoposition.flags import Flag
from geoposition.pose_table import DirectionTable, PoseTable

_OK = np.uint8(Flag.OK)
_OUTSIDE_IMAGE = np.uint8(Flag.OUTSIDE_IMAGE)
_OUTSIDE_MODEL = np.uint8(Flag.OUTSIDE_MODEL)
_BAD_INPUT = np.uint8(Flag.BAD_INPUT)
_NO_INTERSECTION = np.uint8(Flag.NO_INTERSECTION)
_NOT_CONVERGED = np.uint8(Flag.NOT_CONVERGED)

_B_OVER_A2 = 1.0 - WGS84_E2
_B_M = WGS84_A_M * math.sqrt(_B_OVER_A2)
_MEAN_RADIUS_M = 6371e3
_MAX_STEPS = 25
_STEP_TOLERANCE_PX = 2e-5
"""A Newton step below this leaves an error of its square's order, far below 1e-6 px."""

# NaN must keep its meaning, so only the reorderings of fast-math that respect it.
_FAST = {"contract", "arcp", "nsz", "reassoc"}


class ModelTable(NamedTuple):
    """All a kernel needs of one rigorous model.

    `start` (20, 2) is a cubic in local coordinates p = `R_local_ecef` (P − `centre_ecef_m`) /
    `extent_m` that gives line and sample within some pixels: where the inverse location begins.
    `aberration`, `light_time` are 0 or 1, `refraction_m` is (n0 − 1) H or 0, `scale_height_m` H.
    """

    lines: int
    samples: int
    pose: PoseTable
    directions: DirectionTable
    aberration: float
    light_time: float
    refraction_m: float
    scale_height_m: float
    mean_range_m: float
    R_local_ecef: FloatArray
    centre_ecef_m: FloatArray
    extent_m: float
    start: FloatArray


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _segment(
    x: float, knots: FloatArray, first: int, n: int, bins: IntArray, bin0: int, o: float, f: float
) -> int:
    """Index of the segment of `x`: knots[first + i] <= x < knots[first + i + 1]."""
    if n == 1:
        return 0
    cell = int((x - o) * f)
    cell = min(max(cell, 0), 4 * n - 1)
    k = bins[bin0 + cell]
    while k > 0 and x < knots[first + k]:
        k -= 1
    while k < n - 1 and x >= knots[first + k + 1]:
        k += 1
    return int(k)


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _pose(pose: PoseTable, line: float):  # type: ignore[no-untyped-def]
    """Position, its rate per second, quaternion, its rate per line, seconds per line."""
    cubic = pose.cubic
    n = cubic.coefficients.shape[0]
    k = _segment(line, cubic.knots, 0, n, cubic.bins, 0, cubic.bin_origin, cubic.bin_scale)
    low = cubic.knots[k]
    length = cubic.knots[k + 1] - low
    s = (line - low) / length
    c = cubic.coefficients[k]
    x = c[0, 0] + s * (c[1, 0] + s * (c[2, 0] + s * c[3, 0]))
    y = c[0, 1] + s * (c[1, 1] + s * (c[2, 1] + s * c[3, 1]))
    z = c[0, 2] + s * (c[1, 2] + s * (c[2, 2] + s * c[3, 2]))
    per_second = 1.0 / pose.seconds[k]
    vx = (c[1, 0] + s * (2.0 * c[2, 0] + s * 3.0 * c[3, 0])) * per_second
    vy = (c[1, 1] + s * (2.0 * c[2, 1] + s * 3.0 * c[3, 1])) * per_second
    vz = (c[1, 2] + s * (2.0 * c[2, 2] + s * 3.0 * c[3, 2])) * per_second
    qx = c[0, 3] + s * (c[1, 3] + s * (c[2, 3] + s * c[3, 3]))
    qy = c[0, 4] + s * (c[1, 4] + s * (c[2, 4] + s * c[3, 4]))
    qz = c[0, 5] + s * (c[1, 5] + s * (c[2, 5] + s * c[3, 5]))
    qw = c[0, 6] + s * (c[1, 6] + s * (c[2, 6] + s * c[3, 6]))
    return k, s, length, x, y, z, vx, vy, vz, qx, qy, qz, qw


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _tangents(table: DirectionTable, ccd: int, sample: float):  # type: ignore[no-untyped-def]
    """Tangents and their rates per sample; the end segments continue beyond the ends."""
    start = table.start[ccd]
    first = start + ccd
    n = table.start[ccd + 1] - start
    k = _segment(
        sample,
        table.knots,
        first,
        n,
        table.bins,
        table.bin_start[ccd],
        table.bin_origin[ccd],
        table.bin_scale[ccd],
    )
    low = table.knots[first + k]
    per_sample = 1.0 / (table.knots[first + k + 1] - low)
    s = (sample - low) * per_sample
    c = table.coefficients[start + k]
    a = c[0, 0] + s * (c[1, 0] + s * (c[2, 0] + s * c[3, 0]))
    b = c[0, 1] + s * (c[1, 1] + s * (c[2, 1] + s * c[3, 1]))
    da = (c[1, 0] + s * (2.0 * c[2, 0] + s * 3.0 * c[3, 0])) * per_sample
    db = (c[1, 1] + s * (2.0 * c[2, 1] + s * 3.0 * c[3, 1])) * per_sample
    return a, b, da, db


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _ccd_of(table: DirectionTable, sample: float) -> int:
    """CCD whose part of the row holds `sample`; the outer ones reach on."""
    ccd = 0
    while ccd < len(table.first_sample) - 1 and sample >= table.first_sample[ccd + 1] - 0.5:
        ccd += 1
    return ccd


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _range_to_height(  # type: ignore[no-untyped-def]
    x: float, y: float, z: float, ux: float, uy: float, uz: float, h: float
):
    """Range along unit u from (x, y, z) to the height surface `h`, and the normal there.

    First the ellipsoid with semi-axes a + h, b + h, which is up to decimetres off the surface
    of height h; then one Newton step on the height itself. NaN where the line misses.
    """
    wa = 1.0 / (WGS84_A_M + h)
    wb = 1.0 / (_B_M + h)
    px, py, pz = x * wa, y * wa, z * wb
    dx, dy, dz = ux * wa, uy * wa, uz * wb
    aa = dx * dx + dy * dy + dz * dz
    bb = px * dx + py * dy + pz * dz
    cc = px * px + py * py + pz * pz - 1.0
    root = bb * bb - aa * cc
    if not (root >= 0.0 and bb < 0.0 and cc > 0.0):
        return np.nan, np.nan, np.nan, np.nan, np.nan
    t = cc / (-bb + math.sqrt(root))
    gx = x + t * ux
    gy = y + t * uy
    gz = z + t * uz
    mx, my, mz = gx * wa * wa, gy * wa * wa, gz * wb * wb
    sin2 = mz * mz / (mx * mx + my * my + mz * mz)
    radius = WGS84_A_M / math.sqrt(1.0 - WGS84_E2 * sin2)
    along = 1.0 / (radius + h)
    nx = gx * along
    ny = gy * along
    nz = gz / (radius * _B_OVER_A2 + h)
    height = nx * gx + ny * gy + nz * gz - WGS84_A_M * WGS84_A_M / radius
    t += (h - height) / (nx * ux + ny * uy + nz * uz)
    return t, nx, ny, nz, radius


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _bend(  # type: ignore[no-untyped-def]
    k_m: float, nx: float, ny: float, nz: float, ux: float, uy: float, uz: float
):
    """Shift of the ground point by refraction: towards the satellite, at the same height.

    `k_m` is (n0 − 1) H exp(−h / H); n the normal, u the direction to the ground.
    """
    cos_z = -(nx * ux + ny * uy + nz * uz)
    f = k_m / (cos_z * cos_z * cos_z)
    sx = f * (-ux - cos_z * nx)
    sy = f * (-uy - cos_z * ny)
    sz = f * (-uz - cos_z * nz)
    # A horizontal step leaves a curved surface upwards: come back down.
    drop = 0.5 * (sx * sx + sy * sy + sz * sz) / _MEAN_RADIUS_M
    return sx - drop * nx, sy - drop * ny, sz - drop * nz


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _locate(m: ModelTable, line: float, sample: float, h: float):  # type: ignore[no-untyped-def]
    """Camera and ground point of height `h` (ECEF), and the radius N there; NaN if missed."""
    k, s, length, x, y, z, vx, vy, vz, qx, qy, qz, qw = _pose(m.pose, line)
    ccd = _ccd_of(m.directions, sample)
    a, b, da, db = _tangents(m.directions, ccd, sample)
    # u = q (a, b, 1) q*, up to the length of q.
    tx = 2.0 * (qy - qz * b)
    ty = 2.0 * (qz * a - qx)
    tz = 2.0 * (qx * b - qy * a)
    q2 = qx * qx + qy * qy + qz * qz + qw * qw
    ux = q2 * a + (qw * tx + qy * tz - qz * ty)
    uy = q2 * b + (qw * ty + qz * tx - qx * tz)
    uz = q2 + (qw * tz + qx * ty - qy * tx)
    scale = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
    ux *= scale
    uy *= scale
    uz *= scale
    w = EARTH_RATE_RAD_S
    if m.aberration + m.light_time > 0.0:
        # v / c, with the ground point P = S + range u entering through the Earth's rotation.
        fx = m.aberration * (vx - w * y) / SPEED_OF_LIGHT_M_S
        fy = m.aberration * (vy + w * x) / SPEED_OF_LIGHT_M_S
        fz = m.aberration * vz / SPEED_OF_LIGHT_M_S
        g = m.light_time * w / SPEED_OF_LIGHT_M_S
        ax, ay, az = ux, uy, uz
        reach = m.mean_range_m
        ux, uy, uz = _turned(
            ax, ay, az, fx + g * (y + reach * ay), fy - g * (x + reach * ax), fz
        )
        if m.light_time > 0.0:
            # The range matters to some 30 m; the mean range may be 100 km off.
            reach, nx, ny, nz, radius = _range_to_height(x, y, z, ux, uy, uz, h)
            ux, uy, uz = _turned(
                ax, ay, az, fx + g * (y + reach * uy), fy - g * (x + reach * ux), fz
            )
    t, nx, ny, nz, radius = _range_to_height(x, y, z, ux, uy, uz, h)
    gx = x + t * ux
    gy = y + t * uy
    gz = z + t * uz
    if m.refraction_m > 0.0:
        k_m = m.refraction_m * math.exp(-h / m.scale_height_m)
        sx, sy, sz = _bend(k_m, nx, ny, nz, ux, uy, uz)
        gx += sx
        gy += sy
        gz += sz
    return x, y, z, gx, gy, gz, radius


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _turned(  # type: ignore[no-untyped-def]
    ax: float, ay: float, az: float, fx: float, fy: float, fz: float
):
    """unit(u_app − v / c)."""
    ux = ax - fx
    uy = ay - fy
    uz = az - fz
    scale = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
    return ux * scale, uy * scale, uz * scale


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _pixel_flag(m: ModelTable, line: float, sample: float):  # type: ignore[no-untyped-def]
    """Flag of an image point before anything is computed with it."""
    if not (math.isfinite(line) and math.isfinite(sample)):
        return _BAD_INPUT
    margin = max(100.0, 0.05 * m.samples)
    if not (
        m.pose.first_line <= line <= m.pose.last_line
        and -margin <= sample <= m.samples - 1 + margin
    ):
        return _OUTSIDE_MODEL
    if -0.5 <= line <= m.lines - 0.5 and -0.5 <= sample <= m.samples - 0.5:
        return _OK
    return _OUTSIDE_IMAGE


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def direct(
    m: ModelTable,
    image_px: FloatArray,
    height_m: FloatArray,
    height_step: int,
    geodetic: FloatArray,
    flags: FlagArray,
) -> None:
    """Fill `geodetic` (n, 3) and `flags` (n,) for `image_px` (n, 2).

    Point i has height `height_m[i * height_step]`: step 0 means one height for all.
    """
    for i in prange(len(image_px)):
        line, sample, h = image_px[i, 0], image_px[i, 1], height_m[i * height_step]
        flag = _pixel_flag(m, line, sample)
        if not math.isfinite(h):
            flag = _BAD_INPUT
        if flag <= _OUTSIDE_IMAGE:
            x, y, z, gx, gy, gz, radius = _locate(m, line, sample, h)
            if math.isfinite(gx):
                p = math.sqrt(gx * gx + gy * gy)
                geodetic[i, 0] = math.atan2(gy, gx)
                geodetic[i, 1] = math.atan2(gz, p * (1.0 - WGS84_E2 * radius / (radius + h)))
                geodetic[i, 2] = h
            else:
                flag = _NO_INTERSECTION
        if flag > _OUTSIDE_IMAGE:
            geodetic[i, 0] = np.nan
            geodetic[i, 1] = np.nan
            geodetic[i, 2] = np.nan
        flags[i] = flag


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def rays(
    m: ModelTable,
    image_px: FloatArray,
    height_m: FloatArray,
    height_step: int,
    origin: FloatArray,
    direction: FloatArray,
    flags: FlagArray,
) -> None:
    """Fill `origin`, `direction` (n, 3) and `flags` (n,): camera to the point at `height_m`."""
    for i in prange(len(image_px)):
        line, sample, h = image_px[i, 0], image_px[i, 1], height_m[i * height_step]
        flag = _pixel_flag(m, line, sample)
        if not math.isfinite(h):
            flag = _BAD_INPUT
        x = y = z = dx = dy = dz = np.nan
        if flag <= _OUTSIDE_IMAGE:
            x, y, z, gx, gy, gz, radius = _locate(m, line, sample, h)
            dx, dy, dz = gx - x, gy - y, gz - z
            f = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            dx *= f
            dy *= f
            dz *= f
            if not math.isfinite(dx):
                flag = _NO_INTERSECTION
                x = y = z = np.nan
        origin[i, 0], origin[i, 1], origin[i, 2] = x, y, z
        direction[i, 0], direction[i, 1], direction[i, 2] = dx, dy, dz
        flags[i] = flag


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _start(m: ModelTable, px: float, py: float, pz: float):  # type: ignore[no-untyped-def]
    """Approximate line and sample of an ECEF point, from the cubic fitted to the model."""
    f = 1.0 / m.extent_m
    cx = (px - m.centre_ecef_m[0]) * f
    cy = (py - m.centre_ecef_m[1]) * f
    cz = (pz - m.centre_ecef_m[2]) * f
    r = m.R_local_ecef
    e = r[0, 0] * cx + r[0, 1] * cy + r[0, 2] * cz
    n = r[1, 0] * cx + r[1, 1] * cy + r[1, 2] * cz
    u = r[2, 0] * cx + r[2, 1] * cy + r[2, 2] * cz
    line = _cubic(m.start, 0, e, n, u)
    sample = _cubic(m.start, 1, e, n, u)
    return line, sample


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _cubic(c: FloatArray, j: int, e: float, n: float, u: float) -> float:
    """Cubic in e, n, u with the 20 terms in the order of `cubic_terms`."""
    return (
        c[0, j]
        + e * (c[1, j] + e * (c[4, j] + e * c[10, j] + n * c[11, j] + u * c[12, j]))
        + n * (c[2, j] + n * (c[5, j] + n * c[13, j] + e * c[14, j] + u * c[15, j]))
        + u * (c[3, j] + u * (c[6, j] + u * c[16, j] + e * c[17, j] + n * c[18, j]))
        + e * n * (c[7, j] + u * c[19, j])
        + e * u * c[8, j]
        + n * u * c[9, j]
    )


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _project(  # type: ignore[no-untyped-def]
    m: ModelTable,
    ccd: int,
    line: float,
    sample: float,
    gx: float,
    gy: float,
    gz: float,
    nx: float,
    ny: float,
    nz: float,
    k_m: float,
):
    """Newton iteration from (line, sample): image point of ground point g seen by CCD `ccd`."""
    low, high = m.pose.first_line, m.pose.last_line
    far = 2.0 * m.samples + 1000.0
    w = EARTH_RATE_RAD_S
    sx = sy = sz = 0.0
    at_end = 0
    for _ in range(_MAX_STEPS):
        line = min(max(line, low), high)
        k, s, length, x, y, z, vx, vy, vz, qx, qy, qz, qw = _pose(m.pose, line)
        # The straight line of sight meets the height surface beside the true point.
        ux = gx - sx - x
        uy = gy - sy - y
        uz = gz - sz - z
        per_range = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
        ux *= per_range
        uy *= per_range
        uz *= per_range
        if k_m > 0.0:
            bx = nx - sx / _MEAN_RADIUS_M
            by = ny - sy / _MEAN_RADIUS_M
            bz = nz - sz / _MEAN_RADIUS_M
            sx, sy, sz = _bend(k_m, bx, by, bz, ux, uy, uz)
            ux = gx - sx - x
            uy = gy - sy - y
            uz = gz - sz - z
            per_range = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
            ux *= per_range
            uy *= per_range
            uz *= per_range
        # u_app = k u + v / c with k such that its length is one.
        fx = (m.aberration * (vx - w * y) + m.light_time * w * (gy - sy)) / SPEED_OF_LIGHT_M_S
        fy = (m.aberration * (vy + w * x) - m.light_time * w * (gx - sx)) / SPEED_OF_LIGHT_M_S
        fz = m.aberration * vz / SPEED_OF_LIGHT_M_S
        uf = ux * fx + uy * fy + uz * fz
        f2 = fx * fx + fy * fy + fz * fz
        stretch = math.sqrt(uf * uf + 1.0 - f2) - uf
        ax = stretch * ux + fx
        ay = stretch * uy + fy
        az = stretch * uz + fz
        # Into the camera frame: q* a q, up to the length of q.
        q2 = qx * qx + qy * qy + qz * qz + qw * qw
        cx, cy, cz = _turn_back(qx, qy, qz, qw, q2, ax, ay, az)
        if not cz > 0.0:
            return line, sample, _OUTSIDE_MODEL
        # Rate per line: the camera turns (w_cam = 2 q* q') and moves.
        c = m.pose.cubic.coefficients[k]
        per_line = 1.0 / length
        rx = (c[1, 3] + s * (2.0 * c[2, 3] + s * 3.0 * c[3, 3])) * per_line
        ry = (c[1, 4] + s * (2.0 * c[2, 4] + s * 3.0 * c[3, 4])) * per_line
        rz = (c[1, 5] + s * (2.0 * c[2, 5] + s * 3.0 * c[3, 5])) * per_line
        rw = (c[1, 6] + s * (2.0 * c[2, 6] + s * 3.0 * c[3, 6])) * per_line
        ox = 2.0 * (qw * rx - qx * rw - qy * rz + qz * ry) / q2
        oy = 2.0 * (qw * ry - qy * rw - qz * rx + qx * rz) / q2
        oz = 2.0 * (qw * rz - qz * rw - qx * ry + qy * rx) / q2
        line_s = m.pose.seconds[k] * per_line
        vu = vx * ux + vy * uy + vz * uz
        g = -line_s * per_range
        ex, ey, ez = _turn_back(
            qx, qy, qz, qw, q2, g * (vx - vu * ux), g * (vy - vu * uy), g * (vz - vu * uz)
        )
        ex -= oy * cz - oz * cy
        ey -= oz * cx - ox * cz
        ez -= ox * cy - oy * cx
        a, b, da, db = _tangents(m.directions, ccd, sample)
        per_z = 1.0 / cz
        ta = cx * per_z
        tb = cy * per_z
        da_line = (ex - ta * ez) * per_z
        db_line = (ey - tb * ez) * per_z
        det = db_line * da - da_line * db
        d_line = (db * (ta - a) - da * (tb - b)) / det
        d_sample = (db_line * (ta - a) - da_line * (tb - b)) / det
        if not (math.isfinite(d_line) and math.isfinite(d_sample)):
            return line, sample, _NOT_CONVERGED
        line += d_line
        sample += d_sample
        sample = min(max(sample, -far), m.samples + far)
        if abs(d_line) < _STEP_TOLERANCE_PX and abs(d_sample) < _STEP_TOLERANCE_PX:
            return line, sample, _OK
        if line < low or line > high:
            at_end += 1
            if at_end > 3:
                return line, sample, _OUTSIDE_MODEL
        else:
            at_end = 0
    return line, sample, _NOT_CONVERGED


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _turn_back(  # type: ignore[no-untyped-def]
    qx: float, qy: float, qz: float, qw: float, q2: float, x: float, y: float, z: float
):
    """q* v q, times 1 for a unit q: reference frame to camera frame, scaled by q2."""
    tx = 2.0 * (qz * y - qy * z)
    ty = 2.0 * (qx * z - qz * x)
    tz = 2.0 * (qy * x - qx * y)
    return (
        q2 * x + qw * tx + (qz * ty - qy * tz),
        q2 * y + qw * ty + (qx * tz - qz * tx),
        q2 * z + qw * tz + (qy * tx - qx * ty),
    )


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _project_any(  # type: ignore[no-untyped-def]
    m: ModelTable, gx: float, gy: float, gz: float, nx: float, ny: float, nz: float, k_m: float
):
    """Image point on whichever CCD sees the ground point; the first where two overlap."""
    line, sample = _start(m, gx, gy, gz)
    if not (math.isfinite(line) and math.isfinite(sample)):
        line, sample = 0.5 * m.lines, 0.5 * m.samples
    ccds = len(m.directions.first_sample)
    ccd = _ccd_of(m.directions, sample)
    tried = 0
    best_line, best_sample, best_flag, best_gap = np.nan, np.nan, _OUTSIDE_MODEL, np.inf
    while tried < 4:
        line, sample, flag = _project(m, ccd, line, sample, gx, gy, gz, nx, ny, nz, k_m)
        low = m.directions.first_sample[ccd] - 0.5
        high = m.directions.last_sample[ccd] + 0.5
        gap = max(low - sample, sample - high, 0.0)
        if flag == _OK and ccds > 1 and 0.0 < gap:
            # Outer ends may be left: there the margin begins.
            if (ccd == 0 and sample < low) or (ccd == ccds - 1 and sample > high):
                gap = 0.0
        if flag != _OK or ccds == 1 or gap == 0.0:
            return line, sample, flag
        if gap < best_gap:
            best_line, best_sample, best_flag, best_gap = line, sample, _OUTSIDE_IMAGE, gap
        ccd = min(max(ccd + (1 if sample > high else -1), 0), ccds - 1)
        tried += 1
    return best_line, best_sample, best_flag


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def inverse(m: ModelTable, geodetic: FloatArray, image_px: FloatArray, flags: FlagArray) -> None:
    """Fill `image_px` (n, 2) and `flags` (n,) for `geodetic` (n, 3)."""
    for i in prange(len(geodetic)):
        lon, lat, h = geodetic[i, 0], geodetic[i, 1], geodetic[i, 2]
        line = sample = np.nan
        if not (math.isfinite(lon) and math.isfinite(h) and abs(lat) <= 0.5 * math.pi + 1e-12):
            flag = _BAD_INPUT
        else:
            sin_lat, cos_lat = math.sin(lat), math.cos(lat)
            radius = WGS84_A_M / math.sqrt(1.0 - WGS84_E2 * sin_lat * sin_lat)
            nx, ny, nz = cos_lat * math.cos(lon), cos_lat * math.sin(lon), sin_lat
            gx = (radius + h) * nx
            gy = (radius + h) * ny
            gz = (radius * _B_OVER_A2 + h) * nz
            k_m = 0.0
            if m.refraction_m > 0.0:
                k_m = m.refraction_m * math.exp(-h / m.scale_height_m)
            line, sample, flag = _project_any(m, gx, gy, gz, nx, ny, nz, k_m)
            if flag == _OUTSIDE_IMAGE:
                pass
            elif flag == _OK:
                flag = _pixel_flag(m, line, sample)
            if flag <= _OUTSIDE_IMAGE:
                # The far side of the Earth projects too, through the ground.
                k, s, length, x, y, z, vx, vy, vz, qx, qy, qz, qw = _pose(m.pose, line)
                if not (x - gx) * nx + (y - gy) * ny + (z - gz) * nz > 0.0:
                    flag = _OUTSIDE_MODEL
            if flag > _OUTSIDE_IMAGE:
                line = sample = np.nan
        image_px[i, 0] = line
        image_px[i, 1] = sample
        flags[i] = flag
