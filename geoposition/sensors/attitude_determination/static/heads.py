"""Several star heads, one body attitude: the heads' samples of one epoch fused by information.

A head knows the turns across its boresight well and the turn about it less; two heads that look
apart know all three. Each sample is turned into the body by the head's mounting and weighted by
the inverse of its own covariance there, on the manifold, until the correction vanishes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, IntArray, read_only
from geoposition.errors import ArgumentError
from geoposition.rotation import continuous_quat, nearest_rotation
from geoposition.sensors.kinematics import (
    quat_from_rotvec_xyzw,
    quat_product_xyzw,
    relative_rotvec_rad,
    rotvec_from_quat_xyzw,
)
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

_ITERATIONS: Final = 20
_CONVERGED_RAD: Final = 1e-14
_FAR_RAD: Final = 0.5
"""A rate over a longer turn than this between two samples of a head is not trusted."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedHeads:
    """Body attitudes at `times_s` (n,): `quat_xyzw` (n, 4) of R_inertial_body, signs continuous.

    `covariance_rad2` (n, 3, 3) is in the body. `heads` (n,) took part; `disagreement` (n,) is
    the sum of their squared normalised residuals, chi-squared with 3 (heads − 1) degrees of
    freedom where mountings and noise are right.
    """

    times_s: FloatArray
    quat_xyzw: FloatArray
    covariance_rad2: FloatArray
    heads: IntArray
    disagreement: FloatArray

    @property
    def R_inertial_body(self) -> Rotation:
        """The attitudes as rotations (n,)."""
        return Rotation.from_quat(np.array(self.quat_xyzw))

    def increments(self) -> GyroSeries:
        """Return the turning from epoch to epoch, as slow as it is, in the form of a gyro's series.

        `angular_band.band_restored` takes it for the motion that a band-limited sensor misses.
        """
        turns = relative_rotvec_rad(self.quat_xyzw)
        return GyroSeries.of(self.times_s, np.concatenate([turns[:1], turns]), "increment")


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedMounting:
    """A `mounting` of rotations and how far from them the matrices were: Frobenius, by sensor."""

    mounting: Mounting
    error: Mapping[str, float]


def mounting_from_matrices(matrices: Mapping[str, ArrayLike]) -> ProjectedMounting:
    """Nearest rotations to mounting matrices (3, 3), sensor to body, that need not be orthogonal.

    A mirroring or singular one is an `ArgumentError` that names the sensor.
    """
    rotations, errors = {}, {}
    for sensor, matrix in matrices.items():
        try:
            nearest = nearest_rotation(matrix)
        except ArgumentError as problem:
            raise ArgumentError(f"mounting of {sensor}: {problem}") from None
        rotations[sensor] = nearest.rotation
        errors[sensor] = float(nearest.error)
    return ProjectedMounting(Mounting(rotations), errors)


def body_quaternions(star: StarSeries, mounting: Mounting) -> FloatArray:
    """Each sample as an attitude of the body: R_inertial_body (n, 4)."""
    back = _by_head(star, [mounting.rotation(name).inv().as_quat() for name in star.heads])
    return quat_product_xyzw(star.quat_xyzw, back)


def body_covariances_rad2(star: StarSeries, mounting: Mounting) -> FloatArray:
    """Each sample's covariance (n, 3, 3) in the body."""
    matrix = _by_head(star, [mounting.rotation(name).as_matrix() for name in star.heads])
    sigma = np.stack([star.sigma_cross_rad, star.sigma_cross_rad, star.sigma_bore_rad], axis=-1)
    return np.asarray(np.einsum("nij,nj,nkj->nik", matrix, sigma**2, matrix))


