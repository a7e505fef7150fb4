"""Two ratios of cubics through points: linear start, Gauss-Newton steps, uncertainty.

Three rules keep coefficients tame. The damping of what the points do not determine is chosen
from the data (`fit_ridge`). A denominator that still leaves `SOUND` at some point is damped more.
And where a residual remains that the ratio cannot follow, points are reweighted by it a few
times (Lawson's step), which trades a little of the mean square for a much smaller maximum.

*Source*: reweighting: Rice and Usow (1968), "The Lawson algorithm and extensions", eq. 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.errors import GeometryError
from geoposition.rpc.fit_basis import count, monomials, recipe
from geoposition.rpc.fit_columns import Columns, affine_parts, moment_sizes
from geoposition.rpc.fit_kernels import moments, residuals
from geoposition.rpc.fit_ridge import Damped

Denominators = Literal["separate", "equal"]

SOUND: Final = (0.8, 1.25)
"""Denominators stay within this range of their mean where the points are."""

_STEPS = 5
_SETTLED = 1e-4
_REWEIGHTS = 4
_LEAST_WEIGHT = 0.05
_WORTH = 100.0
_FIRMER = 4.0
_TINY = 1e-300
_STRONGEST = 1e9


@dataclass(frozen=True, slots=True)
class Ratios:
    """Two ratios of cubics in x: `num` and `den` (2, 20), of monomials in RPC00B order.

    `strength` (2) is the damping chosen, `den_range` (2, 2) holds each denominator's extremes
    at the points, `residual` (2, n) is what is left, in targets, `effective` (2) the number of
    parameters that the points determine. `covariance` (2, 40, 40) is of (num, den). `leverage`
    (2, n) is how much of its own error each point takes, where numerators were damped.
    """

    num: FloatArray
    den: FloatArray
    strength: FloatArray
    den_range: FloatArray
    residual: FloatArray
    effective: FloatArray
    covariance: FloatArray
    leverage: FloatArray | None


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How to fit: see `fit_model`. `floor` is a residual, in units, of no importance.

    `damp_numerators` damps numerators beyond their affine part, too: for few points, with
    errors. No damping is below `least_strength`.
    """

    degree: int = 3
    denominators: Denominators = "separate"
    floor: float = 1e-5
    damp_numerators: bool = False
    least_strength: float = 0.0
    minimise_maximum: bool = True


def fit_ratios(
    x: FloatArray,
    target: FloatArray,
    unit: FloatArray,
    options: FitOptions,
    weight: FloatArray | None = None,
) -> Ratios:
    """Fit two targets (2, n) as ratios of polynomials in `x` (3, n), which is within ±1.

    `unit` (2) is what 1 is worth in each target; `weight` (n) weights the points' squares. A
    `GeometryError` where no sound ratio follows the points.
    """
    given = np.ones(x.shape[1]) if weight is None else weight / weight.mean()
    fit = _Fit(x, target, unit, options, given)
    weights = np.stack([given, given])
    fit.iterate(weights)
    while fit.unsound().any():
        if fit.strength[fit.unsound()].min() > _STRONGEST:
            raise GeometryError("RPC fit: no denominator without zeros follows the points")
        fit.least = np.where(fit.unsound(), 10.0 * fit.strength, fit.least)
        fit.restart()
        fit.iterate(weights)
    if options.minimise_maximum:
        fit.reweight(weights)
    return fit.result(weights)


