"""Compiled covariance of pairs of lines of sight: from midpoints to weighted points.

The point between two lines of sight is moved by their weighted least squares, which is linear
there: with the gap g from line a to line b, and the midpoint between them,
    dP = C (A_bᵀ A_b − A_aᵀ A_a) g / 2 ,   C = (A_aᵀ A_a + A_bᵀ A_b)⁻¹ ,
A = L⁻¹ J as in `kernels`. Image scales and models' errors are quadratics over the image, see
`scale`. Everything runs over rows of a work array, so that it compiles to vector instructions.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray
from geoposition.constants import WGS84_A_M, WGS84_E2
from geoposition.flags import Flag
from geoposition.sines import fill_sines

_OUTSIDE_IMAGE = int(Flag.OUTSIDE_IMAGE)
_WEAK_GEOMETRY = int(Flag.WEAK_GEOMETRY)
# NaN must keep its meaning, so only the reorderings of fast-math that respect it.
_FAST = {"contract", "arcp", "nsz", "reassoc"}

_LANES = 64
_TASK = 64 * _LANES
# Rows of the work array: image scales of a and b (6 each), their image covariances (3 each),
# then the weighted normal matrices (6 each), the gap (3), sines and cosines (4), the points (3).
# Results go where the image scales and covariances were: moved points (3), covariances (6),
# the normal matrix's determinant.
_J, _C, _N, _GAP, _ANGLES, _POINT = 0, 12, 18, 30, 33, 37
_MOVED, _COVARIANCE, _DETERMINANT = 0, 3, 9
_ROWS = 40


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _fill_fields(
    n: int,
    w: FloatArray,
    image: int,
    image_px: FloatArray,
    packed: FloatArray,
    errors: FloatArray,
    noise: FloatArray,
) -> None:
    """Scale rows and covariance rows of image 0 or 1 from their quadratics."""
    c0, c1, c2 = packed[0, 0], packed[0, 1], packed[0, 2]
    s0, s1, s2 = packed[0, 3], packed[0, 4], packed[0, 5]
    for m in range(9):
        if m < 6:
            row, rest = _J + 6 * image + m, 0.0
            k0, k1, k2, k3, k4 = (
                packed[2, m],
                packed[3, m],
                packed[4, m],
                packed[5, m],
                packed[6, m],
            )
            k5, k6, k7, k8, k9 = (
                packed[7, m], packed[8, m], packed[9, m], packed[10, m], packed[11, m]
            )  # fmt: skip
        else:
            e = m - 6
            row, rest = _C + 3 * image + e, noise[e]
            k0, k1, k2, k3, k4 = (
                errors[0, e],
                errors[1, e],
                errors[2, e],
                errors[3, e],
                errors[4, e],
            )
            k5, k6, k7, k8, k9 = (
                errors[5, e],
                errors[6, e],
                errors[7, e],
                errors[8, e],
                errors[9, e],
            )
        k0 += rest
        for i in range(n):
            a = (image_px[i, 0] - c0) * s0
            b = (image_px[i, 1] - c1) * s1
            c = (w[_POINT + 2, i] - c2) * s2
            w[row, i] = (
                k0
                + a * (k1 + a * k4 + b * k7 + c * k8)
                + b * (k2 + b * k5 + c * k9)
                + c * (k3 + c * k6)
            )


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _fill_normal(n: int, w: FloatArray, image: int) -> None:
    """Jᵀ C⁻¹ J of one image, its six numbers."""
    j, s, out = _J + 6 * image, _C + 3 * image, _N + 6 * image
    for i in range(n):
        lx, ly, lz = w[j, i], w[j + 1, i], w[j + 2, i]
        sx, sy, sz = w[j + 3, i], w[j + 4, i], w[j + 5, i]
        ll, ls, ss = w[s, i], w[s + 1, i], w[s + 2, i]
        d = 1.0 / (ll * ss - ls * ls)
        p, q, r = ss * d, -ls * d, ll * d
        ux, uy, uz = p * lx + q * sx, p * ly + q * sy, p * lz + q * sz
        vx, vy, vz = q * lx + r * sx, q * ly + r * sy, q * lz + r * sz
        w[out, i] = lx * ux + sx * vx
        w[out + 1, i] = lx * uy + sx * vy
        w[out + 2, i] = lx * uz + sx * vz
        w[out + 3, i] = ly * uy + sy * vy
        w[out + 4, i] = ly * uz + sy * vz
        w[out + 5, i] = lz * uz + sz * vz


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _fill_gap(
    n: int,
    w: FloatArray,
    origin_a: FloatArray,
    direction_a: FloatArray,
    origin_b: FloatArray,
    direction_b: FloatArray,
) -> None:
    """Vector from line a to line b where they are nearest."""
    for i in range(n):
        ax, ay, az = direction_a[i, 0], direction_a[i, 1], direction_a[i, 2]
        bx, by, bz = direction_b[i, 0], direction_b[i, 1], direction_b[i, 2]
        dx = origin_b[i, 0] - origin_a[i, 0]
        dy = origin_b[i, 1] - origin_a[i, 1]
        dz = origin_b[i, 2] - origin_a[i, 2]
        nx = ay * bz - az * by
        ny = az * bx - ax * bz
        nz = ax * by - ay * bx
        gap = (dx * nx + dy * ny + dz * nz) / (nx * nx + ny * ny + nz * nz)
        w[_GAP, i] = gap * nx
        w[_GAP + 1, i] = gap * ny
        w[_GAP + 2, i] = gap * nz


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _solve(n: int, w: FloatArray) -> None:
    """Move the points to the weighted ones; their covariances east, north, up."""
    a, b = _N, _N + 6
    for i in range(n):
        xx = w[a, i] + w[b, i]
        xy = w[a + 1, i] + w[b + 1, i]
        xz = w[a + 2, i] + w[b + 2, i]
        yy = w[a + 3, i] + w[b + 3, i]
        yz = w[a + 4, i] + w[b + 4, i]
        zz = w[a + 5, i] + w[b + 5, i]
        axx = yy * zz - yz * yz
        axy = xz * yz - xy * zz
        axz = xy * yz - xz * yy
        determinant = xx * axx + xy * axy + xz * axz
        d = 1.0 / determinant
        cxx, cxy, cxz = axx * d, axy * d, axz * d
        cyy = (xx * zz - xz * xz) * d
        cyz = (xy * xz - xx * yz) * d
        czz = (xx * yy - xy * xy) * d

        gx, gy, gz = 0.5 * w[_GAP, i], 0.5 * w[_GAP + 1, i], 0.5 * w[_GAP + 2, i]
        ox, oy, oz = w[b, i] - w[a, i], w[b + 1, i] - w[a + 1, i], w[b + 2, i] - w[a + 2, i]
        py, pz = w[b + 3, i] - w[a + 3, i], w[b + 4, i] - w[a + 4, i]
        qz = w[b + 5, i] - w[a + 5, i]
        rx = ox * gx + oy * gy + oz * gz
        ry = oy * gx + py * gy + pz * gz
        rz = oz * gx + pz * gy + qz * gz
        dx = cxx * rx + cxy * ry + cxz * rz
        dy = cxy * rx + cyy * ry + cyz * rz
        dz = cxz * rx + cyz * ry + czz * rz

        sl, cl = w[_ANGLES, i], w[_ANGLES + 1, i]
        sp, cp = w[_ANGLES + 2, i], w[_ANGLES + 3, i]
        inner = 1.0 - WGS84_E2 * sp * sp
        normal = WGS84_A_M / math.sqrt(inner)
        meridian = normal * (1.0 - WGS84_E2) / inner
        h = w[_POINT + 2, i]
        ahead = cl * dx + sl * dy
        w[_MOVED, i] = w[_POINT, i] + (cl * dy - sl * dx) / ((normal + h) * cp)
        w[_MOVED + 1, i] = w[_POINT + 1, i] + (cp * dz - sp * ahead) / (meridian + h)
        w[_MOVED + 2, i] = h + cp * ahead + sp * dz

        ex, ey, ez = cxy * cl - cxx * sl, cyy * cl - cxy * sl, cyz * cl - cxz * sl
        # Towards the meridian, flat: (cl, sl, 0).
        mx, my, mz = cxx * cl + cxy * sl, cxy * cl + cyy * sl, cxz * cl + cyz * sl
        em = cl * ex + sl * ey
        mm = cl * mx + sl * my
        w[_COVARIANCE, i] = cl * ey - sl * ex
        w[_COVARIANCE + 1, i] = cp * ez - sp * em
        w[_COVARIANCE + 2, i] = cp * em + sp * ez
        w[_COVARIANCE + 3, i] = cp * cp * czz - 2.0 * cp * sp * mz + sp * sp * mm
        w[_COVARIANCE + 4, i] = cp * sp * (czz - mm) + (cp * cp - sp * sp) * mz
        w[_COVARIANCE + 5, i] = cp * cp * mm + 2.0 * cp * sp * mz + sp * sp * czz
        w[_DETERMINANT, i] = determinant


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _write(
    n: int, w: FloatArray, geodetic: FloatArray, covariance: FloatArray, flags: FlagArray
) -> None:
    """From the work rows to the points, their covariances and flags."""
    for i in range(n):
        for j in range(3):
            geodetic[i, j] = w[_MOVED + j, i]
        covariance[i, 0, 0] = w[_COVARIANCE, i]
        covariance[i, 0, 1] = w[_COVARIANCE + 1, i]
        covariance[i, 0, 2] = w[_COVARIANCE + 2, i]
        covariance[i, 1, 0] = w[_COVARIANCE + 1, i]
        covariance[i, 1, 1] = w[_COVARIANCE + 3, i]
        covariance[i, 1, 2] = w[_COVARIANCE + 4, i]
        covariance[i, 2, 0] = w[_COVARIANCE + 2, i]
        covariance[i, 2, 1] = w[_COVARIANCE + 4, i]
        covariance[i, 2, 2] = w[_COVARIANCE + 5, i]
    for i in range(n):
        if flags[i] <= _OUTSIDE_IMAGE and not w[_DETERMINANT, i] > 0.0:
            flags[i] = _WEAK_GEOMETRY
        if flags[i] > _OUTSIDE_IMAGE:
            for j in range(3):
                geodetic[i, j] = np.nan
                for k in range(3):
                    covariance[i, j, k] = np.nan


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def weigh_pairs(
    image_a: FloatArray,
    image_b: FloatArray,
    origin_a: FloatArray,
    direction_a: FloatArray,
    origin_b: FloatArray,
    direction_b: FloatArray,
    fields: FloatArray,
    errors: FloatArray,
    noise: FloatArray,
    geodetic: FloatArray,
    covariance: FloatArray,
    flags: FlagArray,
) -> None:
    """Move midpoints `geodetic` (n, 3) to the weighted points; fill `covariance` (n, 3, 3).

    `fields` (2, 2 + TERMS, 6) and `errors` (2, TERMS, 3) are the quadratics of the two images,
    `noise` (2, 3) their image points' covariances ll, ls, ss. NaN stays NaN.
    """
    total = len(flags)
    for task in prange((total + _TASK - 1) // _TASK):
        w = np.empty((_ROWS, _LANES))
        for first in range(task * _TASK, min(total, (task + 1) * _TASK), _LANES):
            last = min(first + _LANES, total)
            n = last - first
            ground = geodetic[first:last]
            for i in range(n):
                w[_POINT, i] = ground[i, 0]
                w[_POINT + 1, i] = ground[i, 1]
                w[_POINT + 2, i] = ground[i, 2]
            _fill_fields(n, w, 0, image_a[first:last], fields[0], errors[0], noise[0])
            _fill_fields(n, w, 1, image_b[first:last], fields[1], errors[1], noise[1])
            _fill_normal(n, w, 0)
            _fill_normal(n, w, 1)
            fill_sines(w[_POINT], n, w[_ANGLES], w[_ANGLES + 1])
            fill_sines(w[_POINT + 1], n, w[_ANGLES + 2], w[_ANGLES + 3])
            _fill_gap(
                n,
                w,
                origin_a[first:last],
                direction_a[first:last],
                origin_b[first:last],
                direction_b[first:last],
            )
            _solve(n, w)
            _write(n, w, ground, covariance[first:last], flags[first:last])
