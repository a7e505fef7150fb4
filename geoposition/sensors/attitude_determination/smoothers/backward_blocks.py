"""Compiled pieces that both backward passes are made of: transitions and updates, pulled back.

A matrix L and a vector of all later data, and columns V that carry cross-covariances, go backward
through [[A, B], [0, I]] and through I − K H, without a product with their zeros.
"""

from __future__ import annotations

import math

from numba import njit

from geoposition.arrays import FloatArray
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.propagation import quat_of_turn


@njit(cache=True, error_model="numpy")
def pull_matrix(
    token: tuple[int, ...], L: FloatArray, A: FloatArray, B: FloatArray, work: FloatArray
) -> None:
    """L becomes Phi^T L Phi, in place; `work` is (3, n − 3) at least."""
    n = len(token)
    r = n - 3
    for i in range(3):  # L_dd B, and L_dr + half of it for the symmetric corner
        a, b, c = L[i, 0], L[i, 1], L[i, 2]
        for j in range(r):
            work[i, j] = a * B[0, j] + b * B[1, j] + c * B[2, j]
    for i in range(r):
        for j in range(i + 1):
            value = L[3 + i, 3 + j]
            for k in range(3):
                value += B[k, i] * (work[k, j] + L[k, 3 + j]) + L[k, 3 + i] * B[k, j]
            L[3 + i, 3 + j] = value
            L[3 + j, 3 + i] = value
    for j in range(r):
        a, b, c = work[0, j] + L[0, 3 + j], work[1, j] + L[1, 3 + j], work[2, j] + L[2, 3 + j]
        for i in range(3):
            value = A[0, i] * a + A[1, i] * b + A[2, i] * c
            L[i, 3 + j] = value
            L[3 + j, i] = value
    d00, d01, d02, d11, d12, d22 = L[0, 0], L[0, 1], L[0, 2], L[1, 1], L[1, 2], L[2, 2]
    for i in range(3):
        a = A[0, i] * d00 + A[1, i] * d01 + A[2, i] * d02
        b = A[0, i] * d01 + A[1, i] * d11 + A[2, i] * d12
        c = A[0, i] * d02 + A[1, i] * d12 + A[2, i] * d22
        for j in range(i + 1):
            value = a * A[0, j] + b * A[1, j] + c * A[2, j]
            L[i, j] = value
            L[j, i] = value


@njit(cache=True, error_model="numpy")
def pull_columns(
    token: tuple[int, ...], V: FloatArray, columns: int, A: FloatArray, B: FloatArray
) -> None:
    """Make the first `columns` of V (n, p) Phi^T V, in place."""
    for j in range(columns):
        a, b, c = V[0, j], V[1, j], V[2, j]
        for i in range(len(token) - 3):
            V[3 + i, j] += B[0, i] * a + B[1, i] * b + B[2, i] * c
        for i in range(3):
            V[i, j] = A[0, i] * a + A[1, i] * b + A[2, i] * c


@njit(cache=True, error_model="numpy")
def undo_columns(token: tuple[int, ...], V: FloatArray, columns: int, K: FloatArray) -> None:
    """Make the first `columns` of V (n, p) (I − K H)^T V, in place."""
    for j in range(columns):
        a, b, c = 0.0, 0.0, 0.0
        for i in range(len(token)):
            v = V[i, j]
            a += K[i, 0] * v
            b += K[i, 1] * v
            c += K[i, 2] * v
        V[0, j] -= a
        V[1, j] -= b
        V[2, j] -= c


@njit(cache=True, error_model="numpy")
def undo_matrix(
    token: tuple[int, ...], L: FloatArray, K: FloatArray, information: FloatArray, work: FloatArray
) -> None:
    """L becomes (I − K H)^T L (I − K H) + H^T information H; `work` is (n, 3) at least."""
    n = len(token)
    for i in range(n):
        for j in range(3):
            work[i, j] = 0.0
        for k in range(n):
            value = L[i, k]
            for j in range(3):
                work[i, j] += value * K[k, j]
    for i in range(3):
        for j in range(3):
            value = information[i, j] - work[i, j] - work[j, i]
            for k in range(n):
                value += K[k, i] * work[k, j]
            L[i, j] += value
    for i in range(3, n):
        for j in range(3):
            L[i, j] -= work[i, j]
            L[j, i] = L[i, j]


@njit(cache=True, error_model="numpy")
def move_state(
    token: tuple[int, ...], quat: FloatArray, rest: FloatArray, change: FloatArray
) -> None:
    """Add an error state (n,) to an estimate, in place."""
    x, y, z, w = quat_of_turn(change[0], change[1], change[2])
    x, y, z, w = quat_multiply(quat[0], quat[1], quat[2], quat[3], x, y, z, w)
    scale = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    quat[0], quat[1], quat[2], quat[3] = x * scale, y * scale, z * scale, w * scale
    for i in range(len(token) - 3):
        rest[i] += change[3 + i]


@njit(cache=True, error_model="numpy")
def cross_covariance_block(
    token: tuple[int, ...], P: FloatArray, V: FloatArray, out: FloatArray
) -> None:
    """Fill `out` (p, q) with the first rows and columns of P V."""
    rows, columns = out.shape
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
        for k in range(len(token)):
            for j in range(columns):
                out[i, j] += P[i, k] * V[k, j]
