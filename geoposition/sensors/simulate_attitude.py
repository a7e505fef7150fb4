"""Simulated attitude: Earth pointing with yaw steering, slow control error and jitter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, as_components, read_only
from geoposition.constants import EARTH_RATE_RAD_S
from geoposition.errors import ArgumentError
from geoposition.frames import R_itrs_body
from geoposition.orbit_frame import R_inertial_orbit_nadir, R_orbit_body, nadir_orbit_axes
from geoposition.sensors.simulate_orbit import Orbit


@dataclass(frozen=True, slots=True)
class Vibration:
    """One oscillation of the body: `amplitude_rad` (3,) about X, Y, Z, at one frequency.

    The turn is amplitude × sin(2 pi frequency t + phase), `phase_rad` (3,).
    """

    frequency_hz: float
    amplitude_rad: FloatArray
    phase_rad: FloatArray

    def __post_init__(self) -> None:
        for name in ("amplitude_rad", "phase_rad"):
            object.__setattr__(self, name, read_only(as_components(getattr(self, name), 3, name)))
        if not self.frequency_hz > 0.0:
            raise ArgumentError("vibration: a positive frequency expected")

    def turn_rad(self, times_s: ArrayLike) -> FloatArray:
        """Rotation vectors (..., 3) in the body at `times_s` (...)."""
        phase = 2.0 * np.pi * self.frequency_hz * np.asarray(times_s, dtype=np.float64)
        result: FloatArray = self.amplitude_rad * np.sin(phase[..., None] + self.phase_rad)
        return result


@dataclass(frozen=True, slots=True)
class Pointing:
    """How the body is held in the nadir orbit frame (X along track, Y right, Z down).

    Constant `roll_rad`, `pitch_rad`, `yaw_rad` (of `geoposition.orbit_frame`); with
    `yaw_steering` the yaw that lays X along the ground track is added; then the `vibrations`.
    """

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    yaw_steering: bool = True
    vibrations: tuple[Vibration, ...] = ()

    def R_gcrs_body(self, orbit: Orbit, times_s: FloatArray) -> Rotation:
        """Inertial attitude at increasing `times_s` (n,)."""
        position, velocity = orbit.states(times_s)
        yaw = np.full(len(times_s), self.yaw_rad)
        if self.yaw_steering:
            yaw = yaw + drift_angle_rad(position, velocity, orbit.pole_gcrs)
        body = R_orbit_body(self.roll_rad, self.pitch_rad, yaw)
        for vibration in self.vibrations:
            body = body * Rotation.from_rotvec(vibration.turn_rad(times_s))
        return R_inertial_orbit_nadir(position, velocity) * body

    def R_itrs_body(self, orbit: Orbit, times_s: FloatArray) -> Rotation:
        """Earth-fixed attitude at increasing `times_s` (n,)."""
        return R_itrs_body(self.R_gcrs_body(orbit, times_s), orbit.epoch, times_s)


def drift_angle_rad(
    position_gcrs_m: ArrayLike, velocity_gcrs_m_s: ArrayLike, pole_gcrs: ArrayLike
) -> FloatArray:
    """Yaw (...) that turns X of the nadir orbit frame along the motion over the turning Earth.

    Up to 4 degrees at the equator; positive turns the nose to the right.
    """
    position = as_components(position_gcrs_m, 3, "position")
    rate = EARTH_RATE_RAD_S * as_components(pole_gcrs, 3, "pole")
    velocity = as_components(velocity_gcrs_m_s, 3, "velocity")
    relative = velocity - np.cross(rate, position)
    axes = nadir_orbit_axes(position, velocity)
    along = np.sum(axes[..., 0] * relative, axis=-1)
    right = np.sum(axes[..., 1] * relative, axis=-1)
    result: FloatArray = np.arctan2(right, along)
    return result
