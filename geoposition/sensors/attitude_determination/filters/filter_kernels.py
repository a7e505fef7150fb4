"""The compiled forward filter: one pass over a timeline, state and covariance at every knot.

Two kernels' worth of blocks: [[A, B], [0, I]] is the transition, [I, 0] the measurement matrix,
and nothing multiplies by their zeros. Star samples are absorbed one by one, each about the
estimate after the one before it; the covariance update is Joseph's.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.propagation import (
    gyro_matrix,
    inverse3,
    process_noise,
    quat_of_turn,
    times_matrix,
    transition,
    turn_of_quat,
)


@njit(cache=True, error_model="numpy")
def corrected_turn(
    token: tuple[int, ...],
    rest: FloatArray,
    reference: FloatArray,
    measured: FloatArray,
    step: float,
    work: FloatArray,
    M: FloatArray,
) -> tuple[float, float, float, float, float, float]:
    """Turn that moves the estimate, and the one the transition is linearised at; fills M.

    Without a `reference` (empty) both are (I + S)^-1 (measured − bias step). About a reference
    (n − 3,) the first is its first-order expansion there, so that all passes over the data see
    one linear problem.
    """
    x, y, z = measured[0], measured[1], measured[2]
    u, v, w = x - rest[0] * step, y - rest[1] * step, z - rest[2] * step
    if len(token) == 6:
        return u, v, w, u, v, w
    if len(reference) == 0:
        gyro_matrix(rest, work)
        inverse3(work, M)
        a, b, c = times_matrix(M, u, v, w)
        return a, b, c, a, b, c
    gyro_matrix(reference, work)
    inverse3(work, M)
    r, s, t = times_matrix(
        M, x - reference[0] * step, y - reference[1] * step, z - reference[2] * step
    )
    u -= (rest[3] - reference[3]) * r + (rest[6] - reference[6]) * s
    u -= (rest[7] - reference[7]) * t
    v -= (rest[9] - reference[9]) * r + (rest[4] - reference[4]) * s
    v -= (rest[8] - reference[8]) * t
    w -= (rest[10] - reference[10]) * r + (rest[11] - reference[11]) * s
    w -= (rest[5] - reference[5]) * t
    a, b, c = times_matrix(M, u, v, w)
    return a, b, c, r, s, t


@njit(cache=True, error_model="numpy")
def predict_covariance(
    token: tuple[int, ...],
    P: FloatArray,
    A: FloatArray,
    B: FloatArray,
    Qdd: FloatArray,
    Qdb: FloatArray,
    qbb: float,
    work: FloatArray,
) -> None:
    """P becomes Phi P Phi^T + Q, in place; `work` is (3, n − 3) twice, one above the other."""
    n = len(token)
    r = n - 3
    for i in range(3):
        for j in range(r):
            work[i, j] = A[i, 0] * P[0, 3 + j] + A[i, 1] * P[1, 3 + j] + A[i, 2] * P[2, 3 + j]
            work[3 + i, j] = 0.0
        for k in range(r):
            b = B[i, k]
            for j in range(r):
                work[3 + i, j] += b * P[3 + k, 3 + j]
    d00, d01, d02, d11, d12, d22 = P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2]
    for i in range(3):
        p = A[i, 0] * d00 + A[i, 1] * d01 + A[i, 2] * d02
        q = A[i, 0] * d01 + A[i, 1] * d11 + A[i, 2] * d12
        s = A[i, 0] * d02 + A[i, 1] * d12 + A[i, 2] * d22
        for j in range(i + 1):
            total = p * A[j, 0] + q * A[j, 1] + s * A[j, 2] + Qdd[i, j]
            for k in range(r):
                total += (work[i, k] + work[3 + i, k]) * B[j, k] + B[i, k] * work[j, k]
            P[i, j] = total
            P[j, i] = total
    for i in range(3):
        for j in range(r):
            value = work[i, j] + work[3 + i, j]
            if j < 3:
                value += Qdb[i, j]
            P[i, 3 + j] = value
            P[3 + j, i] = value
        P[3 + i, 3 + i] += qbb


@njit(cache=True, error_model="numpy")
def update_covariance(
    token: tuple[int, ...], P: FloatArray, R: FloatArray, K: FloatArray, work: FloatArray
) -> None:
    """Joseph's form (I − K H) P (I − K H)^T + K R K^T, in place; `work` is (n, n)."""
    n = len(token)
    for i in range(n):
        a, b, c = K[i, 0], K[i, 1], K[i, 2]
        for j in range(n):
            work[i, j] = P[i, j] - (a * P[0, j] + b * P[1, j] + c * P[2, j])
    for i in range(n):
        a = work[i, 0] - (K[i, 0] * R[0, 0] + K[i, 1] * R[1, 0] + K[i, 2] * R[2, 0])
        b = work[i, 1] - (K[i, 0] * R[0, 1] + K[i, 1] * R[1, 1] + K[i, 2] * R[2, 1])
        c = work[i, 2] - (K[i, 0] * R[0, 2] + K[i, 1] * R[1, 2] + K[i, 2] * R[2, 2])
        for j in range(n):
            P[i, j] = work[i, j] - (a * K[j, 0] + b * K[j, 1] + c * K[j, 2])
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = mean
            P[j, i] = mean


