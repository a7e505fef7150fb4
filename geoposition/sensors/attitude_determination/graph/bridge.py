"""Compiled part of `factor_graph_dense`: the bridge between two knots, epoch by epoch."""

from __future__ import annotations

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.preintegration import (
    extend_link,
    load_constants,
    start_link,
)
from geoposition.sensors.attitude_determination.propagation import (
    gyro_matrix,
    inverse3,
    quat_of_turn,
)


@njit(cache=True, error_model="numpy")
def bridge(
    E: FloatArray,
    F: FloatArray,
    Qaa: FloatArray,
    Qab: FloatArray,
    qbb: float,
    whole_E: FloatArray,
    whole_F: FloatArray,
    weight: FloatArray,
    T: FloatArray,
    K: FloatArray,
    noise: FloatArray,
    Q: FloatArray,
    work: FloatArray,
) -> None:
    """Fill T (6, n) of (x_i, x_{i+1}, c), K (6, 6), `noise` (6, 6) and Q (6, 6) at one epoch."""
    G, QG = work[0], work[1]
    for r in range(3):
        for c in range(3):
            Q[r, c], Q[r, 3 + c], Q[3 + c, r] = Qaa[r, c], Qab[r, c], Qab[r, c]
            Q[3 + r, 3 + c] = qbb if r == c else 0.0
            s = 0.0
            for k in range(3):
                s += whole_E[r, k] * E[c, k]
            G[r, c] = s
            G[3 + r, c] = 0.0
            G[3 + r, 3 + c] = 1.0 if r == c else 0.0
    for r in range(3):
        for c in range(3):
            s = whole_F[r, c]
            for k in range(3):
                s -= G[r, k] * F[k, c]
            G[r, 3 + c] = s
    for r in range(6):
        for c in range(6):
            s = 0.0
            for k in range(6):
                s += Q[r, k] * G[c, k]
            QG[r, c] = s
    for r in range(6):
        for c in range(6):
            s = 0.0
            for k in range(6):
                s += QG[r, k] * weight[k, c]
            K[r, c] = s
    for r in range(6):
        for c in range(r + 1):
            s = Q[r, c]
            for k in range(6):
                s -= K[r, k] * QG[c, k]
            noise[r, c] = s
            noise[c, r] = s
    wide = F.shape[1]
    for r in range(6):
        for c in range(3):
            s = E[r, c] if r < 3 else 0.0
            t = F[r, c] if r < 3 else (1.0 if r - 3 == c else 0.0)
            for k in range(3):
                s -= K[r, k] * whole_E[k, c]
                t -= K[r, k] * whole_F[k, c]
            T[r, c] = s
            T[r, 3 + c] = t - K[r, 3 + c]
        for c in range(6):
            T[r, 6 + c] = K[r, c]
        for c in range(12, T.shape[1]):
            T[r, c] = 0.0
        for c in range(3, wide):
            s = F[r, c] if r < 3 else 0.0
            for k in range(3):
                s -= K[r, k] * whole_F[k, c]
            T[r, 9 + c] = s


@njit(cache=True, error_model="numpy")
def write_epoch(
    T: FloatArray,
    noise: FloatArray,
    pair: FloatArray,
    V: FloatArray,
    covariance: FloatArray,
) -> None:
    """Covariance (6 or 15) of one epoch; V (6, n) becomes its covariance with the pair."""
    n, states = pair.shape[0], covariance.shape[0]
    for r in range(6):
        for c in range(n):
            V[r, c] = 0.0
        for k in range(n):
            t = T[r, k]
            for c in range(n):
                V[r, c] += t * pair[k, c]
    for r in range(6):
        for c in range(r + 1):
            s = noise[r, c]
            for k in range(n):
                s += V[r, k] * T[c, k]
            covariance[r, c] = s
            covariance[c, r] = s
        for c in range(6, states):
            covariance[r, c] = V[r, 6 + c]
            covariance[c, r] = V[r, 6 + c]
    for r in range(6, states):
        for c in range(6, states):
            covariance[r, c] = pair[6 + r, 6 + c]


