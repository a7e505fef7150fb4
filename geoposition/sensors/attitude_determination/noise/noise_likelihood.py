"""How likely a star and gyro series is under many noise levels at once: innovations, compiled.

Between star epochs the gyro is preintegrated once; the noise of a link is linear in the squared
random walks, so that a trial of other levels costs one small filter over the star epochs. Trials
run in parallel. *Source*: Mehra 1970; Schweppe 1965 for the likelihood of innovations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.filters.filter_kernels import (
    gain,
    update_covariance,
)
from geoposition.sensors.attitude_determination.filters.forward import prior_variance, state_token
from geoposition.sensors.attitude_determination.preintegration import preintegrate
from geoposition.sensors.attitude_determination.propagation import (
    quat_of_turn,
    times_matrix,
    turn_of_quat,
)
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.threads import in_chunks
from geoposition.sensors.attitude_determination.timeline import Timeline
from geoposition.sensors.telemetry import Mounting, StarSeries


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodData:
    """Star samples (m,) by knot, links between knots, and the noise per unit of each level.

    `noise` (3, k − 1, 3, 3, 3) are Qaa, Qab, Qbb for squared angle and rate random
    walks of 1 and for what gaps add.
    """

    token: tuple[int, ...]
    reference: FloatArray
    prior: FloatArray
    turn_xyzw: FloatArray
    E: FloatArray
    F: FloatArray
    noise: FloatArray
    knot: IntArray
    quat_xyzw: FloatArray
    head: IntArray
    cross_rad: FloatArray
    bore_rad: FloatArray
    bore_body: FloatArray


def likelihood_data(
    timeline: Timeline,
    star: StarSeries,
    mounting: Mounting,
    settings: FusionSettings,
    reference: FloatArray,
) -> LikelihoodData:
    """Preintegrate a timeline about bias and constants `reference` (12,)."""
    ends = np.flatnonzero(np.diff(timeline.star_start)).astype(np.int64)
    general = settings.states == 15
    bias = np.tile(reference[:3], (len(ends), 1))
    plain = replace(timeline, extra_rad2=np.zeros_like(timeline.extra_rad2))
    unit = [
        preintegrate(line, ends, bias, reference[3:], general, sv, su)
        for line, sv, su in ((plain, 1.0, 0.0), (plain, 0.0, 1.0), (timeline, 0.0, 0.0))
    ]
    noise = np.zeros((3, len(ends) - 1, 3, 3, 3))
    for i, links in enumerate(unit):
        noise[i, :, 0], noise[i, :, 1] = links.Qaa, links.Qab
        noise[i, :, 2] = links.qbb[:, None, None] * np.eye(3)
    index = timeline.star_index
    counts = np.diff(timeline.star_start)[ends]
    bore = np.array([mounting.rotation(name).as_matrix()[:, 2] for name in star.heads])
    return LikelihoodData(
        state_token(settings),
        reference[: settings.states - 3],
        prior_variance(settings),
        unit[0].quat_xyzw,
        unit[0].E,
        unit[0].F,
        noise,
        np.repeat(np.arange(len(ends)), counts),
        np.array(timeline.quat_inertial_body),
        star.head[index],
        star.sigma_cross_rad[index],
        star.sigma_bore_rad[index],
        bore,
    )


def minus_log_likelihood(
    data: LikelihoodData, trials: FloatArray, keep: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the samples' shares (b, m) in −log L of trials, and squared innovations (b, m).

    The latter are normalised.

    A trial is (sigma_v, sigma_u, cross and bore scale of head 0, of head 1, …), (b, 2 + 2 heads).
    Samples that `keep` (m,) leaves out do not enter; nor does the first, which starts the filter.
    """
    shape = (len(trials), len(data.knot))
    shares, squared = np.zeros(shape), np.full(shape, np.nan)
    in_chunks(
        _likelihood,
        len(trials),
        data.token,
        data.reference,
        data.prior,
        data.turn_xyzw,
        data.E,
        data.F,
        data.noise,
        data.knot,
        data.quat_xyzw,
        data.head,
        data.cross_rad,
        data.bore_rad,
        data.bore_body,
        trials,
        keep,
        shares,
        squared,
    )
    return shares, squared


@njit(cache=True, error_model="numpy")
def _predict(
    n: int,
    P: FloatArray,
    E: FloatArray,
    F: FloatArray,
    noise: FloatArray,
    k: int,
    sv2: float,
    su2: float,
    work: FloatArray,
) -> None:
    """P becomes Phi P Phi^T + Q over link k; `work` is (3, n)."""
    for i in range(3):
        for j in range(n):
            s = E[k, i, 0] * P[0, j] + E[k, i, 1] * P[1, j] + E[k, i, 2] * P[2, j]
            for c in range(n - 3):
                s += F[k, i, c] * P[3 + c, j]
            work[i, j] = s
    for i in range(3):
        for j in range(3, n):
            P[i, j] = work[i, j]
            P[j, i] = work[i, j]
    for i in range(3):
        for j in range(3):
            s = work[i, 0] * E[k, j, 0] + work[i, 1] * E[k, j, 1] + work[i, 2] * E[k, j, 2]
            for c in range(n - 3):
                s += work[i, 3 + c] * F[k, j, c]
            P[i, j] = s + sv2 * noise[0, k, 0, i, j] + su2 * noise[1, k, 0, i, j]
            P[i, j] += noise[2, k, 0, i, j]
            cross = sv2 * noise[0, k, 1, i, j] + su2 * noise[1, k, 1, i, j]
            P[i, 3 + j] += cross
            P[3 + j, i] += cross
            P[3 + i, 3 + j] += su2 * noise[1, k, 2, i, j]


