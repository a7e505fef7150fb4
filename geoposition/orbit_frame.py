"""The orbit frame, and roll, pitch and yaw in it.

Three sets of axes are in use; all come from a position from the Earth's centre and the
*inertial* velocity, both in one and the same set of axes, inertial or Earth-fixed:

=======  ============  ============  ============  =========================================
frame    X             Y             Z             where
=======  ============  ============  ============  =========================================
zenith   along track   left          up            T 2.1.1 (4); the default here
nadir    along track   right         down          most flight software
SPOT     right         along track   up            DIMAP v1, and T (2.38) as printed
=======  ============  ============  ============  =========================================

"Along track" is in the orbit plane, at right angles to Z; it is the velocity's own direction
only where the height is steady. Left is the direction of the orbital momentum r × v.

Roll, pitch and yaw are right-handed turns of the body about its X, Y and Z axes, taken as
yaw, roll, pitch (3-1-2), so `R_orbit_body` = R3(yaw) R1(roll) R2(pitch), singular at roll ±90°.
For a camera that looks down in the zenith frame, positive roll looks to the left, positive
pitch backward, and positive yaw turns the nose to the left; in the nadir frame (looking along
+Z) positive roll looks to the left, positive pitch forward, positive yaw to the right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, as_components
from geoposition.constants import EARTH_RATE_RAD_S
from geoposition.errors import GeometryError
from geoposition.rotation import intrinsic_euler_from_rotation, rotation_from_intrinsic_euler

_EULER = "3-1-2"


def zenith_orbit_axes(position_m: ArrayLike, velocity_m_s: ArrayLike) -> FloatArray:
    """Matrices (..., 3, 3) whose columns are along track, left and up.

    `position_m` and inertial `velocity_m_s` (..., 3) in the same axes, which the columns are
    then in too. *Source*: T 2.1.1 (4).
    """
    up, left = _up_and_left(position_m, velocity_m_s)
    return np.stack([np.cross(left, up), left, up], axis=-1)


def nadir_orbit_axes(position_m: ArrayLike, velocity_m_s: ArrayLike) -> FloatArray:
    """Matrices (..., 3, 3) whose columns are along track, right and down."""
    up, left = _up_and_left(position_m, velocity_m_s)
    return np.stack([np.cross(left, up), -left, -up], axis=-1)


def spot_orbit_axes(position_m: ArrayLike, velocity_m_s: ArrayLike) -> FloatArray:
    """Matrices (..., 3, 3) whose columns are right, along track and up, as SPOT 1–5 has them.

    Z = P/|P|, X = unit(V × Z), Y = Z × X. The velocity is taken as it is: which one a product
    means, inertial or Earth-fixed, is its reader's affair. *Source*: SPOT Satellite Geometry
    Handbook, 2.3; T (2.38).
    """
    up, left = _up_and_left(position_m, velocity_m_s)
    return np.stack([-left, np.cross(left, up), up], axis=-1)


def R_inertial_orbit(position_m: ArrayLike, velocity_m_s: ArrayLike) -> Rotation:
    """Turn zenith orbit frame components into those of `position_m` and `velocity_m_s`."""
    return Rotation.from_matrix(zenith_orbit_axes(position_m, velocity_m_s), assume_valid=True)


def R_inertial_orbit_nadir(position_m: ArrayLike, velocity_m_s: ArrayLike) -> Rotation:
    """Turn nadir orbit frame components into those of `position_m` and `velocity_m_s`."""
    return Rotation.from_matrix(nadir_orbit_axes(position_m, velocity_m_s), assume_valid=True)


def inertial_velocity_ecef(position_ecef_m: ArrayLike, velocity_ecef_m_s: ArrayLike) -> FloatArray:
    """Inertial velocity (..., 3), in ECEF axes, of a velocity relative to the rotating Earth.

    V + omega × P with the nominal rate about Z: right to 2 mm/s at LEO; `frames` has the exact
    rate and axes.
    """
    position = as_components(position_ecef_m, 3, "position_ecef_m")
    velocity = as_components(velocity_ecef_m_s, 3, "velocity_ecef_m_s")
    return velocity + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], position)


@dataclass(frozen=True, slots=True)
class OrbitAngles:
    """Attitude to the orbit frame: `roll_rad`, `pitch_rad`, `yaw_rad` (...), `singular` (...).

    Roll is in [−pi/2, pi/2]; where it is singular (±pi/2) pitch is 0 and yaw takes all.
    """

    roll_rad: FloatArray
    pitch_rad: FloatArray
    yaw_rad: FloatArray
    singular: BoolArray


def orbit_angles(R_orbit_body: Rotation) -> OrbitAngles:
    """Roll, pitch and yaw of a body in its orbit frame.

    From inertial attitude: `orbit_angles(R_inertial_orbit(p, v).inv() * R_inertial_body)`,
    T (2.39). The frame decides the signs' meaning; see the module's text.
    """
    euler = intrinsic_euler_from_rotation(_EULER, R_orbit_body)
    yaw, roll, pitch = np.moveaxis(euler.angles_rad, -1, 0)
    return OrbitAngles(roll, pitch, yaw, euler.singular)


def R_orbit_body(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> Rotation:
    """Attitude (...) in the orbit frame from roll, pitch and yaw; inverse of `orbit_angles`."""
    angles = np.stack(np.broadcast_arrays(yaw_rad, roll_rad, pitch_rad), axis=-1)
    return rotation_from_intrinsic_euler(_EULER, angles)


def _up_and_left(position_m: ArrayLike, velocity_m_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
    position = as_components(position_m, 3, "position_m")
    velocity = as_components(velocity_m_s, 3, "velocity_m_s")
    momentum = np.cross(position, velocity)
    radius = np.linalg.norm(position, axis=-1, keepdims=True)
    size = np.linalg.norm(momentum, axis=-1, keepdims=True)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    # Also false where anything is NaN.
    if not np.all((size > 1e-9 * radius * speed) & (radius * speed > 0.0)):
        raise GeometryError(
            "orbit frame: finite positions and velocities expected, not zero and not parallel"
        )
    return np.broadcast_to(position / radius, momentum.shape), momentum / size
