"""Blunders found: graduated non-convexity with truncated least squares, then a test of each point.

Graduated non-convexity starts from plain least squares and makes the cost of large residuals
flatter step by step, until each point either counts fully or not at all. It needs no start, and
stands well over 20 % of gross errors. Then every point is tested against the solution without
the blunders, with the covariance its residual really has, and taken in or left out until nothing
changes. *Source*: Yang, Antonante, Tzoumas & Carlone 2020, *Graduated non-convexity for robust
spatial perception*, IEEE RA-L 5(2), eqs. (13)-(15).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from geoposition.adjust.factors import GraphSolution
from geoposition.adjust.linear import Linear
from geoposition.arrays import BoolArray, FloatArray

_LEAST_EIGENVALUE: Final = 1e-6
_MOST_LEVERAGE: Final = 0.9
_MOST_GRADUATIONS: Final = 200
_MOST_RETESTS: Final = 12
_SLOW_UP_TO: Final = 5000
"""Points up to which the graduation takes its time."""

Solve = Callable[[list[FloatArray]], GraphSolution]


@dataclass(frozen=True, slots=True)
class RobustOptions:
    """How blunders are told from noise.

    A point is a blunder if a good one would show such a residual in one adjustment of
    1/`family_risk` only. `adapt` widens that where the stated noise turns out too small for the
    bulk of the points, role by role.
    """

    family_risk: float = 1e-4
    adapt: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class RobustResult:
    """Solution, `used` (n) per group, and each point's test: `statistic` (n) and `limit` (n).

    `scale` by role is how many times the stated noise the bulk of the points shows (1 where it
    fits or is less).
    """

    solution: GraphSolution
    used: list[BoolArray]
    statistic: list[FloatArray]
    limit: list[FloatArray]
    scale: dict[str, float]


def without_robustness(groups: Sequence[Linear], solve: Solve) -> RobustResult:
    """Least squares of all points; their statistics all the same."""
    used = [group.strong.copy() for group in groups]
    solution = solve([u.astype(np.float64) for u in used])
    statistic = statistics(groups, solution, used)
    limit = [np.full(len(group.r), np.inf) for group in groups]
    return RobustResult(solution, used, statistic, limit, {})


def find_blunders(
    groups: Sequence[Linear], roles: Sequence[str], solve: Solve, o: RobustOptions
) -> RobustResult:
    """Solve with the blunders among the points left out; `roles` (per group) share a scale."""
    strong = [group.strong for group in groups]
    weights = [s.astype(np.float64) for s in strong]
    count = max(sum(int(s.sum()) for s in strong), 1)
    limit = [np.full(len(g.r), chi2.isf(o.family_risk / count, g.r.shape[1])) for g in groups]
    scale = dict.fromkeys(roles, 1.0)
    weights, solution = _graduated(groups, weights, limit, solve)
    used = [w > 0.5 for w in weights]
    if o.adapt:
        scale = _scales(groups, roles, statistics(groups, solution, used))
        if max(scale.values(), default=1.0) > 1.0:
            limit = [lim * scale[role] ** 2 for lim, role in zip(limit, roles, strict=True)]
            start = [s.astype(np.float64) for s in strong]
            weights, solution = _graduated(groups, start, limit, solve)
            used = [w > 0.5 for w in weights]
    return _retested(groups, roles, solve, RobustResult(solution, used, [], limit, scale), o)


def retest(
    groups: Sequence[Linear],
    roles: Sequence[str],
    solve: Solve,
    before: RobustResult,
    o: RobustOptions,
) -> RobustResult:
    """Solve anew at another linearisation, starting from the blunders found before."""
    return _retested(groups, roles, solve, before, o)


def _retested(
    groups: Sequence[Linear],
    roles: Sequence[str],
    solve: Solve,
    start: RobustResult,
    o: RobustOptions,
) -> RobustResult:
    used, limit, scale = start.used, start.limit, start.scale
    count = max(sum(int(group.strong.sum()) for group in groups), 1)
    solution, statistic = start.solution, start.statistic
    for _ in range(_MOST_RETESTS):
        solution = solve([u.astype(np.float64) for u in used])
        statistic = statistics(groups, solution, used)
        if o.adapt:
            scale = _scales(groups, roles, statistic)
            limit = [
                np.full(len(g.r), chi2.isf(o.family_risk / count, g.r.shape[1]) * scale[role] ** 2)
                for g, role in zip(groups, roles, strict=True)
            ]
        now = [g.strong & (s <= lim) for g, s, lim in zip(groups, statistic, limit, strict=True)]
        same = all(np.array_equal(a, b) for a, b in zip(now, used, strict=True))
        used = now
        if same:
            break
    return RobustResult(solution, used, statistic, limit, scale)


def statistics(
    groups: Sequence[Linear], solution: GraphSolution, used: Sequence[BoolArray]
) -> list[FloatArray]:
    """Chi-square of each point, with the covariance of its own residual.

    I − A C Aᵀ for points the solution rests on, I + A C Aᵀ for the others; a direction without
    redundancy says nothing and is left out. The solution's z is a step from where the groups
    were linearised.
    """
    return [
        _chi_square(g, g.r + g.A @ solution.z[g.columns], solution.covariance, u)
        for g, u in zip(groups, used, strict=True)
    ]


def _chi_square(
    group: Linear, residual: FloatArray, covariance: FloatArray, used: BoolArray
) -> FloatArray:
    some = covariance[np.ix_(group.columns, group.columns)]
    sign = np.where(used, -1.0, 1.0)
    q = residual.shape[1]
    if q == 1:
        row = group.A[:, 0]
        v = 1.0 + sign * np.sum((row @ some) * row, axis=1)
        ok = v > _LEAST_EIGENVALUE
        return np.where(ok, residual[:, 0] ** 2 / np.where(ok, v, 1.0), 0.0)
    shown = (group.A @ some) @ group.A.transpose(0, 2, 1)
    own = np.eye(q) + sign[:, None, None] * shown
    # Far from singular, as nearly all are, the plain way is much the faster.
    plain = ~used | (np.trace(shown, axis1=1, axis2=2) < _MOST_LEVERAGE)
    out = np.empty(len(residual))
    solved = np.linalg.solve(own[plain], residual[plain][..., None])[..., 0]
    out[plain] = np.sum(residual[plain] * solved, axis=1)
    if not np.all(plain):
        values, vectors = np.linalg.eigh(own[~plain])
        parts = np.einsum("nqk,nq->nk", vectors, residual[~plain])
        ok = values > _LEAST_EIGENVALUE
        out[~plain] = np.sum(np.where(ok, parts**2 / np.where(ok, values, 1.0), 0.0), axis=1)
    return out


def redundancy(
    groups: Sequence[Linear], covariance: FloatArray, used: Sequence[BoolArray]
) -> list[FloatArray]:
    """Each point's part in the redundancy, 0 .. q; 0 for points left out."""
    out = []
    for g, u in zip(groups, used, strict=True):
        some = covariance[np.ix_(g.columns, g.columns)]
        flat = g.A.reshape(-1, len(g.columns))
        taken = np.sum((flat @ some) * flat, axis=1).reshape(len(g.r), -1).sum(axis=1)
        out.append(np.where(u, g.r.shape[1] - taken, 0.0))
    return out


