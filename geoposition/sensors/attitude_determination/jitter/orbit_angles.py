"""Roll, pitch and yaw of a series, as jitter analysis takes them: continuous over time.

With an orbit they are the Euler angles of `geoposition.orbit_frame`, in whichever of its two
frames with Z in the vertical the body is nearer to; without one, the angles turned about the
body's own axes since the first sample.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, require_increasing
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError
from geoposition.frames import gcrs_from_itrs
from geoposition.orbit_frame import R_inertial_orbit, orbit_angles
from geoposition.sensors.attitude_determination.checks.axis_angle import interpolate_rotations

_ALIGNED_RAD: Final = np.radians(60.0)
"""A body farther than this from both orbit frames has its axes named otherwise."""
_KNOT_S: Final = 1.0
"""A cubic through orbit frames so far apart is right to 1e-12 rad in a low orbit."""


def orbit_roll_pitch_yaw(
    times_s: FloatArray, R_gcrs_body: Rotation, ephemeris: Ephemeris
) -> FloatArray:
    """Unwrapped roll, pitch and yaw (n, 3) of inertial attitude at `times_s` (n,).

    Times count from the epoch of `ephemeris`, which must cover them (`SpanError`); the velocity
    is the inertial one. A body whose axes are far from both orbit frames is measured from its
    mean orientation in the orbit. *Source*: T (2.38)–(2.39), X along track, Y completing.
    """
    times = _checked(times_s, R_gcrs_body)
    R_gcrs_orbit = _zenith_frames(times, ephemeris)
    # Half a turn about X makes the nadir frame of the zenith one.
    zenith = R_gcrs_orbit.inv() * R_gcrs_body
    nadir = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * zenith
    R_orbit_body = min(zenith, nadir, key=_misalignment_rad)
    if _misalignment_rad(R_orbit_body) > _ALIGNED_RAD:
        R_orbit_body = R_orbit_body * R_orbit_body.mean().inv()
    angles = orbit_angles(R_orbit_body)
    stacked = np.stack([angles.roll_rad, angles.pitch_rad, angles.yaw_rad], axis=-1)
    return np.asarray(np.unwrap(stacked, axis=0))


def body_roll_pitch_yaw(times_s: FloatArray, R_inertial_body: Rotation) -> FloatArray:
    """Angles (n, 3) turned about the body's X, Y and Z since the first of `times_s` (n,).

    The rotation vectors from sample to sample are summed, as a perfect gyro would: no angle is
    singular however far the body turns, and the noise of the samples stays white.
    """
    times = _checked(times_s, R_inertial_body)
    steps = (R_inertial_body[:-1].inv() * R_inertial_body[1:]).as_rotvec()
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])[: len(times)]


def _checked(times_s: FloatArray, rotations: Rotation) -> FloatArray:
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "attitude times")
    if rotations.single or len(rotations) != len(times):
        raise ArgumentError(f"attitude: {len(times)} rotations expected, one for each time")
    return times


def _misalignment_rad(rotations: Rotation) -> float:
    return float(np.median(rotations.magnitude()))


def _zenith_frames(times: FloatArray, ephemeris: Ephemeris) -> Rotation:
    count = int(np.ceil((times[-1] - times[0]) / _KNOT_S)) + 1
    if count < 8 or 2 * count > len(times):
        return _zenith_frames_at(times, ephemeris)
    knots = np.linspace(times[0], times[-1], count)
    _, frames = interpolate_rotations(knots, _zenith_frames_at(knots, ephemeris), times)
    return frames


def _zenith_frames_at(times: FloatArray, ephemeris: Ephemeris) -> Rotation:
    position, velocity = ephemeris.position_m(times), ephemeris.velocity_m_s(times)
    if ephemeris.frame == "itrs":
        position, velocity = gcrs_from_itrs(position, velocity, ephemeris.epoch, times)
    return R_inertial_orbit(position, velocity)
