"""Compiled loop from ground to image.

Points are taken in blocks that fit the first-level cache: copied into separate columns, worked
on by vector instructions, copied out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange, uint64

from geoposition.arrays import FlagArray, FloatArray
from geoposition.rpc.kernel_base import (
    BAD_INPUT,
    BLOCK,
    HALF_BLOCK,
    HAS_NUMBERS,
    INLINE,
    LINE_DEN,
    LINE_NUM,
    OUTSIDE_IMAGE,
    OUTSIDE_MODEL,
    PARALLEL,
    SAMP_DEN,
    SAMP_NUM,
    TASK,
    U1,
    U2,
    U3,
    KernelParameters,
    cubic,
    outside_image,
    outside_model,
    wrapped,
)


@njit(**INLINE)
def _project(
    c: FloatArray, p: KernelParameters, lon_rad: float, lat_rad: float, height_m: float
) -> tuple[float, float, float]:
    """Line, sample and flag (as a float, so that the loop stays in one vector width)."""
    L = wrapped(lon_rad - p.lon_off_rad) * p.lon_unit
    P = (lat_rad - p.lat_off_rad) * p.lat_unit
    H = (height_m - p.height_off_m) * p.height_unit
    line_den = cubic(c, LINE_DEN, L, P, H)
    samp_den = cubic(c, SAMP_DEN, L, P, H)
    # One division serves both ratios.
    inverse = 1.0 / (line_den * samp_den)
    line = cubic(c, LINE_NUM, L, P, H) * samp_den * inverse
    samp = cubic(c, SAMP_NUM, L, P, H) * line_den * inverse
    line_px = p.line_off_px + p.line_scale_px * line
    samp_px = p.samp_off_px + p.samp_scale_px * samp
    flag = 0.0
    if outside_image(p, line_px, samp_px):
        flag = OUTSIDE_IMAGE
    if outside_model(p, L, P, H, line_den, samp_den):
        flag = OUTSIDE_MODEL
    if not ((abs(L) + abs(H) < np.inf) & (abs(lat_rad) <= 0.5 * math.pi)):
        flag = BAD_INPUT
    if flag > HAS_NUMBERS:
        line_px = np.nan
        samp_px = np.nan
    return line_px, samp_px, flag


@njit(**PARALLEL)
def project_points(
    geodetic: FloatArray, c: FloatArray, p: KernelParameters, image_px: FloatArray, flags: FlagArray
) -> None:
    """Project flattened `geodetic` (3n) into flattened `image_px` (2n) and `flags` (n)."""
    n = flags.size
    for task in prange((n + TASK - 1) // TASK):
        a = np.zeros(BLOCK)
        b = np.zeros(BLOCK)
        h = np.zeros(BLOCK)
        for begin in range(task * TASK, min(n, (task + 1) * TASK), BLOCK):
            m = min(BLOCK, n - begin)
            source = geodetic[3 * begin : 3 * (begin + m)]
            target = image_px[2 * begin : 2 * (begin + m)]
            target_flags = flags[begin : begin + m]
            for i in range(uint64(m)):
                a[i] = source[U3 * i]
                b[i] = source[U3 * i + U1]
                h[i] = source[U3 * i + U2]
            # Two points per turn share each load of a coefficient.
            for i in range(HALF_BLOCK):
                j = i + HALF_BLOCK
                line, samp, flag = _project(c, p, a[i], b[i], h[i])
                line_2, samp_2, flag_2 = _project(c, p, a[j], b[j], h[j])
                a[i], b[i], h[i] = line, samp, flag
                a[j], b[j], h[j] = line_2, samp_2, flag_2
            for i in range(uint64(m)):
                target[U2 * i] = a[i]
                target[U2 * i + U1] = b[i]
            for i in range(uint64(m)):
                target_flags[i] = np.uint8(h[i])
