"""How attitude error, bias and gyro constants go over one interval, in closed form.

Error state d: R_true = R_estimate exp(d). With the corrected turn `theta` of an interval (constant
rate) and M = (I + S)^-1, d' = A d + B rest + noise, and the rest (bias, scale, misalignments)
stays, the bias with a random walk. A is the rotation back by theta (Rodrigues), the integral of
A over the interval (the right Jacobian times the step) takes the bias into the angle, and its
own integral and square give the noise: exact for a constant rate, with no power series in the
step. M is taken to commute with the turn in the noise, wrong by (M − I) theta of its value.

*Source*: Farrenkopf 1978; Markley & Crassidis 2014, sections 6.2 and 3.2.2; T (3.23)–(3.26) and
(4.3)–(4.8), corrected.
"""

from __future__ import annotations

import math

from numba import njit

from geoposition.arrays import FloatArray

_SERIES_BELOW = 0.1
"""Squared angle below which six terms of a series are exact to rounding."""


@njit(cache=True, error_model="numpy")
def turn_coefficients(squared: float) -> tuple[float, float, float, float, float]:
    """Factors of an angle x, `squared` = x²: sin x/x, (1−cos x)/x², (x−sin x)/x³, and two more.

    The last two: (x²/2 − 1 + cos x)/x⁴ and (1/3 − 2 (x − sin x)/x³)/x².
    """
    if squared < _SERIES_BELOW:
        u = squared
        a = 1.0 - u / 6.0 * (
            1.0 - u / 20.0 * (1.0 - u / 42.0 * (1.0 - u / 72.0 * (1.0 - u / 110.0)))
        )
        b = 0.5 - u / 24.0 * (
            1.0 - u / 30.0 * (1.0 - u / 56.0 * (1.0 - u / 90.0 * (1.0 - u / 132.0)))
        )
        c = (
            1.0
            - u / 20.0 * (1.0 - u / 42.0 * (1.0 - u / 72.0 * (1.0 - u / 110.0 * (1.0 - u / 156.0))))
        ) / 6.0
        d = (
            1.0
            - u / 30.0 * (1.0 - u / 56.0 * (1.0 - u / 90.0 * (1.0 - u / 132.0 * (1.0 - u / 182.0))))
        ) / 24.0
        e = (1.0 - u / 42.0 * (1.0 - u / 72.0 * (1.0 - u / 110.0 * (1.0 - u / 156.0)))) / 60.0
        return a, b, c, d, e
    x = math.sqrt(squared)
    a = math.sin(x) / x
    cosine = math.cos(x)
    b = (1.0 - cosine) / squared
    c = (1.0 - a) / squared
    return a, b, c, (0.5 - b) / squared, (1.0 / 3.0 - 2.0 * c) / squared


@njit(cache=True, error_model="numpy")
def quat_of_turn(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the unit quaternion, scalar last, of the rotation vector (x, y, z)."""
    squared = 0.25 * (x * x + y * y + z * z)
    half = math.sqrt(squared)
    if squared < 1e-4:
        factor = 0.5 - squared / 12.0 * (1.0 - squared / 20.0 * (1.0 - squared / 42.0))
        return factor * x, factor * y, factor * z, math.sqrt(1.0 - 4.0 * factor**2 * squared)
    factor = 0.5 * math.sin(half) / half
    return factor * x, factor * y, factor * z, math.cos(half)


@njit(cache=True, error_model="numpy")
def turn_of_quat(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Rotation vector, at most pi long, of a unit quaternion, scalar last."""
    norm = math.sqrt(x * x + y * y + z * z)
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    factor = 2.0 if norm < 1e-12 else 2.0 * math.atan2(norm, w) / norm
    return factor * x, factor * y, factor * z


@njit(cache=True, error_model="numpy")
def inverse3(m: FloatArray, out: FloatArray) -> None:
    """Inverse of a 3 x 3 matrix by cofactors."""
    a = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    b = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    d = 1.0 / (m[0, 0] * a + m[0, 1] * b + m[0, 2] * c)
    e = m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]
    f = m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]
    g = m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]
    h = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    i = m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]
    j = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    out[0, 0], out[0, 1], out[0, 2] = a * d, e * d, h * d
    out[1, 0], out[1, 1], out[1, 2] = b * d, f * d, i * d
    out[2, 0], out[2, 1], out[2, 2] = c * d, g * d, j * d


@njit(cache=True, error_model="numpy")
def gyro_matrix(rest: FloatArray, out: FloatArray) -> None:
    """I + S of the constants rest[3:12]: scale, upper, lower. *Source*: T (2.27)."""
    out[0, 0], out[0, 1], out[0, 2] = 1.0 + rest[3], rest[6], rest[7]
    out[1, 0], out[1, 1], out[1, 2] = rest[9], 1.0 + rest[4], rest[8]
    out[2, 0], out[2, 1], out[2, 2] = rest[10], rest[11], 1.0 + rest[5]


