"""What the push-broom kernels share: the model's tables, the work array, the look-ups.

Points go through in blocks of `LANES`. A block's numbers lie in rows of one work array, row r
of lane i at `w[r * LANES + i]`: table look-ups fill rows lane by lane, and the arithmetic
between runs over whole rows in loops without branches, which compile to vector instructions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from geoposition.arrays import FloatArray, IntArray
from geoposition.constants import SPEED_OF_LIGHT_M_S, WGS84_A_M, WGS84_E2
from geoposition.flags import Flag

LANES = 256
BLOCKS_PER_TASK = 16
VECTOR = 32

OK = int(Flag.OK)
OUTSIDE_IMAGE = int(Flag.OUTSIDE_IMAGE)
OUTSIDE_MODEL = int(Flag.OUTSIDE_MODEL)
BAD_INPUT = int(Flag.BAD_INPUT)
NO_INTERSECTION = int(Flag.NO_INTERSECTION)
NOT_CONVERGED = int(Flag.NOT_CONVERGED)

B_OVER_A2 = 1.0 - WGS84_E2
B_M = WGS84_A_M * math.sqrt(B_OVER_A2)
PER_C = 1.0 / SPEED_OF_LIGHT_M_S

MAX_STEPS = 25
STEP_TOLERANCE_PX = 2e-5
"""A Newton step below this, not the first, leaves an error far below 1e-6 px."""
EDGE_TOLERANCE_PX = 1e-5
"""Rounding allowed at the edges of image and margin, so that what is located comes back."""
LOWEST_HEIGHT_M = -1e5
"""A height below this is no point on Earth."""

# Rows of the work array. First what identifies a point and the state of its iteration.
LINE, SAMPLE, HEIGHT, CCD, TRIES, AT_END = 0, 1, 2, 3, 4, 5
GX, GY, GZ, NX, NY, NZ, KM, BX, BY, BZ = 6, 7, 8, 9, 10, 11, 12, 13, 14, 15
KEPT = 16
# Then what one pass computes: camera position, velocity, quaternion and its rate per line,
# seconds per line, tangents and their rates per sample, the Newton step, the radius N.
SX, SY, SZ, VX, VY, VZ, QX, QY, QZ, QW = 16, 17, 18, 19, 20, 21, 22, 23, 24, 25
RX, RY, RZ, RW, LINE_S, TA, TB, DA, DB = 26, 27, 28, 29, 30, 31, 32, 33, 34
DLINE, DSAMPLE, FRONT, RADIUS = 35, 36, 37, 38
ROWS = 39

# NaN must keep its meaning, so only the reorderings of fast-math that respect it.
FAST = {"contract", "arcp", "nsz", "reassoc"}


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


@njit(cache=True, error_model="numpy", fastmath=FAST)
def fill_pose(m: ModelTable, w: FloatArray, n: int) -> None:
    """Camera pose of the lines in row `LINE`, which must lie within the table."""
    knots, c, bins, seconds = m.pose_knots, m.pose_coefficients, m.pose_bins, m.pose_seconds
    last = len(seconds) - 1
    cells = len(bins) - 1
    origin, scale = m.pose_bin_origin, m.pose_bin_scale
    for i in range(n):
        line = w[LINE * LANES + i]
        cell = int((line - origin) * scale)
        k = bins[min(max(cell, 0), cells)]
        while k > 0 and line < knots[k]:
            k -= 1
        while k < last and line >= knots[k + 1]:
            k += 1
        per_line = 1.0 / (knots[k + 1] - knots[k])
        s = (line - knots[k]) * per_line
        for j in range(3):
            w[(SX + j) * LANES + i] = c[k, 0, j] + s * (
                c[k, 1, j] + s * (c[k, 2, j] + s * c[k, 3, j])
            )
            w[(VX + j) * LANES + i] = (
                c[k, 1, j] + s * (2.0 * c[k, 2, j] + s * 3.0 * c[k, 3, j])
            ) / seconds[k]
        for j in range(4):
            w[(QX + j) * LANES + i] = c[k, 0, 3 + j] + s * (
                c[k, 1, 3 + j] + s * (c[k, 2, 3 + j] + s * c[k, 3, 3 + j])
            )
            w[(RX + j) * LANES + i] = per_line * (
                c[k, 1, 3 + j] + s * (2.0 * c[k, 2, 3 + j] + s * 3.0 * c[k, 3, 3 + j])
            )
        w[LINE_S * LANES + i] = seconds[k] * per_line


@njit(cache=True, error_model="numpy", fastmath=FAST)
def fill_tangents(m: ModelTable, w: FloatArray, n: int) -> None:
    """Tangents and their rates of the samples in row `SAMPLE`, for the CCDs in row `CCD`.

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
        sample = w[SAMPLE * LANES + i]
        ccd = int(w[CCD * LANES + i])
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
            w[(TA + j) * LANES + i] = c[k, 0, j] + s * (
                c[k, 1, j] + s * (c[k, 2, j] + s * c[k, 3, j])
            )
            w[(DA + j) * LANES + i] = per_sample * (
                c[k, 1, j] + s * (2.0 * c[k, 2, j] + s * 3.0 * c[k, 3, j])
            )


@njit(cache=True, error_model="numpy", fastmath=FAST, inline="always")
def ccd_of(first_sample: FloatArray, sample: float) -> int:
    """CCD whose part of the row holds `sample`; the outer ones reach on."""
    ccd = 0
    while ccd < len(first_sample) - 1 and sample >= first_sample[ccd + 1] - 0.5:
        ccd += 1
    return ccd


@njit(cache=True, error_model="numpy", inline="always")
def full_vectors(n: int) -> int:
    """`n` rounded up to whole vectors: no lane is left to a scalar loop that rounds otherwise.

    The lanes beyond `n` hold anything; nothing is read from them.
    """
    return (n + VECTOR - 1) // VECTOR * VECTOR


@njit(cache=True, error_model="numpy", fastmath=FAST, inline="always")
def pixel_flag(
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
        return BAD_INPUT
    off_line = max(first_line - line, line - last_line)
    off_sample = max(-margin_px - sample, sample - (samples - 1 + margin_px))
    if max(off_line, off_sample) > EDGE_TOLERANCE_PX:
        return OUTSIDE_MODEL
    off_line = max(-0.5 - line, line - (lines - 0.5))
    off_sample = max(-0.5 - sample, sample - (samples - 0.5))
    if max(off_line, off_sample) <= EDGE_TOLERANCE_PX:
        return OK
    return OUTSIDE_IMAGE
