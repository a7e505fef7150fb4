"""Compiled moments: everything the normal equations of two ratios of cubics are made of.

The products of the fit's columns are polynomials times powers of the residual from an affine
function. Summing monomials instead of columns takes one pass over the points, no matrix, and a
few per cent of the time of a least-squares solution.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from geoposition.arrays import FloatArray, IntArray
from geoposition.rpc.kernel_base import FAST, cubic

BLOCK = 128
CHUNKS = 16
"""Parts of the points, added up in this order whatever the number of threads."""


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def moments(
    x: FloatArray,
    target: FloatArray,
    weight: FloatArray,
    affine: FloatArray,
    num: FloatArray,
    den: FloatArray,
    newton: bool,
    parent: IntArray,
    variable: IntArray,
    sizes: IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum monomials of `x` (3, n) with five weights for each of two targets (2, n).

    With r the target, a its `affine` (2, 4) part, N/D the ratio of `num` to `den` (2, 20) and
    p the `weight` (2, n), the monomials up to sizes[0], sizes[1], ... are weighted by

        w = p/D², w δ, w δ², e p/D, e p/D δ

    where, if `newton`, δ = N/D − a and e = r − N/D; else D = 1, δ = r − a, e = 0.

    Returns the sums (2, 5, size), Σ p e² (2), and the extremes (2, 2) of D.
    """
    n = x.shape[1]
    size = sizes[0]
    part = np.zeros((CHUNKS, 2, 5, size))
    square = np.zeros((CHUNKS, 2))
    low, high = np.full((CHUNKS, 2), np.inf), np.full((CHUNKS, 2), -np.inf)
    step = (n + CHUNKS - 1) // CHUNKS
    for chunk in prange(CHUNKS):
        mono = np.empty((size, BLOCK))
        w = np.zeros((5, BLOCK))
        top, bottom = np.zeros(BLOCK), np.zeros(BLOCK)
        first, last = chunk * step, min(n, (chunk + 1) * step)
        for begin in range(first, last, BLOCK):
            used = min(BLOCK, last - begin)
            mono[0] = 1.0
            for j in range(1, size):
                k, v = parent[j], variable[j]
                for b in range(used):
                    mono[j, b] = mono[k, b] * x[v, begin + b]
            for axis in range(2):
                for b in range(used):
                    top[b], bottom[b] = target[axis, begin + b], 1.0
                if newton:
                    top[:] = 0.0
                    bottom[:] = 0.0
                    for j in range(20):
                        for b in range(used):
                            top[b] += num[axis, j] * mono[j, b]
                            bottom[b] += den[axis, j] * mono[j, b]
                total, least, most = 0.0, np.inf, -np.inf
                for b in range(used):
                    p, d = weight[axis, begin + b], bottom[b]
                    delta = top[b] / d - affine[axis, 0]
                    e = target[axis, begin + b] - top[b] / d
                    for k in range(1, 4):
                        delta -= affine[axis, k] * mono[k, b]
                    w[0, b] = p / (d * d)
                    w[1, b] = w[0, b] * delta
                    w[2, b] = w[1, b] * delta
                    w[3, b] = p * e / d
                    w[4, b] = w[3, b] * delta
                    total += p * e * e
                    least, most = min(least, d), max(most, d)
                square[chunk, axis] += total
                low[chunk, axis] = min(low[chunk, axis], least)
                high[chunk, axis] = max(high[chunk, axis], most)
                for i in range(5 if newton else 3):
                    for j in range(sizes[i]):
                        total = 0.0
                        for b in range(used):
                            total += mono[j, b] * w[i, b]
                        part[chunk, axis, i, j] += total
    sums, squares = np.zeros((2, 5, size)), np.zeros(2)
    extremes = np.empty((2, 2))
    extremes[:, 0], extremes[:, 1] = np.inf, -np.inf
    for chunk in range(CHUNKS):
        sums += part[chunk]
        squares += square[chunk]
        for axis in range(2):
            extremes[axis, 0] = min(extremes[axis, 0], low[chunk, axis])
            extremes[axis, 1] = max(extremes[axis, 1], high[chunk, axis])
    return sums, squares, extremes


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def residuals(
    x: FloatArray, target: FloatArray, num: FloatArray, den: FloatArray, out: FloatArray
) -> None:
    """Put r − N/D of two `target` (2, n) at `x` (3, n) into `out` (2, n)."""
    for i in prange(x.shape[1]):
        u, v, w = x[0, i], x[1, i], x[2, i]
        for axis in range(2):
            top = cubic(num[axis], 0, u, v, w)
            out[axis, i] = target[axis, i] - top / cubic(den[axis], 0, u, v, w)
