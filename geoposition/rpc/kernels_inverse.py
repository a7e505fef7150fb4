"""Compiled loop from image to ground: Newton's method on the inverse coefficients.

With the height and the image point given, each coordinate's equation,
numerator − value · denominator = 0, is a cubic in longitude and latitude alone: ten
coefficients, worked out once per point. Three Newton steps from the fitted start suffice; the
point where they do not is tried again with step control.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange, uint64

from geoposition.arrays import FlagArray, FloatArray
from geoposition.rpc.kernel_base import (
    BAD_INPUT,
    BLOCK,
    FAST,
    HAS_NUMBERS,
    INLINE,
    LINE_DEN,
    LINE_NUM,
    NOT_CONVERGED,
    OUTSIDE_IMAGE,
    OUTSIDE_MODEL,
    PARALLEL,
    SAMP_DEN,
    SAMP_NUM,
    START_LAT,
    START_LON,
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

_QUADRATIC_RESIDUAL = 1e-7
"""Residual (normalised) from which one more Newton step reaches rounding."""
_CONVERGED_STEP = 1e-13
_MAX_ITERATIONS = 40


@njit(**INLINE)
def _reduced(
    c: FloatArray, num: int, den: int, value: float, H: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Coefficients of numerator − value · denominator as a cubic in L and P alone, H given.

    In the order 1, L, P, L², LP, P², L³, L²P, LP², P³.
    """
    return (
        c[num] - value * c[den]
        + H * (c[num + 3] - value * c[den + 3]
        + H * (c[num + 9] - value * c[den + 9]
        + H * (c[num + 19] - value * c[den + 19]))),
        c[num + 1] - value * c[den + 1]
        + H * (c[num + 5] - value * c[den + 5] + H * (c[num + 13] - value * c[den + 13])),
        c[num + 2] - value * c[den + 2]
        + H * (c[num + 6] - value * c[den + 6] + H * (c[num + 16] - value * c[den + 16])),
        c[num + 7] - value * c[den + 7] + H * (c[num + 17] - value * c[den + 17]),
        c[num + 4] - value * c[den + 4] + H * (c[num + 10] - value * c[den + 10]),
        c[num + 8] - value * c[den + 8] + H * (c[num + 18] - value * c[den + 18]),
        c[num + 11] - value * c[den + 11],
        c[num + 14] - value * c[den + 14],
        c[num + 12] - value * c[den + 12],
        c[num + 15] - value * c[den + 15],
    )  # fmt: skip


@njit(**INLINE)
def _value_and_slopes(q: tuple[float, ...], L: float, P: float) -> tuple[float, float, float]:
    """Value and derivatives by L and P of the bivariate cubic of `_reduced`."""
    value = q[0] + L * (q[1] + L * (q[3] + L * q[6]) + P * (q[4] + L * q[7] + P * q[8]))
    value += P * (q[2] + P * (q[5] + P * q[9]))
    d_lon = q[1] + L * (2.0 * q[3] + 3.0 * L * q[6]) + P * (q[4] + 2.0 * L * q[7] + P * q[8])
    d_lat = q[2] + P * (2.0 * q[5] + 3.0 * P * q[9]) + L * (q[4] + 2.0 * P * q[8] + L * q[7])
    return value, d_lon, d_lat


@njit(**INLINE)
def _start(c: FloatArray, p: KernelParameters, x: float, y: float, H: float) -> tuple[float, float]:
    """Normalised ground near the solution; the polynomial is held to where it was fitted."""
    u = min(max((x - p.start_line_off) * p.start_line_unit, -1.5), 1.5)
    v = min(max((y - p.start_samp_off) * p.start_samp_unit, -1.5), 1.5)
    w = min(max((H - p.start_height_off) * p.start_height_unit, -1.5), 1.5)
    return cubic(c, START_LON, u, v, w), cubic(c, START_LAT, u, v, w)


@njit(**INLINE)
def _newton(
    q: tuple[float, ...], r: tuple[float, ...], L: float, P: float
) -> tuple[float, float, float]:
    """One Newton step for both equations at once; the residual is that before the step."""
    f, f_lon, f_lat = _value_and_slopes(q, L, P)
    g, g_lon, g_lat = _value_and_slopes(r, L, P)
    inverse = 1.0 / (f_lon * g_lat - f_lat * g_lon)
    L -= (f * g_lat - g * f_lat) * inverse
    P -= (g * f_lon - f * g_lon) * inverse
    return L, P, abs(f) + abs(g)


