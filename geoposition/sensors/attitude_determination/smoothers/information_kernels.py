"""The compiled two-filter smoother: a backward information filter met with a forward pass.

The backward filter starts without information (L = 0, l = 0), in the forward pass's linearisation.
At each knot it has not yet seen the knot's own samples, which the forward one has: nothing counts
twice. P_s = (P^-1 + L)^-1 and x_s = x + P_s l, in place. The result is the RTS smoother's to
rounding, found another way.

*Source*: Fraser & Potter 1969; T (4.11)–(4.17) and P (8), corrected: Gamma_b = −phi_b Gamma_f.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.sensors.attitude_determination.filters.filter_kernels import corrected_turn
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
)


@njit(cache=True, error_model="numpy")
def lose_information(
    token: tuple[int, ...],
    L: FloatArray,
    information: FloatArray,
    G: FloatArray,
    noise: FloatArray,
    work: FloatArray,
) -> None:
    """Let noise of covariance `noise` (3, 3) enter before L.

    It acts through G on the angle and at once on the bias; without G (empty) on the angle alone:
    L − L G (noise^-1 + G^T L G)^-1 G^T L, and likewise `information` (n, 1); `work` (2 n + 6, 3).
    """
    n = len(token)
    through_bias = len(G) > 0
    for i in range(n):
        a, b, c = L[i, 0], L[i, 1], L[i, 2]
        if through_bias:
            for j in range(3):
                work[i, j] = a * G[0, j] + b * G[1, j] + c * G[2, j] + L[i, 3 + j]
        else:
            work[i, 0], work[i, 1], work[i, 2] = a, b, c
    middle, inner = work[2 * n : 2 * n + 3], work[2 * n + 3 : 2 * n + 6]
    # (noise^-1 + g)^-1 = noise (I + g noise)^-1, which also holds for singular noise
    for i in range(3):
        for j in range(3):
            g = work[i, j]
            if through_bias:
                g = G[0, i] * work[0, j] + G[1, i] * work[1, j] + G[2, i] * work[2, j]
                g += work[3 + i, j]
            inner[i, j] = g
    for i in range(3):
        a, b, c = inner[i, 0], inner[i, 1], inner[i, 2]
        for j in range(3):
            middle[i, j] = a * noise[0, j] + b * noise[1, j] + c * noise[2, j]
        middle[i, i] += 1.0
    inverse3(middle, inner)
    for i in range(3):
        a, b, c = noise[i, 0], noise[i, 1], noise[i, 2]
        for j in range(3):
            middle[i, j] = a * inner[0, j] + b * inner[1, j] + c * inner[2, j]
    p, q, s = 0.0, 0.0, 0.0
    if through_bias:
        p = G[0, 0] * information[0, 0] + G[1, 0] * information[1, 0] + G[2, 0] * information[2, 0]
        q = G[0, 1] * information[0, 0] + G[1, 1] * information[1, 0] + G[2, 1] * information[2, 0]
        s = G[0, 2] * information[0, 0] + G[1, 2] * information[1, 0] + G[2, 2] * information[2, 0]
        p, q, s = p + information[3, 0], q + information[4, 0], s + information[5, 0]
    else:
        p, q, s = information[0, 0], information[1, 0], information[2, 0]
    for i in range(n):
        a, b, c = work[i, 0], work[i, 1], work[i, 2]
        for j in range(3):
            work[n + i, j] = a * middle[0, j] + b * middle[1, j] + c * middle[2, j]
    for i in range(n):
        a, b, c = work[n + i, 0], work[n + i, 1], work[n + i, 2]
        information[i, 0] -= a * p + b * q + c * s
        for j in range(i + 1):
            value = L[i, j] - (a * work[j, 0] + b * work[j, 1] + c * work[j, 2])
            L[i, j] = value
            L[j, i] = value


@njit(cache=True, error_model="numpy")
def combine(
    token: tuple[int, ...],
    P: FloatArray,
    L: FloatArray,
    root: FloatArray,
    work: FloatArray,
    X: FloatArray,
) -> None:
    """P becomes (P^-1 + L)^-1, in place, by Cholesky factors: P may be singular, as L is.

    `root`, `work` and `X` are (n, n), `root` with zeros above its diagonal. Inner loops run along
    rows, whole, so that they compile to vector instructions.
    """
    n = len(token)
    for j in range(n):  # P = root root^T
        for i in range(j, n):
            value = P[i, j]
            for k in range(j):
                value -= root[i, k] * root[j, k]
            if i == j:
                root[j, j] = math.sqrt(value) if value > 0.0 else 0.0
            else:
                root[i, j] = value / root[j, j] if root[j, j] > 0.0 else 0.0
    for i in range(n):  # X = L root
        for j in range(n):
            X[i, j] = 0.0
            work[i, j] = 0.0
        for k in range(n):
            value = L[i, k]
            for j in range(n):
                X[i, j] += value * root[k, j]
    for k in range(n):  # work = I + root^T X
        for i in range(k + 1):
            value = root[k, i]
            for j in range(n):
                work[i, j] += value * X[k, j]
    for j in range(n):  # its factor, in place
        work[j, j] += 1.0
        for k in range(j):
            work[j, j] -= work[j, k] * work[j, k]
        work[j, j] = math.sqrt(work[j, j])
        for i in range(j + 1, n):
            value = work[i, j]
            for k in range(j):
                value -= work[i, k] * work[j, k]
            work[i, j] = value / work[j, j]
    for i in range(n):  # X = factor^-1 root^T, and P = X^T X
        for j in range(n):
            X[i, j] = root[j, i]
            P[i, j] = 0.0
        for k in range(i):
            value = work[i, k]
            for j in range(n):
                X[i, j] -= value * X[k, j]
        scale = 1.0 / work[i, i]
        for j in range(n):
            X[i, j] *= scale
    for k in range(n):
        for i in range(n):
            value = X[k, i]
            for j in range(n):
                P[i, j] += value * X[k, j]


@njit(cache=True, error_model="numpy", nogil=True)
def information_pass(
    token: tuple[int, ...],
    first: int,
    start: int,
    steps_s: FloatArray,
    measured_rad: FloatArray,
    extra_rad2: FloatArray,
    is_output: BoolArray,
    star_start: IntArray,
    star_covariance: FloatArray,
    walks: tuple[float, float],
    reference: FloatArray,
    residual: FloatArray,
    K: FloatArray,
    accepted: BoolArray,
    quat: FloatArray,
    rest: FloatArray,
    P: FloatArray,
    lag: FloatArray,
    at_first: FloatArray,
) -> None:
    """Smooth a forward pass in place, as `smooth_kernels.adjoint_pass` does."""
    n = len(token)
    columns = lag.shape[1]
    sv2, su2 = walks
    A, B, L2, M = np.empty((3, 3)), np.empty((3, n - 3)), np.empty((3, 3)), np.empty((3, 3))
    Qdd, Qdb, small, weight = (
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
    )
    G, walk, direct = np.empty((3, 3)), np.zeros((3, 3)), np.empty((0, 3))
    strip, tall, root = np.empty((n, n)), np.empty((2 * n + 6, 3)), np.zeros((n, n))
    L, info, V = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((n, columns))
    cov, square, change = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    for k in range(len(quat) - 1, first - 1, -1):
        if k < len(quat) - 1:
            step = steps_s[k]
            _, _, _, x, y, z = corrected_turn(
                token, rest[k], reference, measured_rad[k], step, small, M
            )
            factors = transition(token, x, y, z, step, M, A, B, L2)
            process_noise(token, x, y, z, step, sv2, su2, extra_rad2[k], factors, M, L2, Qdd, Qdb)
            if su2 > 0.0:
                variance = su2 * step
                for i in range(3):
                    walk[i, i] = variance
                    for j in range(3):
                        G[i, j] = Qdb[i, j] / variance
                for i in range(3):
                    for j in range(3):
                        for m in range(3):
                            Qdd[i, j] -= G[i, m] * Qdb[j, m]
                lose_information(token, L, info, G, walk, tall)
            lose_information(token, L, info, direct, Qdd, tall)
            pull_matrix(token, L, A, B, strip)
            pull_columns(token, info, 1, A, B)
            pull_columns(token, V, columns, A, B)
        for i in range(n):
            for j in range(n):
                cov[i, j] = P[k, i, j]
        if is_output[k]:
            cross_covariance_block(token, cov, V, lag[k])
        if k == first:
            cross_covariance_block(token, cov, V, at_first)
        combine(token, cov, L, root, strip, square)
        for i in range(n):
            change[i] = 0.0
            for j in range(n):
                change[i] += cov[i, j] * info[j, 0]
                P[k, i, j] = cov[i, j]
        if is_output[k]:
            for i in range(n):
                for j in range(columns):
                    value = 1.0 if i == j else 0.0
                    for m in range(n):
                        value -= L[i, m] * cov[m, j]
                    V[i, j] = value
        move_state(token, quat[k], rest[k], change)
        for m in range(star_start[k + 1] - 1, star_start[k] - 1, -1):
            if not accepted[m] or m == start:
                continue
            inverse3(star_covariance[m], weight)
            for i in range(n):
                change[i] = 0.0
                for j in range(3):
                    change[i] += K[m, i, j] * residual[m, j]
            for i in range(n):
                for j in range(n):
                    info[i, 0] += L[i, j] * change[j]
            for i in range(3):
                for j in range(3):
                    L[i, j] += weight[i, j]
                    info[i, 0] += weight[i, j] * residual[m, j]
            undo_columns(token, V, columns, K[m])
