"""Kernels of the least-squares matching in `refine`: a patch read by splines, sums, the loop."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from geoposition.arrays import BoolArray, FloatArray, IntArray

Grey: TypeAlias = NDArray[np.float32]

BLOCK_PX: Final = 8
_STEPS: Final = 20
_CONVERGED_PX: Final = 2e-3
"""A step that small leaves less than a tenth of itself."""
_FAST: Final = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _weights(t: float) -> tuple[float, float, float, float]:
    u = 1.0 - t
    middle = 2.0 / 3.0
    return (
        u * u * u / 6.0,
        middle - t * t * (1.0 - 0.5 * t),
        middle - u * u * (1.0 - 0.5 * u),
        t * t * t / 6.0,
    )


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _slope_weights(t: float) -> tuple[float, float, float, float]:
    u = 1.0 - t
    return -0.5 * u * u, -t * (2.0 - 1.5 * t), u * (2.0 - 1.5 * u), 0.5 * t * t


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _read(
    spline: Grey,
    row: int,
    col: int,
    row_weights: tuple[float, float, float, float],
    col_weights: tuple[float, float, float, float],
    strip: Grey,
    out: Grey,
) -> None:
    """Filter a patch whose first pixel is (row, col); `strip` (size + 3, size) is scratch."""
    size = out.shape[0]
    a, b, c, d = col_weights
    w0, w1, w2, w3 = np.float32(a), np.float32(b), np.float32(c), np.float32(d)
    for i in range(size + 3):
        source, into = spline[row - 1 + i, col - 1 : col + size + 2], strip[i]
        for j in range(size):
            into[j] = w0 * source[j] + w1 * source[j + 1] + w2 * source[j + 2] + w3 * source[j + 3]
    a, b, c, d = row_weights
    w0, w1, w2, w3 = np.float32(a), np.float32(b), np.float32(c), np.float32(d)
    for i in range(size):
        s0, s1, s2, s3, into = strip[i], strip[i + 1], strip[i + 2], strip[i + 3], out[i]
        for j in range(size):
            into[j] = w0 * s0[j] + w1 * s1[j] + w2 * s2[j] + w3 * s3[j]


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _moments(
    grey: Grey, row_slope: Grey, col_slope: Grey, weight: Grey, r0: int, c0: int, image: Grey
) -> tuple[float, float, float, float, float]:
    """Sum `image` and its products with itself, the template and the template's slopes."""
    size = image.shape[0]
    s_sum = ss = st = rs = cs = 0.0
    for i in range(size):
        # 32 bits over one row keep the loop in vectors; the rows add up in 64
        f_s = f_ss = f_st = f_rs = f_cs = np.float32(0.0)
        w, s, t = weight[i], image[i], grey[r0 + i, c0 : c0 + size]
        g_r, g_c = row_slope[r0 + i, c0 : c0 + size], col_slope[r0 + i, c0 : c0 + size]
        for j in range(size):
            ws = w[j] * s[j]
            f_s += ws
            f_ss += ws * s[j]
            f_st += ws * t[j]
            f_rs += ws * g_r[j]
            f_cs += ws * g_c[j]
        s_sum += float(f_s)
        ss += float(f_ss)
        st += float(f_st)
        rs += float(f_rs)
        cs += float(f_cs)
    return s_sum, ss, st, rs, cs


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _score(
    grey: Grey,
    row_slope: Grey,
    col_slope: Grey,
    weight: Grey,
    r0: int,
    c0: int,
    image: Grey,
    line: tuple[float, float],
    row_line: tuple[float, float],
    col_line: tuple[float, float],
) -> tuple[float, float, float]:
    """Sum squares of (slope · residual) over blocks: what the covariance is made of.

    `line` is (offset, gain) of the template on the image, `row_line` and `col_line` those of the
    slopes.
    """
    size = image.shape[0]
    m_rr = m_rc = m_cc = 0.0
    for bi in range(0, size, BLOCK_PX):
        for bj in range(0, size, BLOCK_PX):
            u_r = u_c = 0.0
            for i in range(bi, min(bi + BLOCK_PX, size)):
                for j in range(bj, min(bj + BLOCK_PX, size)):
                    s = image[i, j]
                    e = weight[i, j] * (grey[r0 + i, c0 + j] - line[0] - line[1] * s)
                    u_r += e * (row_slope[r0 + i, c0 + j] - row_line[0] - row_line[1] * s)
                    u_c += e * (col_slope[r0 + i, c0 + j] - col_line[0] - col_line[1] * s)
            m_rr += u_r * u_r
            m_rc += u_r * u_c
            m_cc += u_c * u_c
    return m_rr, m_rc, m_cc


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def refine_patches(
    grey: Grey,
    row_slope: Grey,
    col_slope: Grey,
    known: Grey,
    spline: Grey,
    seen: Grey,
    corners: IntArray,
    size: int,
    farthest_px: float,
    middle: FloatArray,
    shift: FloatArray,
    covariance: FloatArray,
    correlation: FloatArray,
    converged: BoolArray,
) -> None:
    """Refine `shift` (n, 2) of patches in place, with covariance, correlation, convergence."""
    rows, cols = spline.shape
    for p in prange(len(corners)):
        r0, c0 = corners[p, 0], corners[p, 1]
        start_r, start_c = shift[p, 0], shift[p, 1]
        near_r, near_c = r0 + round(start_r), c0 + round(start_c)
        if min(near_r, near_c) < 2 or near_r + size > rows - 2 or near_c + size > cols - 2:
            continue
        strip = np.empty((size + 3, size), np.float32)
        image = np.empty((size, size), np.float32)
        slope = np.empty((size, size), np.float32)
        weight = np.empty((size, size), np.float32)
        n = i_sum = j_sum = 0.0
        for i in range(size):
            k = known[r0 + i, c0 : c0 + size]
            m, w = seen[near_r + i, near_c : near_c + size], weight[i]
            row_n = row_j = np.float32(0.0)
            for j in range(size):
                w[j] = k[j] * m[j]
                row_n += w[j]
                row_j += np.float32(j) * w[j]
            n += float(row_n)
            i_sum += i * float(row_n)
            j_sum += float(row_j)
        if not n > 16.0:
            continue
        middle[p, 0], middle[p, 1] = i_sum / n, j_sum / n
        own = grey[r0 : r0 + size, c0 : c0 + size]
        t_sum, tt, _, tr, tc = _moments(grey, row_slope, col_slope, weight, r0, c0, own)
        own = row_slope[r0 : r0 + size, c0 : c0 + size]
        r_sum, rr, _, _, rc = _moments(grey, row_slope, col_slope, weight, r0, c0, own)
        own = col_slope[r0 : r0 + size, c0 : c0 + size]
        c_sum, cc, _, _, _ = _moments(grey, row_slope, col_slope, weight, r0, c0, own)
        tt -= t_sum * t_sum / n
        tr -= t_sum * r_sum / n
        tc -= t_sum * c_sum / n
        rr -= r_sum * r_sum / n
        rc -= r_sum * c_sum / n
        cc -= c_sum * c_sum / n
        at_r, at_c = start_r, start_c
        b = s_sum = rs = cs = h_rr = h_rc = h_cr = h_cc = det = 0.0
        ss = 1.0
        good = False
        for step in range(_STEPS):
            whole_r, whole_c = math.floor(at_r), math.floor(at_c)
            row, col = r0 + int(whole_r), c0 + int(whole_c)
            if min(row, col) < 1 or row + size + 2 > rows or col + size + 2 > cols:
                break
            weights_r, weights_c = _weights(at_r - whole_r), _weights(at_c - whole_c)
            _read(spline, row, col, weights_r, weights_c, strip, image)
            s_sum, ss, st, rs, cs = _moments(grey, row_slope, col_slope, weight, r0, c0, image)
            ss -= s_sum * s_sum / n
            st -= s_sum * t_sum / n
            rs -= s_sum * r_sum / n
            cs -= s_sum * c_sum / n
            b = st / ss
            correlation[p] = st / math.sqrt(ss * tt)
            if step == 0:
                # slopes of the template twice: enough to come near
                h_rr, h_cc = rr - rs * rs / ss, cc - cs * cs / ss
                h_rc = h_cr = rc - rs * cs / ss
            elif step == 1:
                # slopes of both images: noise, which they do not share, is not in their product
                _read(spline, row, col, _slope_weights(at_r - whole_r), weights_c, strip, slope)
                d_sum, _, _, h_rr, h_cr = _moments(
                    grey, row_slope, col_slope, weight, r0, c0, slope
                )
                h_rr = b * (h_rr - d_sum * r_sum / n)
                h_cr = b * (h_cr - d_sum * c_sum / n)
                _read(spline, row, col, weights_r, _slope_weights(at_c - whole_c), strip, slope)
                d_sum, _, _, h_rc, h_cc = _moments(
                    grey, row_slope, col_slope, weight, r0, c0, slope
                )
                h_rc = b * (h_rc - d_sum * r_sum / n)
                h_cc = b * (h_cc - d_sum * c_sum / n)
            det = h_rr * h_cc - h_rc * h_cr
            if not (ss > 0.0 and b > 0.0 and h_rr > 0.0 and det > 1e-3 * h_rr * h_cc):
                break
            right_r, right_c = tr - b * rs, tc - b * cs
            step_r = (h_cc * right_r - h_rc * right_c) / det
            step_c = (h_rr * right_c - h_cr * right_r) / det
            at_r += step_r
            at_c += step_c
            if not max(abs(at_r - start_r), abs(at_c - start_c)) <= farthest_px:
                break
            if step > 0 and max(abs(step_r), abs(step_c)) < _CONVERGED_PX:
                good = True
                break
        if not good:
            continue
        shift[p, 0], shift[p, 1] = at_r, at_c
        converged[p] = True
        m_rr, m_rc, m_cc = _score(
            grey, row_slope, col_slope, weight, r0, c0, image,
            ((t_sum - b * s_sum) / n, b),
            ((r_sum - rs / ss * s_sum) / n, rs / ss),
            ((c_sum - cs / ss * s_sum) / n, cs / ss),
        )  # fmt: skip
        i_rr, i_rc, i_cr, i_cc = h_cc / det, -h_rc / det, -h_cr / det, h_rr / det
        a_rr, a_rc = i_rr * m_rr + i_rc * m_rc, i_rr * m_rc + i_rc * m_cc
        a_cr, a_cc = i_cr * m_rr + i_cc * m_rc, i_cr * m_rc + i_cc * m_cc
        covariance[p, 0, 0] = a_rr * i_rr + a_rc * i_rc
        covariance[p, 0, 1] = covariance[p, 1, 0] = a_rr * i_cr + a_rc * i_cc
        covariance[p, 1, 1] = a_cr * i_cr + a_cc * i_cc
