# mypy: disable-error-code="import-not-found,import-untyped"
"""Adjustment by GTSAM's own factors: one per point, eliminated by GTSAM, points first.

Ours eliminates the points itself, all at once, and gives GTSAM one factor for each set of images.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.scripts.bench.adjustment import Problem, Rows
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Contender, Missing


def gtsam_contender(
    case: Problem, rounds: int, result: Callable[[Any], FloatArray]
) -> Contender | Missing:
    """Solve the same equations, linearised `rounds` times."""
    version = installed("gtsam")
    name = f"GTSAM {version}" if version else "GTSAM"
    try:
        import gtsam
    except ImportError as error:
        return Missing(name, f"not installed ({error})")

    def step(rows: Rows, x: FloatArray) -> FloatArray:
        """Solve the problem linearised at `x`."""
        p, keys = rows.unknowns, gtsam.Ordering()
        graph, dx = gtsam.GaussianFactorGraph(), np.zeros(rows.size)
        of_prior = gtsam.noiseModel.Unit.Create(p)
        graph.add(gtsam.JacobianFactor(0, np.eye(p), -x[:p], of_prior))
        places: list[int] = []
        for work, (points, first) in zip(rows.at(x), rows.places(), strict=True):
            noise = gtsam.noiseModel.Unit.Create(work.shape[1])
            by_bias = np.asfortranarray(work[:, :, 3:-1])
            for n, place in enumerate((first + 3 * points).tolist()):
                graph.add(gtsam.JacobianFactor(
                    0, by_bias[n], place, -work[n, :, :3], -work[n, :, -1], noise
                ))  # fmt: skip
                keys.push_back(place)
                places.append(place)
        keys.push_back(0)
        found = graph.optimize(keys)
        dx[:p] = found.at(0)
        for place in places:
            dx[place : place + 3] = found.at(place)
        return dx

    def run() -> FloatArray:
        rows = Rows.of(case)
        x = np.zeros(rows.size)
        for _ in range(rounds):
            x = x + step(rows, x)
        return rows.theta(x)

    note = f"a JacobianFactor each, points first, {rounds} linearisations; no covariance"
    return Contender(name, slice(None), run, result, note)
