"""The weighted mean of attitudes: the quaternion nearest to all, whatever their signs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, as_components, read_only
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.sensors.kinematics import quat_product_xyzw, rotvec_from_quat_xyzw

_LEAST_GAP: Final = 1e-9
"""Share of the weight by which the largest eigenvalue must lead, or the mean is anywhere."""


@dataclass(frozen=True, slots=True, eq=False)
class MeanAttitude:
    """Means (...): `quat_xyzw` (..., 4), scalar >= 0, `covariance_rad2` (..., 3, 3) in the body.

    `residual_rad` (..., m, 3) turns the mean into each sample, in the body. NaN where `flag`
    (...) is not OK: `TOO_FEW_RAYS` without a usable sample, `WEAK_GEOMETRY` where the samples
    oppose each other, so that no mean is nearer to them than others.
    """

    quat_xyzw: FloatArray
    covariance_rad2: FloatArray
    residual_rad: FloatArray
    flag: FlagArray


def weighted_mean(
    quat_xyzw: ArrayLike,
    weights: ArrayLike | None = None,
    covariance_rad2: ArrayLike | None = None,
) -> MeanAttitude:
    """Mean of quaternions (..., m, 4) with `weights` (..., m), all ones if not given.

    The eigenvector of sum w q q^T with the largest eigenvalue. `covariance_rad2` (..., m, 3, 3)
    of independent samples in the body is propagated through the mean; without it the covariance
    is that of the samples' scatter about it (NaN for one sample). A sample with NaN, or with
    weight 0, is left out. *Source*: T (2.21); Markley et al. 2007.
    """
    quat = as_components(quat_xyzw, 4, "quaternions")
    if quat.ndim < 2:
        raise ArgumentError("quaternion mean: a list (..., m, 4) expected")
    given = np.ones(quat.shape[:-1]) if weights is None else np.asarray(weights, dtype=np.float64)
    try:
        weight = np.broadcast_to(given, quat.shape[:-1])
    except ValueError:
        raise ArgumentError(f"quaternion mean: weights {quat.shape[:-1]} expected") from None
    if np.any(weight < 0.0):
        raise ArgumentError("quaternion mean: weights must not be negative")
    size = np.linalg.norm(quat, axis=-1)
    used = np.isfinite(size) & (size > 0.0) & np.isfinite(weight) & (weight > 0.0)
    unit = np.where(used[..., None], quat, [0.0, 0.0, 0.0, 1.0])
    unit = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
    weight = np.where(used, weight, 0.0)
    total = np.sum(weight, axis=-1)
    none = ~(total > 0.0)
    weight = weight / np.where(none, 1.0, total)[..., None]
    values, vectors = np.linalg.eigh(np.einsum("...m,...mi,...mj->...ij", weight, unit, unit))
    split = ~none & (values[..., 3] - values[..., 2] < _LEAST_GAP)
    flag = np.where(none, Flag.TOO_FEW_RAYS, np.where(split, Flag.WEAK_GEOMETRY, Flag.OK))
    mean = vectors[..., :, -1]
    mean = mean * np.where(mean[..., 3:] < 0.0, -1.0, 1.0)
    back = (mean * [-1.0, -1.0, -1.0, 1.0])[..., None, :]
    residual = rotvec_from_quat_xyzw(quat_product_xyzw(back, unit))
    if covariance_rad2 is None:
        covariance = _scatter(weight, residual, np.sum(used, axis=-1))
    else:
        covariance = _propagated(weight, np.asarray(covariance_rad2, dtype=np.float64))
    ok = flag == Flag.OK
    return MeanAttitude(
        read_only(np.where(ok[..., None], mean, np.nan)),
        read_only(np.where(ok[..., None, None], covariance, np.nan)),
        read_only(np.where((ok[..., None] & used)[..., None], residual, np.nan)),
        flag.astype(np.uint8),
    )


def _propagated(weight: FloatArray, covariance: FloatArray) -> FloatArray:
    """Sum of w^2 P (..., 3, 3): weights (..., m) sum to one, residuals are small."""
    if covariance.shape[-3:] != (weight.shape[-1], 3, 3):
        raise ArgumentError(
            f"quaternion mean: covariances (..., {weight.shape[-1]}, 3, 3) expected"
        )
    kept = np.where(weight[..., None, None] > 0.0, covariance, 0.0)
    return np.asarray(np.einsum("...m,...mij->...ij", weight**2, kept))


def _scatter(weight: FloatArray, residual: FloatArray, count: FloatArray) -> FloatArray:
    """Covariance (..., 3, 3) of a mean from the weighted scatter, weights known to a factor."""
    squared = np.einsum("...m,...mi,...mj->...ij", weight, residual, residual)
    freedom = np.where(count > 1, count - 1.0, np.nan)
    return np.asarray(squared / freedom[..., None, None])