@njit(cache=True, error_model="numpy")
def _trial(
    token: tuple[int, ...],
    reference: FloatArray,
    prior: FloatArray,
    turn: FloatArray,
    E: FloatArray,
    F: FloatArray,
    noise: FloatArray,
    knot: IntArray,
    measured: FloatArray,
    head: IntArray,
    cross: FloatArray,
    bore: FloatArray,
    axis: FloatArray,
    levels: FloatArray,
    keep: BoolArray,
    shares: FloatArray,
    squared: FloatArray,
) -> None:
    """Filter all samples under one set of levels; fill `shares` and `squared` (m,)."""
    n = len(token)
    P, work, square = np.zeros((n, n)), np.empty((3, n)), np.empty((n, n))
    R, S, inverse, K = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((n, 3))
    state = np.zeros(n - 3)
    sv2, su2 = levels[0] ** 2, levels[1] ** 2
    start = 0
    while not keep[start]:
        start += 1
    k = knot[start]
    qx, qy, qz = measured[start, 0], measured[start, 1], measured[start, 2]
    qw = measured[start, 3]
    for m in range(start, len(knot)):
        if not keep[m]:
            continue
        while k < knot[m]:
            _predict(n, P, E, F, noise, k, sv2, su2, work)
            qx, qy, qz, qw = quat_multiply(
                qx, qy, qz, qw, turn[k, 0], turn[k, 1], turn[k, 2], turn[k, 3]
            )
            x, y, z = 0.0, 0.0, 0.0
            for c in range(n - 3):
                off = state[c] - reference[c]
                x += F[k, 0, c] * off
                y += F[k, 1, c] * off
                z += F[k, 2, c] * off
            a, b, c_, d = quat_of_turn(x, y, z)
            qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, a, b, c_, d)
            k += 1
        h = head[m]
        cross2 = (levels[2 + 2 * h] * cross[m]) ** 2
        bore2 = (levels[3 + 2 * h] * bore[m]) ** 2
        for i in range(3):
            for j in range(3):
                R[i, j] = (bore2 - cross2) * axis[h, i] * axis[h, j]
            R[i, i] += cross2
        if m == start:
            P[:3, :3] = R
            for i in range(n - 3):
                P[3 + i, 3 + i] = prior[i]
            continue
        a, b, c_, d = quat_multiply(
            -qx, -qy, -qz, qw, measured[m, 0], measured[m, 1], measured[m, 2], measured[m, 3]
        )
        x, y, z = turn_of_quat(a, b, c_, d)
        gain(token, P, R, S, inverse, K)
        u, v, w = times_matrix(inverse, x, y, z)
        squared[m] = x * u + y * v + z * w
        determinant = (
            S[0, 0] * (S[1, 1] * S[2, 2] - S[1, 2] * S[2, 1])
            - S[0, 1] * (S[1, 0] * S[2, 2] - S[1, 2] * S[2, 0])
            + S[0, 2] * (S[1, 0] * S[2, 1] - S[1, 1] * S[2, 0])
        )
        shares[m] = 0.5 * (np.log(determinant) + squared[m])
        update_covariance(token, P, R, K, square)
        for i in range(n - 3):
            state[i] += K[3 + i, 0] * x + K[3 + i, 1] * y + K[3 + i, 2] * z
        x, y, z = times_matrix(K, x, y, z)
        a, b, c_, d = quat_of_turn(x, y, z)
        qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, a, b, c_, d)


@njit(cache=True, error_model="numpy", nogil=True)
def _likelihood(
    low: int,
    high: int,
    token: tuple[int, ...],
    reference: FloatArray,
    prior: FloatArray,
    turn: FloatArray,
    E: FloatArray,
    F: FloatArray,
    noise: FloatArray,
    knot: IntArray,
    measured: FloatArray,
    head: IntArray,
    cross: FloatArray,
    bore: FloatArray,
    axis: FloatArray,
    trials: FloatArray,
    keep: BoolArray,
    shares: FloatArray,
    squared: FloatArray,
) -> None:
    for i in range(low, high):
        _trial(
            token,
            reference,
            prior,
            turn,
            E,
            F,
            noise,
            knot,
            measured,
            head,
            cross,
            bore,
            axis,
            trials[i],
            keep,
            shares[i],
            squared[i],
        )
