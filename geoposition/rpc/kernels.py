"""Compiled inner loops of the RPC model: project, locate, differentiate, build lines of sight.

Points are taken in blocks that fit the first-level cache: copied into separate columns, worked
on by vector instructions, copied out. The polynomial's twenty terms are in RPC00B order,
1, L, P, H, LP, LH, PH, L², P², H², LPH, L³, LP², LH², L²P, P³, PH², L²H, P²H, H³, with L, P, H
the normalised longitude, latitude and height.

*Source*: STDI-0002 vol. 1 appendix E (RPC00B), section E.2.4.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange, uint64

from geoposition.arrays import FlagArray, FloatArray
from geoposition.constants import WGS84_A_M, WGS84_E2
from geoposition.flags import Flag

LINE_NUM, LINE_DEN, SAMP_NUM, SAMP_DEN, START_LON, START_LAT = 0, 20, 40, 60, 80, 100
"""Where each polynomial begins in the coefficient vector (120)."""

# Reordering and contraction are safe; NaN and infinity must keep their meaning here.
_FAST = {"contract", "arcp", "reassoc", "nsz"}
_BLOCK = 128
_HALF = _BLOCK // 2
_BLOCKS_PER_TASK = 64
_TASK = _BLOCK * _BLOCKS_PER_TASK

_TWO_PI = 2.0 * math.pi
_MIN_DENOMINATOR = 1e-3
"""A denominator below this share of its value in mid-image has lost its meaning."""
_QUADRATIC_RESIDUAL = 1e-7
"""Residual (normalised) from which one more Newton step reaches rounding."""
_CONVERGED_STEP = 1e-13
_MAX_ITERATIONS = 40

_OUTSIDE_IMAGE = float(Flag.OUTSIDE_IMAGE)
_OUTSIDE_MODEL = float(Flag.OUTSIDE_MODEL)
_BAD_INPUT = float(Flag.BAD_INPUT)
_NOT_CONVERGED = float(Flag.NOT_CONVERGED)
_HAS_NUMBERS = float(Flag.OUTSIDE_IMAGE) + 0.5

_U1, _U2, _U3 = np.uint64(1), np.uint64(2), np.uint64(3)


class KernelParameters(NamedTuple):
    """Scalars of one model: `*_off` and `*_unit` normalise ground, `*_scale` unpacks the image.

    The pixel bounds are infinite where the image size is unknown. `*_den_unit` is one over the
    denominator in mid-image; `*_centre` and `*_half` bound the normalised ground on which the
    polynomials are trusted; `start_*` normalise the variables of the start polynomials.
    """

    lon_off_rad: float
    lon_unit: float
    lat_off_rad: float
    lat_unit: float
    height_off_m: float
    height_unit: float
    line_off_px: float
    line_scale_px: float
    samp_off_px: float
    samp_scale_px: float
    line_low_px: float
    line_high_px: float
    samp_low_px: float
    samp_high_px: float
    line_den_unit: float
    samp_den_unit: float
    lon_centre: float
    lon_half: float
    lat_centre: float
    lat_half: float
    height_centre: float
    height_half: float
    start_line_off: float
    start_line_unit: float
    start_samp_off: float
    start_samp_unit: float
    start_height_off: float
    start_height_unit: float


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _cubic(c: FloatArray, k: int, L: float, P: float, H: float) -> float:
    """Cubic polynomial whose twenty coefficients begin at `c[k]`."""
    return (
        c[k]
        + L * (c[k + 1] + P * (c[k + 4] + H * c[k + 10] + L * c[k + 14] + P * c[k + 12]))
        + L * (H * (c[k + 5] + L * c[k + 17] + H * c[k + 13]) + L * (c[k + 7] + L * c[k + 11]))
        + P * (c[k + 2] + H * (c[k + 6] + P * c[k + 18] + H * c[k + 16]))
        + P * (P * (c[k + 8] + P * c[k + 15]))
        + H * (c[k + 3] + H * (c[k + 9] + H * c[k + 19]))
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _cubic_gradient(
    c: FloatArray, k: int, L: float, P: float, H: float
) -> tuple[float, float, float]:
    """Partial derivatives of `_cubic` with respect to L, P and H."""
    d_lon = (
        c[k + 1]
        + P * (c[k + 4] + P * c[k + 12])
        + H * (c[k + 5] + H * c[k + 13] + P * c[k + 10])
        + L * (2.0 * (c[k + 7] + P * c[k + 14] + H * c[k + 17]) + 3.0 * L * c[k + 11])
    )
    d_lat = (
        c[k + 2]
        + L * (c[k + 4] + L * c[k + 14])
        + H * (c[k + 6] + H * c[k + 16] + L * c[k + 10])
        + P * (2.0 * (c[k + 8] + L * c[k + 12] + H * c[k + 18]) + 3.0 * P * c[k + 15])
    )
    d_height = (
        c[k + 3]
        + L * (c[k + 5] + L * c[k + 17] + P * c[k + 10])
        + P * (c[k + 6] + P * c[k + 18])
        + H * (2.0 * (c[k + 9] + L * c[k + 13] + P * c[k + 16]) + 3.0 * H * c[k + 19])
    )
    return d_lon, d_lat, d_height


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _wrapped(angle_rad: float) -> float:
    """Bring an angle into ±π."""
    return angle_rad - _TWO_PI * np.rint(angle_rad * (1.0 / _TWO_PI))


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _outside_model(
    p: KernelParameters, L: float, P: float, H: float, line_den: float, samp_den: float
) -> bool:
    return (
        (line_den * p.line_den_unit < _MIN_DENOMINATOR)
        | (samp_den * p.samp_den_unit < _MIN_DENOMINATOR)
        | (abs(L - p.lon_centre) > p.lon_half)
        | (abs(P - p.lat_centre) > p.lat_half)
        | (abs(H - p.height_centre) > p.height_half)
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _outside_image(p: KernelParameters, line_px: float, samp_px: float) -> bool:
    return (
        (line_px < p.line_low_px)
        | (line_px > p.line_high_px)
        | (samp_px < p.samp_low_px)
        | (samp_px > p.samp_high_px)
    )


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _project(
    c: FloatArray, p: KernelParameters, lon_rad: float, lat_rad: float, height_m: float
) -> tuple[float, float, float]:
    """Line, sample and flag (as a float, so that the loop stays in one vector width)."""
    L = _wrapped(lon_rad - p.lon_off_rad) * p.lon_unit
    P = (lat_rad - p.lat_off_rad) * p.lat_unit
    H = (height_m - p.height_off_m) * p.height_unit
    line_den = _cubic(c, LINE_DEN, L, P, H)
    samp_den = _cubic(c, SAMP_DEN, L, P, H)
    # One division serves both ratios.
    inverse = 1.0 / (line_den * samp_den)
    line = _cubic(c, LINE_NUM, L, P, H) * samp_den * inverse
    samp = _cubic(c, SAMP_NUM, L, P, H) * line_den * inverse
    line_px = p.line_off_px + p.line_scale_px * line
    samp_px = p.samp_off_px + p.samp_scale_px * samp
    flag = 0.0
    if _outside_image(p, line_px, samp_px):
        flag = _OUTSIDE_IMAGE
    if _outside_model(p, L, P, H, line_den, samp_den):
        flag = _OUTSIDE_MODEL
    if not ((abs(L) + abs(H) < np.inf) & (abs(lat_rad) <= 0.5 * math.pi)):
        flag = _BAD_INPUT
    if flag > _HAS_NUMBERS:
        line_px = np.nan
        samp_px = np.nan
    return line_px, samp_px, flag


@njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
def project_points(
    geodetic: FloatArray, c: FloatArray, p: KernelParameters, image_px: FloatArray, flags: FlagArray
) -> None:
    """Project flattened `geodetic` (3n) into flattened `image_px` (2n) and `flags` (n)."""
    n = flags.size
    for task in prange((n + _TASK - 1) // _TASK):
        a = np.zeros(_BLOCK)
        b = np.zeros(_BLOCK)
        h = np.zeros(_BLOCK)
        for begin in range(task * _TASK, min(n, (task + 1) * _TASK), _BLOCK):
            m = min(_BLOCK, n - begin)
            source = geodetic[3 * begin : 3 * (begin + m)]
            target = image_px[2 * begin : 2 * (begin + m)]
            target_flags = flags[begin : begin + m]
            # Unsigned indices spare the test for negative ones and let the loops vectorise.
            for i in range(uint64(m)):
                a[i] = source[_U3 * i]
                b[i] = source[_U3 * i + _U1]
                h[i] = source[_U3 * i + _U2]
            # Two points per turn share each load of a coefficient.
            for i in range(_HALF):
                j = i + _HALF
                line, samp, flag = _project(c, p, a[i], b[i], h[i])
                line_2, samp_2, flag_2 = _project(c, p, a[j], b[j], h[j])
                a[i], b[i], h[i] = line, samp, flag
                a[j], b[j], h[j] = line_2, samp_2, flag_2
            for i in range(uint64(m)):
                target[_U2 * i] = a[i]
                target[_U2 * i + _U1] = b[i]
            for i in range(uint64(m)):
                target_flags[i] = np.uint8(h[i])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
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


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _value_and_slopes(
    q: tuple[float, ...], L: float, P: float
) -> tuple[float, float, float]:
    """Value and derivatives by L and P of the bivariate cubic of `_reduced`."""
    value = q[0] + L * (q[1] + L * (q[3] + L * q[6]) + P * (q[4] + L * q[7] + P * q[8]))
    value += P * (q[2] + P * (q[5] + P * q[9]))
    d_lon = q[1] + L * (2.0 * q[3] + 3.0 * L * q[6]) + P * (q[4] + 2.0 * L * q[7] + P * q[8])
    d_lat = q[2] + P * (2.0 * q[5] + 3.0 * P * q[9]) + L * (q[4] + 2.0 * P * q[8] + L * q[7])
    return value, d_lon, d_lat


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _start(
    c: FloatArray, p: KernelParameters, x: float, y: float, H: float
) -> tuple[float, float]:
    """Normalised ground near the solution; the polynomial is held to where it was fitted."""
    u = min(max((x - p.start_line_off) * p.start_line_unit, -1.5), 1.5)
    v = min(max((y - p.start_samp_off) * p.start_samp_unit, -1.5), 1.5)
    w = min(max((H - p.start_height_off) * p.start_height_unit, -1.5), 1.5)
    return _cubic(c, START_LON, u, v, w), _cubic(c, START_LAT, u, v, w)


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
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


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
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


@njit(cache=True, fastmath=_FAST, error_model="numpy")
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


@njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
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
    for task in prange((n + _TASK - 1) // _TASK):
        a = np.zeros(_BLOCK)
        b = np.zeros(_BLOCK)
        h = np.zeros(_BLOCK)
        lon = np.zeros(_BLOCK)
        lat = np.zeros(_BLOCK)
        last = np.zeros(_BLOCK)
        for begin in range(task * _TASK, min(n, (task + 1) * _TASK), _BLOCK):
            m = min(_BLOCK, n - begin)
            source = image_px[2 * begin : 2 * (begin + m)]
            target = geodetic[3 * begin : 3 * (begin + m)]
            target_flags = flags[begin : begin + m]
            for i in range(uint64(m)):
                a[i] = source[_U2 * i]
                b[i] = source[_U2 * i + _U1]
            if common_height:
                h[:] = height_m[0]
            else:
                h[:m] = height_m[begin : begin + m]
            for i in range(_BLOCK):
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
            for i in range(_BLOCK):
                L = lon[i]
                P = lat[i]
                H = (h[i] - p.height_off_m) * p.height_unit
                lon_rad = p.lon_off_rad + L / p.lon_unit
                lat_rad = p.lat_off_rad + P / p.lat_unit
                flag = 0.0
                if _outside_image(p, a[i], b[i]):
                    flag = _OUTSIDE_IMAGE
                line_den = _cubic(c, LINE_DEN, L, P, H)
                samp_den = _cubic(c, SAMP_DEN, L, P, H)
                if _outside_model(p, L, P, H, line_den, samp_den) | (abs(lat_rad) > 0.5 * math.pi):
                    flag = _OUTSIDE_MODEL
                if not last[i] < _QUADRATIC_RESIDUAL:
                    flag = _NOT_CONVERGED
                if not abs(a[i]) + abs(b[i]) + abs(h[i]) < np.inf:
                    flag = _BAD_INPUT
                height = h[i]
                if flag > _HAS_NUMBERS:
                    lon_rad = np.nan
                    lat_rad = np.nan
                    height = np.nan
                lon[i] = _wrapped(lon_rad)
                lat[i] = lat_rad
                a[i] = height
                b[i] = flag
            for i in range(uint64(m)):
                target[_U3 * i] = lon[i]
                target[_U3 * i + _U1] = lat[i]
                target[_U3 * i + _U2] = a[i]
            for i in range(uint64(m)):
                target_flags[i] = np.uint8(b[i])


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _ratio_gradient(
    c: FloatArray, num: int, den: int, L: float, P: float, H: float
) -> tuple[float, float, float]:
    """Derivatives by L, P, H of the ratio of two cubics."""
    n_lon, n_lat, n_height = _cubic_gradient(c, num, L, P, H)
    d_lon, d_lat, d_height = _cubic_gradient(c, den, L, P, H)
    inverse = 1.0 / _cubic(c, den, L, P, H)
    ratio = _cubic(c, num, L, P, H) * inverse
    return (
        (n_lon - ratio * d_lon) * inverse,
        (n_lat - ratio * d_lat) * inverse,
        (n_height - ratio * d_height) * inverse,
    )


@njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
def differentiate_points(
    geodetic: FloatArray, c: FloatArray, p: KernelParameters, jacobian: FloatArray
) -> None:
    """d(line, sample)/d(lon_rad, lat_rad, height_m) at `geodetic` (n, 3), into (n, 2, 3)."""
    for i in prange(geodetic.shape[0]):
        L = _wrapped(geodetic[i, 0] - p.lon_off_rad) * p.lon_unit
        P = (geodetic[i, 1] - p.lat_off_rad) * p.lat_unit
        H = (geodetic[i, 2] - p.height_off_m) * p.height_unit
        x = _ratio_gradient(c, LINE_NUM, LINE_DEN, L, P, H)
        y = _ratio_gradient(c, SAMP_NUM, SAMP_DEN, L, P, H)
        units = (p.lon_unit, p.lat_unit, p.height_unit)
        for k in range(3):
            jacobian[i, 0, k] = p.line_scale_px * x[k] * units[k]
            jacobian[i, 1, k] = p.samp_scale_px * y[k] * units[k]


@njit(forceinline=True, fastmath=_FAST, error_model="numpy")
def _slope_of_sight(
    c: FloatArray, p: KernelParameters, lon_rad: float, lat_rad: float, height_m: float
) -> tuple[float, float]:
    """Change of longitude and latitude per metre of height along which the image point stays."""
    L = _wrapped(lon_rad - p.lon_off_rad) * p.lon_unit
    P = (lat_rad - p.lat_off_rad) * p.lat_unit
    H = (height_m - p.height_off_m) * p.height_unit
    x_lon, x_lat, x_height = _ratio_gradient(c, LINE_NUM, LINE_DEN, L, P, H)
    y_lon, y_lat, y_height = _ratio_gradient(c, SAMP_NUM, SAMP_DEN, L, P, H)
    inverse = p.height_unit / (x_lon * y_lat - x_lat * y_lon)
    return (
        (x_lat * y_height - y_lat * x_height) * inverse / p.lon_unit,
        (y_lon * x_height - x_lon * y_height) * inverse / p.lat_unit,
    )


@njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
def sight_lines(
    geodetic: FloatArray,
    c: FloatArray,
    p: KernelParameters,
    altitude_m: float,
    origin_ecef_m: FloatArray,
    direction_ecef: FloatArray,
) -> None:
    """Tangents of the curves of constant image point through `geodetic` (3n), pointing down.

    All arrays are flattened (3n). An origin is where the tangent is `altitude_m` above the
    horizontal plane of its point. NaN in, NaN out.
    """
    n = geodetic.size // 3
    for task in prange((n + _TASK - 1) // _TASK):
        lon = np.zeros(_BLOCK)
        lat = np.zeros(_BLOCK)
        h = np.zeros(_BLOCK)
        lon_slope = np.zeros(_BLOCK)
        lat_slope = np.zeros(_BLOCK)
        for begin in range(task * _TASK, min(n, (task + 1) * _TASK), _BLOCK):
            m = min(_BLOCK, n - begin)
            source = geodetic[3 * begin : 3 * (begin + m)]
            origin = origin_ecef_m[3 * begin : 3 * (begin + m)]
            direction = direction_ecef[3 * begin : 3 * (begin + m)]
            for i in range(uint64(m)):
                lon[i] = source[_U3 * i]
                lat[i] = source[_U3 * i + _U1]
                h[i] = source[_U3 * i + _U2]
            for i in range(_BLOCK):
                lon_slope[i], lat_slope[i] = _slope_of_sight(c, p, lon[i], lat[i], h[i])
            for i in range(uint64(m)):
                sin_lon = math.sin(lon[i])
                cos_lon = math.cos(lon[i])
                sin_lat = math.sin(lat[i])
                cos_lat = math.cos(lat[i])
                w2 = 1.0 - WGS84_E2 * sin_lat * sin_lat
                normal_m = WGS84_A_M / math.sqrt(w2)
                polar_m = normal_m * (1.0 - WGS84_E2)
                across_m = (normal_m + h[i]) * cos_lat
                east = across_m * lon_slope[i]
                north = (polar_m / w2 + h[i]) * lat_slope[i]
                # Per metre of height, in ECEF; its length is one over cos(zenith angle).
                t_x = -sin_lon * east - sin_lat * cos_lon * north + cos_lat * cos_lon
                t_y = cos_lon * east - sin_lat * sin_lon * north + cos_lat * sin_lon
                t_z = cos_lat * north + sin_lat
                shrink = 1.0 / math.sqrt(t_x * t_x + t_y * t_y + t_z * t_z)
                origin[_U3 * i] = across_m * cos_lon + altitude_m * t_x
                origin[_U3 * i + _U1] = across_m * sin_lon + altitude_m * t_y
                origin[_U3 * i + _U2] = (polar_m + h[i]) * sin_lat + altitude_m * t_z
                direction[_U3 * i] = -t_x * shrink
                direction[_U3 * i + _U1] = -t_y * shrink
                direction[_U3 * i + _U2] = -t_z * shrink
