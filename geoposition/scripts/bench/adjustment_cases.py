# mypy: disable-error-code="import-not-found,import-untyped"
"""Adjustment as a case of the benchmarks: ours, SciPy, Ceres through pyceres, GTSAM.

All solve the same problem from the same residuals and analytic derivatives; only ours looks
for blunders, gives covariances and makes adjusted models too. Ceres gets the rows of each point
at each linearisation, for it cannot ask for all of them at once from Python.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.scripts.bench.adjustment import (
    MATCHES,
    SCIPY_MATCHES,
    TARGET_S,
    Problem,
    Rows,
    by_scipy,
    ours,
    problem,
)
from geoposition.scripts.bench.adjustment_gtsam import gtsam_contender
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Case, Contender, Missing
from geoposition.sensors.simulate import ARCSEC_RAD

_OURS: Final = "geoposition"
_EVERY: Final = slice(None)
_QUICK: Final = 300
_ROUNDS: Final = 2
"""Linearisations that ours needs too."""


def adjustment_cases(quick: bool = False) -> Iterator[Case]:
    """Two images and 200 control points: many matches for us alone, fewer beside the peers."""
    many = problem(_QUICK if quick else MATCHES)
    yield adjustment_case("adjust", many, MATCHES / TARGET_S / 1e6)
    few = problem(_QUICK if quick else SCIPY_MATCHES)
    scipy = Contender(
        f"SciPy {installed('scipy')}", _EVERY, partial(by_scipy, few), partial(_arcsec, few),
        "least_squares, sparse Jacobian; no covariance, no blunders",
    )  # fmt: skip
    gtsam = gtsam_contender(few, _ROUNDS, partial(_arcsec, few))
    yield adjustment_case("adjust-peers", few, None, scipy, _ceres(few), gtsam)


def adjustment_case(
    key: str, case: Problem, target_mpoint_s: float | None, *peers: Contender | Missing
) -> Case:
    """Solve `case` with everything ours comes with; `points` are the matches."""
    count = len(case.ties) // 2
    return Case(
        key=key,
        title=f"attitude biases of a pair, 200 control points and {count:,} matches",
        points=count,
        unit="arcsec",
        tolerance=0.01,
        ours=Contender(
            _OURS, _EVERY, partial(ours, case), partial(_arcsec, case),
            "with covariance, blunder search, adjusted models",
        ),
        peers=peers,
        target_mpoint_s=target_mpoint_s,
    )  # fmt: skip


def _arcsec(case: Problem, theta: Any) -> FloatArray:
    """Biases (matches, 6): what is compared is the same for every match."""
    return np.broadcast_to(np.asarray(theta) / ARCSEC_RAD, (len(case.ties) // 2, len(theta)))


def _ceres(case: Problem) -> Contender | Missing:
    version = installed("pyceres")
    name = f"Ceres (pyceres {version})" if version else "Ceres (pyceres)"
    try:
        import pyceres
    except ImportError as error:
        return Missing(name, f"not installed ({error})")

    class Point(pyceres.CostFunction):  # type: ignore[misc]
        """Rows (r, 3 + p + 1) of one point, linear about where they were made."""

        def __init__(self, row: FloatArray) -> None:
            pyceres.CostFunction.__init__(self)
            self.set_num_residuals(len(row))
            self.set_parameter_block_sizes([row.shape[1] - 4, 3])
            self.residual = row[:, -1].copy()
            self.by_bias = np.ascontiguousarray(row[:, 3:-1])
            self.by_place = np.ascontiguousarray(-row[:, :3])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            moved = self.by_bias @ parameters[0] + self.by_place @ parameters[1]
            residuals[:] = self.residual + moved
            if jacobians is not None:
                if jacobians[0] is not None:
                    jacobians[0][:] = self.by_bias.ravel()
                if jacobians[1] is not None:
                    jacobians[1][:] = self.by_place.ravel()
            return True

    class Prior(pyceres.CostFunction):  # type: ignore[misc]
        """The biases in units of their prior, `offset` (p) where the step is zero."""

        def __init__(self, offset: FloatArray) -> None:
            pyceres.CostFunction.__init__(self)
            self.set_num_residuals(len(offset))
            self.set_parameter_block_sizes([len(offset)])
            self.offset = offset.copy()

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            residuals[:] = self.offset + parameters[0]
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = np.eye(len(self.offset)).ravel()
            return True

    def step(rows: Rows, x: FloatArray) -> FloatArray:
        """Solve the problem linearised at `x`."""
        p, dx = rows.unknowns, np.zeros(rows.size)
        graph = pyceres.Problem()
        costs: list[Any] = [Prior(x[:p])]
        graph.add_residual_block(costs[0], None, [dx[:p]])
        for work, (points, first) in zip(rows.at(x), rows.places(), strict=True):
            for row, point in zip(work, points.tolist(), strict=True):
                at = first + 3 * point
                costs.append(Point(row))
                graph.add_residual_block(costs[-1], None, [dx[:p], dx[at : at + 3]])
        solver = pyceres.SolverOptions()
        solver.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
        pyceres.solve(solver, graph, pyceres.SolverSummary())
        return dx

    def run() -> FloatArray:
        rows = Rows.of(case)
        x = np.zeros(rows.size)
        for _ in range(_ROUNDS):
            x = x + step(rows, x)
        return rows.theta(x)

    note = f"SPARSE_SCHUR, {_ROUNDS} linearisations, costs in Python; no covariance"
    return Contender(name, _EVERY, run, partial(_arcsec, case), note)
