"""Compiled loop from ground to image.

One plain loop: the compiler takes the interleaved columns apart by itself, and what the memory
does hides behind the arithmetic.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange, uint64

from geoposition.arrays import FlagArray, FloatArray
from geoposition.rpc.kernel_base import (
    BAD_INPUT,
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
        begin, end = task * TASK, min(n, (task + 1) * TASK)
        source = geodetic[3 * begin : 3 * end]
        target = image_px[2 * begin : 2 * end]
        target_flags = flags[begin:end]
        for i in range(uint64(end - begin)):
            line, samp, flag = _project(
                c, p, source[U3 * i], source[U3 * i + U1], source[U3 * i + U2]
            )
            target[U2 * i] = line
            target[U2 * i + U1] = samp
            target_flags[i] = np.uint8(flag)
