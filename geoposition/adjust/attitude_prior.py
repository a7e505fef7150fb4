"""The fused attitude's own covariance as prior of its errors at knots.

The estimate's errors at neighbouring epochs are correlated; given their covariances P_k and the
lag-one cross-covariances C_k = cov(e_k, e_k+1), a chain in which each error depends on the past
through its neighbour only (as the errors of a filter and smoother do) has
cov(e_j, e_k) = C_j P_j+1⁻¹ C_j+1 ... P_k−1⁻¹ C_k−1 for j < k.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geoposition.adjust.time_basis import KnotBasis
from geoposition.adjust.unknowns import AXES, Block, covered_times
from geoposition.arrays import FloatArray, IntArray
from geoposition.attitude import Attitude
from geoposition.errors import ArgumentError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel


def joint_covariance(attitude: Attitude, times_s: FloatArray) -> FloatArray:
    """Covariance (3 m, 3 m) of the attitude's errors at `times_s` (m,), increasing.

    Times between epochs take the errors' straight line between them. Without `lag_one_rad2`
    epochs are taken as independent. An attitude without covariance is an `ArgumentError`.
    """
    epochs, own = attitude.covariance_times_s, attitude.covariance_rad2
    if epochs is None or own is None:
        raise ArgumentError("attitude prior: an attitude with covariance expected")
    if len(epochs) < 2:
        raise ArgumentError("attitude prior: covariances at two or more epochs expected")
    cell = np.clip(np.searchsorted(epochs, times_s, side="right") - 1, 0, len(epochs) - 2)
    used = np.unique(np.concatenate([cell, cell + 1]))
    joint = _chain(own, attitude.lag_one_rad2, used)
    share = np.clip((times_s - epochs[cell]) / (epochs[cell + 1] - epochs[cell]), 0.0, 1.0)
    weights = np.zeros((len(times_s), len(used)))
    rows = np.arange(len(times_s))
    weights[rows, np.searchsorted(used, cell)] = 1.0 - share
    weights[rows, np.searchsorted(used, cell + 1)] += share
    blend = np.kron(weights, np.eye(3))
    result: FloatArray = blend @ joint @ blend.T
    return 0.5 * (result + result.T)


def _chain(own: FloatArray, lag_one: FloatArray | None, used: IntArray) -> FloatArray:
    """Joint covariance of the epochs `used`, increasing."""
    m = len(used)
    joint = np.zeros((m, 3, m, 3))
    for a in range(m):
        joint[a, :, a] = own[used[a]]
        if lag_one is None:
            continue
        cross = own[used[a]]
        at = int(used[a])
        for b in range(a + 1, m):
            for k in range(at, int(used[b])):
                cross = cross @ np.linalg.solve(own[k], lag_one[k])
            at = int(used[b])
            joint[a, :, b] = cross
            joint[b, :, a] = cross.T
    return joint.reshape(3 * m, 3 * m)


def attitude_process(
    name: str,
    models: Sequence[SensorModel],
    images: Sequence[int],
    *,
    spacing_s: float = 1.0,
    attitude: Attitude | None = None,
) -> Block:
    """Errors of a fused attitude at knots `spacing_s` apart, correlated as it states itself.

    All `images` share the attitude (`attitude`, or the first image's), of which the errors at
    knots over each image's time are unknown. Straight lines join them.
    """
    if not spacing_s > 0.0:
        raise ArgumentError(f"{name}: a positive spacing in seconds expected, got {spacing_s}")
    spans = []
    for image in images:
        model = models[image]
        if not isinstance(model, PushbroomModel):
            raise ArgumentError(f"{name}: image {image} has no rigorous model")
        spans.append(covered_times(model))
    first = models[images[0]]
    assert isinstance(first, PushbroomModel)
    series = attitude or first.attitude
    knots = []
    for epoch, low, high in spans:
        shift = epoch - series.epoch
        count = max(int(np.ceil((high - low) / spacing_s)) + 1, 2)
        knots.append(np.linspace(low + shift, high + shift, count))
    times = np.unique(np.concatenate(knots))
    times = times[np.concatenate([[True], np.diff(times) > 1e-3 * spacing_s])]
    basis = KnotBasis(series.epoch, times)
    labels = tuple(f"{axis}_{label}" for label in basis.labels for axis in AXES)
    return Block(
        name,
        "attitude",
        tuple(images),
        labels,
        ("rad",) * len(labels),
        joint_covariance(series, times),
        basis,
    )