class _Fit:
    """State of one fit: ratios, their damping, the denominators' extremes."""

    def __init__(
        self,
        x: FloatArray,
        target: FloatArray,
        unit: FloatArray,
        options: FitOptions,
        weight: FloatArray,
    ):
        degree = options.degree
        self.x, self.target, self.unit, self.options = x, target, unit, options
        self.affine = affine_parts(x, target, weight)
        self.columns = [Columns.of(a, degree) for a in self.affine]
        self.systems = _systems(
            count(degree), len(self.columns[0].p), options.denominators == "equal"
        )
        self.free = np.zeros(len(self.columns[0].p), dtype=bool)
        self.free[: count(1 if options.damp_numerators else degree)] = True
        self.least = np.full(2, options.least_strength)
        self.strength = np.zeros(2)
        self.den_range = np.ones((2, 2))
        self.restart()

    def restart(self) -> None:
        """Forget the ratios: steps from unsound ones lead nowhere."""
        self.num, self.den = np.zeros((2, 20)), np.zeros((2, 20))
        self.den[:, 0] = 1.0
        self.started = False
        self.settled: list[Damped] | None = None

    def damped(self, weights: FloatArray) -> list[Damped]:
        """Systems of equations around the present ratios."""
        degree = self.options.degree
        sums, squares, self.den_range = moments(
            self.x, self.target, weights, self.affine, self.num, self.den, self.started,
            *recipe(), moment_sizes(degree),
        )  # fmt: skip
        total = weights.sum(axis=1)
        normal = [
            self.columns[i].normal(sums[i] / total[i], squares[i] / total[i], unit, degree)
            for i, unit in enumerate(self.unit)
        ]
        rows = self.x.shape[1]
        return [
            Damped.of([normal[i] for i in system], list(system.values()), self.free, rows)
            for system in self.systems
        ]

    def iterate(self, weights: FloatArray) -> None:
        """Take a linear step from nothing, then Gauss-Newton steps; choose the damping."""
        for _ in range(_STEPS):
            before = self.den.copy()
            systems = self.damped(weights)
            for system, damped in zip(self.systems, systems, strict=True):
                targets = list(system)
                least = float(self.least[targets].max())
                self.strength[targets] = damped.strength(self.options.floor, least)
            self.step(systems)
            if self.started and np.abs(self.den - before).max() < _SETTLED:
                self.settled = systems
                return
            self.started = True

    def step(self, systems: list[Damped]) -> None:
        """Replace the ratios by the solution of `systems`."""
        for system, damped in zip(self.systems, systems, strict=True):
            found = damped.solve(float(self.strength[next(iter(system))]))
            for i, places in system.items():
                self.num[i], self.den[i] = self.columns[i].ratio(found[places])
        if not (np.all(np.isfinite(self.num)) and np.all(np.isfinite(self.den))):
            raise GeometryError("RPC fit: the points determine no ratio of polynomials")

    def unsound(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Tell which denominators leave the sound range at some point."""
        values = np.array([self.den_range[:, 0].min(), self.den_range[:, 1].max()])
        low, high = self.den_range.T
        if self.options.denominators == "equal":
            low, high = np.full(2, values[0]), np.full(2, values[1])
        result: np.ndarray[tuple[int], np.dtype[np.bool_]] = ~(
            (low >= SOUND[0]) & (high <= SOUND[1])
        )
        return result

    def residual(self) -> FloatArray:
        out = np.empty(self.target.shape)
        residuals(self.x, self.target, self.num, self.den, out)
        return out

    def reweight(self, weights: FloatArray) -> None:
        """Reweight by the residual, and keep the ratios with the least maximum times rms."""
        residual = self.residual()
        best, least = (self.num.copy(), self.den.copy()), self._score(residual, weights)
        if not np.any(np.abs(residual).max(axis=1) * self.unit > _WORTH * self.options.floor):
            return
        changed = weights.copy()
        for _ in range(_REWEIGHTS + 1):
            size = np.abs(residual)
            size /= np.sqrt((weights * size**2).mean(axis=1, keepdims=True)) + _TINY
            changed *= size + _LEAST_WEIGHT
            changed /= changed.mean(axis=1, keepdims=True)
            systems = self.damped(changed)
            score = np.where(self.unsound(), np.inf, self._score(residual, weights))
            for i in np.flatnonzero(score < least):
                best[0][i], best[1][i], least[i] = self.num[i], self.den[i], score[i]
            self.strength[self.unsound()] *= _FIRMER
            self.step(systems)
            residual = self.residual()
        self.num, self.den = best
        self.settled = None

    def _score(self, residual: FloatArray, weight: FloatArray) -> FloatArray:
        score = np.abs(residual).max(axis=1) * np.sqrt((weight * residual**2).mean(axis=1))
        score *= self.unit**2
        if self.options.denominators == "equal":
            score[:] = score.sum()
        return np.asarray(score)

    def result(self, weights: FloatArray) -> Ratios:
        """Ratios as they are, with their uncertainty."""
        # Where the steps have come to rest, the last equations are those of the result.
        systems = self.damped(weights) if self.settled is None else self.settled
        residual = self.residual()
        square = (weights * residual**2).mean(axis=1) * self.unit**2
        effective, covariance = np.zeros(2), np.zeros((2, 40, 40))
        leverage = np.zeros(self.target.shape) if self.options.damp_numerators else None
        for system, damped in zip(self.systems, systems, strict=True):
            targets = list(system)
            strength = float(self.strength[targets[0]])
            # Over all targets of the system: its equations are theirs together.
            whole = damped.covariance(strength, float(square[targets].sum()))
            for i, places in system.items():
                effective[i] = damped.used(strength) / len(system)
                to = np.concatenate([self.columns[i].to_num, self.columns[i].to_den])
                covariance[i] = to @ whole[np.ix_(places, places)] @ to.T
                if leverage is not None:
                    inverse = damped.damped_inverse(strength)[np.ix_(places, places)]
                    rows = self.unit[i] * self._rows(i)
                    share = weights[i] / weights[i].sum()
                    leverage[i] = share * np.sum((rows @ inverse) * rows, axis=1)
        return Ratios(
            self.num, self.den, self.strength, self.den_range, residual, effective, covariance,
            leverage,
        )  # fmt: skip

    def _rows(self, i: int) -> FloatArray:
        """Columns of the equations of one target at the points, (n, k)."""
        terms = monomials(self.x, max(self.options.degree + 1, 3))
        ratio = (self.num[i] @ terms[:20]) / (self.den[i] @ terms[:20])
        delta = ratio - self.affine[i] @ terms[:4]
        columns = self.columns[i]
        low = terms[: columns.q.shape[1]]
        rows = columns.p @ terms[: columns.p.shape[1]] + delta * (columns.q @ low)
        result: FloatArray = (rows / (self.den[i] @ terms[:20])).T
        return result


def _systems(numerators: int, size: int, equal: bool) -> list[dict[int, IntArray]]:
    """Systems to solve: for each of their targets, the places of its parameters."""
    if not equal:
        return [{0: np.arange(size)}, {1: np.arange(size)}]
    shared, own = np.arange(2 * numerators, numerators + size), np.arange(numerators)
    return [{i: np.concatenate([own + i * numerators, shared]) for i in range(2)}]
