"""The compiled unscented filter: sigma points through the gyro's kinematics, over a timeline.

A sigma point is a rotation vector about the estimate and an error of bias and constants. Points go
over an interval by the quaternion itself; their mean is taken in the tangent space of the central
one. A star sample measures the rotation vector directly, for which the unscented update of
T (3.33) is the linear one in closed form, and is written as such.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.filters.filter_kernels import (
    gain,
    update_covariance,
)
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
def square_root(P: FloatArray, low: FloatArray) -> None:
    """Lower triangular root of a covariance; directions without any variance stay zero."""
    n = len(P)
    for j in range(n):
        s = P[j, j]
        for k in range(j):
            s -= low[j, k] * low[j, k]
        # Rounding leaves a tiny negative number where nothing is.
        pivot = math.sqrt(s) if s > 1e-15 * P[j, j] else 0.0
        low[j, j] = pivot
        for i in range(j + 1, n):
            s = P[i, j]
            for k in range(j):
                s -= low[i, k] * low[j, k]
            low[i, j] = s / pivot if pivot > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def point_turn(
    token: tuple[int, ...],
    rest: FloatArray,
    measured: FloatArray,
    step: float,
    gyro: FloatArray,
    M: FloatArray,
) -> tuple[float, float, float]:
    """Corrected turn of one point with bias and constants `rest`; fills M = (I + S)^-1."""
    u = measured[0] - rest[0] * step
    v = measured[1] - rest[1] * step
    w = measured[2] - rest[2] * step
    if len(token) == 6:
        return u, v, w
    gyro_matrix(rest, gyro)
    inverse3(gyro, M)
    return times_matrix(M, u, v, w)


@njit(cache=True, error_model="numpy")
def unscented_step(
    token: tuple[int, ...],
    rest: FloatArray,
    P: FloatArray,
    measured: FloatArray,
    step: float,
    spread: float,
    weights: tuple[float, float, float],
    low: FloatArray,
    points: FloatArray,
    trial: FloatArray,
    gyro: FloatArray,
    point_M: FloatArray,
    M: FloatArray,
) -> tuple[float, float, float, float, float, float]:
    """Take P over one interval, without process noise; `spread` is the root of n + lambda.

    Returns the turn of the central point, and the mean of the points about where it ends. M is
    the central point's. `weights` are those of the centre in mean and covariance, and of others.
    """
    n = len(token)
    # The centre is the origin of the tangent space: its weight in the mean counts for nothing.
    _, centre_square, other = weights
    square_root(P, low)
    x, y, z = 0.0, 0.0, 0.0
    mean_x, mean_y, mean_z = 0.0, 0.0, 0.0
    cx, cy, cz = point_turn(token, rest, measured, step, gyro, M)
    bx, by, bz, bw = quat_of_turn(-cx, -cy, -cz)
    for i in range(n):
        for side in range(2):
            sign = spread if side == 0 else -spread
            for k in range(n - 3):
                trial[k] = rest[k] + sign * low[3 + k, i]
            x, y, z = point_turn(token, trial, measured, step, gyro, point_M)
            px, py, pz, pw = quat_of_turn(sign * low[0, i], sign * low[1, i], sign * low[2, i])
            tx, ty, tz, tw = quat_of_turn(x, y, z)
            px, py, pz, pw = quat_multiply(px, py, pz, pw, tx, ty, tz, tw)
            px, py, pz, pw = quat_multiply(bx, by, bz, bw, px, py, pz, pw)
            x, y, z = turn_of_quat(px, py, pz, pw)
            points[2 * i + side, 0] = x
            points[2 * i + side, 1] = y
            points[2 * i + side, 2] = z
            mean_x += other * x
            mean_y += other * y
            mean_z += other * z
    for i in range(n):
        for j in range(n):
            P[i, j] = 0.0
    P[0, 0], P[1, 1], P[2, 2] = mean_x * mean_x, mean_y * mean_y, mean_z * mean_z
    P[1, 0], P[2, 0], P[2, 1] = mean_x * mean_y, mean_x * mean_z, mean_y * mean_z
    for i in range(3):
        for j in range(i + 1):
            P[i, j] *= centre_square
    for i in range(n):
        for side in range(2):
            sign = spread if side == 0 else -spread
            trial[0] = points[2 * i + side, 0] - mean_x
            trial[1] = points[2 * i + side, 1] - mean_y
            trial[2] = points[2 * i + side, 2] - mean_z
            for k in range(n - 3):
                trial[3 + k] = sign * low[3 + k, i]
            for r in range(n):
                value = other * trial[r]
                for c in range(r + 1):
                    P[r, c] += value * trial[c]
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]
    return cx, cy, cz, mean_x, mean_y, mean_z


@njit(cache=True, error_model="numpy", nogil=True)
def unscented_pass(
    token: tuple[int, ...],
    first: int,
    times_s: FloatArray,
    measured_rad: FloatArray,
    extra_rad2: FloatArray,
    star_start: IntArray,
    star_quat: FloatArray,
    star_covariance: FloatArray,
    walks: tuple[float, float],
    gate: float,
    spread: float,
    weights: tuple[float, float, float],
    low_pass_rad_s: float,
    quat: FloatArray,
    rest: FloatArray,
    P: FloatArray,
    residual: FloatArray,
    S: FloatArray,
    K: FloatArray,
    accepted: BoolArray,
) -> None:
    """Filter from knot `first` on; arguments as in `filter_kernels.forward_pass`.

    With a positive `low_pass_rad_s`, a star sample first meets the prediction in a complementary
    filter of first order with that corner: only the share 1 − exp(−corner × time since the star
    epoch before) of its innovation is passed on, and taken to have as small a share of its noise.
    """
    n = len(token)
    sv2, su2 = walks
    A, B, L2, M = np.empty((3, 3)), np.empty((3, n - 3)), np.empty((3, 3)), np.eye(3)
    Qdd, Qdb, S_inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    low, points, square = np.zeros((n, n)), np.empty((2 * n, 3)), np.empty((n, n))
    trial, gyro, point_M = np.empty(15), np.empty((3, 3)), np.eye(3)
    R, z = np.empty((3, 3)), np.empty(3)
    state, cov = np.zeros(12), P[first].copy()
    state[: n - 3] = rest[first]
    qx, qy, qz, qw = quat[first, 0], quat[first, 1], quat[first, 2], quat[first, 3]
    star_time = times_s[first]
    for k in range(first, len(quat)):
        if k > first:
            step = times_s[k] - times_s[k - 1]
            x, y, z_, ex, ey, ez = unscented_step(
                token,
                state,
                cov,
                measured_rad[k - 1],
                step,
                spread,
                weights,
                low,
                points,
                trial,
                gyro,
                point_M,
                M,
            )
            factors = transition(token, x, y, z_, step, M, A, B, L2)
            process_noise(
                token, x, y, z_, step, sv2, su2, extra_rad2[k - 1], factors, M, L2, Qdd, Qdb
            )
            for i in range(3):
                for j in range(3):
                    cov[i, j] += Qdd[i, j]
                    cov[i, 3 + j] += Qdb[i, j]
                    cov[3 + j, i] += Qdb[i, j]
                cov[3 + i, 3 + i] += su2 * step
            px, py, pz, pw = quat_of_turn(x, y, z_)
            qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, px, py, pz, pw)
            px, py, pz, pw = quat_of_turn(ex, ey, ez)
            qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, px, py, pz, pw)
        share = 1.0
        if low_pass_rad_s > 0.0 and star_start[k + 1] > star_start[k]:
            if times_s[k] > star_time:
                share = 1.0 - math.exp(-low_pass_rad_s * (times_s[k] - star_time))
            star_time = times_s[k]
        for m in range(star_start[k], star_start[k + 1]):
            if k == first and accepted[m]:
                continue
            px, py, pz, pw = quat_multiply(
                -qx,
                -qy,
                -qz,
                qw,
                star_quat[m, 0],
                star_quat[m, 1],
                star_quat[m, 2],
                star_quat[m, 3],
            )
            z[0], z[1], z[2] = turn_of_quat(px, py, pz, pw)
            for i in range(3):
                z[i] *= share
                residual[m, i] = z[i]
                for j in range(3):
                    R[i, j] = share * share * star_covariance[m, i, j]
            gain(token, cov, R, S[m], S_inverse, K[m])
            u, v, w = times_matrix(S_inverse, z[0], z[1], z[2])
            accepted[m] = u * z[0] + v * z[1] + w * z[2] <= gate
            if not accepted[m]:
                continue
            update_covariance(token, cov, R, K[m], square)
            for i in range(n - 3):
                state[i] += K[m, 3 + i, 0] * z[0] + K[m, 3 + i, 1] * z[1] + K[m, 3 + i, 2] * z[2]
            u, v, w = times_matrix(K[m], z[0], z[1], z[2])
            px, py, pz, pw = quat_of_turn(u, v, w)
            qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, px, py, pz, pw)
        scale = 1.0 / math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        qx, qy, qz, qw = qx * scale, qy * scale, qz * scale, qw * scale
        quat[k, 0], quat[k, 1], quat[k, 2], quat[k, 3] = qx, qy, qz, qw
        rest[k] = state[: n - 3]
        P[k] = cov
