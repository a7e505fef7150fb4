"""Least-squares matching: a match's place in the second image to a small part of a pixel.

Around a match the second image is an affine view of the first, with another gain and offset:
    A(x) = gain · B(place + M (x − x0)) + offset .
The eight unknowns follow by Gauss–Newton over a round, smoothly weighted patch; B is read by
cubic convolution. M starts from what the models say.

*Source*: Gruen 1985, S. Afr. J. Photogrammetry 14(3); Keys 1981, IEEE ASSP 29(6), (4) with
a = −1/2, for the convolution.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from geoposition.arrays import BoolArray, FloatArray

RADIUS_PX = 10
_SIGMA_PX = 5.0
_STEPS = 12
_CONVERGED_PX = 0.003
_UNKNOWNS = 8
_FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _weights(t: float) -> tuple[float, float, float, float, float, float, float, float]:
    """Cubic-convolution weights of four neighbours at fraction t, and their derivatives."""
    t2 = t * t
    t3 = t2 * t
    return (
        -0.5 * t3 + t2 - 0.5 * t,
        1.5 * t3 - 2.5 * t2 + 1.0,
        -1.5 * t3 + 2.0 * t2 + 0.5 * t,
        0.5 * t3 - 0.5 * t2,
        -1.5 * t2 + 2.0 * t - 0.5,
        4.5 * t2 - 5.0 * t,
        -4.5 * t2 + 4.0 * t + 0.5,
        1.5 * t2 - t,
    )


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _sample(grey: FloatArray, line: float, sample: float) -> tuple[float, float, float]:
    """Value and its derivatives by line and sample; NaN outside."""
    i, j = math.floor(line), math.floor(sample)
    if not (1 <= i < grey.shape[0] - 2 and 1 <= j < grey.shape[1] - 2):
        return math.nan, math.nan, math.nan
    a0, a1, a2, a3, p0, p1, p2, p3 = _weights(line - i)
    b0, b1, b2, b3, q0, q1, q2, q3 = _weights(sample - j)
    value = by_line = by_sample = 0.0
    for k in range(4):
        row = grey[i - 1 + k]
        g0, g1, g2, g3 = row[j - 1], row[j], row[j + 1], row[j + 2]
        across = b0 * g0 + b1 * g1 + b2 * g2 + b3 * g3
        slope = q0 * g0 + q1 * g1 + q2 * g2 + q3 * g3
        a = a0 if k == 0 else (a1 if k == 1 else (a2 if k == 2 else a3))
        p = p0 if k == 0 else (p1 if k == 1 else (p2 if k == 2 else p3))
        value += a * across
        by_line += p * across
        by_sample += a * slope
    return value, by_line, by_sample


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _cholesky_solve(n: FloatArray, right: FloatArray) -> bool:
    """Solve n x = right in place (lower triangle of `n` is used); False if not positive."""
    size = len(right)
    for i in range(size):
        for j in range(i + 1):
            total = n[i, j]
            for k in range(j):
                total -= n[i, k] * n[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                n[i, i] = math.sqrt(total)
            else:
                n[i, j] = total / n[j, j]
    for i in range(size):
        for k in range(i):
            right[i] -= n[i, k] * right[k]
        right[i] /= n[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= n[k, i] * right[k]
        right[i] /= n[i, i]
    return True


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def refine(
    grey_a: FloatArray,
    grey_b: FloatArray,
    points_a: FloatArray,
    affine: FloatArray,
    farthest_px: float,
    points_b: FloatArray,
    correlation: FloatArray,
    converged: BoolArray,
) -> None:
    """Improve `points_b` (n, 2), the places of `points_a` (n, 2) in `grey_b`, in place.

    Points are in the pixels of the two arrays. `affine` (n, 2, 2) is where M starts. A point is
    left as it was, with `converged` false, where a patch reaches outside or the solution moves
    farther than `farthest_px`. `correlation` is that of the patches at the solution.
    """
    for p in prange(len(points_a)):
        converged[p] = False
        correlation[p] = np.nan
        line_a, sample_a = points_a[p, 0], points_a[p, 1]
        i0, j0 = round(line_a), round(sample_a)
        r = RADIUS_PX
        if not (r <= i0 < grey_a.shape[0] - r and r <= j0 < grey_a.shape[1] - r):
            continue
        n = np.empty((_UNKNOWNS, _UNKNOWNS))
        right = np.empty(_UNKNOWNS)
        row = np.empty(_UNKNOWNS)
        line, sample = points_b[p, 0], points_b[p, 1]
        m00, m01, m10, m11 = affine[p, 0, 0], affine[p, 0, 1], affine[p, 1, 0], affine[p, 1, 1]
        gain, offset = 0.0, 0.0
        good = False
        for step in range(_STEPS):
            n[:] = 0.0
            right[:] = 0.0
            w_sum = a_sum = b_sum = aa = ab = bb = 0.0
            # First the gain and offset that suit the present place, then all together.
            for turn in range(2 if step == 0 else 1):
                fit_all = step > 0 or turn == 1
                for di in range(-r, r + 1):
                    for dj in range(-r, r + 1):
                        if di * di + dj * dj > r * r:
                            continue
                        x, y = i0 + di - line_a, j0 + dj - sample_a
                        w = math.exp(-0.5 * (x * x + y * y) / (_SIGMA_PX * _SIGMA_PX))
                        a = grey_a[i0 + di, j0 + dj]
                        b, b_l, b_s = _sample(
                            grey_b, line + m00 * x + m01 * y, sample + m10 * x + m11 * y
                        )
                        if fit_all:
                            row[0] = gain * b_l
                            row[1] = gain * b_s
                            row[2] = row[0] * x
                            row[3] = row[0] * y
                            row[4] = row[1] * x
                            row[5] = row[1] * y
                            row[6] = b
                            row[7] = 1.0
                            misfit = a - gain * b - offset
                            for u in range(_UNKNOWNS):
                                right[u] += w * row[u] * misfit
                                for v in range(u + 1):
                                    n[u, v] += w * row[u] * row[v]
                        if not fit_all or step > 0:
                            w_sum += w
                            a_sum += w * a
                            b_sum += w * b
                            aa += w * a * a
                            ab += w * a * b
                            bb += w * b * b
                if not fit_all:
                    spread = bb - b_sum * b_sum / w_sum
                    gain = (ab - a_sum * b_sum / w_sum) / spread
                    offset = (a_sum - gain * b_sum) / w_sum
            if step > 0:
                spread_a = aa - a_sum * a_sum / w_sum
                spread_b = bb - b_sum * b_sum / w_sum
                correlation[p] = (ab - a_sum * b_sum / w_sum) / math.sqrt(spread_a * spread_b)
            if not (math.isfinite(gain) and _cholesky_solve(n, right)):
                break
            line += right[0]
            sample += right[1]
            m00 += right[2]
            m01 += right[3]
            m10 += right[4]
            m11 += right[5]
            gain += right[6]
            offset += right[7]
            moved = math.hypot(line - points_b[p, 0], sample - points_b[p, 1])
            if not moved <= farthest_px:
                break
            if step > 0 and math.hypot(right[0], right[1]) < _CONVERGED_PX:
                good = True
                break
        if good:
            points_b[p, 0] = line
            points_b[p, 1] = sample
            converged[p] = True
