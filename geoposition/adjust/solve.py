"""Gauss-Newton: linearise, find blunders, solve the graph, until nothing moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.adjust.factors import GraphSolution, SetFactor, compressed, solve_graph
from geoposition.adjust.linear import Equations, Linear, group_columns, linearise, whitened_rows
from geoposition.adjust.point_sets import Group, PointSet, groups
from geoposition.adjust.residuals import ImageEquations
from geoposition.adjust.robust import (
    RobustOptions,
    RobustResult,
    find_blunders,
    retest,
    without_robustness,
)
from geoposition.adjust.unknowns import Block
from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.errors import ArgumentError, ConvergenceError
from geoposition.sensor_model import SensorModel

MOST_ITERATIONS: Final = 20
_STEP_SIGMA: Final = 1e-3
"""A step this small, in standard deviations of the solution itself, ends the iteration."""
_POINT_STEP_M: Final = 0.1


@dataclass(frozen=True, slots=True)
class Iteration:
    """One linearisation: `cost` before it, the step in sigmas of the solution, points used."""

    cost: float
    step_sigma: float
    used: int
    rejected: int


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Where the iteration ended: `z` in units of the prior, the graph's solution there.

    `sets`, their `groups` and `linear` equations at `z`; `used` per set and group.
    """

    z: FloatArray
    solution: GraphSolution
    robust: RobustResult
    sets: tuple[PointSet, ...]
    groups: tuple[tuple[Group, ...], ...]
    linear: tuple[tuple[Linear, ...], ...]
    history: tuple[Iteration, ...]


def equations_of(models: Sequence[SensorModel], blocks: Sequence[Block]) -> Equations:
    """Equations of all images; a block of an unknown image is an `ArgumentError`."""
    names = [name for block in blocks for name in block.names]
    if len(set(names)) != len(names):
        raise ArgumentError("adjustment: each block's name once expected")
    for block in blocks:
        for image in block.images:
            if not 0 <= image < len(models):
                raise ArgumentError(
                    f"{block.name}: image {image} is unknown, 0 .. {len(models) - 1} expected"
                )
    for image in range(len(models)):
        for kind in ("image", "mounting", "time", "look"):
            same = [b for b in blocks if b.kind == kind and image in b.images]
            if len({b.detector for b in same}) < len(same):
                given = [b.name for b in same]
                raise ArgumentError(f"image {image}: one {kind} block expected, got {given}")
    first = block_starts(blocks)
    S = np.zeros((int(first[-1]), int(first[-1])))
    for i, block in enumerate(blocks):
        S[first[i] : first[i + 1], first[i] : first[i + 1]] = block.root
    images = tuple(
        ImageEquations.of(image, model, blocks, first) for image, model in enumerate(models)
    )
    return Equations(images, S)


def block_starts(blocks: Sequence[Block]) -> IntArray:
    """First unknown of each block, and their number."""
    return np.concatenate([[0], np.cumsum([len(b) for b in blocks])]).astype(np.int64)


@dataclass(slots=True)
class Graph:
    """Linear groups at `z0` as a graph over blocks, solved for any weights of the points.

    `explicit` are rows (n, r, 3 + p + 1) of points that stay variables, each with its columns.
    """

    blocks: tuple[Block, ...]
    first: IntArray
    linear: list[Linear]
    z0: FloatArray
    explicit: list[tuple[IntArray, FloatArray]]

    def solve(self, weights: list[FloatArray]) -> GraphSolution:
        """Solution as a step from `z0`: the prior is that of z itself."""
        sizes = [len(b) for b in self.blocks]
        prior = [True] * len(sizes)
        factors = []
        for group, weight in zip(self.linear, weights, strict=True):
            kept = weight > 0.0
            if not np.any(kept) or len(group.columns) == 0:
                continue
            A, r = group.A, group.r
            if not np.all(weight == 1.0):
                root = np.sqrt(weight[kept])
                A, r = A[kept] * root[:, None, None], r[kept] * root[:, None]
            A, r = A.reshape(-1, len(group.columns)), r.reshape(-1)
            r = r - A @ self.z0[group.columns]
            factors.append(SetFactor(self._variables(group.columns), *compressed(A, r)))
        for columns, rows in self.explicit:
            for point in rows:
                A = np.column_stack([point[:, 3:-1], -point[:, :3]])
                b = point[:, -1] - point[:, 3:-1] @ self.z0[columns]
                factors.append(SetFactor((*self._variables(columns), len(sizes)), A, b))
                sizes.append(3)
                prior.append(False)
        found = solve_graph(sizes, prior, factors)
        return GraphSolution(
            found.z - _padded(self.z0, len(found.z)), found.covariance, found.info_root
        )

    def _variables(self, columns: IntArray) -> tuple[int, ...]:
        blocks = np.unique(np.searchsorted(self.first, columns, side="right") - 1)
        return tuple(int(i) for i in blocks)


