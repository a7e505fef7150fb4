"""Interpolation that the USGS CSM line scanner prescribes: Lagrange on equal steps.

*Source.* usgscsm (public domain, DOI-USGS), `lagrangeInterp`: the stencil is centred, of order 8
(4 for airborne platforms), and narrows to 6, 4 and 2 nodes towards the ends of the table, unlike
`LagrangeCurve`, which keeps its order and pushes the stencil inwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, IntArray, read_only, require_finite
from geoposition.errors import ArgumentError
from geoposition.interpolation import within_span


@dataclass(frozen=True, slots=True)
class CsmLagrangeCurve:
    """Lagrange curve through `values` (n, k) at `start_s` + i × `step_s`, n >= 2.

    `order` is the number of nodes of the widest stencil, 8 or 4. Never extrapolates.
    """

    start_s: float
    step_s: float
    values: FloatArray
    order: int = 8

    def __post_init__(self) -> None:
        values = require_finite(read_only(self.values), "samples")
        if values.ndim != 2 or len(values) < 2:
            raise ArgumentError(f"samples: 2 or more rows expected, got shape {values.shape}")
        if not (np.isfinite(self.start_s) and np.isfinite(self.step_s) and self.step_s > 0):
            raise ArgumentError("samples: a finite start and a positive step expected")
        if self.order not in (4, 8):
            raise ArgumentError(f"Lagrange order: 4 or 8 expected, got {self.order}")
        object.__setattr__(self, "values", values)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last sample time."""
        return self.start_s, self.start_s + self.step_s * (len(self.values) - 1)

    @property
    def knots_s(self) -> FloatArray:
        """The sample times: there the stencil moves on."""
        times: FloatArray = self.start_s + self.step_s * np.arange(len(self.values), dtype=float)
        return times

    def value(self, times_s: ArrayLike) -> FloatArray:
        """Values (..., k) at `times_s` (...)."""
        return self._weighted(times_s, _weights)

    def rate(self, times_s: ArrayLike) -> FloatArray:
        """First derivatives (..., k), per second, at `times_s` (...)."""
        return self._weighted(times_s, _rate_weights) / self.step_s

    def _weighted(
        self, times_s: ArrayLike, weights: Callable[[FloatArray, IntArray], FloatArray]
    ) -> FloatArray:
        times = within_span(times_s, self.span_s, "interpolation")
        shape, n = times.shape, len(self.values)
        cell = (times.ravel() - self.start_s) / self.step_s
        index = np.clip(cell.astype(np.int64), 0, n - 2)
        tau = cell - index
        half = np.clip(np.minimum(index + 1, n - 1 - index), 1, self.order // 2)
        result = np.empty((len(index), self.values.shape[1]))
        for width in np.unique(half):
            here = half == width
            nodes = np.arange(1 - width, width + 1)
            rows = self.values[index[here, None] + nodes]
            result[here] = np.einsum("nm,nmk->nk", weights(tau[here], nodes), rows)
        return result.reshape(*shape, self.values.shape[1])


def _weights(tau: FloatArray, nodes: IntArray) -> FloatArray:
    """Lagrange weights (n, m) at `tau` (n,), in steps from node 0."""
    weights = np.ones((len(tau), len(nodes)))
    for j, node in enumerate(nodes):
        for other in nodes[nodes != node]:
            weights[:, j] *= (tau - other) / (node - other)
    return weights


def _rate_weights(tau: FloatArray, nodes: IntArray) -> FloatArray:
    """Compute derivatives (n, m) of the Lagrange weights, per step."""
    weights = np.zeros((len(tau), len(nodes)))
    for j, node in enumerate(nodes):
        others = nodes[nodes != node]
        for skipped in others:
            term = np.full(len(tau), 1.0 / (node - skipped))
            for other in others[others != skipped]:
                term *= (tau - other) / (node - other)
            weights[:, j] += term
    return weights
