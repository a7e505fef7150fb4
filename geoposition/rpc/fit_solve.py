"""Two ratios of cubics through points: linear start, Gauss-Newton steps, uncertainty.

Each target r is N/D = (a·(1 + q) + M) / (1 + q + c): a is the affine function nearest to r, M a
full cubic, q the denominator's terms below the highest degree and c those of the highest.
D times the residual is linear in M, q and c,

    M − δ q − r c = δ,  δ = r − a,

and its small columns stay small: what makes RPC columns nearly dependent, r ≈ a, is gone by
algebra, so that normal equations are accurate enough. Gauss-Newton steps on the true residual
r − N/D have the same columns with N/D in the place of r.

*Source*: linear start: Tao and Hu (2001), "A comprehensive study of the rational function model
for photogrammetric processing", eq. 7 to 9; the substitution is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.errors import GeometryError
from geoposition.rpc.fit_basis import count, legendre, products, recipe, times_affine
from geoposition.rpc.fit_kernels import moments
from geoposition.rpc.fit_ridge import Damped, Normal, symmetric_inverse

Denominators = Literal["separate", "equal"]

_STEPS = 3


@dataclass(frozen=True, slots=True)
class Ratios:
    """Two ratios of cubics in x: `num` and `den` (2, 20), of monomials in RPC00B order.

    `strength` (2) is the damping chosen, `den_range` (2, 2) holds each denominator's extremes
    at the points, `rms` (2) the residual in targets, `effective` (2) the number of parameters
    that the points determine. `covariance` (2, 40, 40) is of (num, den).
    """

    num: FloatArray
    den: FloatArray
    strength: FloatArray
    den_range: FloatArray
    rms: FloatArray
    effective: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class _Columns:
    """Columns of one target's equations: polynomials P + δ Q (rows), and what they add to N, D."""

    p: FloatArray
    q: FloatArray
    to_num: FloatArray
    to_den: FloatArray


def fit_ratios(
    x: FloatArray,
    target: FloatArray,
    unit: FloatArray,
    floor: float,
    degree: int = 3,
    denominators: Denominators = "separate",
    weight: FloatArray | None = None,
    damp_numerators: bool = False,
    least_strength: float = 0.0,
) -> Ratios:
    """Fit two targets (2, n) as ratios of polynomials of `degree` in `x` (3, n) within ±1.

    Parameters
    ----------
    unit
        What 1 is worth in each target, (2).
    floor
        Root-mean-square residual, in that unit, that is not worth a larger coefficient.
    weight
        Weights (n) of the points' squares.
    damp_numerators
        Damp the numerators beyond their affine part, too: for few points, with errors.
    least_strength
        The least damping to be chosen.
    """
    n = x.shape[1]
    weight = np.ones((2, n)) if weight is None else np.tile(weight, (2, 1))
    affine = _affine(x, target, weight)
    columns = [_columns(a, degree) for a in affine]
    maps = _maps(count(degree), len(columns[0].p), denominators)
    free = np.zeros(len(columns[0].p), dtype=bool)
    free[: count(1) if damp_numerators else count(degree)] = True
    total = weight.sum(axis=1)
    sizes = np.array([count(2 * degree + 2), count(2 * degree + 1), count(2 * degree),
                      count(degree + 1), count(degree)])  # fmt: skip
    num, den, strength = np.zeros((2, 20)), np.zeros((2, 20)), np.zeros(2)
    den[:, 0] = 1.0
    for step in range(_STEPS + 1):
        sums, squares, den_range = moments(
            x, target, weight, affine, num, den, step > 0, *recipe(), sizes
        )
        normal = [
            _normal(columns[i], sums[i] / total[i], squares[i] / total[i], unit[i], degree)
            for i in range(2)
        ]
        if step == _STEPS:
            break
        for group in maps:
            system = Damped.of([normal[i] for i in group], list(group.values()), free, n)
            strength[list(group)] = chosen = system.strength(floor, least_strength)
            found = system.solve(chosen)
            for i, places in group.items():
                num[i] = columns[i].to_num @ found[places]
                num[i, :4] += affine[i]
                den[i] = columns[i].to_den @ found[places]
                den[i, 0] += 1.0
        if not (np.all(np.isfinite(num)) and np.all(np.isfinite(den))):
            raise GeometryError("RPC fit: the points determine no ratio of polynomials")
    effective, covariance = np.zeros(2), np.zeros((2, 40, 40))
    for group in maps:
        system = Damped.of([normal[i] for i in group], list(group.values()), free, n)
        mean_square = sum(squares[i] / total[i] * unit[i] ** 2 for i in group)
        used, whole = system.covariance(float(strength[next(iter(group))]), mean_square)
        for i, places in group.items():
            effective[i] = used / len(group)
            to = np.concatenate([columns[i].to_num, columns[i].to_den])
            covariance[i] = to @ whole[np.ix_(places, places)] @ to.T
    return Ratios(num, den, strength, den_range, np.sqrt(squares / total), effective, covariance)


def _maps(numerators: int, size: int, denominators: Denominators) -> list[dict[int, IntArray]]:
    """Systems to solve: for each of their targets, the places of its parameters."""
    if denominators == "separate":
        return [{0: np.arange(size)}, {1: np.arange(size)}]
    shared = np.arange(2 * numerators, numerators + size)
    own = np.arange(numerators)
    return [{i: np.concatenate([own + i * numerators, shared]) for i in range(2)}]


def _affine(x: FloatArray, target: FloatArray, weight: FloatArray) -> FloatArray:
    """Affine functions (2, 4) nearest to the targets."""
    terms = np.concatenate([np.ones((1, x.shape[1])), x])
    weighted = terms * weight[0]
    gram, right = weighted @ terms.T, weighted @ target.T
    result: FloatArray = (symmetric_inverse(gram) @ right).T
    return np.ascontiguousarray(result)


def _columns(affine: FloatArray, degree: int) -> _Columns:
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
    return _Columns(p, q, to_num, to_den)


def _normal(
    columns: _Columns, sums: FloatArray, square: float, unit: float, degree: int
) -> Normal:
    """Normal equations of one target from its mean moments (5, n), in units."""
    top, low = count(degree + 1), count(degree)
    p, q = columns.p, columns.q
    across = p @ sums[1][products(top, low)] @ q.T
    gram = p @ sums[0][products(top, top)] @ p.T + across + across.T
    gram += q @ sums[2][products(low, low)] @ q.T
    right = p @ (sums[1, :top] + sums[3, :top]) + q @ (sums[2, :low] + sums[4, :low])
    whole = sums[2, 0] + 2.0 * sums[4, 0] + square
    return Normal(unit**2 * gram, unit**2 * right, float(unit**2 * whole))
