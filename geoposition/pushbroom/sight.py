"""Compiled direct location and lines of sight; the corrections' formulas are in `corrections`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray
from geoposition.constants import EARTH_RATE_RAD_S, WGS84_A_M, WGS84_E2
from geoposition.pushbroom.angles import write_geodetic
from geoposition.pushbroom.lanes import (
    B_M,
    B_OVER_A2,
    BAD_INPUT,
    BLOCKS_PER_TASK,
    CCD,
    FAST,
    GX,
    GY,
    GZ,
    HEIGHT,
    KM,
    LANES,
    LINE,
    LOWEST_HEIGHT_M,
    NO_INTERSECTION,
    OUTSIDE_IMAGE,
    PER_C,
    QW,
    QX,
    QY,
    QZ,
    RADIUS,
    ROWS,
    RX,
    RY,
    RZ,
    SAMPLE,
    SX,
    SY,
    SZ,
    TA,
    TB,
    VX,
    VY,
    VZ,
    ModelTable,
    ccd_of,
    fill_pose,
    fill_tangents,
    full_vectors,
    pixel_flag,
)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _sight(
    n: int, w: FloatArray, aberration: float, light_time: float, mean_range_m: float
) -> None:
    """Ground points of the heights in row `HEIGHT`: rows `GX` .. `GZ`, `RADIUS`.

    NaN where the line of sight misses. Rows pose, tangents and `KM` must be filled.
    """
    g = light_time * EARTH_RATE_RAD_S * PER_C
    f = aberration * PER_C
    for i in range(n):
        a, b = w[TA * LANES + i], w[TB * LANES + i]
        x, y, z = w[SX * LANES + i], w[SY * LANES + i], w[SZ * LANES + i]
        qx, qy, qz = w[QX * LANES + i], w[QY * LANES + i], w[QZ * LANES + i]
        qw = w[QW * LANES + i]
        h = w[HEIGHT * LANES + i]
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
        fx = f * (w[VX * LANES + i] - EARTH_RATE_RAD_S * y) + g * y
        fy = f * (w[VY * LANES + i] + EARTH_RATE_RAD_S * x) - g * x
        fz = f * w[VZ * LANES + i]
        far = g * mean_range_m
        ux = ax - (fx + far * ay)
        uy = ay - (fy - far * ax)
        uz = az - fz
        unit = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
        ux *= unit
        uy *= unit
        uz *= unit
        wa = 1.0 / (WGS84_A_M + h)
        wb = 1.0 / (B_M + h)
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
        nz = gz / (radius * B_OVER_A2 + h)
        unit = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx *= unit
        ny *= unit
        nz *= unit
        flat = math.sqrt(1.0 - WGS84_E2 * nz * nz)
        height = nx * gx + ny * gy + nz * gz - WGS84_A_M * flat
        cos_z = -(nx * ux + ny * uy + nz * uz)
        dt = (height - h) / cos_z
        # Refraction: towards the satellite, and back down to the curved surface.
        bend = w[KM * LANES + i] / (cos_z * cos_z * cos_z)
        sx = bend * (-ux - cos_z * nx)
        sy = bend * (-uy - cos_z * ny)
        sz = bend * (-uz - cos_z * nz)
        curved = (1.0 - 0.5 * WGS84_E2 * nz * nz) / WGS84_A_M
        steep = curved * (1.0 + WGS84_E2 + WGS84_E2 * WGS84_E2)
        drop = 0.5 * (curved * (sx * sx + sy * sy) + steep * sz * sz)
        # Behind the camera, or below the surface: no line of sight (cos_z is NaN for a miss).
        miss = 0.0 if (t > 0.0 and cos_z > 0.0 and cc > 0.0) else np.nan
        w[GX * LANES + i] = gx + dt * ux + sx - drop * nx + miss
        w[GY * LANES + i] = gy + dt * uy + sy - drop * ny + miss
        w[GZ * LANES + i] = gz + dt * uz + sz - drop * nz + miss
        w[RADIUS * LANES + i] = WGS84_A_M / flat


@njit(cache=True, error_model="numpy", fastmath=FAST)
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
        flag = pixel_flag(line, sample, first_line, last_line, margin_px, lines, samples)
        if not (math.isfinite(h) and h > LOWEST_HEIGHT_M):
            flag = BAD_INPUT
        if flag > OUTSIDE_IMAGE:
            line, sample, h = first_line, 0.0, 0.0
        flags[first + i] = flag
        w[LINE * LANES + i] = line
        w[SAMPLE * LANES + i] = sample
        w[HEIGHT * LANES + i] = h
        w[CCD * LANES + i] = ccd_of(first_sample, sample)
        w[KM * LANES + i] = same_km
    if height_step > 0 and refraction_m > 0.0:
        for i in range(n):
            w[KM * LANES + i] = refraction_m * math.exp(-w[HEIGHT * LANES + i] / scale_height_m)
    fill_pose(m, w, n)
    fill_tangents(m, w, n)
    _sight(full_vectors(n), w, m.aberration, m.light_time, m.mean_range_m)
    for i in range(n):
        if flags[first + i] > OUTSIDE_IMAGE:
            w[GX * LANES + i] = np.nan
        elif not math.isfinite(w[GX * LANES + i]):
            flags[first + i] = NO_INTERSECTION


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
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
    size = LANES * BLOCKS_PER_TASK
    for task in prange((total + size - 1) // size):
        w = np.empty(ROWS * LANES)
        for first in range(task * size, min((task + 1) * size, total), LANES):
            n = min(LANES, total - first)
            _see_block(m, w, image_px, height_m, height_step, flags, first, n)
            write_geodetic(m, w, n, geodetic[first : first + n])


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
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
    size = LANES * BLOCKS_PER_TASK
    for task in prange((total + size - 1) // size):
        w = np.empty(ROWS * LANES)
        for first in range(task * size, min((task + 1) * size, total), LANES):
            n = min(LANES, total - first)
            _see_block(m, w, image_px, height_m, height_step, flags, first, n)
            for i in range(full_vectors(n)):
                x, y, z = w[SX * LANES + i], w[SY * LANES + i], w[SZ * LANES + i]
                dx, dy, dz = w[GX * LANES + i] - x, w[GY * LANES + i] - y, w[GZ * LANES + i] - z
                unit = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
                w[RX * LANES + i] = dx * unit
                w[RY * LANES + i] = dy * unit
                w[RZ * LANES + i] = dz * unit
            for i in range(n):
                none = 0.0 * w[GX * LANES + i]
                for j in range(3):
                    origin[first + i, j] = w[(SX + j) * LANES + i] + none
                    direction[first + i, j] = w[(RX + j) * LANES + i]
