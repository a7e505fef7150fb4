"""Compiled arithmetic of the adjustment: corrected lines of sight, and points eliminated.

`observe` turns and moves lines of sight by the corrections and says how far, in pixels, they
pass from ground points. `eliminate` removes a point's three coordinates from its rows by
Householder reflections: what remains is the projection onto the null space of the point, 2 m − 3
rows for m views, more with what is known of the point itself.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from geoposition.arrays import BoolArray, FloatArray, IntArray

BLOCK = 256
"""Observations that share work arrays."""
FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _turned(v: FloatArray, roll: float, pitch: float, yaw: float) -> None:
    """Turn `v` (3,) in place by X(roll) Y(pitch) Z(yaw)."""
    c, s = math.cos(yaw), math.sin(yaw)
    v[0], v[1] = c * v[0] - s * v[1], s * v[0] + c * v[1]
    c, s = math.cos(pitch), math.sin(pitch)
    v[0], v[2] = c * v[0] + s * v[2], -s * v[0] + c * v[2]
    c, s = math.cos(roll), math.sin(roll)
    v[1], v[2] = c * v[1] - s * v[2], s * v[1] + c * v[2]


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def observe(
    image_px: FloatArray,
    origin: FloatArray,
    direction: FloatArray,
    scale: FloatArray,
    ground: FloatArray,
    first_line: float,
    per_step: float,
    R_ecef_body: FloatArray,
    R_body_camera: FloatArray,
    turns: FloatArray,
    mounting: FloatArray,
    tangents: FloatArray,
    moved: FloatArray,
    residual: FloatArray,
    by_ground: FloatArray,
    by_turn: FloatArray,
    by_mounting: FloatArray,
    by_tangent: FloatArray,
) -> None:
    """Residuals (n, 2), line of sight less `ground` (n, 3) in pixels, and their derivatives.

    `turns` (n, b, 3) roll, pitch, yaw of b corrections one after the other, `mounting` (3, 3) a
    rotation on the right of R_body_camera, `tangents` (n, 2) and `moved` (n, 3), metres, what is
    added to the camera's tangents and to the satellite. Derivatives: `by_ground` (n, 2, 3) per
    metre of the line of sight, `by_turn` and `by_mounting` (n, 2, 3) per radian about the axes of
    body and camera, `by_tangent` (n, 2, 2).
    """
    last = len(R_ecef_body) - 2
    total = len(image_px)
    for block in prange((total + BLOCK - 1) // BLOCK):
        v, d, undone = np.empty(3), np.empty(3), np.empty(3)
        body, camera = np.empty((3, 3)), np.empty((3, 3))
        for i in range(block * BLOCK, min((block + 1) * BLOCK, total)):
            at = (image_px[i, 0] - first_line) * per_step
            cell = min(max(int(at), 0), last)
            share = at - cell
            for a in range(3):
                for b in range(3):
                    low = R_ecef_body[cell, a, b]
                    body[a, b] = low + share * (R_ecef_body[cell + 1, a, b] - low)
            for a in range(3):
                for b in range(3):
                    camera[a, b] = (
                        body[a, 0] * R_body_camera[0, b]
                        + body[a, 1] * R_body_camera[1, b]
                        + body[a, 2] * R_body_camera[2, b]
                    )
            # Into the camera, where tangents and mounting act ...
            for b in range(3):
                d[b] = (
                    camera[0, b] * direction[i, 0]
                    + camera[1, b] * direction[i, 1]
                    + camera[2, b] * direction[i, 2]
                )
            along_axis = d[2]
            d[0] += along_axis * tangents[i, 0]
            d[1] += along_axis * tangents[i, 1]
            for b in range(3):
                v[b] = mounting[b, 0] * d[0] + mounting[b, 1] * d[1] + mounting[b, 2] * d[2]
            # ... into the body, where the attitude's corrections do, and back to the Earth.
            for b in range(3):
                d[b] = (
                    R_body_camera[b, 0] * v[0]
                    + R_body_camera[b, 1] * v[1]
                    + R_body_camera[b, 2] * v[2]
                )
            for b in range(turns.shape[1] - 1, -1, -1):
                _turned(d, turns[i, b, 0], turns[i, b, 1], turns[i, b, 2])
            # The interpolated matrix is not quite a rotation: only the change is taken from it.
            for b in range(3):
                undone[b] = (
                    body[0, b] * direction[i, 0]
                    + body[1, b] * direction[i, 1]
                    + body[2, b] * direction[i, 2]
                )
            ux, uy, uz = direction[i, 0], direction[i, 1], direction[i, 2]
            for b in range(3):
                change = d[b] - undone[b]
                ux += body[0, b] * change
                uy += body[1, b] * change
                uz += body[2, b] * change
            unit = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
            ux *= unit
            uy *= unit
            uz *= unit
            qx = origin[i, 0] + moved[i, 0] - ground[i, 0]
            qy = origin[i, 1] + moved[i, 1] - ground[i, 1]
            qz = origin[i, 2] + moved[i, 2] - ground[i, 2]
            far = -(qx * ux + qy * uy + qz * uz)
            qx += far * ux
            qy += far * uy
            qz += far * uz
            for a in range(2):
                jx, jy, jz = scale[i, a, 0], scale[i, a, 1], scale[i, a, 2]
                along = jx * ux + jy * uy + jz * uz
                jx -= along * ux
                jy -= along * uy
                jz -= along * uz
                residual[i, a] = jx * qx + jy * qy + jz * qz
                by_ground[i, a, 0] = jx
                by_ground[i, a, 1] = jy
                by_ground[i, a, 2] = jz
                # j . (w x u) far = w . (u x j) far
                gx = far * (uy * jz - uz * jy)
                gy = far * (uz * jx - ux * jz)
                gz = far * (ux * jy - uy * jx)
                for b in range(3):
                    by_turn[i, a, b] = gx * body[0, b] + gy * body[1, b] + gz * body[2, b]
                    by_mounting[i, a, b] = gx * camera[0, b] + gy * camera[1, b] + gz * camera[2, b]
                for b in range(2):
                    by_tangent[i, a, b] = (
                        far
                        * along_axis
                        * (jx * camera[0, b] + jy * camera[1, b] + jz * camera[2, b])
                    )


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def eliminate(rows: FloatArray) -> None:
    """Triangularise the first three columns of `rows` (n, r, c), r >= 3, in place.

    Afterwards rows 0 .. 2 of each point are its triangle and what goes with it, the others have
    zeros in front: the null-space rows. Columns that vanish leave zeros on the diagonal.
    """
    n, r, c = rows.shape
    for i in prange(n):
        for k in range(3):
            norm2 = 0.0
            for a in range(k, r):
                norm2 += rows[i, a, k] * rows[i, a, k]
            if not norm2 > 0.0:
                continue
            norm = math.sqrt(norm2)
            head = rows[i, k, k]
            alpha = -norm if head > 0.0 else norm
            v0 = head - alpha
            # v = (v0, rest); H = 1 - 2 v v' / v'v, with v'v = 2 norm (norm + |head|)
            beta = 1.0 / (norm * (norm + abs(head)))
            for b in range(k + 1, c):
                dot = v0 * rows[i, k, b]
                for a in range(k + 1, r):
                    dot += rows[i, a, k] * rows[i, a, b]
                dot *= beta
                rows[i, k, b] -= dot * v0
                for a in range(k + 1, r):
                    rows[i, a, b] -= dot * rows[i, a, k]
            rows[i, k, k] = alpha
            for a in range(k + 1, r):
                rows[i, a, k] = 0.0


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def fill_rows(
    work: FloatArray,
    at: int,
    root: FloatArray,
    root_row: IntArray,
    by_ground: FloatArray,
    jacobian: FloatArray,
    residual: FloatArray,
    places: IntArray,
) -> None:
    """Write whitened rows `at` and `at` + 1 of `work` (n, r, 3 + p + 1).

    `root[root_row[i]]` (2, 2) whitens observation i; column j of `jacobian` goes to
    3 + `places[j]`, the residual to the last one.
    """
    last = work.shape[2] - 1
    for i in prange(len(work)):
        for a in range(2):
            w0, w1 = root[root_row[i], a, 0], root[root_row[i], a, 1]
            for b in range(3):
                work[i, at + a, b] = w0 * by_ground[i, 0, b] + w1 * by_ground[i, 1, b]
            for j in range(len(places)):
                work[i, at + a, 3 + places[j]] = w0 * jacobian[i, 0, j] + w1 * jacobian[i, 1, j]
            work[i, at + a, last] = w0 * residual[i, 0] + w1 * residual[i, 1]


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def back_substitute(triangle: FloatArray, right: FloatArray, strong: BoolArray) -> None:
    """Replace `right` (n, 3, c) by `triangle`⁻¹ `right`; zeros where not `strong`."""
    for i in prange(len(right)):
        if not strong[i]:
            for a in range(3):
                for b in range(right.shape[2]):
                    right[i, a, b] = 0.0
            continue
        for k in range(2, -1, -1):
            unit = 1.0 / triangle[i, k, k]
            for b in range(right.shape[2]):
                value = right[i, k, b]
                for a in range(k + 1, 3):
                    value -= triangle[i, k, a] * right[i, a, b]
                right[i, k, b] = value * unit


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def scale_matrices(
    image_px: FloatArray,
    height_m: FloatArray,
    centre: FloatArray,
    per_extent: FloatArray,
    coefficients: FloatArray,
    out: FloatArray,
) -> None:
    """Fill `out` (n, 2, 3) with quadratics (10, 6) in line, sample, height; order as in `scale`."""
    for i in prange(len(image_px)):
        a = (image_px[i, 0] - centre[0]) * per_extent[0]
        b = (image_px[i, 1] - centre[1]) * per_extent[1]
        c = (height_m[i] - centre[2]) * per_extent[2]
        for k in range(6):
            q = coefficients[:, k]
            out[i, k // 3, k % 3] = (
                q[0]
                + a * (q[1] + q[4] * a + q[7] * b + q[8] * c)
                + b * (q[2] + q[5] * b + q[9] * c)
                + c * (q[3] + q[6] * c)
            )
