"""Where a patch fits best among whole pixels: normalised correlation with holes."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FloatArray, IntArray
from geoposition.calib_fields.refine import Searched, Template
from geoposition.calib_fields.refine_kernels import Grey

_FAST: Final = {"contract", "arcp", "nsz", "reassoc"}


def correlate(
    template: Template,
    searched: Searched,
    corners: IntArray,
    size: int,
    radius: int,
    least_known: float,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Best whole shifts (n, 2) within `radius`, the correlation there (n,), and contrast (n, 2).

    `corners` (n, 2) are the patches' first pixels. The contrast is the standard deviation of the
    patch and of what lies under it in the searched image. The correlation is NaN where less than
    the share `least_known` of a patch is known in both.
    """
    n = len(corners)
    shift = np.zeros((n, 2), dtype=np.int64)
    score, contrast = np.full(n, np.nan), np.full((n, 2), np.nan)
    _correlate(
        template.grey,
        template.known,
        searched.grey,
        searched.known,
        np.ascontiguousarray(corners, dtype=np.int64),
        size,
        radius,
        least_known * size * size,
        shift,
        score,
        contrast,
    )
    return shift, score, contrast


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _correlate(
    grey: Grey,
    known: Grey,
    other: Grey,
    seen: Grey,
    corners: IntArray,
    size: int,
    radius: int,
    least: float,
    shift: IntArray,
    score: FloatArray,
    contrast: FloatArray,
) -> None:
    rows, cols = other.shape
    for p in prange(len(corners)):
        r0, c0 = corners[p, 0], corners[p, 1]
        best = -2.0
        for dr in range(-radius, radius + 1):
            for dc in range(-radius, radius + 1):
                row, col = r0 + dr, c0 + dc
                if min(row, col) < 0 or row + size > rows or col + size > cols:
                    continue
                n = ts = ss = tt = st = so = 0.0
                for i in range(size):
                    f_n = f_t = f_s = f_tt = f_st = f_ss = np.float32(0.0)
                    t, k = grey[r0 + i, c0 : c0 + size], known[r0 + i, c0 : c0 + size]
                    s, m = other[row + i, col : col + size], seen[row + i, col : col + size]
                    for j in range(size):
                        w = k[j] * m[j]
                        wt, ws = w * t[j], w * s[j]
                        f_n += w
                        f_t += wt
                        f_s += ws
                        f_tt += wt * t[j]
                        f_st += wt * s[j]
                        f_ss += ws * s[j]
                    n += float(f_n)
                    ts += float(f_t)
                    ss += float(f_s)
                    tt += float(f_tt)
                    st += float(f_st)
                    so += float(f_ss)
                if not (n >= least and n > 1.0):
                    continue
                v_t, v_s = tt - ts * ts / n, so - ss * ss / n
                value = -1.0
                if v_t > 0.0 and v_s > 0.0:
                    value = (st - ts * ss / n) / math.sqrt(v_t * v_s)
                if value > best:
                    best = value
                    shift[p, 0], shift[p, 1] = dr, dc
                    contrast[p, 0] = math.sqrt(max(v_t, 0.0) / n)
                    contrast[p, 1] = math.sqrt(max(v_s, 0.0) / n)
        if best > -2.0:
            score[p] = best
