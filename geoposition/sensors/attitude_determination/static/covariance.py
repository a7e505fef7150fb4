"""What directions tell about an attitude: Fisher information, TRIAD's covariance, weak geometry."""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FloatArray

_WEAK_SINE: Final = 1e-6
"""Vectors nearer to one line than this fix no turn about it, however precise they are."""
_WEAK_SIGMA_RAD: Final = 0.5
"""A turn known no better than this is not known: its covariance, to first order, says nothing."""


def fisher_information(
    vectors: FloatArray, sigma_rad: FloatArray, present: BoolArray
) -> FloatArray:
    """Information (..., 3, 3) of unit vectors (..., m, 3): sum of (I − b b^T) / sigma^2.

    *Source*: the QUEST measurement model, Shuster 1989; Markley & Crassidis 2014, (5.114).
    """
    weight = np.where(present, sigma_rad**-2.0, 0.0)
    outer = np.einsum("...m,...mi,...mj->...ij", weight, vectors, vectors)
    total = np.sum(weight, axis=-1)
    return np.asarray(total[..., None, None] * np.eye(3) - outer)


def fisher_covariance(vectors: FloatArray, sigma_rad: FloatArray, present: BoolArray) -> FloatArray:
    """Covariance (..., 3, 3) of an optimal attitude, in the body; NaN where it is singular."""
    information = fisher_information(vectors, sigma_rad, present)
    good = ~geometry_is_weak(vectors, sigma_rad, present)
    safe = np.where(good[..., None, None], information, np.eye(3))
    return np.where(good[..., None, None], np.linalg.inv(safe), np.nan)


def geometry_is_weak(vectors: FloatArray, sigma_rad: FloatArray, present: BoolArray) -> BoolArray:
    """Tell (...) where directions (..., m, 3) do not fix all three turns."""
    low, _, high = np.moveaxis(
        np.linalg.eigvalsh(fisher_information(vectors, sigma_rad, present)), -1, 0
    )
    return np.asarray((low <= _WEAK_SINE**2 * high) | (low < _WEAK_SIGMA_RAD**-2.0))


def triad_covariance(
    body: FloatArray, reference: FloatArray, sigma_rad: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Covariance (..., 3, 3) in the body of TRIAD's attitude from two vectors (..., 2, 3).

    The first vector is the anchor. Beside it, where (...) the geometry is weak: covariance NaN.
    *Source*: Shuster & Oh 1981, (36).
    """
    first, second = body[..., 0, :], body[..., 1, :]
    variance1, variance2 = sigma_rad[..., 0] ** 2, sigma_rad[..., 1] ** 2
    sine2 = np.sum(np.cross(first, second) ** 2, axis=-1)
    true_sine2 = np.sum(np.cross(reference[..., 0, :], reference[..., 1, :]) ** 2, axis=-1)
    weak = np.minimum(sine2, true_sine2) <= _WEAK_SINE**2
    sine2 = np.where(weak, 1.0, sine2)
    cosine = np.sum(first * second, axis=-1)
    mixed = first[..., :, None] * second[..., None, :]
    mixed = (variance1 * cosine)[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
    along = (variance2 - variance1)[..., None, None] * first[..., :, None] * first[..., None, :]
    covariance = variance1[..., None, None] * np.eye(3) + (mixed + along) / sine2[..., None, None]
    weak |= (variance2 + cosine**2 * variance1) / sine2 > _WEAK_SIGMA_RAD**2
    return np.where(weak[..., None, None], np.nan, covariance), np.asarray(weak)