def _scales(
    groups: Sequence[Linear],
    roles: Sequence[str],
    tested: Sequence[FloatArray],
) -> dict[str, float]:
    """How many times the stated noise the median point of each role shows, at least 1."""
    out = {}
    for role in dict.fromkeys(roles):
        ratio = [
            t[g.strong] / chi2.median(g.r.shape[1])
            for g, t, r in zip(groups, tested, roles, strict=True)
            if r == role
        ]
        every = np.concatenate(ratio) if ratio else np.empty(0)
        # A handful's median strays on its own: only what it cannot explain counts.
        spare = 1.0 + 3.0 / np.sqrt(max(len(every), 1))
        value = float(np.sqrt(np.median(every))) if len(every) else 1.0
        out[role] = value if value > spare else 1.0
    return out


def _graduated(
    groups: Sequence[Linear],
    weights: list[FloatArray],
    limit: Sequence[FloatArray],
    solve: Solve,
) -> tuple[list[FloatArray], GraphSolution]:
    """Graduated non-convexity; final weights are 0 or 1."""
    first = weights
    solution = solve(weights)
    ratio = _ratios(groups, solution, limit)
    worst = max((float(r[w > 0].max(initial=0.0)) for r, w in zip(ratio, first, strict=True)))
    if worst <= 1.0:
        return weights, solution
    count = sum(len(r) for r in ratio)
    factor = 1.4 if count <= _SLOW_UP_TO else 3.0
    mu = 1.0 / max(2.0 * worst - 1.0, 1e-12)
    for _ in range(_MOST_GRADUATIONS):
        weights = [
            np.where(f > 0.0, _weights(r, mu), 0.0) for f, r in zip(first, ratio, strict=True)
        ]
        solution = solve(weights)
        ratio = _ratios(groups, solution, limit)
        if all(np.all((w < 1e-6) | (w > 1.0 - 1e-6)) for w in weights):
            break
        mu *= factor
    return [np.where(w > 0.5, 1.0, 0.0) for w in weights], solution


def _weights(ratio: FloatArray, mu: float) -> FloatArray:
    """Weights of squared residuals over their limit, at the control parameter `mu`."""
    between = np.sqrt(mu * (mu + 1.0) / np.maximum(ratio, 1e-300)) - mu
    return np.where(ratio >= (mu + 1.0) / mu, 0.0, np.where(ratio <= mu / (mu + 1.0), 1.0, between))


def _ratios(
    groups: Sequence[Linear], solution: GraphSolution, limit: Sequence[FloatArray]
) -> list[FloatArray]:
    return [
        np.sum((g.r + g.A @ solution.z[g.columns]) ** 2, axis=1) / lim
        for g, lim in zip(groups, limit, strict=True)
    ]