def fuse_heads(
    star: StarSeries, mounting: Mounting | None = None, tolerance_s: float = 1e-3
) -> FusedHeads:
    """One attitude per epoch from all heads that sampled it.

    Samples of different heads within `tolerance_s` of the first make one epoch, at their mean
    time. Each is carried there at the rate its own head shows between its neighbouring samples,
    whose noise is added; a head without neighbours is taken as it is.
    """
    if not 0.0 <= tolerance_s < float("inf"):
        raise ArgumentError("star heads: a tolerance of zero seconds or more expected")
    mounting = mounting or Mounting()
    group = _groups(star.times_s, star.head, tolerance_s, len(star.heads))
    epochs = int(group[-1]) + 1
    count = np.bincount(group, minlength=epochs)
    offset = star.times_s - star.times_s[np.searchsorted(group, np.arange(epochs))][group]
    mean_offset = (np.bincount(group, offset, epochs) / count)[group]
    times = np.bincount(group, star.times_s - offset + mean_offset, epochs) / count
    quat, covariance = _carried(star, mounting, mean_offset - offset)
    information = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    total = np.asarray(np.linalg.inv(_summed(information, group, epochs)), dtype=np.float64)
    # Start from each epoch's first sample.
    mean = quat[np.searchsorted(group, np.arange(epochs))]
    for _ in range(_ITERATIONS):
        residual = _residual(mean[group], quat)
        pull = _summed(np.einsum("nij,nj->ni", information, residual), group, epochs)
        change = np.einsum("nij,nj->ni", total, pull)
        mean = quat_product_xyzw(mean, quat_from_rotvec_xyzw(change))
        mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
        if np.max(np.abs(change)) < _CONVERGED_RAD:
            break
    residual = _residual(mean[group], quat)
    misfit = np.einsum("ni,nij,nj->n", residual, information, residual)
    return FusedHeads(
        read_only(times),
        read_only(continuous_quat(mean)),
        read_only(total),
        count.astype(np.int64),
        read_only(np.bincount(group, misfit, epochs)),
    )


def _carried(
    star: StarSeries, mounting: Mounting, ahead_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Body quaternions and covariances, each carried ahead by `ahead_s` (n,)."""
    quat, covariance = body_quaternions(star, mounting), body_covariances_rad2(star, mounting)
    for head in range(len(star.heads)):
        rows = np.flatnonzero(star.head == head)
        if len(rows) < 2 or not np.any(ahead_s[rows]):
            continue
        before = rows[np.maximum(np.arange(len(rows)) - 1, 0)]
        after = rows[np.minimum(np.arange(len(rows)) + 1, len(rows) - 1)]
        turn = _residual(quat[before], quat[after])
        gap = star.times_s[after] - star.times_s[before]
        trusted = (gap > 0.0) & (np.linalg.norm(turn, axis=1) < _FAR_RAD)
        share = np.where(trusted, ahead_s[rows] / np.where(gap > 0.0, gap, 1.0), 0.0)
        quat[rows] = quat_product_xyzw(quat[rows], quat_from_rotvec_xyzw(share[:, None] * turn))
        # The turn has the noise of both its ends; at the series' ends one is the sample itself.
        own = share * ((after == rows) - 1.0 * (before == rows))
        others = share**2 * ((after != rows) + 1.0 * (before != rows))
        covariance[rows] *= ((1.0 + own) ** 2 + others)[:, None, None]
    return quat, covariance


def _residual(mean: FloatArray, quat: FloatArray) -> FloatArray:
    return rotvec_from_quat_xyzw(quat_product_xyzw(mean * [-1.0, -1.0, -1.0, 1.0], quat))


def _summed(values: FloatArray, group: IntArray, groups: int) -> FloatArray:
    """Sum rows (n, ...) over each group: groups are neighbours, in order."""
    return np.asarray(np.add.reduceat(values, np.searchsorted(group, np.arange(groups)), axis=0))


def _by_head(star: StarSeries, values: list[FloatArray]) -> FloatArray:
    return np.stack(values)[star.head]


@njit(cache=True)
def _groups(times: FloatArray, head: IntArray, tolerance: float, heads: int) -> IntArray:
    """Return each sample's epoch (n,): a new one where it is late, or its head already there."""
    group = np.zeros(len(times), dtype=np.int64)
    last = np.full(heads, -1, dtype=np.int64)
    start, current = times[0], 0
    for k in range(len(times)):
        if times[k] - start > tolerance or last[head[k]] == current:
            current += 1
            start = times[k]
        last[head[k]] = current
        group[k] = current
    return group