@njit(cache=True, error_model="numpy")
def times_matrix(m: FloatArray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Product of a 3 x 3 matrix and a vector."""
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@njit(cache=True, error_model="numpy")
def transition(
    token: tuple[int, ...],
    x: float,
    y: float,
    z: float,
    step: float,
    M: FloatArray,
    A: FloatArray,
    B: FloatArray,
    L2: FloatArray,
) -> tuple[float, float]:
    """Fill A (3, 3), B (3, n − 3) for the corrected turn (x, y, z), and L2 for the noise.

    `token` is a tuple as long as the state, so that its length n is known to the compiler.
    L2 is the integral of the integral of A, over the squared step. Returns the noise's factors.
    """
    n = len(token)
    xx, yy, zz = x * x, y * y, z * z
    squared = xx + yy + zz
    a, b, c, d, e = turn_coefficients(squared)
    xy, xz, yz = x * y, x * z, y * z
    # I - p [theta x] + q [theta x]^2, for each pair of factors
    A[0, 0], A[1, 1], A[2, 2] = 1.0 - b * (yy + zz), 1.0 - b * (xx + zz), 1.0 - b * (xx + yy)
    A[0, 1], A[1, 0] = b * xy + a * z, b * xy - a * z
    A[0, 2], A[2, 0] = b * xz - a * y, b * xz + a * y
    A[1, 2], A[2, 1] = b * yz + a * x, b * yz - a * x
    L2[0, 0], L2[1, 1], L2[2, 2] = 0.5 - d * (yy + zz), 0.5 - d * (xx + zz), 0.5 - d * (xx + yy)
    L2[0, 1], L2[1, 0] = d * xy + c * z, d * xy - c * z
    L2[0, 2], L2[2, 0] = d * xz - c * y, d * xz + c * y
    L2[1, 2], L2[2, 1] = d * yz + c * x, d * yz - c * x
    j00, j11, j22 = 1.0 - c * (yy + zz), 1.0 - c * (xx + zz), 1.0 - c * (xx + yy)
    j01, j10 = c * xy + b * z, c * xy - b * z
    j02, j20 = c * xz - b * y, c * xz + b * y
    j12, j21 = c * yz + b * x, c * yz - b * x
    if n == 6:
        B[0, 0], B[0, 1], B[0, 2] = -step * j00, -step * j01, -step * j02
        B[1, 0], B[1, 1], B[1, 2] = -step * j10, -step * j11, -step * j12
        B[2, 0], B[2, 1], B[2, 2] = -step * j20, -step * j21, -step * j22
    else:
        for i in range(3):
            p, q, r = (
                (j00, j01, j02) if i == 0 else ((j10, j11, j12) if i == 1 else (j20, j21, j22))
            )
            g = -(p * M[0, 0] + q * M[1, 0] + r * M[2, 0])
            h = -(p * M[0, 1] + q * M[1, 1] + r * M[2, 1])
            k = -(p * M[0, 2] + q * M[1, 2] + r * M[2, 2])
            B[i, 0], B[i, 1], B[i, 2] = step * g, step * h, step * k
            B[i, 3], B[i, 4], B[i, 5] = g * x, h * y, k * z
            B[i, 6], B[i, 7], B[i, 8] = g * y, g * z, h * z
            B[i, 9], B[i, 10], B[i, 11] = h * x, k * x, k * y
    return c, e


@njit(cache=True, error_model="numpy")
def process_noise(
    token: tuple[int, ...],
    x: float,
    y: float,
    z: float,
    step: float,
    sv2: float,
    su2: float,
    extra: float,
    factors: tuple[float, float],
    M: FloatArray,
    L2: FloatArray,
    Qdd: FloatArray,
    Qdb: FloatArray,
) -> None:
    """Fill the noise of the angle Qdd and its covariance with the bias's, Qdb; Qbb = su2 step.

    `sv2`, `su2` are the squares of the angle and rate random walks; `extra` is added variance of
    the angle. `factors` and `L2` come from `transition`.
    """
    c, e = factors
    cube = su2 * step**3
    even = sv2 * step + extra + 2.0 * c * cube
    odd = e * cube
    t = (x, y, z)
    for i in range(3):
        for j in range(3):
            Qdd[i, j] = odd * t[i] * t[j]
        Qdd[i, i] += even
    scale = -su2 * step * step
    if len(token) == 6:
        for i in range(3):
            for j in range(3):
                Qdb[i, j] = scale * L2[i, j]
        return
    for i in range(3):
        a, b, d = Qdd[i, 0], Qdd[i, 1], Qdd[i, 2]
        for j in range(3):
            Qdb[i, j] = a * M[j, 0] + b * M[j, 1] + d * M[j, 2]
    for j in range(3):
        a, b, d = Qdb[0, j], Qdb[1, j], Qdb[2, j]
        for i in range(3):
            Qdd[i, j] = M[i, 0] * a + M[i, 1] * b + M[i, 2] * d
    for i in range(3):
        for j in range(3):
            Qdb[i, j] = scale * (L2[i, 0] * M[0, j] + L2[i, 1] * M[1, j] + L2[i, 2] * M[2, j])
