"""Compiled push-broom geometry: lines of sight, direct and inverse location.

Points go through in blocks of `LANES`. A block's numbers lie in rows of one work array, row r
of lane i at `w[r * LANES + i]`: table look-ups fill rows lane by lane, and the arithmetic
between runs over whole rows in loops without branches, which compile to vector instructions.
The formulas of the corrections are in `corrections`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.constants import EARTH_RATE_RAD_S, SPEED_OF_LIGHT_M_S, WGS84_A_M, WGS84_E2
from geoposition.flags import Flag

LANES = 256
_BLOCKS_PER_TASK = 16
_VECTOR = 32

_OK = int(Flag.OK)
_OUTSIDE_IMAGE = int(Flag.OUTSIDE_IMAGE)
_OUTSIDE_MODEL = int(Flag.OUTSIDE_MODEL)
_BAD_INPUT = int(Flag.BAD_INPUT)
_NO_INTERSECTION = int(Flag.NO_INTERSECTION)
_NOT_CONVERGED = int(Flag.NOT_CONVERGED)

_B_OVER_A2 = 1.0 - WGS84_E2
_B_M = WGS84_A_M * math.sqrt(_B_OVER_A2)
_MEAN_RADIUS_M = 6371e3
_PER_C = 1.0 / SPEED_OF_LIGHT_M_S

MAX_STEPS = 25
STEP_TOLERANCE_PX = 2e-5
"""A Newton step below this, not the first, leaves an error far below 1e-6 px."""
EDGE_TOLERANCE_PX = 1e-5
"""Rounding allowed at the edges of image and margin, so that what is located comes back."""
LOWEST_HEIGHT_M = -1e5
"""A height below this is no point on Earth."""

# Rows of the work array. First what identifies a point and the state of its iteration.
_LINE, _SAMPLE, _HEIGHT, _CCD, _TRIES, _AT_END = 0, 1, 2, 3, 4, 5
_GX, _GY, _GZ, _NX, _NY, _NZ, _KM, _BX, _BY, _BZ = 6, 7, 8, 9, 10, 11, 12, 13, 14, 15
_KEPT = 16
# Then what one pass computes: camera position, velocity, quaternion and its rate per line,
# seconds per line, tangents and their rates per sample, the Newton step, the radius N.
_SX, _SY, _SZ, _VX, _VY, _VZ, _QX, _QY, _QZ, _QW = 16, 17, 18, 19, 20, 21, 22, 23, 24, 25
_RX, _RY, _RZ, _RW, _LINE_S, _TA, _TB, _DA, _DB = 26, 27, 28, 29, 30, 31, 32, 33, 34
_DLINE, _DSAMPLE, _FRONT, _RADIUS = 35, 36, 37, 38
_ROWS = 39

# NaN must keep its meaning, so only the reorderings of fast-math that respect it.
_FAST = {"contract", "arcp", "nsz", "reassoc"}


class ModelTable(NamedTuple):
    """All a kernel needs of one rigorous model; flat, since parallel loops take no nested ones.

    `pose_*`: piecewise cubic over lines of the position in ECEF (3) and the quaternion xyzw (4)
    of R_ecef_camera, not normalised; `pose_seconds` (n,) is the time each segment takes,
    negative in reverse scans. `ccd_*`: piecewise cubics of the camera-frame tangents (2) over
    the samples of m CCDs, one after the other: those of CCD i are entries `ccd_start[i]` ..
    `ccd_start[i + 1]` of `ccd_coefficients`, its knots begin at `ccd_start[i] + i`, its bins at
    `ccd_bin_start[i]`. `start` (20, 2) is a cubic in local coordinates p = `R_local_ecef`
    (P − `centre_ecef_m`) / `extent_m` that gives line and sample within some pixels: where the
    inverse location begins. `aberration`, `light_time` are 0 or 1, `refraction_m` is (n0 − 1) H
    or 0, `scale_height_m` H. `margin_px` are the samples beyond the image still answered.
    """

    lines: int
    samples: int
    first_line: float
    last_line: float
    margin_px: float
    pose_knots: FloatArray
    pose_coefficients: FloatArray
    pose_bins: IntArray
    pose_bin_origin: float
    pose_bin_scale: float
    pose_seconds: FloatArray
    ccd_first_sample: FloatArray
    ccd_last_sample: FloatArray
    ccd_start: IntArray
    ccd_knots: FloatArray
    ccd_coefficients: FloatArray
    ccd_bins: IntArray
    ccd_bin_start: IntArray
    ccd_bin_origin: FloatArray
    ccd_bin_scale: FloatArray
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
def _fill_pose(m: ModelTable, w: FloatArray, n: int) -> None:
    """Camera pose of the lines in row `_LINE`, which must lie within the table."""
    knots, c, bins, seconds = m.pose_knots, m.pose_coefficients, m.pose_bins, m.pose_seconds
    last = len(seconds) - 1
    cells = len(bins) - 1
    origin, scale = m.pose_bin_origin, m.pose_bin_scale
    for i in range(n):
        line = w[_LINE * LANES + i]
        cell = int((line - origin) * scale)
        k = bins[min(max(cell, 0), cells)]
        while k > 0 and line < knots[k]:
            k -= 1
        while k < last and line >= knots[k + 1]:
            k += 1
        per_line = 1.0 / (knots[k + 1] - knots[k])
        s = (line - knots[k]) * per_line
        for j in range(3):
            w[(_SX + j) * LANES + i] = c[k, 0, j] + s * (
                c[k, 1, j] + s * (c[k, 2, j] + s * c[k, 3, j])
            )
            w[(_VX + j) * LANES + i] = (
                c[k, 1, j] + s * (2.0 * c[k, 2, j] + s * 3.0 * c[k, 3, j])
            ) / seconds[k]
        for j in range(4):
            w[(_QX + j) * LANES + i] = c[k, 0, 3 + j] + s * (
                c[k, 1, 3 + j] + s * (c[k, 2, 3 + j] + s * c[k, 3, 3 + j])
            )
            w[(_RX + j) * LANES + i] = per_line * (
                c[k, 1, 3 + j] + s * (2.0 * c[k, 2, 3 + j] + s * 3.0 * c[k, 3, 3 + j])
            )
        w[_LINE_S * LANES + i] = seconds[k] * per_line


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _fill_tangents(m: ModelTable, w: FloatArray, n: int) -> None:
    """Tangents and their rates of the samples in row `_SAMPLE`, for the CCDs in row `_CCD`.

    The end segments continue beyond the ends.
    """
    knots, c, bins = m.ccd_knots, m.ccd_coefficients, m.ccd_bins
    start, bin_start, origin, scale = (
        m.ccd_start,
        m.ccd_bin_start,
        m.ccd_bin_origin,
        m.ccd_bin_scale,
    )
    for i in range(n):
        sample = w[_SAMPLE * LANES + i]
        ccd = int(w[_CCD * LANES + i])
        first = start[ccd]
        knot = first + ccd
        last = start[ccd + 1] - first - 1
        k = 0
        if last > 0:
            cell = int((sample - origin[ccd]) * scale[ccd])
            cells = bin_start[ccd + 1] - bin_start[ccd] - 1
            k = bins[bin_start[ccd] + min(max(cell, 0), cells)]
            while k > 0 and sample < knots[knot + k]:
                k -= 1
            while k < last and sample >= knots[knot + k + 1]:
                k += 1
        per_sample = 1.0 / (knots[knot + k + 1] - knots[knot + k])
        s = (sample - knots[knot + k]) * per_sample
        k += first
        for j in range(2):
            w[(_TA + j) * LANES + i] = c[k, 0, j] + s * (
                c[k, 1, j] + s * (c[k, 2, j] + s * c[k, 3, j])
            )
            w[(_DA + j) * LANES + i] = per_sample * (
                c[k, 1, j] + s * (2.0 * c[k, 2, j] + s * 3.0 * c[k, 3, j])
            )


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _ccd_of(first_sample: FloatArray, sample: float) -> int:
    """CCD whose part of the row holds `sample`; the outer ones reach on."""
    ccd = 0
    while ccd < len(first_sample) - 1 and sample >= first_sample[ccd + 1] - 0.5:
        ccd += 1
    return ccd


@njit(cache=True, error_model="numpy", inline="always")
def _full(n: int) -> int:
    """`n` rounded up to whole vectors: no lane is left to a scalar loop that rounds otherwise.

    The lanes beyond `n` hold anything; nothing is read from them.
    """
    return (n + _VECTOR - 1) // _VECTOR * _VECTOR


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _sight(
    n: int, w: FloatArray, aberration: float, light_time: float, mean_range_m: float
) -> None:
    """Ground points of the heights in row `_HEIGHT`: rows `_GX` .. `_GZ`, `_RADIUS`.

    NaN where the line of sight misses. Rows pose, tangents and `_KM` must be filled.
    """
    g = light_time * EARTH_RATE_RAD_S * _PER_C
    f = aberration * _PER_C
    for i in range(n):
        a, b = w[_TA * LANES + i], w[_TB * LANES + i]
        x, y, z = w[_SX * LANES + i], w[_SY * LANES + i], w[_SZ * LANES + i]
        qx, qy, qz = w[_QX * LANES + i], w[_QY * LANES + i], w[_QZ * LANES + i]
        qw = w[_QW * LANES + i]
        h = w[_HEIGHT * LANES + i]
        # Apparent direction: q (a, b, 1) q*, up to the length of q.
        tx = 2.0 * (qy - qz * b)
        ty = 2.0 * (qz * a - qx)
        tz = 2.0 * (qx * b - qy * a)
        q2 = qx * qx + qy * qy + qz * qz + qw * qw
        ax = q2 * a + (qw * tx + qy * tz - qz * ty)
        ay = q2 * b + (qw * ty + qz * tx - qx * tz)
        az = q2 + (qw * tz + qx * ty - qy * tx)
        unit = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
        ax *= unit
        ay *= unit
        az *= unit
        # True direction unit(u_app − v / c); P = S + range u enters v through the Earth's
        # rotation. The mean range is some 100 km off at worst, hence 2 cm; then the range of
        # the height surface, good to decimetres, hence far below a micrometre.
        fx = f * (w[_VX * LANES + i] - EARTH_RATE_RAD_S * y) + g * y
        fy = f * (w[_VY * LANES + i] + EARTH_RATE_RAD_S * x) - g * x
        fz = f * w[_VZ * LANES + i]
        far = g * mean_range_m
        ux = ax - (fx + far * ay)
        uy = ay - (fy - far * ax)
        uz = az - fz
        unit = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
        ux *= unit
        uy *= unit
        uz *= unit
        wa = 1.0 / (WGS84_A_M + h)
        wb = 1.0 / (_B_M + h)
        px, py, pz = x * wa, y * wa, z * wb
        cc = px * px + py * py + pz * pz - 1.0
        dx, dy, dz = ux * wa, uy * wa, uz * wb
        aa = dx * dx + dy * dy + dz * dz
        bb = px * dx + py * dy + pz * dz
        far = g * (cc / (math.sqrt(bb * bb - aa * cc) - bb))
        rx = ax - (fx + far * uy)
        ry = ay - (fy - far * ux)
        uz = az - fz
        unit = 1.0 / math.sqrt(rx * rx + ry * ry + uz * uz)
        ux = rx * unit
        uy = ry * unit
        uz *= unit
        # The ellipsoid with semi-axes a + h, b + h is up to decimetres off the surface of
        # height h; a Newton step on the height itself, along the exact normal, mends it.
        dx, dy, dz = ux * wa, uy * wa, uz * wb
        aa = dx * dx + dy * dy + dz * dz
        bb = px * dx + py * dy + pz * dz
        t = cc / (math.sqrt(bb * bb - aa * cc) - bb)
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
        unit = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx *= unit
        ny *= unit
        nz *= unit
        flat = math.sqrt(1.0 - WGS84_E2 * nz * nz)
        height = nx * gx + ny * gy + nz * gz - WGS84_A_M * flat
        cos_z = -(nx * ux + ny * uy + nz * uz)
        dt = (height - h) / cos_z
        # Refraction: towards the satellite, and back down to the curved surface.
        bend = w[_KM * LANES + i] / (cos_z * cos_z * cos_z)
        sx = bend * (-ux - cos_z * nx)
        sy = bend * (-uy - cos_z * ny)
        sz = bend * (-uz - cos_z * nz)
        drop = 0.5 * (sx * sx + sy * sy + sz * sz) / _MEAN_RADIUS_M
        # Behind the camera, or below the surface: no line of sight (cos_z is NaN for a miss).
        miss = 0.0 if (t > 0.0 and cos_z > 0.0 and cc > 0.0) else np.nan
        w[_GX * LANES + i] = gx + dt * ux + sx - drop * nx + miss
        w[_GY * LANES + i] = gy + dt * uy + sy - drop * ny + miss
        w[_GZ * LANES + i] = gz + dt * uz + sz - drop * nz + miss
        w[_RADIUS * LANES + i] = WGS84_A_M / flat


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _newton(n: int, w: FloatArray, aberration: float, light_time: float) -> None:
    """One Newton step towards the image points of the ground points: `_DLINE`, `_DSAMPLE`.

    Rows pose, tangents, ground, normal, `_KM` must be filled; the bend rows are refined.
    `_FRONT` becomes positive where the point lies before the camera.
    """
    f = aberration * _PER_C
    g = light_time * EARTH_RATE_RAD_S * _PER_C
    for i in range(n):
        x, y, z = w[_SX * LANES + i], w[_SY * LANES + i], w[_SZ * LANES + i]
        vx, vy, vz = w[_VX * LANES + i], w[_VY * LANES + i], w[_VZ * LANES + i]
        gx, gy, gz = w[_GX * LANES + i], w[_GY * LANES + i], w[_GZ * LANES + i]
        # The straight line of sight meets the height surface beside the true point.
        sx, sy, sz = w[_BX * LANES + i], w[_BY * LANES + i], w[_BZ * LANES + i]
        ux, uy, uz = gx - sx - x, gy - sy - y, gz - sz - z
        unit = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
        ux *= unit
        uy *= unit
        uz *= unit
        nx = w[_NX * LANES + i] - sx / _MEAN_RADIUS_M
        ny = w[_NY * LANES + i] - sy / _MEAN_RADIUS_M
        nz = w[_NZ * LANES + i] - sz / _MEAN_RADIUS_M
        cos_z = -(nx * ux + ny * uy + nz * uz)
        bend = w[_KM * LANES + i] / (cos_z * cos_z * cos_z)
        sx = bend * (-ux - cos_z * nx)
        sy = bend * (-uy - cos_z * ny)
        sz = bend * (-uz - cos_z * nz)
        drop = 0.5 * (sx * sx + sy * sy + sz * sz) / _MEAN_RADIUS_M
        sx -= drop * nx
        sy -= drop * ny
        sz -= drop * nz
        w[_BX * LANES + i] = sx
        w[_BY * LANES + i] = sy
        w[_BZ * LANES + i] = sz
        ux, uy, uz = gx - sx - x, gy - sy - y, gz - sz - z
        per_range = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
        ux *= per_range
        uy *= per_range
        uz *= per_range
        # u_app = k u + v / c, with k such that its length is one.
        fx = f * (vx - EARTH_RATE_RAD_S * y) + g * (gy - sy)
        fy = f * (vy + EARTH_RATE_RAD_S * x) - g * (gx - sx)
        fz = f * vz
        uf = ux * fx + uy * fy + uz * fz
        stretch = math.sqrt(uf * uf + 1.0 - fx * fx - fy * fy - fz * fz) - uf
        ax = stretch * ux + fx
        ay = stretch * uy + fy
        az = stretch * uz + fz
        # Into the camera frame: q* a q, up to the length of q.
        qx, qy, qz = w[_QX * LANES + i], w[_QY * LANES + i], w[_QZ * LANES + i]
        qw = w[_QW * LANES + i]
        q2 = qx * qx + qy * qy + qz * qz + qw * qw
        tx = 2.0 * (qz * ay - qy * az)
        ty = 2.0 * (qx * az - qz * ax)
        tz = 2.0 * (qy * ax - qx * ay)
        cx = q2 * ax + qw * tx + (qz * ty - qy * tz)
        cy = q2 * ay + qw * ty + (qx * tz - qz * tx)
        cz = q2 * az + qw * tz + (qy * tx - qx * ty)
        # Its rate per line: the camera moves, and turns by 2 q* q'.
        vu = vx * ux + vy * uy + vz * uz
        move = -w[_LINE_S * LANES + i] * per_range
        mx, my, mz = move * (vx - vu * ux), move * (vy - vu * uy), move * (vz - vu * uz)
        tx = 2.0 * (qz * my - qy * mz)
        ty = 2.0 * (qx * mz - qz * mx)
        tz = 2.0 * (qy * mx - qx * my)
        ex = q2 * mx + qw * tx + (qz * ty - qy * tz)
        ey = q2 * my + qw * ty + (qx * tz - qz * tx)
        ez = q2 * mz + qw * tz + (qy * tx - qx * ty)
        rx, ry, rz = w[_RX * LANES + i], w[_RY * LANES + i], w[_RZ * LANES + i]
        rw = w[_RW * LANES + i]
        turn = 2.0 / q2
        ox = turn * (qw * rx - qx * rw - qy * rz + qz * ry)
        oy = turn * (qw * ry - qy * rw - qz * rx + qx * rz)
        oz = turn * (qw * rz - qz * rw - qx * ry + qy * rx)
        ex -= oy * cz - oz * cy
        ey -= oz * cx - ox * cz
        ez -= ox * cy - oy * cx
        per_z = 1.0 / cz
        ta = cx * per_z
        tb = cy * per_z
        da_line = (ex - ta * ez) * per_z
        db_line = (ey - tb * ez) * per_z
        da, db = w[_DA * LANES + i], w[_DB * LANES + i]
        ra = ta - w[_TA * LANES + i]
        rb = tb - w[_TB * LANES + i]
        per_det = 1.0 / (db_line * da - da_line * db)
        w[_DLINE * LANES + i] = (db * ra - da * rb) * per_det
        w[_DSAMPLE * LANES + i] = (db_line * ra - da_line * rb) * per_det
        # Before the camera, and on its side of the Earth.
        w[_FRONT * LANES + i] = min(cz, cos_z)


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _pixel_flag(
    line: float,
    sample: float,
    first_line: float,
    last_line: float,
    margin_px: float,
    lines: int,
    samples: int,
) -> int:
    """Flag of an image point: within the image, its margin, or beyond."""
    if not (math.isfinite(line) and math.isfinite(sample)):
        return _BAD_INPUT
    off_line = max(first_line - line, line - last_line)
    off_sample = max(-margin_px - sample, sample - (samples - 1 + margin_px))
    if max(off_line, off_sample) > EDGE_TOLERANCE_PX:
        return _OUTSIDE_MODEL
    off_line = max(-0.5 - line, line - (lines - 0.5))
    off_sample = max(-0.5 - sample, sample - (samples - 0.5))
    if max(off_line, off_sample) <= EDGE_TOLERANCE_PX:
        return _OK
    return _OUTSIDE_IMAGE


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _see_block(
    m: ModelTable,
    w: FloatArray,
    image_px: FloatArray,
    height_m: FloatArray,
    height_step: int,
    flags: FlagArray,
    first: int,
    n: int,
) -> None:
    """Camera and ground rows, and flags, of points `first` .. `first + n`."""
    first_sample = m.ccd_first_sample
    first_line, last_line, margin_px = m.first_line, m.last_line, m.margin_px
    lines, samples = m.lines, m.samples
    refraction_m, scale_height_m = m.refraction_m, m.scale_height_m
    same_km = 0.0
    if height_step == 0 and refraction_m > 0.0:
        same_km = refraction_m * math.exp(-height_m[0] / scale_height_m)
    for i in range(n):
        line, sample = image_px[first + i, 0], image_px[first + i, 1]
        h = height_m[(first + i) * height_step]
        flag = _pixel_flag(line, sample, first_line, last_line, margin_px, lines, samples)
        if not (math.isfinite(h) and h > LOWEST_HEIGHT_M):
            flag = _BAD_INPUT
        if flag > _OUTSIDE_IMAGE:
            line, sample, h = first_line, 0.0, 0.0
        flags[first + i] = flag
        w[_LINE * LANES + i] = line
        w[_SAMPLE * LANES + i] = sample
        w[_HEIGHT * LANES + i] = h
        w[_CCD * LANES + i] = _ccd_of(first_sample, sample)
        w[_KM * LANES + i] = same_km
    if height_step > 0 and refraction_m > 0.0:
        for i in range(n):
            w[_KM * LANES + i] = refraction_m * math.exp(-w[_HEIGHT * LANES + i] / scale_height_m)
    _fill_pose(m, w, n)
    _fill_tangents(m, w, n)
    _sight(_full(n), w, m.aberration, m.light_time, m.mean_range_m)
    for i in range(n):
        if flags[first + i] > _OUTSIDE_IMAGE:
            w[_GX * LANES + i] = np.nan
        elif not math.isfinite(w[_GX * LANES + i]):
            flags[first + i] = _NO_INTERSECTION


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
    total = len(image_px)
    size = LANES * _BLOCKS_PER_TASK
    for task in prange((total + size - 1) // size):
        w = np.empty(_ROWS * LANES)
        for first in range(task * size, min((task + 1) * size, total), LANES):
            n = min(LANES, total - first)
            _see_block(m, w, image_px, height_m, height_step, flags, first, n)
            for i in range(n):
                gx, gy, gz = w[_GX * LANES + i], w[_GY * LANES + i], w[_GZ * LANES + i]
                radius, h = w[_RADIUS * LANES + i], w[_HEIGHT * LANES + i]
                p = math.sqrt(gx * gx + gy * gy) * (1.0 - WGS84_E2 * radius / (radius + h))
                # gx is NaN where there is no result, and so is all that follows from it.
                geodetic[first + i, 0] = math.atan2(gy, gx)
                geodetic[first + i, 1] = math.atan2(gz, p)
                geodetic[first + i, 2] = h + 0.0 * gx


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
    total = len(image_px)
    size = LANES * _BLOCKS_PER_TASK
    for task in prange((total + size - 1) // size):
        w = np.empty(_ROWS * LANES)
        for first in range(task * size, min((task + 1) * size, total), LANES):
            n = min(LANES, total - first)
            _see_block(m, w, image_px, height_m, height_step, flags, first, n)
            for i in range(_full(n)):
                x, y, z = w[_SX * LANES + i], w[_SY * LANES + i], w[_SZ * LANES + i]
                dx, dy, dz = w[_GX * LANES + i] - x, w[_GY * LANES + i] - y, w[_GZ * LANES + i] - z
                unit = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
                w[_RX * LANES + i] = dx * unit
                w[_RY * LANES + i] = dy * unit
                w[_RZ * LANES + i] = dz * unit
            for i in range(n):
                none = 0.0 * w[_GX * LANES + i]
                for j in range(3):
                    origin[first + i, j] = w[(_SX + j) * LANES + i] + none
                    direction[first + i, j] = w[(_RX + j) * LANES + i]


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _cubic(c: FloatArray, j: int, e: float, n: float, u: float) -> float:
    """Cubic in e, n, u with the 20 terms in the order of `pushbroom.cubic_terms`."""
    value: float = (
        c[0, j]
        + e * (c[1, j] + e * (c[4, j] + e * c[10, j] + n * c[11, j] + u * c[12, j]))
        + n * (c[2, j] + n * (c[5, j] + n * c[13, j] + e * c[14, j] + u * c[15, j]))
        + u * (c[3, j] + u * (c[6, j] + u * c[16, j] + e * c[17, j] + n * c[18, j]))
        + e * n * (c[7, j] + u * c[19, j])
        + e * u * c[8, j]
        + n * u * c[9, j]
    )
    return value


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _begin(
    m: ModelTable,
    w: FloatArray,
    geodetic: FloatArray,
    ids: IntArray,
    image_px: FloatArray,
    flags: FlagArray,
    first: int,
    n: int,
) -> int:
    """Ground rows and the start of the iteration for the good points; their number."""
    r, centre, c, first_sample = m.R_local_ecef, m.centre_ecef_m, m.start, m.ccd_first_sample
    per_extent = 1.0 / m.extent_m
    first_line, last_line, far = m.first_line, m.last_line, 2.0 * m.samples + 1000.0
    right, highest = m.samples + far, m.mean_range_m
    refraction_m, scale_height_m = m.refraction_m, m.scale_height_m
    good = 0
    for i in range(first, first + n):
        lon, lat, h = geodetic[i, 0], geodetic[i, 1], geodetic[i, 2]
        on_earth = abs(lat) <= 0.5 * math.pi + 1e-12 and LOWEST_HEIGHT_M < h < highest
        if not (math.isfinite(lon) and on_earth):
            flags[i] = _BAD_INPUT
            image_px[i, 0] = np.nan
            image_px[i, 1] = np.nan
            continue
        sin_lat, cos_lat = math.sin(lat), math.cos(lat)
        w[_NX * LANES + good] = cos_lat * math.cos(lon)
        w[_NY * LANES + good] = cos_lat * math.sin(lon)
        w[_NZ * LANES + good] = sin_lat
        w[_HEIGHT * LANES + good] = h
        ids[good] = i
        good += 1
    for i in range(_full(good)):
        nx, ny, nz = w[_NX * LANES + i], w[_NY * LANES + i], w[_NZ * LANES + i]
        h = w[_HEIGHT * LANES + i]
        radius = WGS84_A_M / math.sqrt(1.0 - WGS84_E2 * nz * nz)
        gx = (radius + h) * nx
        gy = (radius + h) * ny
        gz = (radius * _B_OVER_A2 + h) * nz
        w[_GX * LANES + i] = gx
        w[_GY * LANES + i] = gy
        w[_GZ * LANES + i] = gz
        cx = (gx - centre[0]) * per_extent
        cy = (gy - centre[1]) * per_extent
        cz = (gz - centre[2]) * per_extent
        e = r[0, 0] * cx + r[0, 1] * cy + r[0, 2] * cz
        north = r[1, 0] * cx + r[1, 1] * cy + r[1, 2] * cz
        u = r[2, 0] * cx + r[2, 1] * cy + r[2, 2] * cz
        w[_LINE * LANES + i] = _cubic(c, 0, e, north, u)
        w[_SAMPLE * LANES + i] = _cubic(c, 1, e, north, u)
        w[_BX * LANES + i] = 0.0
        w[_BY * LANES + i] = 0.0
        w[_BZ * LANES + i] = 0.0
        w[_TRIES * LANES + i] = 0.0
        w[_AT_END * LANES + i] = 0.0
        w[_KM * LANES + i] = 0.0
    for i in range(good):
        # Far from the scene the cubic may point anywhere: bring it back to what the table holds.
        w[_LINE * LANES + i] = min(max(w[_LINE * LANES + i], first_line), last_line)
        w[_SAMPLE * LANES + i] = min(max(w[_SAMPLE * LANES + i], -far), right)
        w[_CCD * LANES + i] = _ccd_of(first_sample, w[_SAMPLE * LANES + i])
    if refraction_m > 0.0:
        for i in range(good):
            w[_KM * LANES + i] = refraction_m * math.exp(-w[_HEIGHT * LANES + i] / scale_height_m)
    return good


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _sort_out(
    m: ModelTable,
    w: FloatArray,
    ids: IntArray,
    image_px: FloatArray,
    flags: FlagArray,
    n: int,
    step: int,
) -> int:
    """Write the points that are done; close the ranks of the others; their number.

    A point seen outside its CCD is tried on the neighbour; between CCDs it is lost.
    """
    first_sample, last_sample = m.ccd_first_sample, m.ccd_last_sample
    ccds = len(first_sample)
    first_line, last_line, margin_px = m.first_line, m.last_line, m.margin_px
    lines, samples = m.lines, m.samples
    far = 2.0 * samples + 1000.0
    left = 0
    for i in range(n):
        d_line, d_sample = w[_DLINE * LANES + i], w[_DSAMPLE * LANES + i]
        line, sample = w[_LINE * LANES + i] + d_line, w[_SAMPLE * LANES + i] + d_sample
        flag = -1
        if not (math.isfinite(d_line) and math.isfinite(d_sample)):
            flag = _NOT_CONVERGED
        elif step > 0 and max(abs(d_line), abs(d_sample)) < STEP_TOLERANCE_PX:
            flag = _pixel_flag(line, sample, first_line, last_line, margin_px, lines, samples)
            if not w[_FRONT * LANES + i] > 0.0:
                flag = _OUTSIDE_MODEL
            ccd = int(w[_CCD * LANES + i])
            below = sample < first_sample[ccd] - 0.5 and ccd > 0
            above = sample > last_sample[ccd] + 0.5 and ccd < ccds - 1
            if below or above:
                w[_TRIES * LANES + i] += 1.0
                if w[_TRIES * LANES + i] > 3.0:
                    flag = _OUTSIDE_MODEL
                else:
                    w[_CCD * LANES + i] = ccd - 1.0 if below else ccd + 1.0
                    flag = -1
        elif line < first_line or line > last_line:
            w[_AT_END * LANES + i] += 1.0
            if w[_AT_END * LANES + i] > 3.0:
                flag = _OUTSIDE_MODEL
        if flag == _OUTSIDE_MODEL and w[_TRIES * LANES + i] == 0.0:
            # Beyond the lines of this CCD: a staggered neighbour that overlaps it may see it.
            ccd = int(w[_CCD * LANES + i])
            ccd += 1 if sample > 0.5 * (first_sample[ccd] + last_sample[ccd]) else -1
            if 0 <= ccd < ccds:
                w[_TRIES * LANES + i] = 3.0
                w[_AT_END * LANES + i] = 0.0
                w[_CCD * LANES + i] = ccd
                flag = -1
        if flag < 0 and step == MAX_STEPS - 1:
            flag = _NOT_CONVERGED
        if flag < 0:
            if left < i:
                for row in range(_KEPT):
                    w[row * LANES + left] = w[row * LANES + i]
                ids[left] = ids[i]
            w[_LINE * LANES + left] = min(max(line, first_line), last_line)
            w[_SAMPLE * LANES + left] = min(max(sample, -far), samples + far)
            left += 1
        else:
            found = flag <= _OUTSIDE_IMAGE
            image_px[ids[i], 0] = line if found else np.nan
            image_px[ids[i], 1] = sample if found else np.nan
            flags[ids[i]] = flag
    return left


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def inverse(m: ModelTable, geodetic: FloatArray, image_px: FloatArray, flags: FlagArray) -> None:
    """Fill `image_px` (n, 2) and `flags` (n,) for `geodetic` (n, 3)."""
    total = len(geodetic)
    size = LANES * _BLOCKS_PER_TASK
    for task in prange((total + size - 1) // size):
        w = np.empty(_ROWS * LANES)
        ids = np.empty(LANES, dtype=np.int64)
        for first in range(task * size, min((task + 1) * size, total), LANES):
            n = min(LANES, total - first)
            n = _begin(m, w, geodetic, ids, image_px, flags, first, n)
            for step in range(MAX_STEPS):
                _fill_pose(m, w, n)
                _fill_tangents(m, w, n)
                _newton(_full(n), w, m.aberration, m.light_time)
                n = _sort_out(m, w, ids, image_px, flags, n, step)
                if n == 0:
                    break