@njit(cache=True, error_model="numpy")
def gain(
    token: tuple[int, ...],
    P: FloatArray,
    R: FloatArray,
    S: FloatArray,
    S_inverse: FloatArray,
    K: FloatArray,
) -> None:
    """Fill the innovation's covariance S, its inverse and the gain K (n, 3)."""
    for i in range(3):
        for j in range(3):
            S[i, j] = P[i, j] + R[i, j]
    inverse3(S, S_inverse)
    for i in range(len(token)):
        a, b, c = P[i, 0], P[i, 1], P[i, 2]
        for j in range(3):
            K[i, j] = a * S_inverse[0, j] + b * S_inverse[1, j] + c * S_inverse[2, j]


@njit(cache=True, error_model="numpy", nogil=True)
def forward_pass(
    token: tuple[int, ...],
    first: int,
    steps_s: FloatArray,
    measured_rad: FloatArray,
    extra_rad2: FloatArray,
    star_start: IntArray,
    star_quat: FloatArray,
    star_covariance: FloatArray,
    walks: tuple[float, float],
    gate: float,
    reference: FloatArray,
    quat: FloatArray,
    rest: FloatArray,
    P: FloatArray,
    residual: FloatArray,
    S: FloatArray,
    K: FloatArray,
    accepted: BoolArray,
) -> None:
    """Filter from knot `first` on, whose state is given in `quat`, `rest`, `P`.

    Row k of `quat`, `rest` (bias and constants) and `P` becomes the estimate with all star
    samples of knot k; samples star_start[k] .. star_start[k + 1] belong to it, those of `first`
    that `accepted` already marks being in the given state. Innovations, their covariance and
    the gains go to `residual`, `S` and `K`. `walks` are the squared random walks.
    """
    n = len(token)
    sv2, su2 = walks
    A, B, L2, M = np.empty((3, 3)), np.empty((3, n - 3)), np.empty((3, 3)), np.empty((3, 3))
    Qdd, Qdb, S_inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    small, strips, square = np.empty((3, 3)), np.empty((6, n - 3)), np.empty((n, n))
    state = rest[first].copy()
    cov = P[first].copy()
    qx, qy, qz, qw = quat[first, 0], quat[first, 1], quat[first, 2], quat[first, 3]
    for k in range(first, len(quat)):
        if k > first:
            step = steps_s[k - 1]
            x, y, z, u, v, w = corrected_turn(
                token, state, reference, measured_rad[k - 1], step, small, M
            )
            factors = transition(token, u, v, w, step, M, A, B, L2)
            process_noise(
                token, u, v, w, step, sv2, su2, extra_rad2[k - 1], factors, M, L2, Qdd, Qdb
            )
            predict_covariance(token, cov, A, B, Qdd, Qdb, su2 * step, strips)
            tx, ty, tz, tw = quat_of_turn(x, y, z)
            qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, tx, ty, tz, tw)
        for m in range(star_start[k], star_start[k + 1]):
            if k == first and accepted[m]:
                continue
            hx, hy, hz, hw = quat_multiply(
                -qx,
                -qy,
                -qz,
                qw,
                star_quat[m, 0],
                star_quat[m, 1],
                star_quat[m, 2],
                star_quat[m, 3],
            )
            x, y, z = turn_of_quat(hx, hy, hz, hw)
            residual[m, 0], residual[m, 1], residual[m, 2] = x, y, z
            gain(token, cov, star_covariance[m], S[m], S_inverse, K[m])
            u, v, w = times_matrix(S_inverse, x, y, z)
            accepted[m] = u * x + v * y + w * z <= gate
            if not accepted[m]:
                continue
            update_covariance(token, cov, star_covariance[m], K[m], square)
            for i in range(n - 3):
                state[i] += K[m, 3 + i, 0] * x + K[m, 3 + i, 1] * y + K[m, 3 + i, 2] * z
            u, v, w = times_matrix(K[m], x, y, z)
            tx, ty, tz, tw = quat_of_turn(u, v, w)
            qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, tx, ty, tz, tw)
        scale = 1.0 / math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        qx, qy, qz, qw = qx * scale, qy * scale, qz * scale, qw * scale
        quat[k, 0], quat[k, 1], quat[k, 2], quat[k, 3] = qx, qy, qz, qw
        for i in range(n - 3):
            rest[k, i] = state[i]
        for i in range(n):
            for j in range(n):
                P[k, i, j] = cov[i, j]
