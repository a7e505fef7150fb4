"""From knots back to every gyro epoch between them, with covariance and lag-one covariance.

Between two knots the gyro steps are a bridge. With the link split at an epoch j into the part
before it (Phi_j, noise Q_j) and the part after it (G), x_j is, given both ends,

    x_j = Phi_j x_i + psi_j c + K (x_{i+1} - Phi x_i - psi c) + e,   K = Q_j G^T Q^-1,
    cov(e) = Q_j - K G Q_j,

and neighbours share cov(e_j, e_{j+1}) = Q_j phi^T - K_j Q K_{j+1}^T with phi the step between.
*Source*: conditional of a joint Gaussian; Barfoot 2024, section 3.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray, IntArray
from geoposition.sensors.attitude_determination.graph.bridge import (
    densify_links,
)
from geoposition.sensors.attitude_determination.preintegration import FIFTEEN, SIX, Links
from geoposition.sensors.attitude_determination.threads import in_chunks
from geoposition.sensors.attitude_determination.timeline import Timeline


@dataclass(frozen=True, slots=True, eq=False)
class KnotSolution:
    """Knots at timeline indices `ends` (k,): attitude, bias; constants (9,).

    `pairs` (k − 1, n, n) is the covariance of (x_i, x_{i+1}, c), `misfit` (k − 1, 6) what is left
    of each link, `weight` (k − 1, 6, 6) its inverse covariance.
    """

    ends: IntArray
    quat_xyzw: FloatArray
    bias_rad_s: FloatArray
    constants: FloatArray
    pairs: FloatArray
    misfit: FloatArray
    weight: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DenseSolution:
    """Estimates at the gyro epochs: fields as in `AttitudeEstimate`."""

    quat_xyzw: FloatArray
    bias_rad_s: FloatArray
    covariance: FloatArray
    lag_one: FloatArray


def densify(
    timeline: Timeline, knots: KnotSolution, links: Links, general: bool, walks: tuple[float, float]
) -> DenseSolution:
    """Estimate all gyro epochs; `walks` are the squared angle and rate random walks."""
    token = FIFTEEN if general else SIX
    epochs = np.flatnonzero(timeline.is_gyro)
    size, n, links_n = len(epochs), knots.pairs.shape[1], len(knots.pairs)
    # Epochs of each link: from its first knot on, before its last; the very last epoch is extra.
    inside = np.searchsorted(epochs, knots.ends)
    dense = DenseSolution(
        np.empty((size, 4)),
        np.empty((size, 3)),
        np.zeros((size, len(token), len(token))),
        np.zeros((size - 1, 3, 3)),
    )
    first, last = np.zeros((links_n, 3, n)), np.zeros((links_n, 3, n))
    in_chunks(
        densify_links,
        links_n,
        token,
        timeline.turn_rad,
        timeline.step_s,
        timeline.extra_rad2,
        timeline.is_gyro,
        knots.ends,
        inside,
        knots.quat_xyzw,
        knots.bias_rad_s,
        knots.constants,
        knots.pairs,
        knots.misfit,
        knots.weight,
        walks,
        links.E,
        links.F,
        dense.quat_xyzw,
        dense.bias_rad_s,
        dense.covariance,
        dense.lag_one,
        first,
        last,
    )
    # What the knot to the right says of the one to the left: x_i = regress (x_{i+1}, c) + rest.
    right = knots.pairs[:, 6:, 6:]
    scale = np.sqrt(np.einsum("kii->ki", right))
    unit = right / (scale[:, :, None] * scale[:, None, :])
    cross = knots.pairs[:, 6:, :6] / scale[:, :, None]
    regress = np.swapaxes(np.linalg.solve(unit, cross) / scale[:, :, None], 1, 2)
    _lag_across(inside, knots.pairs, np.ascontiguousarray(regress), first, last, dense.lag_one)
    return dense


@njit(cache=True, error_model="numpy")
def _lag_across(
    inside: IntArray,
    pairs: FloatArray,
    regress: FloatArray,
    first: FloatArray,
    last: FloatArray,
    lag_one: FloatArray,
) -> None:
    """Lag-one covariance of neighbours with knots between them, carried from knot to knot."""
    n, links = pairs.shape[1], len(pairs)
    m = n - 6
    carried, moved = np.empty((m, 3)), np.empty((6, 3))
    for right in range(1, links):
        j = inside[right]
        if inside[right + 1] == j and right < links - 1:
            continue
        if j == 0:
            continue
        # Covariance of (x at the first knot of `right`, c) with epoch j.
        for r in range(m):
            at = r if r < 6 else r + 6
            for c in range(3):
                s = 0.0
                for k in range(n):
                    s += pairs[right, at, k] * first[right, c, k]
                carried[r, c] = s
        left = right - 1
        while inside[left + 1] == inside[left]:
            for r in range(6):
                for c in range(3):
                    s = 0.0
                    for k in range(m):
                        s += regress[left, r, k] * carried[k, c]
                    moved[r, c] = s
            for r in range(6):
                for c in range(3):
                    carried[r, c] = moved[r, c]
            left -= 1
        for r in range(3):
            for c in range(3):
                s = 0.0
                for k in range(m):
                    weight = last[left, r, 6 + k]
                    for a in range(6):
                        weight += last[left, r, a] * regress[left, a, k]
                    s += weight * carried[k, c]
                lag_one[j - 1, r, c] = s
