"""The graph: blocks of unknowns as variables, one factor per image set. Only door to GTSAM here.

The null-space rows of all points that the same images see are compressed by an orthogonal
transformation to as many rows as there are unknowns, and these are one factor. Points that are
wanted in the graph themselves are variables like the blocks, without a prior. GTSAM orders and
eliminates; its Bayes net gives solution and covariance. *Source*: Dellaert & Kaess 2017,
*Factor Graphs for Robot Perception*, chapters 2 and 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import GeometryError


@dataclass(frozen=True, slots=True, eq=False)
class SetFactor:
    """Cost |A z + b|² of the variables numbered `variables`, their columns side by side."""

    variables: tuple[int, ...]
    A: FloatArray
    b: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class GraphSolution:
    """Minimum `z` (p), its `covariance` (p, p), and `info_root` R with covariance (RᵀR)⁻¹."""

    z: FloatArray
    covariance: FloatArray
    info_root: FloatArray


def compressed(A: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fewest rows with the same normal equations as A (n, p), b (n): those of its triangle."""
    n, p = A.shape
    if n <= p:
        return A, b
    triangle = np.asarray(np.linalg.qr(np.column_stack([A, b]), mode="r"))
    return triangle[:p, :p], triangle[:p, p]


def solve_graph(
    sizes: Sequence[int], with_prior: Sequence[bool], factors: Sequence[SetFactor]
) -> GraphSolution:
    """Minimise the factors' costs and |z|² of the variables `with_prior`.

    `sizes` are the variables' dimensions. Variables that nothing determines are a
    `GeometryError`.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, size in enumerate(sizes):
        values.insert(key, np.zeros(size))
        if with_prior[key]:
            unit = gtsam.noiseModel.Unit.Create(size)
            graph.add(gtsam.PriorFactorVector(key, np.zeros(size), unit))
    for factor in factors:
        if len(factor.b):
            graph.add(_custom(factor, sizes))
    # Points first: each meets few blocks.
    keys = sorted(range(len(sizes)), key=lambda k: (with_prior[k], k))
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    try:
        net = graph.linearize(values).eliminateSequential(ordering)
        answer = net.optimize()
        R = np.asarray(net.matrix()[0], dtype=np.float64)
    except RuntimeError:
        raise GeometryError("adjustment: measurements and priors do not fix all unknowns") from None
    z = np.concatenate([answer.at(key) for key in range(len(sizes))]) if sizes else np.empty(0)
    if not np.all(np.isfinite(z)):
        raise GeometryError("adjustment: measurements and priors do not fix all unknowns")
    # The net's columns are in the order of elimination.
    first = np.cumsum([0, *sizes])
    place = [np.arange(first[key], first[key + 1]) for key in keys]
    R = R[:, np.argsort(np.concatenate(place))] if sizes else R
    inverse = np.linalg.inv(R) if len(R) else R
    return GraphSolution(z, inverse @ inverse.T, R)


def _custom(factor: SetFactor, sizes: Sequence[int]) -> gtsam.CustomFactor:
    ends = np.cumsum([0, *(sizes[k] for k in factor.variables)])
    parts = [
        np.asfortranarray(factor.A[:, ends[i] : ends[i + 1]]) for i in range(len(factor.variables))
    ]
    noise = gtsam.noiseModel.Unit.Create(len(factor.b))
    return gtsam.CustomFactor(noise, list(factor.variables), _error(factor, parts))


def _error(
    factor: SetFactor, parts: list[FloatArray]
) -> Callable[[gtsam.CustomFactor, gtsam.Values, list[FloatArray] | None], FloatArray]:
    def error(
        this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None
    ) -> FloatArray:
        result = factor.b.copy()
        for i, key in enumerate(factor.variables):
            result += parts[i] @ values.atVector(key)
            if jacobians is not None:
                jacobians[i] = parts[i]
        return result

    return error
