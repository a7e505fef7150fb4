"""Rotations: quaternion order and sign, Euler sequences, nearest rotation, compiled helpers.

SciPy's `Rotation` crosses boundaries, named `R_to_from`; a bare quaternion says its order
(`quat_xyzw_*`, scalar last, or `quat_wxyz_*`). `R.apply(v)` turns the components of v in `from`
into those in `to`. The textbook's direction cosine matrix A, reference to body (T 2.15, 2.17),
is the inverse of `R_reference_body`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, as_components, require_finite
from geoposition.errors import ArgumentError

SINGULAR_ANGLE_RAD: Final = 1e-6
"""Nearer than this to the singular middle angle, the outer two Euler angles are not separable."""


# Quaternions --------------------------------------------------------------------------------


def quat_xyzw_from_wxyz(quat_wxyz: ArrayLike) -> FloatArray:
    """Reorder quaternions (..., 4) from scalar first to scalar last."""
    return np.roll(as_components(quat_wxyz, 4, "quat_wxyz"), -1, axis=-1)


def quat_wxyz_from_xyzw(quat_xyzw: ArrayLike) -> FloatArray:
    """Reorder quaternions (..., 4) from scalar last to scalar first."""
    return np.roll(as_components(quat_xyzw, 4, "quat_xyzw"), 1, axis=-1)


def continuous_quat(quat: ArrayLike) -> FloatArray:
    """Flip signs along a series (n, 4) so that no quaternion opposes the one before it.

    q and −q are the same rotation; the first keeps its sign. The scalar's place is free.
    """
    series = as_components(quat, 4, "quat")
    if series.ndim != 2:
        raise ArgumentError(f"quat: a series (n, 4) expected, got {series.shape}")
    flips = np.einsum("ij,ij->i", series[1:], series[:-1]) < 0.0
    sign = np.where(np.cumsum(np.concatenate([[False], flips])) % 2 == 0, 1.0, -1.0)
    return series * sign[:, None]


# Euler angles -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class EulerAngles:
    """`angles_rad` (..., 3) in the order of the sequence, and where they are `singular` (...).

    Where singular, only the sum or difference of the outer angles is defined well. Nearer than
    1e-7 rad the third is 0, and the direction of what the middle angle differs from the singular
    one is lost: the angles give the rotation back to 2e-7 rad.
    """

    angles_rad: FloatArray
    singular: BoolArray


def _axes(sequence: str) -> str:
    axes = sequence.replace("-", "").upper().translate(str.maketrans("123", "XYZ"))
    if len(axes) != 3 or set(axes) - set("XYZ") or axes[0] == axes[1] or axes[1] == axes[2]:
        raise ArgumentError(f"Euler sequence {sequence!r}: one like '3-1-2' or 'ZXZ' expected")
    return axes


def rotation_from_intrinsic_euler(sequence: str, angles_rad: ArrayLike) -> Rotation:
    """`R_reference_body` of turns about the body's own axes, one after the other.

    `sequence` is like '3-1-2' or 'ZXY', `angles_rad` (..., 3) are in its order: for '3-1-2',
    `R_reference_body` = R3(a1) R1(a2) R2(a3), whose inverse is T (2.15). Right-handed turns of
    the body. *Source*: T (2.15).
    """
    angles = as_components(angles_rad, 3, "angles_rad")
    return Rotation.from_euler(_axes(sequence), require_finite(angles, "angles_rad"))


def rotation_from_extrinsic_euler(sequence: str, angles_rad: ArrayLike) -> Rotation:
    """`R_reference_body` of turns about the fixed reference axes, one after the other.

    For '3-1-2': R2(a3) R1(a2) R3(a1).
    """
    angles = as_components(angles_rad, 3, "angles_rad")
    return Rotation.from_euler(_axes(sequence).lower(), require_finite(angles, "angles_rad"))


def intrinsic_euler_from_rotation(sequence: str, R_reference_body: Rotation) -> EulerAngles:
    """Angles of `rotation_from_intrinsic_euler`.

    The first and third are in (−pi, pi]. The middle is in [−pi/2, pi/2], singular at its ends,
    or for sequences such as 3-1-3 in [0, pi], singular at 0 and pi: at the middle angle, not
    at the one called pitch.
    """
    axes = _axes(sequence)
    return _euler_angles(axes, axes, R_reference_body)


def extrinsic_euler_from_rotation(sequence: str, R_reference_body: Rotation) -> EulerAngles:
    """Angles of `rotation_from_extrinsic_euler`; ranges and singularity as for intrinsic ones."""
    axes = _axes(sequence)
    return _euler_angles(axes, axes.lower(), R_reference_body)


def _euler_angles(axes: str, scipy_sequence: str, rotation: Rotation) -> EulerAngles:
    angles = rotation.as_euler(scipy_sequence, suppress_warnings=True)
    middle = angles[..., 1]
    distance = np.sin(middle) if axes[0] == axes[2] else np.cos(middle)
    return EulerAngles(angles, np.asarray(np.abs(distance) < SINGULAR_ANGLE_RAD))


def euler_rates(sequence: str, angles_rad: ArrayLike, body_rate_rad_s: ArrayLike) -> FloatArray:
    """Rates (..., 3) of intrinsic Euler angles under a body rate (..., 3) in body axes, rad/s.

    NaN at the singular middle angle. *Source*: T (2.33)–(2.34) for 3-1-2, whose signs are lost
    in print; here for any sequence from the axes themselves.
    """
    axes = ["XYZ".index(axis) for axis in _axes(sequence)]
    angles = as_components(angles_rad, 3, "angles_rad")
    rate = as_components(body_rate_rad_s, 3, "body_rate_rad_s")
    # Columns: each turning axis, seen from the body after the later turns.
    second = Rotation.from_rotvec(angles[..., 1, None] * np.eye(3)[axes[1]])
    third = Rotation.from_rotvec(angles[..., 2, None] * np.eye(3)[axes[2]])
    columns = np.empty((*angles.shape, 3))
    columns[..., 0] = (second * third).inv().apply(np.eye(3)[axes[0]])
    columns[..., 1] = third.inv().apply(np.eye(3)[axes[1]])
    columns[..., 2] = np.eye(3)[axes[2]]
    singular = np.abs(np.linalg.det(columns)) < SINGULAR_ANGLE_RAD
    columns[singular] = np.eye(3)
    rates = np.linalg.solve(columns, rate[..., None])[..., 0]
    return np.where(singular[..., None], np.nan, rates)


# Matrices and small angles ------------------------------------------------------------------


def skew(vectors: ArrayLike) -> FloatArray:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3): skew(a) @ b = a × b."""
    v = as_components(vectors, 3, "vectors")
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -v[..., 2], v[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = v[..., 2], -v[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrix


def rotation_difference_rad(R_a_b: Rotation, R_a_b_reference: Rotation) -> FloatArray:
    """Rotation vectors (..., 3) d, in frame b, with `R_a_b` = `R_a_b_reference` exp(d×).

    Small ones are the angles by which the attitude differs about the body's own axes.
    """
    return np.asarray((R_a_b_reference.inv() * R_a_b).as_rotvec())


@dataclass(frozen=True, slots=True)
class NearestRotation:
    """`rotation`, and how far from it the given matrices were: Frobenius norms `error` (...)."""

    rotation: Rotation
    error: FloatArray


def nearest_rotation(matrices: ArrayLike) -> NearestRotation:
    """Project matrices (..., 3, 3) on the rotations, in the least-squares sense.

    A mirroring or singular matrix (determinant not positive) is an `ArgumentError`.
    *Source*: orthogonal Procrustes problem, Markley & Crassidis 2014, section 5.3.
    """
    m = np.asarray(matrices, dtype=np.float64)
    if m.ndim < 2 or m.shape[-2:] != (3, 3):
        raise ArgumentError(f"matrices: shape (..., 3, 3) expected, got {m.shape}")
    if not np.all(np.isfinite(m)) or not np.all(np.linalg.det(m) > 0.0):
        raise ArgumentError("matrices: finite ones of positive determinant expected")
    u, _, vt = np.linalg.svd(m)
    nearest = u @ vt
    error = np.linalg.norm(m - nearest, axis=(-2, -1))
    return NearestRotation(Rotation.from_matrix(nearest), np.asarray(error))


# Compiled helpers for kernels ---------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def rotate(
    qx: float, qy: float, qz: float, qw: float, vx: float, vy: float, vz: float
) -> tuple[float, float, float]:
    """Turn the vector v by the unit quaternion q, scalar last: q v q*."""
    tx = 2.0 * (qy * vz - qz * vy)
    ty = 2.0 * (qz * vx - qx * vz)
    tz = 2.0 * (qx * vy - qy * vx)
    return (
        vx + qw * tx + qy * tz - qz * ty,
        vy + qw * ty + qz * tx - qx * tz,
        vz + qw * tz + qx * ty - qy * tx,
    )


@njit(cache=True, error_model="numpy")
def quat_multiply(
    px: float, py: float, pz: float, pw: float, qx: float, qy: float, qz: float, qw: float
) -> tuple[float, float, float, float]:
    """Product p q of quaternions, scalar last: first the turn q, then p."""
    return (
        pw * qx + qw * px + py * qz - pz * qy,
        pw * qy + qw * py + pz * qx - px * qz,
        pw * qz + qw * pz + px * qy - py * qx,
        pw * qw - px * qx - py * qy - pz * qz,
    )
