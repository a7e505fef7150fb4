"""Compiled moments: everything the normal equations of two ratios of cubics are made of.

The products of the fit's columns are polynomials times powers of the residual from an affine
function. Summing monomials instead of columns takes one pass over the points, no matrix, and a
few per cent of the time of a least-squares solution. The loops run in one thread and without
the interpreter's lock: the two directions of a fit are what runs side by side.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray, IntArray
from geoposition.rpc.kernel_base import FAST, cubic

_BLOCK = 128


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
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

        p/D², p/D² δ, p/D² δ², e p/D, e p/D δ

    where, if `newton`, δ = N/D − a and e = r − N/D; else D = 1, δ = r − a, e = 0.

    Returns the sums (2, 5, size), Σ p e² (2), and the extremes (2, 2) of D.
    """
    n, size = x.shape[1], sizes[0]
    part, facts = np.zeros((10, size)), np.zeros((2, 3))
    facts[:, 1], facts[:, 2] = np.inf, -np.inf
    mono, w = np.empty((size, _BLOCK)), np.zeros((10, _BLOCK))
    points, work = np.zeros((3, _BLOCK)), np.zeros((6, _BLOCK))
    for begin in range(0, n, _BLOCK):
        _load(x, target, weight, begin, min(_BLOCK, n - begin), points, work)
        _monomials(points, parent, variable, mono)
        for axis in range(2):
            _weights(mono, work, affine[axis], num[axis], den[axis], newton, axis, w, facts[axis])
        _add(mono, w, sizes, newton, part)
    sums = np.empty((2, 5, size))
    for i in range(5):
        sums[0, i], sums[1, i] = part[2 * i], part[2 * i + 1]
    return sums, facts[:, 0].copy(), facts[:, 1:].copy()


@njit(fastmath=FAST, error_model="numpy")
def _load(
    x: FloatArray,
    target: FloatArray,
    weight: FloatArray,
    begin: int,
    used: int,
    points: FloatArray,
    work: FloatArray,
) -> None:
    """Copy a block; the last one is filled up with its first point, of weight zero."""
    for b in range(_BLOCK):
        at = begin + (b if b < used else 0)
        for k in range(3):
            points[k, b] = x[k, at]
        for axis in range(2):
            work[axis, b] = target[axis, at]
            work[2 + axis, b] = weight[axis, at] if b < used else 0.0


@njit(fastmath=FAST, error_model="numpy")
def _monomials(points: FloatArray, parent: IntArray, variable: IntArray, mono: FloatArray) -> None:
    mono[0] = 1.0
    for j in range(1, mono.shape[0]):
        factor, other = points[variable[j]], mono[parent[j]]
        for b in range(_BLOCK):
            mono[j, b] = factor[b] * other[b]


@njit(fastmath=FAST, error_model="numpy")
def _weights(
    mono: FloatArray,
    work: FloatArray,
    affine: FloatArray,
    num: FloatArray,
    den: FloatArray,
    newton: bool,
    axis: int,
    w: FloatArray,
    facts: FloatArray,
) -> None:
    """Put the five weights of a block into `w`, and Σ p e² and the extremes of D into `facts`."""
    r, p, top, bottom = work[axis], work[2 + axis], work[4], work[5]
    for b in range(_BLOCK):
        top[b], bottom[b] = r[b], 1.0
    if newton:
        top[:] = 0.0
        bottom[:] = 0.0
        for j in range(20):
            for b in range(_BLOCK):
                top[b] += num[j] * mono[j, b]
                bottom[b] += den[j] * mono[j, b]
    square, least, most = 0.0, np.inf, -np.inf
    for b in range(_BLOCK):
        f = top[b] / bottom[b]
        delta = f - affine[0] - affine[1] * mono[1, b]
        delta -= affine[2] * mono[2, b] + affine[3] * mono[3, b]
        e = r[b] - f
        share = p[b] / bottom[b]
        plain = share / bottom[b]
        w[axis, b] = plain
        w[2 + axis, b] = plain * delta
        w[4 + axis, b] = plain * delta * delta
        w[6 + axis, b] = share * e
        w[8 + axis, b] = share * e * delta
        square += p[b] * e * e
        least, most = min(least, bottom[b]), max(most, bottom[b])
    facts[0] += square
    facts[1], facts[2] = min(facts[1], least), max(facts[2], most)


@njit(fastmath=FAST, error_model="numpy")
def _add(mono: FloatArray, w: FloatArray, sizes: IntArray, newton: bool, part: FloatArray) -> None:
    """Add a block's weighted monomials; each is read once for as many weights as need it."""
    for j in range(sizes[2]):
        a = b = c = d = e = f = 0.0
        for i in range(_BLOCK):
            m = mono[j, i]
            a += m * w[0, i]
            b += m * w[1, i]
            c += m * w[2, i]
            d += m * w[3, i]
            e += m * w[4, i]
            f += m * w[5, i]
        part[0, j] += a
        part[1, j] += b
        part[2, j] += c
        part[3, j] += d
        part[4, j] += e
        part[5, j] += f
    for j in range(sizes[2], sizes[0]):
        a = b = c = d = 0.0
        for i in range(_BLOCK):
            m = mono[j, i]
            a += m * w[0, i]
            b += m * w[1, i]
            c += m * w[2, i]
            d += m * w[3, i]
        part[0, j] += a
        part[1, j] += b
        part[2, j] += c
        part[3, j] += d
    if newton:
        for j in range(sizes[3]):
            a = b = c = d = 0.0
            for i in range(_BLOCK):
                m = mono[j, i]
                a += m * w[6, i]
                b += m * w[7, i]
                c += m * w[8, i]
                d += m * w[9, i]
            part[6, j] += a
            part[7, j] += b
            part[8, j] += c
            part[9, j] += d


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def residuals(
    x: FloatArray, target: FloatArray, num: FloatArray, den: FloatArray, out: FloatArray
) -> None:
    """Put r − N/D of two `target` (2, n) at `x` (3, n) into `out` (2, n)."""
    for i in range(x.shape[1]):
        u, v, w = x[0, i], x[1, i], x[2, i]
        for axis in range(2):
            top = cubic(num[axis], 0, u, v, w)
            out[axis, i] = target[axis, i] - top / cubic(den[axis], 0, u, v, w)
