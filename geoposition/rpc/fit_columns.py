"""The columns of the fit's equations, and their normal equations from moments.

Each target r is N/D = (a·(1 + q) + M) / (1 + q + c): a is the affine function nearest to r, M a
full polynomial, q the denominator's terms below the highest degree and c those of the highest.
D times the residual is linear in M, q and c,

    M − δ q − r c = δ,  δ = r − a,

and its small columns stay small: what makes RPC columns nearly dependent, r ≈ a, is gone by
algebra, so that normal equations are accurate enough. Gauss-Newton steps on the true residual
r − N/D have the same columns with N/D in the place of r.

*Source*: the linear form: Tao and Hu (2001), "A comprehensive study of the rational function
model for photogrammetric processing", eq. 7 to 9; the substitution is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.rpc.fit_basis import count, legendre, products, times_affine
from geoposition.rpc.fit_ridge import Normal, symmetric_inverse


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of one target's equations: polynomials P + δ Q (rows), and what they add to N, D.

    The parameters are M, then q, then c.
    """

    affine: FloatArray
    p: FloatArray
    q: FloatArray
    to_num: FloatArray
    to_den: FloatArray

    @classmethod
    def of(cls, affine: FloatArray, degree: int) -> Columns:
        """Columns for polynomials of `degree` and the target's `affine` part (4)."""
        basis = legendre(degree)
        size, below = count(degree), count(degree - 1)
        pad = np.zeros((size, count(degree + 1) - size))
        plain = np.concatenate([basis, pad], axis=1)
        times = times_affine(basis, affine)
        low, high = slice(1, below), slice(below, size)
        p = np.concatenate([plain, np.zeros_like(plain[low]), -times[high]])
        q = np.concatenate([np.zeros_like(basis), -basis[low], -basis[high]])
        to_num, to_den = np.zeros((20, len(p))), np.zeros((20, len(p)))
        to_num[:size, :size] = basis.T
        to_num[:size, size : size + below - 1] = times[low, :size].T
        to_den[:size, size:] = basis[1:].T
        return cls(affine, p, q, to_num, to_den)

    def ratio(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Numerator and denominator (20 each) of monomials."""
        num, den = self.to_num @ parameters, self.to_den @ parameters
        num[:4] += self.affine
        den[0] += 1.0
        return num, den

    def normal(self, sums: FloatArray, square: float, unit: float, degree: int) -> Normal:
        """Return normal equations from mean moments (5, n), in squares of `unit`."""
        top, low = count(degree + 1), count(degree)
        p, q = self.p, self.q
        across = p @ sums[1][products(top, low)] @ q.T
        gram = p @ sums[0][products(top, top)] @ p.T + across + across.T
        gram += q @ sums[2][products(low, low)] @ q.T
        right = p @ (sums[1, :top] + sums[3, :top]) + q @ (sums[2, :low] + sums[4, :low])
        whole = sums[2, 0] + 2.0 * sums[4, 0] + square
        return Normal(unit**2 * gram, unit**2 * right, float(unit**2 * whole))


def moment_sizes(degree: int) -> IntArray:
    """How many monomials each of the five weights needs."""
    return np.array([count(2 * degree + 2), count(2 * degree + 1), count(2 * degree),
                     count(degree + 1), count(degree)])  # fmt: skip


def affine_parts(x: FloatArray, target: FloatArray, weight: FloatArray) -> FloatArray:
    """Affine functions (m, 4) of `x` (3, n) nearest to the targets (m, n)."""
    terms = np.concatenate([np.ones((1, x.shape[1])), x])
    weighted = terms * weight
    gram, right = weighted @ terms.T, weighted @ target.T
    return np.ascontiguousarray((symmetric_inverse(gram) @ right).T)
