"""Weights of star samples that may be wrong: Huber, Cauchy, or truncated by graduated steps.

The normalised residual r of a sample is the root of its squared Mahalanobis norm, 3 degrees of
freedom. Huber and Cauchy are reweighted least squares; the truncated loss, min(r², t²), takes a
sample fully or not at all and is approached from a convex one, so that the start does not matter
much. *Source*: Huber 1981; Zhang 1997; Yang et al. 2020, (14) for graduated non-convexity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.stats import chi2

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError

RobustKind: TypeAlias = Literal["huber", "cauchy", "truncated"]

_SHARPEN = 3.0
"""Factor between the graduated steps of the truncated loss."""


@dataclass(frozen=True, slots=True)
class RobustNoise:
    """A loss and its threshold on the normalised residual."""

    kind: RobustKind
    threshold: float = 2.8  # 95 % of the residuals of 3 components are below

    def __post_init__(self) -> None:
        if self.kind not in ("huber", "cauchy", "truncated"):
            raise ArgumentError(f"robust noise: huber, cauchy or truncated, got {self.kind!r}")
        if not 0.0 < self.threshold < float("inf"):
            raise ArgumentError("robust noise: a positive threshold expected")

    @classmethod
    def gate(cls, probability: float) -> RobustNoise:
        """Return the truncated loss at a chi-squared quantile of 3 degrees of freedom."""
        return cls("truncated", float(np.sqrt(chi2.ppf(probability, 3))))


def start_control(noise: RobustNoise, residual: FloatArray) -> float:
    """Control parameter with which the truncated loss is still convex for these residuals (m,)."""
    worst = float(np.max(residual, initial=0.0))
    squared = noise.threshold**2
    return squared / max(2.0 * worst**2 - squared, squared)


def sharpened(control: float) -> float:
    """Next control parameter of the truncated loss."""
    return control * _SHARPEN


def weights(noise: RobustNoise, residual: FloatArray, control: float) -> FloatArray:
    """Weights (m,) in [0, 1] of samples with normalised residuals (m,)."""
    t = noise.threshold
    if noise.kind == "huber":
        return np.asarray(t / np.maximum(residual, t))
    if noise.kind == "cauchy":
        return np.asarray(1.0 / (1.0 + (residual / t) ** 2))
    squared = (residual / t) ** 2
    between = np.sqrt(control * (control + 1.0) / np.maximum(squared, 1e-300)) - control
    inner = squared <= control / (control + 1.0)
    outer = squared >= (control + 1.0) / control
    return np.where(inner, 1.0, np.where(outer, 0.0, between))
