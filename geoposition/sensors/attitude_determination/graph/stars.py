"""What star samples say about knots: residuals, quadratics, head offsets, a start that holds.

A sample measures R_inertial_body exp(o) exp(noise); the offset o of its head, in the body, is its
alignment error plus a sine and a cosine at the orbital period.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.propagation import (
    inverse3,
    quat_of_turn,
    turn_of_quat,
)
from geoposition.sensors.attitude_determination.settings import FusionSettings

_LEAST_SIGMA = 1e-12
"""A prior of zero stands for this: known, for every practical purpose."""


@dataclass(frozen=True, slots=True, eq=False)
class Constants:
    """Shared unknowns: 9 gyro constants or none, then by head 3 alignments, 6 periodic terms.

    `sigma` (p,) are the priors; `alignment` and `periodic` (heads,) the first column or −1.
    """

    gyro: int
    sigma: FloatArray
    alignment: IntArray
    periodic: IntArray


def constants_of(
    heads: tuple[str, ...],
    settings: FusionSettings,
    alignment_sigma_rad: float | Mapping[str, float] | None,
    periodic_sigma_rad: float | Mapping[str, float] | None,
) -> Constants:
    """Lay the shared unknowns out: those of the gyro model, and of the heads given a prior."""
    sigma: list[float] = []
    if settings.model == "general":
        sigma += [settings.scale_sigma] * 3 + [settings.misalignment_sigma] * 6
    gyro = len(sigma)
    columns = []
    for given, size in ((alignment_sigma_rad, 3), (periodic_sigma_rad, 6)):
        column = np.full(len(heads), -1, dtype=np.int64)
        for i, name in enumerate(heads):
            prior = _prior(given, heads, name)
            if prior > 0.0:
                column[i] = len(sigma)
                sigma += [prior] * size
        columns.append(column)
    return Constants(gyro, np.maximum(sigma, _LEAST_SIGMA), *columns)


def _prior(given: float | Mapping[str, float] | None, heads: tuple[str, ...], name: str) -> float:
    if given is None:
        return 0.0
    if isinstance(given, Mapping):
        unknown = sorted(set(given) - set(heads))
        if unknown:
            raise ArgumentError(f"factor graph: no head {unknown[0]!r} among {', '.join(heads)}")
        value = float(given.get(name, 0.0))
    else:
        value = float(given)
    if not 0.0 <= value < float("inf"):
        raise ArgumentError("factor graph: priors of heads finite and not negative expected")
    return value


@dataclass(frozen=True, slots=True, eq=False)
class StarSamples:
    """Samples (m,): `knot` they are at, `head`, sine and cosine (m, 2) of the orbital phase."""

    knot: IntArray
    head: IntArray
    phase: FloatArray
    quat_xyzw: FloatArray
    covariance_rad2: FloatArray


def linearised(
    samples: StarSamples,
    quat_xyzw: FloatArray,
    constants: FloatArray,
    layout: Constants,
    weight: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Quadratics H (k, 3 + p, 3 + p), g (k, 3 + p) of the knots, normalised residuals (m,)."""
    k, size = len(quat_xyzw), 3 + len(constants)
    H, g, residual = np.zeros((k, size, size)), np.zeros((k, size)), np.empty(len(samples.knot))
    _linearise(
        samples.knot,
        samples.head,
        samples.phase,
        samples.quat_xyzw,
        samples.covariance_rad2,
        quat_xyzw,
        constants,
        layout.alignment,
        layout.periodic,
        weight,
        H,
        g,
        residual,
    )
    return H, g, residual


