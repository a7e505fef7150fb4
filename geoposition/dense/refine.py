"""Disparities to a small part of a pixel, with their standard deviations: least squares.

Semi-global matching fits a parabola through costs of whole disparities, which draws results to
these. Around each pixel the first image A and the second one, brought there by the disparities
found, B, differ by gain, offset and a rest e of the disparity:
    A = a + b B + c B' ,   c = − b e ,
B' the slope of B along the row. Least squares over a Gaussian window gives e, and from its
residuals the standard deviation. All sums are local means of products, the same for all pixels.
B is read by cubic splines: cubic convolution would shift detail by some hundredths of a pixel.

*Source*: Lucas and Kanade 1981; Förstner 1982 for the precision; Unser 1999, IEEE Signal
Processing Magazine 16(6), for the splines' filter.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.dense.filters import Grey, Mask, gaussian_mean, smoothed

_SIGMA_PX: Final = 2.0
_SIZE_PX: Final = 11
_TURNS: Final = 2
_FADES: Final = 16
"""The pole's powers are below 1e-9 after so many pixels."""
_FARTHEST_PX: Final = 0.75
_SMOOTH_JUMP_PX: Final = 0.75
_FEWEST_WEIGHTS: Final = 4.0 * math.pi * _SIGMA_PX**2
"""As many independent pixels give the same mean's variance."""
_FAST = {"contract", "arcp", "nsz", "reassoc"}


def refine_rows(
    first: Grey, second: Grey, disparity_px: Grey, believed: Mask, least_correlation: float = 0.5
) -> tuple[Grey, Grey]:
    """Improve `disparity_px` of `first` in `second`; disparity and its sigma, NaN where lost.

    A pixel is lost where it was not believed, where the images correlate by less than
    `least_correlation` or where the result lies too far from what was found.
    """
    known = np.isfinite(first)
    middle = np.float32(first[known].mean()) if known.any() else np.float32(0.0)
    a = np.where(known, first - middle, np.float32(0.0)).astype(np.float32)
    holes = np.isfinite(second)
    spline = np.where(holes, second - middle, np.float32(0.0)).astype(np.float32)
    _spline(spline)
    start = smoothed(disparity_px, _SMOOTH_JUMP_PX)
    found = start
    b, slope = np.empty_like(a), np.empty_like(a)
    rest, variance, correlation2 = np.empty_like(a), np.empty_like(a), np.empty_like(a)
    for turn in range(_TURNS):
        _brought(spline, found, b, slope)
        _solve(
            _mean(a),
            _mean(b),
            _mean(slope),
            _mean(a * a),
            _mean(a * b),
            _mean(a * slope),
            _mean(b * b),
            _mean(b * slope),
            _mean(slope * slope),
            rest,
            variance,
            correlation2,
        )
        found = found + rest
        if turn + 1 < _TURNS:
            found = smoothed(found, _SMOOTH_JUMP_PX)
    good = believed & (np.abs(found - start) <= _FARTHEST_PX)
    good &= correlation2 >= least_correlation**2
    nothing = np.float32(np.nan)
    return np.where(good, found, nothing), np.where(good, np.sqrt(variance), nothing)


def _mean(grey: Grey) -> Grey:
    return gaussian_mean(grey, _SIGMA_PX, _SIZE_PX)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _spline(grey: Grey) -> None:
    """Make rows of values the coefficients of cubic B-splines through them, in place."""
    columns = grey.shape[1]
    pole = math.sqrt(3.0) - 2.0
    for v in prange(grey.shape[0]):
        row = grey[v]
        total, power = float(row[0]), pole
        for u in range(1, min(columns, _FADES)):
            total += power * row[u]
            power *= pole
        before = 6.0 * total
        row[0] = before
        for u in range(1, columns):
            before = 6.0 * row[u] + pole * before
            row[u] = before
        after = pole / (pole * pole - 1.0) * (row[columns - 1] + pole * row[columns - 2])
        row[columns - 1] = after
        for u in range(columns - 2, -1, -1):
            after = pole * (after - row[u])
            row[u] = after


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _brought(coefficients: Grey, disparity: Grey, out: Grey, slope: Grey) -> None:
    """Values and slopes at u − d of the splines along the rows."""
    columns = coefficients.shape[1]
    for v in prange(coefficients.shape[0]):
        row = coefficients[v]
        for u in range(columns):
            x = min(max(u - disparity[v, u], 1.0), columns - 3.0)
            j = int(x)
            t = x - j
            c0, c1, c2, c3 = row[j - 1], row[j], row[j + 1], row[j + 2]
            p0 = (c0 + 4.0 * c1 + c2) / 6.0
            p1 = 0.5 * (c2 - c0)
            p2 = 0.5 * (c0 - 2.0 * c1 + c2)
            p3 = (c3 - c0) / 6.0 + 0.5 * (c1 - c2)
            out[v, u] = p0 + t * (p1 + t * (p2 + t * p3))
            slope[v, u] = p1 + t * (2.0 * p2 + t * 3.0 * p3)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _solve(
    a: Grey,
    b: Grey,
    g: Grey,
    aa: Grey,
    ab: Grey,
    ag: Grey,
    bb: Grey,
    bg: Grey,
    gg: Grey,
    rest: Grey,
    variance: Grey,
    correlation2: Grey,
) -> None:
    """Rest of the disparity, at most one pixel, its variance and the squared correlation."""
    n = _FEWEST_WEIGHTS
    for v in prange(a.shape[0]):
        for u in range(a.shape[1]):
            ma, mb, mg = float(a[v, u]), float(b[v, u]), float(g[v, u])
            s_aa, s_ab, s_ag = aa[v, u] - ma * ma, ab[v, u] - ma * mb, ag[v, u] - ma * mg
            s_bb, s_bg, s_gg = bb[v, u] - mb * mb, bg[v, u] - mb * mg, gg[v, u] - mg * mg
            det = s_bb * s_gg - s_bg * s_bg
            rest[v, u] = 0.0
            variance[v, u] = np.inf
            correlation2[v, u] = 0.0
            if not (det > 1e-9 * s_bb * s_gg and s_aa > 0.0 and s_ab > 0.0):
                continue
            gain = (s_gg * s_ab - s_bg * s_ag) / det
            c = (s_bb * s_ag - s_bg * s_ab) / det
            if not gain > 0.0:
                continue
            left = max(s_aa - gain * s_ab - c * s_ag, 0.0)
            rest[v, u] = min(max(-c / gain, -1.0), 1.0)
            variance[v, u] = left * n / (n - 3.0) * (s_bb / det) / n / (gain * gain)
            correlation2[v, u] = 1.0 - left / s_aa