@njit(**INLINE)
def _locate(
    c: FloatArray, p: KernelParameters, line_px: float, samp_px: float, height_m: float
) -> tuple[float, float, float]:
    """Normalised L and P after three Newton steps, and the residual before the last."""
    x = (line_px - p.line_off_px) / p.line_scale_px
    y = (samp_px - p.samp_off_px) / p.samp_scale_px
    H = (height_m - p.height_off_m) * p.height_unit
    L, P = _start(c, p, x, y, H)
    q = _reduced(c, LINE_NUM, LINE_DEN, x, H)
    r = _reduced(c, SAMP_NUM, SAMP_DEN, y, H)
    L, P, _ = _newton(q, r, L, P)
    L, P, _ = _newton(q, r, L, P)
    L, P, residual = _newton(q, r, L, P)
    return L, P, residual


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _locate_stubborn(
    c: FloatArray, p: KernelParameters, line_px: float, samp_px: float, height_m: float
) -> tuple[float, float, bool]:
    """Like `_locate`, for the rare point far from the start: steps are halved as needed."""
    x = (line_px - p.line_off_px) / p.line_scale_px
    y = (samp_px - p.samp_off_px) / p.samp_scale_px
    H = (height_m - p.height_off_m) * p.height_unit
    L, P = _start(c, p, x, y, H)
    q = _reduced(c, LINE_NUM, LINE_DEN, x, H)
    r = _reduced(c, SAMP_NUM, SAMP_DEN, y, H)
    for _ in range(_MAX_ITERATIONS):
        L_new, P_new, residual = _newton(q, r, L, P)
        step_lon = L_new - L
        step_lat = P_new - P
        if not abs(step_lon) + abs(step_lat) < np.inf:
            return np.nan, np.nan, False
        if abs(step_lon) + abs(step_lat) < _CONVERGED_STEP * (1.0 + abs(L) + abs(P)):
            return L_new, P_new, True
        share = 1.0
        while share > 1e-3:
            f, _, _ = _value_and_slopes(q, L + share * step_lon, P + share * step_lat)
            g, _, _ = _value_and_slopes(r, L + share * step_lon, P + share * step_lat)
            if abs(f) + abs(g) < residual or residual < _QUADRATIC_RESIDUAL:
                break
            share *= 0.5
        L += share * step_lon
        P += share * step_lat
    return L, P, False


@njit(**PARALLEL)
def locate_points(
    image_px: FloatArray,
    height_m: FloatArray,
    c: FloatArray,
    p: KernelParameters,
    geodetic: FloatArray,
    flags: FlagArray,
) -> None:
    """Locate flattened `image_px` (2n) at `height_m` (n, or one) into `geodetic` (3n)."""
    n = flags.size
    common_height = height_m.size == 1
    for task in prange((n + TASK - 1) // TASK):
        a = np.zeros(BLOCK)
        b = np.zeros(BLOCK)
        h = np.zeros(BLOCK)
        lon = np.zeros(BLOCK)
        lat = np.zeros(BLOCK)
        last = np.zeros(BLOCK)
        for begin in range(task * TASK, min(n, (task + 1) * TASK), BLOCK):
            m = min(BLOCK, n - begin)
            source = image_px[2 * begin : 2 * (begin + m)]
            target = geodetic[3 * begin : 3 * (begin + m)]
            target_flags = flags[begin : begin + m]
            for i in range(uint64(m)):
                a[i] = source[U2 * i]
                b[i] = source[U2 * i + U1]
            if common_height:
                h[:] = height_m[0]
            else:
                h[:m] = height_m[begin : begin + m]
            for i in range(BLOCK):
                lon[i], lat[i], last[i] = _locate(c, p, a[i], b[i], h[i])
            for i in range(m):
                # Written so that NaN counts as not converged.
                if not last[i] < _QUADRATIC_RESIDUAL:
                    finite = abs(a[i]) + abs(b[i]) + abs(h[i]) < np.inf
                    last[i] = np.inf
                    if finite:
                        lon[i], lat[i], done = _locate_stubborn(c, p, a[i], b[i], h[i])
                        if done:
                            last[i] = 0.0
            for i in range(BLOCK):
                L = lon[i]
                P = lat[i]
                H = (h[i] - p.height_off_m) * p.height_unit
                lon_rad = p.lon_off_rad + L / p.lon_unit
                lat_rad = p.lat_off_rad + P / p.lat_unit
                flag = 0.0
                if outside_image(p, a[i], b[i]):
                    flag = OUTSIDE_IMAGE
                line_den = cubic(c, LINE_DEN, L, P, H)
                samp_den = cubic(c, SAMP_DEN, L, P, H)
                if outside_model(p, L, P, H, line_den, samp_den) | (abs(lat_rad) > 0.5 * math.pi):
                    flag = OUTSIDE_MODEL
                if not last[i] < _QUADRATIC_RESIDUAL:
                    flag = NOT_CONVERGED
                if not abs(a[i]) + abs(b[i]) + abs(h[i]) < np.inf:
                    flag = BAD_INPUT
                height = h[i]
                if flag > HAS_NUMBERS:
                    lon_rad = np.nan
                    lat_rad = np.nan
                    height = np.nan
                lon[i] = wrapped(lon_rad)
                lat[i] = lat_rad
                a[i] = height
                b[i] = flag
            for i in range(uint64(m)):
                target[U3 * i] = lon[i]
                target[U3 * i + U1] = lat[i]
                target[U3 * i + U2] = a[i]
            for i in range(uint64(m)):
                target_flags[i] = np.uint8(b[i])