@njit(cache=True, error_model="numpy")
def _densify_link(
    i: int,
    token: tuple[int, ...],
    angle: FloatArray,
    step: FloatArray,
    extra: FloatArray,
    is_gyro: BoolArray,
    ends: IntArray,
    inside: IntArray,
    knot_quat: FloatArray,
    knot_bias: FloatArray,
    constants: FloatArray,
    pairs: FloatArray,
    misfit: FloatArray,
    weight: FloatArray,
    walks: tuple[float, float],
    whole_E: FloatArray,
    whole_F: FloatArray,
    quat: FloatArray,
    bias: FloatArray,
    covariance: FloatArray,
    lag_one: FloatArray,
    first: FloatArray,
    last: FloatArray,
) -> None:
    """Estimate the epochs from knot i up to knot i + 1."""
    n = pairs.shape[1]
    sv2, su2 = walks
    rest, gyro, M = np.empty(12), np.empty((3, 3)), np.empty((3, 3))
    A, B, work = np.empty((3, 3)), np.empty((3, len(token) - 3)), np.empty((4, 3, 3))
    turn, E, F = np.empty(4), np.empty((3, 3)), np.empty((3, len(token) - 3))
    Qaa, Qab = np.empty((3, 3)), np.empty((3, 3))
    T, before, V = np.empty((6, n)), np.empty((6, n)), np.empty((6, n))
    K, K_before = np.empty((6, 6)), np.zeros((6, 6))
    Q, Q_before = np.empty((6, 6)), np.zeros((6, 6))
    noise, square = np.empty((6, 6)), np.empty((2, 6, 6))
    load_constants(knot_bias[i], constants, rest)
    gyro_matrix(rest, gyro)
    inverse3(gyro, M)
    start_link(turn, E, F, Qaa, Qab)
    qbb = 0.0
    j = inside[i]
    closes = i == len(pairs) - 1
    for k in range(ends[i], ends[i + 1] + 1):
        if k > ends[i]:
            qbb = extend_link(
                token,
                angle[k - 1],
                step[k - 1],
                extra[k - 1],
                knot_bias[i],
                M,
                sv2,
                su2,
                turn,
                E,
                F,
                Qaa,
                Qab,
                qbb,
                A,
                B,
                work,
            )
        if not is_gyro[k] or (k == ends[i + 1] and not closes):
            continue
        bridge(
            E,
            F,
            Qaa,
            Qab,
            qbb,
            whole_E[i],
            whole_F[i],
            weight[i],
            T,
            K,
            noise,
            Q,
            square,
        )
        x, y, z, w = quat_multiply(
            knot_quat[i, 0],
            knot_quat[i, 1],
            knot_quat[i, 2],
            knot_quat[i, 3],
            turn[0],
            turn[1],
            turn[2],
            turn[3],
        )
        d = np.zeros(6)
        for r in range(6):
            for c in range(6):
                d[r] += K[r, c] * misfit[i, c]
        a, b, c_, s = quat_of_turn(d[0], d[1], d[2])
        x, y, z, w = quat_multiply(x, y, z, w, a, b, c_, s)
        quat[j, 0], quat[j, 1], quat[j, 2], quat[j, 3] = x, y, z, w
        for r in range(3):
            bias[j, r] = knot_bias[i, r] + d[3 + r]
        write_epoch(T, noise, pairs[i], V, covariance[j])
        if j > inside[i]:
            # cov(x_{j-1}, x_j) = T' pair T^T + Q' phi^T - K' Q K^T, and Q K^T = G Q_j
            for r in range(3):
                for c in range(3):
                    s = 0.0
                    for m in range(n):
                        s += before[r, m] * V[c, m]
                    for m in range(3):
                        s += Q_before[r, m] * A[c, m] + Q_before[r, 3 + m] * B[c, m]
                    for m in range(6):
                        s -= K_before[r, m] * square[1, c, m]
                    lag_one[j - 1, r, c] = s
        else:
            first[i, :, :] = T[:3]
        before[:, :] = T
        K_before[:, :] = K
        Q_before[:, :] = Q
        last[i, :, :] = T[:3]
        j += 1


@njit(cache=True, error_model="numpy", nogil=True)
def densify_links(
    low: int,
    high: int,
    token: tuple[int, ...],
    angle: FloatArray,
    step: FloatArray,
    extra: FloatArray,
    is_gyro: BoolArray,
    ends: IntArray,
    inside: IntArray,
    knot_quat: FloatArray,
    knot_bias: FloatArray,
    constants: FloatArray,
    pairs: FloatArray,
    misfit: FloatArray,
    weight: FloatArray,
    walks: tuple[float, float],
    whole_E: FloatArray,
    whole_F: FloatArray,
    quat: FloatArray,
    bias: FloatArray,
    covariance: FloatArray,
    lag_one: FloatArray,
    first: FloatArray,
    last: FloatArray,
) -> None:
    """Fill estimates, covariance and lag-one covariance within links; T of their outer epochs."""
    for i in range(low, high):
        _densify_link(
            i,
            token,
            angle,
            step,
            extra,
            is_gyro,
            ends,
            inside,
            knot_quat,
            knot_bias,
            constants,
            pairs,
            misfit,
            weight,
            walks,
            whole_E,
            whole_F,
            quat,
            bias,
            covariance,
            lag_one,
            first,
            last,
        )
