"""Attitude from angular rate: closed form, Runge-Kutta, exact integration, Euler angles.

Quaternions are R_reference_body, scalar last, so the body's rate multiplies on the right:
dq/dt = q (w, 0) / 2. T (2.28) and (2.32) print the same for inertial attitude of the body, in
another order of the components and with signs lost.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components, require_increasing
from geoposition.errors import ArgumentError
from geoposition.rotation import euler_rates, quat_multiply

RateCurve: TypeAlias = Callable[[FloatArray], FloatArray]
"""Body rate (..., 3) in rad/s at times (...) in seconds."""

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)


# One step -----------------------------------------------------------------------------------


def quat_product_xyzw(left_xyzw: ArrayLike, right_xyzw: ArrayLike) -> FloatArray:
    """Products (..., 4) of quaternions: first the turn `right`, then `left`."""
    left = as_components(left_xyzw, 4, "left quaternion")
    right = as_components(right_xyzw, 4, "right quaternion")
    p, q = left[..., :3], right[..., :3]
    vector = left[..., 3:] * q + right[..., 3:] * p + np.cross(p, q)
    scalar = left[..., 3:] * right[..., 3:] - np.sum(p * q, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def quat_rate_xyzw(quat_xyzw: ArrayLike, rate_rad_s: ArrayLike) -> FloatArray:
    """Time derivative (..., 4) of a quaternion under the body rate (..., 3). *Source*: T (2.28)."""
    rate = as_components(rate_rad_s, 3, "rate")
    pure = np.concatenate([rate, np.zeros((*rate.shape[:-1], 1))], axis=-1)
    result: FloatArray = 0.5 * quat_product_xyzw(quat_xyzw, pure)
    return result


def quat_from_rotvec_xyzw(rotvec_rad: ArrayLike) -> FloatArray:
    """Quaternions (..., 4) of rotation vectors (..., 3), exact for the smallest ones too."""
    rotvec = as_components(rotvec_rad, 3, "rotation vector")
    half = 0.5 * np.linalg.norm(rotvec, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * rotvec, np.cos(half)], axis=-1)


def rotvec_from_quat_xyzw(quat_xyzw: ArrayLike) -> FloatArray:
    """Rotation vectors (..., 3), at most pi long, of unit quaternions (..., 4) of either sign."""
    quat = as_components(quat_xyzw, 4, "quaternion")
    vector = quat[..., :3] * np.where(quat[..., 3:] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    half = np.arctan2(sine, np.abs(quat[..., 3:]))
    result: FloatArray = vector * (2.0 * half / np.where(sine > 0.0, sine, 1.0))
    return result


def propagated(quat_xyzw: ArrayLike, rate_rad_s: ArrayLike, step_s: ArrayLike) -> FloatArray:
    """Quaternions (..., 4) after `step_s` (...) of a constant body rate (..., 3): closed form.

    *Source*: T (2.31)–(2.32).
    """
    step = np.asarray(step_s, dtype=np.float64)[..., None]
    turn = quat_from_rotvec_xyzw(as_components(rate_rad_s, 3, "rate") * step)
    return quat_product_xyzw(quat_xyzw, turn)


def propagated_rk4(
    quat_xyzw: ArrayLike,
    rate_start_rad_s: ArrayLike,
    rate_middle_rad_s: ArrayLike,
    rate_end_rad_s: ArrayLike,
    step_s: ArrayLike,
) -> FloatArray:
    """Quaternions (..., 4) after one fourth-order Runge-Kutta step, normalised.

    Rates (..., 3) at the start, the middle and the end of the step; the method T (2.29) names
    and stops at first order.
    """
    q = as_components(quat_xyzw, 4, "quaternion")
    h = np.asarray(step_s, dtype=np.float64)[..., None]
    k1 = quat_rate_xyzw(q, rate_start_rad_s)
    k2 = quat_rate_xyzw(q + 0.5 * h * k1, rate_middle_rad_s)
    k3 = quat_rate_xyzw(q + 0.5 * h * k2, rate_middle_rad_s)
    k4 = quat_rate_xyzw(q + h * k3, rate_end_rad_s)
    end = q + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    result: FloatArray = end / np.linalg.norm(end, axis=-1, keepdims=True)
    return result


def propagated_euler_rk4(
    sequence: str,
    angles_rad: ArrayLike,
    rate_start_rad_s: ArrayLike,
    rate_middle_rad_s: ArrayLike,
    rate_end_rad_s: ArrayLike,
    step_s: ArrayLike,
) -> FloatArray:
    """Intrinsic Euler angles (..., 3) after one Runge-Kutta step; NaN where a stage is singular.

    For 3-1-2 the singular angle is the middle one (about X), not the pitch. *Source*: T (2.33)–
    (2.34) with the textbook's signs.
    """
    a = as_components(angles_rad, 3, "angles")
    h = np.asarray(step_s, dtype=np.float64)[..., None]
    k1 = euler_rates(sequence, a, rate_start_rad_s)
    k2 = _rates_or_nan(sequence, a + 0.5 * h * k1, rate_middle_rad_s)
    k3 = _rates_or_nan(sequence, a + 0.5 * h * k2, rate_middle_rad_s)
    k4 = _rates_or_nan(sequence, a + h * k3, rate_end_rad_s)
    result: FloatArray = a + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return result


def _rates_or_nan(sequence: str, angles: FloatArray, rate: ArrayLike) -> FloatArray:
    lost = ~np.isfinite(angles).all(axis=-1, keepdims=True)
    return np.where(lost, np.nan, euler_rates(sequence, np.where(lost, 0.0, angles), rate))


# Series -------------------------------------------------------------------------------------


def accumulated(quat_start_xyzw: ArrayLike, rotvec_rad: ArrayLike) -> FloatArray:
    """Quaternions (..., n + 1, 4) of a start (..., 4) turned by `rotvec_rad` (..., n, 3) in turn.

    Each rotation vector is in the body as the ones before it left it. Leading axes are runs.
    """
    start = as_components(quat_start_xyzw, 4, "start quaternion")
    turns = quat_from_rotvec_xyzw(rotvec_rad)
    if turns.ndim < 2:
        raise ArgumentError("rotation vectors: a series (..., n, 3) expected")
    leading = np.broadcast_shapes(start.shape[:-1], turns.shape[:-2])
    result = np.empty((*leading, turns.shape[-2] + 1, 4))
    result[..., 0, :] = start
    result[..., 1:, :] = turns
    _accumulate(result.reshape(-1, *result.shape[-2:]))
    return result


@njit(cache=True, error_model="numpy")
def _accumulate(quats: FloatArray) -> None:
    """Replace (runs, n, 4) by its products from the first along axis 1, kept unit."""
    for run in range(quats.shape[0]):
        x, y, z, w = quats[run, 0, 0], quats[run, 0, 1], quats[run, 0, 2], quats[run, 0, 3]
        for k in range(1, quats.shape[1]):
            x, y, z, w = quat_multiply(
                x, y, z, w, quats[run, k, 0], quats[run, k, 1], quats[run, k, 2], quats[run, k, 3]
            )
            # One Newton step keeps the norm at 1 to rounding, without a root.
            keep = 1.5 - 0.5 * (x * x + y * y + z * z + w * w)
            x, y, z, w = keep * x, keep * y, keep * z, keep * w
            quats[run, k, 0], quats[run, k, 1], quats[run, k, 2], quats[run, k, 3] = x, y, z, w


def coning_corrected(increments_rad: ArrayLike) -> FloatArray:
    """Rotation vectors (..., n, 3) of the steps, from integrated rates (..., n, 3), equal steps.

    A gyro integrates its rates; where their direction turns within a step, the step's rotation
    is not that integral. Right for rates linear over two steps; the first takes the second's.
    *Source*: Bortz 1971; Savage 1998: a_k + a_{k-1} × a_k / 12.
    """
    steps = as_components(increments_rad, 3, "increments")
    if steps.ndim < 2 or steps.shape[-2] < 2:
        raise ArgumentError("increments: a series (..., n, 3) of at least 2 expected")
    turned = np.cross(steps[..., :-1, :], steps[..., 1:, :]) / 12.0
    result: FloatArray = steps + np.concatenate([turned[..., :1, :], turned], axis=-2)
    return result


def relative_rotvec_rad(quat_xyzw: ArrayLike) -> FloatArray:
    """Rotation vectors (..., n − 1, 3) that take each quaternion of (..., n, 4) to the next."""
    quat = as_components(quat_xyzw, 4, "quaternions")
    if quat.ndim < 2:
        raise ArgumentError("quaternions: a series (..., n, 4) expected")
    back = quat[..., :-1, :] * [-1.0, -1.0, -1.0, 1.0]
    return rotvec_from_quat_xyzw(quat_product_xyzw(back, quat[..., 1:, :]))


def integrated_rate_rad(rate: RateCurve, times_s: ArrayLike) -> FloatArray:
    """Integrals (n − 1, 3) of a body rate over the steps of `times_s` (n,): five-point Gauss.

    This is what a rate-integrating gyro measures.
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "times")
    half = 0.5 * np.diff(times)
    middle = 0.5 * (times[1:] + times[:-1])
    samples = rate(middle[:, None] + half[:, None] * _GAUSS_NODES)
    return np.asarray(half[:, None] * np.einsum("kgi,g->ki", samples, _GAUSS_WEIGHTS))


def attitude_of_rate(
    rate: RateCurve, times_s: ArrayLike, quat_start_xyzw: ArrayLike, substeps: int = 4
) -> FloatArray:
    """Quaternions (n, 4) at `times_s` (n,) of a body that starts at the first and turns at `rate`.

    Fourth-order Magnus integration: the error falls with the fourth power of the sub-steps, and
    a rate of fixed direction is exact but for its quadrature. *Source*: Iserles & Nørsett 1999.
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "times")
    if substeps < 1:
        raise ArgumentError("substeps: at least 1 expected")
    fraction = np.arange(substeps) / substeps
    start = (times[:-1, None] + np.diff(times)[:, None] * fraction).ravel()
    step = np.repeat(np.diff(times) / substeps, substeps)
    offset = np.sqrt(3.0) / 6.0
    first = rate(start + (0.5 - offset) * step)
    second = rate(start + (0.5 + offset) * step)
    h = step[:, None]
    turned = np.sqrt(3.0) / 12.0 * h**2 * np.cross(first, second)
    rotvec = 0.5 * h * (first + second) + turned
    return np.asarray(accumulated(quat_start_xyzw, rotvec)[::substeps])