def _padded(z: FloatArray, n: int) -> FloatArray:
    return np.concatenate([z, np.zeros(n - len(z))])


def solve(
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    sets: Sequence[PointSet],
    robust: RobustOptions | None,
    *,
    explicit: bool = False,
) -> Solved:
    """Iterate to the minimum.

    With `explicit` all points are variables of the graph themselves, which gives the same and
    costs more: no blunders are looked for then.

    `ConvergenceError` where twenty linearisations do not settle it.
    """
    equations, first = equations_of(models, blocks), block_starts(blocks)
    z = np.zeros(int(first[-1]))
    now = list(sets)
    history: list[Iteration] = []
    before: RobustResult | None = None
    split = [tuple(groups(points, len(models))) for points in now]
    for count in range(MOST_ITERATIONS):
        linear = [
            [linearise(equations, points, group, z) for group in several]
            for points, several in zip(now, split, strict=True)
        ]
        flat = [group for several in linear for group in several]
        roles = [points.role for points, several in zip(now, linear, strict=True) for _ in several]
        graph = Graph(tuple(blocks), first, flat, z, [])
        if explicit:
            raw = _explicit(equations, now, split, z)
            graph = Graph(tuple(blocks), first, [], z, raw)
            solution = _marginal(graph.solve([]), len(z))
            used = [group.strong for group in flat]
            found = RobustResult(solution, used, [], [], {})
        elif robust is None:
            found = without_robustness(flat, graph.solve)
        elif before is None or count < 2:
            found = find_blunders(flat, roles, graph.solve, robust)
        else:
            found = retest(flat, roles, graph.solve, before, robust)
        dz = found.solution.z
        cost = float(z @ z) + sum(
            float(np.sum(g.r[u] ** 2)) for g, u in zip(flat, found.used, strict=True)
        )
        step = float(np.linalg.norm(found.solution.info_root @ dz)) if len(dz) else 0.0
        same = before is not None and all(
            np.array_equal(a, b) for a, b in zip(before.used, found.used, strict=True)
        )
        moved = _move(now, linear, dz, models)
        z = z + dz
        total = sum(int(u.sum()) for u in found.used)
        history.append(Iteration(cost, step, total, sum(len(u) for u in found.used) - total))
        before = found
        # Gauss-Newton: what comes next is smaller than this step by what this is than the last.
        last = history[-2].step_sigma if len(history) > 1 else 0.0
        ahead = step * step / last if last > 0.0 and step < 0.1 else step
        if min(step, ahead) < _STEP_SIGMA and same and moved < _POINT_STEP_M:
            return Solved(
                z,
                found.solution,
                found,
                tuple(now),
                tuple(split),
                tuple(tuple(several) for several in linear),
                tuple(history),
            )
    raise ConvergenceError(
        f"adjustment: no convergence in {MOST_ITERATIONS} linearisations "
        f"(last step {history[-1].step_sigma:.2g} sigma)"
    )


def _move(
    sets: list[PointSet],
    linear: Sequence[Sequence[Linear]],
    dz: FloatArray,
    models: Sequence[SensorModel],
) -> float:
    """Move the sets' points to where the unknowns put them; the largest movement of used ones."""
    largest = 0.0
    for i, several in enumerate(linear):
        ecef = sets[i].ecef_m.copy()
        for part in several:
            step = part.step_m(dz)
            far = np.linalg.norm(step, axis=1)
            # A blunder may point anywhere: it is left where it is.
            ok = far < 50e3
            ecef[part.group.points[ok]] += step[ok]
            largest = max(largest, float(np.median(far[ok])) if np.any(ok) else 0.0)
        sets[i] = sets[i].moved_to(ecef, models)
    return largest


def _explicit(
    equations: Equations,
    sets: Sequence[PointSet],
    split: Sequence[Sequence[Group]],
    z: FloatArray,
) -> list[tuple[IntArray, FloatArray]]:
    theta = equations.theta(z)
    out = []
    for points, several in zip(sets, split, strict=True):
        for group in several:
            columns, _ = group_columns(equations, group)
            rows = whitened_rows(equations, points, group, slice(0, len(group.points)), theta, True)
            S = equations.S[np.ix_(columns, columns)]
            rows[:, :, 3:-1] = rows[:, :, 3:-1] @ S
            out.append((columns, rows))
    return out


def _marginal(solution: GraphSolution, n: int) -> GraphSolution:
    """Solution of the first `n` unknowns alone."""
    covariance = solution.covariance[:n, :n]
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T if n else covariance
    return GraphSolution(solution.z[:n], covariance, root)


def used_by_set(solved: Solved) -> list[list[BoolArray]]:
    """Return the flags of the robust result, per set and group."""
    out, at = [], 0
    for several in solved.linear:
        out.append(list(solved.robust.used[at : at + len(several)]))
        at += len(several)
    return out
