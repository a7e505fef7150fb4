"""The compiled Rauch-Tung-Striebel smoother, in Bryson and Frazier's form.

The adjoints L, l of all later data turn the filter's estimate into the smoothed one, in place:
P_s = P − P L P and x_s = x + P l. It is the RTS smoother (T 4.9–4.10) without its inverse of a
covariance, which is ill-conditioned once constants are known to parts in a million.

The cross-covariance of a knot with a later one is P V, with V = P^-1 P_s of the later one pulled
back through every update and transition between.

*Source*: Bierman 1973, "Fixed interval smoothing with discrete measurements"; T (4.9)–(4.10).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.sensors.attitude_determination.filters.filter_kernels import (
    corrected_turn,
    predict_covariance,
)
from geoposition.sensors.attitude_determination.propagation import (
    inverse3,
    process_noise,
    transition,
)
from geoposition.sensors.attitude_determination.smoothers.backward_blocks import (
    cross_covariance_block,
    move_state,
    pull_columns,
    pull_matrix,
    undo_columns,
    undo_matrix,
)


@njit(cache=True, error_model="numpy", nogil=True)
def adjoint_pass(
    token: tuple[int, ...],
    first: int,
    start: int,
    steps_s: FloatArray,
    measured_rad: FloatArray,
    is_output: BoolArray,
    star_start: IntArray,
    reference: FloatArray,
    residual: FloatArray,
    S: FloatArray,
    K: FloatArray,
    accepted: BoolArray,
    quat: FloatArray,
    rest: FloatArray,
    P: FloatArray,
    lag: FloatArray,
    at_first: FloatArray,
) -> None:
    """Smooth a forward pass in place: `quat`, `rest`, `P` of knots `first` and later.

    `lag` (k, p, p), p = 3 or n, gets at each knot of `is_output` its cross-covariance with the
    next such knot; `at_first` (n, p) that of the whole state at `first`. `start` is the star
    sample that the first attitude came from.
    """
    n = len(token)
    columns = lag.shape[1]
    A, B, L2, M = np.empty((3, 3)), np.empty((3, n - 3)), np.empty((3, 3)), np.empty((3, 3))
    small, S_inverse, strip = np.empty((3, 3)), np.empty((3, 3)), np.empty((n, n))
    L, adjoint, LP, V = np.zeros((n, n)), np.zeros((n, 1)), np.empty((n, n)), np.zeros((n, columns))
    cov, change = np.empty((n, n)), np.empty(n)
    for k in range(len(quat) - 1, first - 1, -1):
        if k < len(quat) - 1:
            step = steps_s[k]
            _, _, _, x, y, z = corrected_turn(
                token, rest[k], reference, measured_rad[k], step, small, M
            )
            transition(token, x, y, z, step, M, A, B, L2)
            pull_matrix(token, L, A, B, strip)
            pull_columns(token, adjoint, 1, A, B)
            pull_columns(token, V, columns, A, B)
        for i in range(n):
            for j in range(n):
                cov[i, j] = P[k, i, j]
        if is_output[k]:
            cross_covariance_block(token, cov, V, lag[k])
        if k == first:
            cross_covariance_block(token, cov, V, at_first)
        for i in range(n):
            for j in range(n):
                LP[i, j] = 0.0
            for m in range(n):
                value = L[i, m]
                for j in range(n):
                    LP[i, j] += value * cov[m, j]
        for i in range(n):
            for j in range(n):
                strip[i, j] = cov[i, j]
            for m in range(n):
                value = cov[i, m]
                for j in range(n):
                    strip[i, j] -= value * LP[m, j]
        for i in range(n):
            change[i] = 0.0
            for j in range(n):
                change[i] += cov[i, j] * adjoint[j, 0]
                P[k, i, j] = 0.5 * (strip[i, j] + strip[j, i])
        if is_output[k]:
            for i in range(n):
                for j in range(columns):
                    V[i, j] = -LP[i, j]
            for j in range(columns):
                V[j, j] += 1.0
        move_state(token, quat[k], rest[k], change)
        for m in range(star_start[k + 1] - 1, star_start[k] - 1, -1):
            if not accepted[m] or m == start:
                continue
            inverse3(S[m], S_inverse)
            undo_matrix(token, L, K[m], S_inverse, strip)
            undo_columns(token, adjoint, 1, K[m])
            undo_columns(token, V, columns, K[m])
            for i in range(3):
                for j in range(3):
                    adjoint[i, 0] += S_inverse[i, j] * residual[m, j]


@njit(cache=True, error_model="numpy", nogil=True)
def extend_back(
    token: tuple[int, ...],
    first: int,
    steps_s: FloatArray,
    measured_rad: FloatArray,
    extra_rad2: FloatArray,
    is_output: BoolArray,
    walks: tuple[float, float],
    reference: FloatArray,
    quat: FloatArray,
    rest: FloatArray,
    P: FloatArray,
    lag: FloatArray,
    at_first: FloatArray,
) -> None:
    """Carry the smoothed state of knot `first` back to knot 0, where no star sample is met.

    The gyro's walks read backward are walks too: the turn and the bias change sign.
    """
    n = len(token)
    columns = lag.shape[1]
    A, B, L2, M = np.empty((3, 3)), np.empty((3, n - 3)), np.empty((3, 3)), np.empty((3, 3))
    Qdd, Qdb, small = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    strips, cov, change = np.empty((6, n - 3)), P[first].copy(), np.zeros(n)
    V = np.zeros((n, columns))
    V[:] = at_first
    for k in range(first - 1, -1, -1):
        step = steps_s[k]
        x, y, z, u, v, w = corrected_turn(
            token, rest[k + 1], reference, measured_rad[k], step, small, M
        )
        factors = transition(token, -u, -v, -w, step, M, A, B, L2)
        for i in range(3):  # the error of the turn has changed its sign, not its constants
            for j in range(n - 3):
                B[i, j] = -B[i, j] if j < 3 else B[i, j]
        process_noise(
            token, -u, -v, -w, step, walks[0], walks[1], extra_rad2[k], factors, M, L2, Qdd, Qdb
        )
        for i in range(3):
            for j in range(3):
                Qdb[i, j] = -Qdb[i, j]
        if is_output[k + 1]:  # V becomes P_s of the later knot, then Phi V at each earlier one
            V[:] = cov[:, :columns]
        for j in range(columns):
            a, b, c = V[0, j], V[1, j], V[2, j]
            for i in range(3):
                value = A[i, 0] * a + A[i, 1] * b + A[i, 2] * c
                for m in range(n - 3):
                    value += B[i, m] * V[3 + m, j]
                V[i, j] = value
        predict_covariance(token, cov, A, B, Qdd, Qdb, walks[1] * step, strips)
        quat[k] = quat[k + 1]
        rest[k] = rest[k + 1]
        change[0], change[1], change[2] = -x, -y, -z
        move_state(token, quat[k], rest[k], change)
        P[k] = cov
        if is_output[k]:
            for i in range(columns):
                for j in range(columns):
                    lag[k, i, j] = V[i, j]
