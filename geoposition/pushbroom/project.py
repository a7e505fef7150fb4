"""Compiled inverse location: Newton's method from a cubic start, block by block."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.constants import EARTH_RATE_RAD_S, WGS84_A_M, WGS84_E2
from geoposition.pushbroom.angles import fill_normals
from geoposition.pushbroom.lanes import (
    AT_END,
    B_OVER_A2,
    BAD_INPUT,
    BLOCKS_PER_TASK,
    BX,
    BY,
    BZ,
    CCD,
    DA,
    DB,
    DLINE,
    DSAMPLE,
    FAST,
    FRONT,
    GX,
    GY,
    GZ,
    HEIGHT,
    KEPT,
    KM,
    LANES,
    LINE,
    LINE_S,
    LOWEST_HEIGHT_M,
    MAX_STEPS,
    NOT_CONVERGED,
    NX,
    NY,
    NZ,
    OUTSIDE_IMAGE,
    OUTSIDE_MODEL,
    PER_C,
    QW,
    QX,
    QY,
    QZ,
    ROWS,
    RW,
    RX,
    RY,
    RZ,
    SAMPLE,
    STEP_TOLERANCE_PX,
    SX,
    SY,
    SZ,
    TA,
    TB,
    TRIES,
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
def _newton(n: int, w: FloatArray, aberration: float, light_time: float) -> None:
    """One Newton step towards the image points of the ground points: `DLINE`, `DSAMPLE`.

    Rows pose, tangents, ground, normal, `KM` must be filled; the bend rows are refined.
    `FRONT` becomes positive where the point lies before the camera.
    """
    f = aberration * PER_C
    g = light_time * EARTH_RATE_RAD_S * PER_C
    for i in range(n):
        x, y, z = w[SX * LANES + i], w[SY * LANES + i], w[SZ * LANES + i]
        vx, vy, vz = w[VX * LANES + i], w[VY * LANES + i], w[VZ * LANES + i]
        gx, gy, gz = w[GX * LANES + i], w[GY * LANES + i], w[GZ * LANES + i]
        # The straight line of sight meets the height surface beside the true point.
        sx, sy, sz = w[BX * LANES + i], w[BY * LANES + i], w[BZ * LANES + i]
        ux, uy, uz = gx - sx - x, gy - sy - y, gz - sz - z
        unit = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
        ux *= unit
        uy *= unit
        uz *= unit
        nx, ny, nz = w[NX * LANES + i], w[NY * LANES + i], w[NZ * LANES + i]
        # The normal there: the ellipsoid's curvature, as of (x / (N + h), z / ((1 - e²) N + h)).
        flat = (1.0 - 0.5 * WGS84_E2 * nz * nz) / WGS84_A_M
        steep = flat * (1.0 + WGS84_E2 + WGS84_E2 * WGS84_E2)
        upright = 1.0 + flat * (nx * sx + ny * sy) + steep * nz * sz
        nx = upright * nx - flat * sx
        ny = upright * ny - flat * sy
        nz = upright * nz - steep * sz
        cos_z = -(nx * ux + ny * uy + nz * uz)
        bend = w[KM * LANES + i] / (cos_z * cos_z * cos_z)
        sx = bend * (-ux - cos_z * nx)
        sy = bend * (-uy - cos_z * ny)
        sz = bend * (-uz - cos_z * nz)
        drop = 0.5 * (flat * (sx * sx + sy * sy) + steep * sz * sz)
        sx -= drop * nx
        sy -= drop * ny
        sz -= drop * nz
        w[BX * LANES + i] = sx
        w[BY * LANES + i] = sy
        w[BZ * LANES + i] = sz
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
        qx, qy, qz = w[QX * LANES + i], w[QY * LANES + i], w[QZ * LANES + i]
        qw = w[QW * LANES + i]
        q2 = qx * qx + qy * qy + qz * qz + qw * qw
        tx = 2.0 * (qz * ay - qy * az)
        ty = 2.0 * (qx * az - qz * ax)
        tz = 2.0 * (qy * ax - qx * ay)
        cx = q2 * ax + qw * tx + (qz * ty - qy * tz)
        cy = q2 * ay + qw * ty + (qx * tz - qz * tx)
        cz = q2 * az + qw * tz + (qy * tx - qx * ty)
        # Its rate per line: the camera moves, and turns by 2 q* q'.
        vu = vx * ux + vy * uy + vz * uz
        move = -w[LINE_S * LANES + i] * per_range
        mx, my, mz = move * (vx - vu * ux), move * (vy - vu * uy), move * (vz - vu * uz)
        tx = 2.0 * (qz * my - qy * mz)
        ty = 2.0 * (qx * mz - qz * mx)
        tz = 2.0 * (qy * mx - qx * my)
        ex = q2 * mx + qw * tx + (qz * ty - qy * tz)
        ey = q2 * my + qw * ty + (qx * tz - qz * tx)
        ez = q2 * mz + qw * tz + (qy * tx - qx * ty)
        rx, ry, rz = w[RX * LANES + i], w[RY * LANES + i], w[RZ * LANES + i]
        rw = w[RW * LANES + i]
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
        da, db = w[DA * LANES + i], w[DB * LANES + i]
        ra = ta - w[TA * LANES + i]
        rb = tb - w[TB * LANES + i]
        per_det = 1.0 / (db_line * da - da_line * db)
        w[DLINE * LANES + i] = (db * ra - da * rb) * per_det
        w[DSAMPLE * LANES + i] = (db_line * ra - da_line * rb) * per_det
        # Before the camera, and on its side of the Earth.
        w[FRONT * LANES + i] = min(cz, cos_z)


@njit(cache=True, error_model="numpy", fastmath=FAST, inline="always")
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


@njit(cache=True, error_model="numpy", fastmath=FAST)
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
            flags[i] = BAD_INPUT
            image_px[i, 0] = np.nan
            image_px[i, 1] = np.nan
            continue
        w[LINE * LANES + good] = lon
        w[SAMPLE * LANES + good] = lat
        w[HEIGHT * LANES + good] = h
        ids[good] = i
        good += 1
    fill_normals(m, w, good)
    for i in range(full_vectors(good)):
        nx, ny, nz = w[NX * LANES + i], w[NY * LANES + i], w[NZ * LANES + i]
        h = w[HEIGHT * LANES + i]
        radius = WGS84_A_M / math.sqrt(1.0 - WGS84_E2 * nz * nz)
        gx = (radius + h) * nx
        gy = (radius + h) * ny
        gz = (radius * B_OVER_A2 + h) * nz
        w[GX * LANES + i] = gx
        w[GY * LANES + i] = gy
        w[GZ * LANES + i] = gz
        cx = (gx - centre[0]) * per_extent
        cy = (gy - centre[1]) * per_extent
        cz = (gz - centre[2]) * per_extent
        e = r[0, 0] * cx + r[0, 1] * cy + r[0, 2] * cz
        north = r[1, 0] * cx + r[1, 1] * cy + r[1, 2] * cz
        u = r[2, 0] * cx + r[2, 1] * cy + r[2, 2] * cz
        w[LINE * LANES + i] = _cubic(c, 0, e, north, u)
        w[SAMPLE * LANES + i] = _cubic(c, 1, e, north, u)
        w[BX * LANES + i] = 0.0
        w[BY * LANES + i] = 0.0
        w[BZ * LANES + i] = 0.0
        w[TRIES * LANES + i] = 0.0
        w[AT_END * LANES + i] = 0.0
        w[KM * LANES + i] = 0.0
    for i in range(good):
        # Far from the scene the cubic may point anywhere: bring it back to what the table holds.
        w[LINE * LANES + i] = min(max(w[LINE * LANES + i], first_line), last_line)
        w[SAMPLE * LANES + i] = min(max(w[SAMPLE * LANES + i], -far), right)
        w[CCD * LANES + i] = ccd_of(first_sample, w[SAMPLE * LANES + i])
    if refraction_m > 0.0:
        for i in range(good):
            w[KM * LANES + i] = refraction_m * math.exp(-w[HEIGHT * LANES + i] / scale_height_m)
    return good


@njit(cache=True, error_model="numpy", fastmath=FAST)
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
        d_line, d_sample = w[DLINE * LANES + i], w[DSAMPLE * LANES + i]
        line, sample = w[LINE * LANES + i] + d_line, w[SAMPLE * LANES + i] + d_sample
        flag = -1
        if not (math.isfinite(d_line) and math.isfinite(d_sample)):
            flag = NOT_CONVERGED
        elif step > 0 and max(abs(d_line), abs(d_sample)) < STEP_TOLERANCE_PX:
            flag = pixel_flag(line, sample, first_line, last_line, margin_px, lines, samples)
            if not w[FRONT * LANES + i] > 0.0:
                flag = OUTSIDE_MODEL
            ccd = int(w[CCD * LANES + i])
            below = sample < first_sample[ccd] - 0.5 and ccd > 0
            above = sample > last_sample[ccd] + 0.5 and ccd < ccds - 1
            if below or above:
                w[TRIES * LANES + i] += 1.0
                if w[TRIES * LANES + i] > 3.0:
                    flag = OUTSIDE_MODEL
                else:
                    w[CCD * LANES + i] = ccd - 1.0 if below else ccd + 1.0
                    flag = -1
        elif line < first_line or line > last_line:
            w[AT_END * LANES + i] += 1.0
            if w[AT_END * LANES + i] > 3.0:
                flag = OUTSIDE_MODEL
        if flag == OUTSIDE_MODEL and w[TRIES * LANES + i] == 0.0:
            # Beyond the lines of this CCD: a staggered neighbour that overlaps it may see it.
            ccd = int(w[CCD * LANES + i])
            ccd += 1 if sample > 0.5 * (first_sample[ccd] + last_sample[ccd]) else -1
            if 0 <= ccd < ccds:
                w[TRIES * LANES + i] = 3.0
                w[AT_END * LANES + i] = 0.0
                w[CCD * LANES + i] = ccd
                flag = -1
        if flag < 0 and step == MAX_STEPS - 1:
            flag = NOT_CONVERGED
        if flag < 0:
            if left < i:
                for row in range(KEPT):
                    w[row * LANES + left] = w[row * LANES + i]
                ids[left] = ids[i]
            w[LINE * LANES + left] = min(max(line, first_line), last_line)
            w[SAMPLE * LANES + left] = min(max(sample, -far), samples + far)
            left += 1
        else:
            found = flag <= OUTSIDE_IMAGE
            image_px[ids[i], 0] = line if found else np.nan
            image_px[ids[i], 1] = sample if found else np.nan
            flags[ids[i]] = flag
    return left


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def inverse(m: ModelTable, geodetic: FloatArray, image_px: FloatArray, flags: FlagArray) -> None:
    """Fill `image_px` (n, 2) and `flags` (n,) for `geodetic` (n, 3)."""
    total = len(geodetic)
    size = LANES * BLOCKS_PER_TASK
    for task in prange((total + size - 1) // size):
        w = np.empty(ROWS * LANES)
        ids = np.empty(LANES, dtype=np.int64)
        for first in range(task * size, min((task + 1) * size, total), LANES):
            n = min(LANES, total - first)
            n = _begin(m, w, geodetic, ids, image_px, flags, first, n)
            for step in range(MAX_STEPS):
                fill_pose(m, w, n)
                fill_tangents(m, w, n)
                _newton(full_vectors(n), w, m.aberration, m.light_time)
                n = _sort_out(m, w, ids, image_px, flags, n, step)
                if n == 0:
                    break
