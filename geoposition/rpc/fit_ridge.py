"""Damped normal equations, with the damping chosen from the data.

Parameters are free or damped. Free ones are eliminated; one eigendecomposition of what is left
then gives residual and solution for every strength at once. The strength is the largest whose
generalised cross-validation score is, within a slack and a floor, as good as the best: where
the data do not need a coefficient, it stays small.

*Source*: Golub, Heath, Wahba (1979), "Generalized cross-validation as a method for choosing a
good ridge parameter", eq. 1.3 and 2.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geoposition.arrays import BoolArray, FloatArray, IntArray

_STRENGTHS = np.logspace(-14, 10, 145)
_SLACK = 1.001
_SINGULAR = 1e-13


@dataclass(frozen=True, slots=True)
class Normal:
    """Mean normal equations: `gram` (k, k), `right` (k), and the mean `square` to explain."""

    gram: FloatArray
    right: FloatArray
    square: float


@dataclass(frozen=True, slots=True)
class Damped:
    """One system in eigenvectors of its damped parameters, the free ones eliminated.

    `values` (d) and `vectors` (d, d) decompose the reduced matrix, `right` (d) is the reduced
    right side in eigenvectors, `square` what remains without damped parameters. `lift` gives
    the free parameters: lift[:, -1] − lift[:, :-1] damped; `inverse` is that of the free block.
    `rows` counts the equations.
    """

    gram: FloatArray
    free: BoolArray
    values: FloatArray
    vectors: FloatArray
    right: FloatArray
    square: float
    lift: FloatArray
    inverse: FloatArray
    rows: int

    @classmethod
    def of(
        cls, normals: Sequence[Normal], places: Sequence[IntArray], free: BoolArray, points: int
    ) -> Damped:
        """System of `normals`, whose parameters have `places` in it; `free` tells of one's."""
        size = 1 + max(int(p[-1]) for p in places)
        gram, right = np.zeros((size, size)), np.zeros(size)
        is_free = np.zeros(size, dtype=bool)
        for normal, place in zip(normals, places, strict=True):
            gram[np.ix_(place, place)] += normal.gram
            right[place] += normal.right
            is_free[place[free]] = True
        inverse = symmetric_inverse(gram[np.ix_(is_free, is_free)])
        across = gram[np.ix_(is_free, ~is_free)]
        lift = inverse @ np.column_stack([across, right[is_free]])
        reduced = gram[np.ix_(~is_free, ~is_free)] - across.T @ lift[:, :-1]
        values, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
        rest = vectors.T @ (right[~is_free] - across.T @ lift[:, -1])
        square = sum(normal.square for normal in normals) - float(right[is_free] @ lift[:, -1])
        return cls(
            gram, is_free, np.maximum(values, 0.0), vectors, rest, max(square, 0.0), lift,
            inverse, points * len(normals),
        )  # fmt: skip

    def strength(self, floor: float, least: float) -> float:
        """Damping chosen from the data; `floor` is a residual that does not matter."""
        tried = _STRENGTHS[least < _STRENGTHS]
        if not tried.size:
            return float(_STRENGTHS[-1])
        kept = self.values / (self.values + tried[:, None])
        # What a damped parameter leaves: its whole gain, times the square of what is cut off.
        gain = self.right**2 / np.where(self.values > 0.0, self.values, np.inf)
        left = self.square - gain.sum() + ((1.0 - kept) ** 2 * gain).sum(axis=1)
        left = np.maximum(left, 1e-15 * self.square)
        freedom = self.rows - (self.free.sum() + kept.sum(axis=1))
        # Few points: the score means nothing where the parameters nearly interpolate them.
        sound = freedom >= min(0.5 * self.rows, freedom[-1])
        score = np.where(sound, np.sqrt(left) * self.rows / np.maximum(freedom, 1e-3), np.inf)
        good = score <= _SLACK * score.min() + floor
        return float(tried[np.flatnonzero(good)[-1]])

    def solve(self, strength: float) -> FloatArray:
        """All parameters, with this damping."""
        damped = self.vectors @ (self.right / (self.values + strength))
        out = np.empty(len(self.free))
        out[~self.free] = damped
        out[self.free] = self.lift[:, -1] - self.lift[:, :-1] @ damped
        return out

    def used(self, strength: float) -> float:
        """Effective number of parameters with this damping."""
        return float(self.free.sum() + (self.values / (self.values + strength)).sum())

    def covariance(self, strength: float, mean_square: float) -> FloatArray:
        """Covariance of all parameters for a mean squared residual of one equation."""
        variance = mean_square / max(self.rows - self.used(strength), 1.0)
        inverse = self.damped_inverse(strength)
        result: FloatArray = variance * inverse @ self.gram @ inverse
        return result

    def damped_inverse(self, strength: float) -> FloatArray:
        """Inverse of the whole damped matrix."""
        lift = self.lift[:, :-1]
        damped = (self.vectors / (self.values + strength)) @ self.vectors.T
        inverse = np.empty_like(self.gram)
        inverse[np.ix_(~self.free, ~self.free)] = damped
        inverse[np.ix_(self.free, ~self.free)] = across = -lift @ damped
        inverse[np.ix_(~self.free, self.free)] = across.T
        inverse[np.ix_(self.free, self.free)] = self.inverse - across @ lift.T
        return inverse


def symmetric_inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a positive matrix; what rounding leaves undetermined stays out of it."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    good = values > _SINGULAR * values[-1]
    half = vectors[:, good] / np.sqrt(values[good]) / scale[:, None]
    result: FloatArray = half @ half.T
    return result
