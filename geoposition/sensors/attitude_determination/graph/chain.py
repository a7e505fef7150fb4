"""Segments of a chain of knots: interior knots eliminated, and found again, in compiled code.

A knot is attitude and bias, x (6); constants c (p) are shared by all. A segment runs from knot a
to knot b. Its interior is eliminated from the left: what remains is one quadratic in
(x_b, x_a, c), a factor for the graph, and for each interior knot its conditional on the knot to
its right, x_a and c, from which its value and covariance follow once the graph is solved.

All quantities are in units in which a prior is about 1. *Source*: nested dissection of a banded
system; Dellaert & Kaess 2017, chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray, IntArray
from geoposition.sensors.attitude_determination.threads import in_chunks


@dataclass(frozen=True, slots=True, eq=False)
class LinearChain:
    """A linearised chain of k knots, p constants.

    Link i says phi[i] x_i + psi[i] c − x_{i+1} = misfit[i] with weight (inverse covariance)
    weight[i]; psi is (k − 1, 6, q), for the first q of the p constants. The star samples of
    knot i are the quadratic of `star_H` (k, 3 + p, 3 + p) and `star_g` (k, 3 + p) in the
    attitude and c.
    """

    phi: FloatArray
    psi: FloatArray
    weight: FloatArray
    misfit: FloatArray
    star_H: FloatArray
    star_g: FloatArray

    @property
    def constants(self) -> int:
        """Number p of shared constants."""
        return int(self.star_g.shape[1]) - 3


@dataclass(frozen=True, slots=True, eq=False)
class Eliminated:
    """Segments between the knots `bounds` (s + 1,): factors (s, n, n), (s, n), n = 12 + p.

    Their order is x_b, x_a, c. `gain` (k, 6, n), `offset` (k, 6) and `covariance` (k, 6, 6) of
    interior knots: x_i = offset − gain (x_{i+1}, x_a, c), with that covariance.
    """

    bounds: IntArray
    H: FloatArray
    g: FloatArray
    gain: FloatArray
    offset: FloatArray
    covariance: FloatArray


def eliminate(chain: LinearChain, bounds: IntArray) -> Eliminated:
    """Eliminate all knots but `bounds`; star samples at the first knot of all are left out."""
    k, n, segments = len(chain.star_g), 12 + chain.constants, len(bounds) - 1
    done = Eliminated(
        bounds,
        np.zeros((segments, n, n)),
        np.zeros((segments, n)),
        np.zeros((k, 6, n)),
        np.zeros((k, 6)),
        np.zeros((k, 6, 6)),
    )
    in_chunks(
        _eliminate,
        segments,
        chain.phi,
        chain.psi,
        chain.weight,
        chain.misfit,
        chain.star_H,
        chain.star_g,
        bounds,
        done.H,
        done.g,
        done.gain,
        done.offset,
        done.covariance,
    )
    return done


@njit(cache=True, error_model="numpy")
def invert6(matrix: FloatArray, out: FloatArray, work: FloatArray) -> None:
    """Inverse of a positive definite 6 x 6 matrix by Cholesky; `work` (2, 6, 6) is scratch."""
    low, inverse = work[0], work[1]
    for i in range(6):
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= low[i, k] * low[j, k]
            if i == j:
                low[i, i] = np.sqrt(s)
            else:
                low[i, j] = s / low[j, j]
    for j in range(6):
        for i in range(j):
            inverse[i, j] = 0.0
        inverse[j, j] = 1.0 / low[j, j]
        for i in range(j + 1, 6):
            s = 0.0
            for k in range(j, i):
                s -= low[i, k] * inverse[k, j]
            inverse[i, j] = s / low[i, i]
    for i in range(6):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, 6):
                s += inverse[k, i] * inverse[k, j]
            out[i, j] = s
            out[j, i] = s


@njit(cache=True, error_model="numpy")
def _eliminate_segment(
    segment: int,
    phi: FloatArray,
    psi: FloatArray,
    weight: FloatArray,
    misfit: FloatArray,
    star_H: FloatArray,
    star_g: FloatArray,
    bounds: IntArray,
    H: FloatArray,
    g: FloatArray,
    gain: FloatArray,
    offset: FloatArray,
    covariance: FloatArray,
) -> None:
    """Eliminate the interior of one segment from the left."""
    p = star_g.shape[1] - 3
    q = psi.shape[2]
    n = 12 + p
    total, right = np.zeros((n + 6, n + 6)), np.zeros(n + 6)
    front, rest = H[segment], g[segment]
    J, WJ = np.zeros((6, 12 + q)), np.zeros((6, 12 + q))
    place = np.zeros(12 + q, np.int64)
    work = np.zeros((2, 6, 6))
    for i in range(bounds[segment], bounds[segment + 1]):
        inside = i > bounds[segment]
        # Unknowns of `total`: x_i, x_{i+1}, x_a, c; the first x_i is x_a itself.
        for c in range(12 + q):
            place[c] = c if c < 12 else c + 6
        total[:, :] = 0.0
        right[:] = 0.0
        if inside:
            for r in range(n):
                at = r if r < 6 else r + 6
                right[at] = rest[r]
                for c in range(n):
                    total[at, c if c < 6 else c + 6] = front[r, c]
        else:
            for c in range(6):
                place[c] = 12 + c
        for r in range(6):
            for c in range(6):
                J[r, c] = phi[i, r, c]
                J[r, 6 + c] = 0.0
            J[r, 6 + r] = -1.0
            for c in range(q):
                J[r, 12 + c] = psi[i, r, c]
        for r in range(6):
            for c in range(12 + q):
                s = 0.0
                for k in range(6):
                    s += weight[i, r, k] * J[k, c]
                WJ[r, c] = s
        for r in range(12 + q):
            s = 0.0
            for k in range(6):
                s += WJ[k, r] * misfit[i, k]
            right[place[r]] += s
            for c in range(12 + q):
                s = 0.0
                for k in range(6):
                    s += J[k, r] * WJ[k, c]
                total[place[r], place[c]] += s
        if inside:
            K, h = gain[i], offset[i]
            invert6(total[:6, :6], covariance[i], work)
            for r in range(6):
                for c in range(n):
                    s = 0.0
                    for k in range(6):
                        s += covariance[i, r, k] * total[k, 6 + c]
                    K[r, c] = s
                s = 0.0
                for k in range(6):
                    s += covariance[i, r, k] * right[k]
                h[r] = s
            for r in range(n):
                for k in range(6):
                    a = total[k, 6 + r]
                    right[6 + r] -= a * h[k]
                    for c in range(n):
                        total[6 + r, 6 + c] -= a * K[k, c]
        for r in range(n):
            rest[r] = right[6 + r]
            for c in range(n):
                front[r, c] = total[6 + r, 6 + c]
        for r in range(3 + p):
            at = r if r < 3 else r + 9
            rest[at] += star_g[i + 1, r]
            for c in range(3 + p):
                front[at, c if c < 3 else c + 9] += star_H[i + 1, r, c]


@njit(cache=True, error_model="numpy", nogil=True)
def _eliminate(
    low: int,
    high: int,
    phi: FloatArray,
    psi: FloatArray,
    weight: FloatArray,
    misfit: FloatArray,
    star_H: FloatArray,
    star_g: FloatArray,
    bounds: IntArray,
    H: FloatArray,
    g: FloatArray,
    gain: FloatArray,
    offset: FloatArray,
    covariance: FloatArray,
) -> None:
    for segment in range(low, high):
        _eliminate_segment(
            segment,
            phi,
            psi,
            weight,
            misfit,
            star_H,
            star_g,
            bounds,
            H,
            g,
            gain,
            offset,
            covariance,
        )