@njit(cache=True, error_model="numpy")
def _linearise(
    knot: IntArray,
    head: IntArray,
    phase: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    quat: FloatArray,
    constants: FloatArray,
    alignment: IntArray,
    periodic: IntArray,
    weight: FloatArray,
    H: FloatArray,
    g: FloatArray,
    residual: FloatArray,
) -> None:
    J, WJ = np.zeros((3, 12)), np.zeros((3, 12))
    place = np.zeros(12, np.int64)
    W, o, z = np.empty((3, 3)), np.empty(3), np.empty(3)
    for m in range(len(knot)):
        k, h = knot[m], head[m]
        o[:] = 0.0
        J[:, :] = 0.0
        used = 3
        if alignment[h] >= 0:
            for r in range(3):
                place[used + r] = 3 + alignment[h] + r
                J[r, used + r] = 1.0
                o[r] += constants[alignment[h] + r]
            used += 3
        if periodic[h] >= 0:
            for r in range(3):
                for part in range(2):
                    at = 3 * part + r
                    place[used + at] = 3 + periodic[h] + at
                    J[r, used + at] = phase[m, part]
                    o[r] += phase[m, part] * constants[periodic[h] + at]
            used += 6
        for r in range(3):
            place[r] = r
            J[r, r] = 1.0
        # The attitude's error seen through the offset: exp(-o) to first order.
        J[0, 1], J[0, 2] = o[2], -o[1]
        J[1, 0], J[1, 2] = -o[2], o[0]
        J[2, 0], J[2, 1] = o[1], -o[0]
        a, b, c, d = quat_multiply(
            -quat[k, 0],
            -quat[k, 1],
            -quat[k, 2],
            quat[k, 3],
            measured[m, 0],
            measured[m, 1],
            measured[m, 2],
            measured[m, 3],
        )
        s, t, u, v = quat_of_turn(-o[0], -o[1], -o[2])
        a, b, c, d = quat_multiply(s, t, u, v, a, b, c, d)
        z[0], z[1], z[2] = turn_of_quat(a, b, c, d)
        inverse3(covariance[m], W)
        squared = 0.0
        for r in range(3):
            for c_ in range(3):
                squared += z[r] * W[r, c_] * z[c_]
        residual[m] = np.sqrt(squared)
        for r in range(3):
            for c_ in range(used):
                WJ[r, c_] = weight[m] * (
                    W[r, 0] * J[0, c_] + W[r, 1] * J[1, c_] + W[r, 2] * J[2, c_]
                )
        for r in range(used):
            at = place[r]
            g[k, at] += WJ[0, r] * z[0] + WJ[1, r] * z[1] + WJ[2, r] * z[2]
            for c_ in range(used):
                H[k, at, place[c_]] += (
                    J[0, r] * WJ[0, c_] + J[1, r] * WJ[1, c_] + J[2, r] * WJ[2, c_]
                )


def first_guess(
    samples: StarSamples, turn_xyzw: FloatArray, tolerance_rad: FloatArray, tries: int = 5
) -> tuple[FloatArray, BoolArray]:
    """Attitudes (k, 4) of the knots from the samples that go together, and which do (m,).

    A sample goes together with the one held before it if the gyro's turns (k − 1, 4) lead from one
    to the other within `tolerance_rad` (k − 1,) per link and twenty sigmas. Of the first few
    samples as start, the one that most others agree with is taken.
    """
    best_quat: FloatArray = np.empty((0, 4))
    best_held = np.zeros(len(samples.knot), dtype=np.bool_)
    for start in range(min(tries, len(samples.knot))):
        quat = np.zeros((len(turn_xyzw) + 1, 4))
        held = np.zeros(len(samples.knot), dtype=np.bool_)
        _lock(
            start,
            samples.knot,
            samples.quat_xyzw,
            samples.covariance_rad2,
            turn_xyzw,
            tolerance_rad,
            quat,
            held,
        )
        if not len(best_quat) or held.sum() > best_held.sum():
            best_quat, best_held = quat, held
        if held[start:].all():
            break
    return best_quat, best_held


@njit(cache=True, error_model="numpy")
def _lock(
    start: int,
    knot: IntArray,
    measured: FloatArray,
    covariance: FloatArray,
    turn: FloatArray,
    tolerance: FloatArray,
    quat: FloatArray,
    held: BoolArray,
) -> None:
    k0 = knot[start]
    x, y, z, w = measured[start, 0], measured[start, 1], measured[start, 2], measured[start, 3]
    quat[k0, 0], quat[k0, 1], quat[k0, 2], quat[k0, 3] = x, y, z, w
    for k in range(k0 - 1, -1, -1):
        x, y, z, w = quat_multiply(x, y, z, w, -turn[k, 0], -turn[k, 1], -turn[k, 2], turn[k, 3])
        quat[k, 0], quat[k, 1], quat[k, 2], quat[k, 3] = x, y, z, w
    x, y, z, w = measured[start, 0], measured[start, 1], measured[start, 2], measured[start, 3]
    held[start] = True
    m, slack = start + 1, 0.0
    for k in range(k0, len(quat)):
        if k > k0:
            x, y, z, w = quat_multiply(
                x, y, z, w, turn[k - 1, 0], turn[k - 1, 1], turn[k - 1, 2], turn[k - 1, 3]
            )
            slack += tolerance[k - 1]
        fresh = True
        while m < len(knot) and knot[m] == k:
            a, b, c, d = quat_multiply(
                -x, -y, -z, w, measured[m, 0], measured[m, 1], measured[m, 2], measured[m, 3]
            )
            a, b, c = turn_of_quat(a, b, c, d)
            sigma = covariance[m, 0, 0] + covariance[m, 1, 1] + covariance[m, 2, 2]
            held[m] = np.sqrt(a * a + b * b + c * c) <= slack + 20.0 * np.sqrt(sigma)
            if held[m] and fresh and k > k0:
                x, y, z, w = measured[m, 0], measured[m, 1], measured[m, 2], measured[m, 3]
                slack, fresh = 0.0, False
            m += 1
        quat[k, 0], quat[k, 1], quat[k, 2], quat[k, 3] = x, y, z, w
