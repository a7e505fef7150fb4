"""Manoeuvres over an orbit: slews, agile scans and swings as smooth profiles of the angles.

Roll, pitch and yaw in the nadir orbit frame follow profiles whose rates and accelerations are
continuous; yaw steering adds to the yaw. The result is true attitude at any epoch.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, read_only, require_finite, require_increasing
from geoposition.errors import ArgumentError
from geoposition.frames import R_itrs_body
from geoposition.orbit_frame import R_orbit_body
from geoposition.sensors.kinematics import rotvec_from_quat_xyzw
from geoposition.sensors.simulate_attitude import Pointing, Vibration
from geoposition.sensors.simulate_orbit import Orbit

_RATE_STEP_S: Final = 0.01


class AngleProfile(Protocol):
    """An angle as a smooth function of time."""

    def angle_rad(self, times_s: FloatArray) -> FloatArray:
        """Angles (...) at `times_s` (...)."""
        ...


@dataclass(frozen=True, slots=True)
class Steady:
    """One angle for ever."""

    value_rad: float = 0.0

    def angle_rad(self, times_s: FloatArray) -> FloatArray:
        """Angles (...) at `times_s` (...)."""
        return np.full(np.shape(times_s), self.value_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Slews:
    """Rest-to-rest turns, one after the other: from `angles_rad[k]` to `angles_rad[k + 1]`.

    Turn k starts at `starts_s[k]` and takes `durations_s[k]`; it must end before the next one
    starts. Each is the fifth-degree polynomial of least jerk: peak rate 1.875 times the mean one,
    peak acceleration 5.774 times the turn over its duration squared.
    """

    starts_s: FloatArray
    durations_s: FloatArray
    angles_rad: FloatArray

    def __post_init__(self) -> None:
        for name in ("starts_s", "durations_s", "angles_rad"):
            values = np.atleast_1d(np.asarray(getattr(self, name), dtype=np.float64))
            object.__setattr__(self, name, read_only(require_finite(values, name)))
        n = len(self.starts_s)
        if self.durations_s.shape != (n,) or self.angles_rad.shape != (n + 1,):
            raise ArgumentError("slews: as many durations as starts, one angle more expected")
        require_increasing(self.starts_s, "slew starts")
        ends = self.starts_s + self.durations_s
        if np.any(self.durations_s <= 0.0) or np.any(ends[:-1] > self.starts_s[1:]):
            raise ArgumentError("slews: each must take time and end before the next one starts")

    def angle_rad(self, times_s: FloatArray) -> FloatArray:
        """Angles (...) at `times_s` (...)."""
        since = np.asarray(times_s, dtype=np.float64)[..., None] - self.starts_s
        part = _smooth_step(since / self.durations_s)
        return np.asarray(self.angles_rad[0] + part @ np.diff(self.angles_rad))


@dataclass(frozen=True, slots=True)
class Scan:
    """A turn at one rate, as agile satellites image, with smooth runs up and down around it.

    The rate is `rate_rad_s` from `start_s` for `duration_s`; the angle is `value_rad` in the
    middle of that. Before and after it rests, `ramp_s` away.
    """

    start_s: float
    duration_s: float
    rate_rad_s: float
    value_rad: float = 0.0
    ramp_s: float = 10.0

    def __post_init__(self) -> None:
        if not (self.duration_s > 0.0 and self.ramp_s > 0.0):
            raise ArgumentError("scan: a positive duration and ramp expected")

    def angle_rad(self, times_s: FloatArray) -> FloatArray:
        """Angles (...) at `times_s` (...)."""
        t = np.asarray(times_s, dtype=np.float64)
        end = self.start_s + self.duration_s
        up = self.ramp_s * _integrated_step((t - self.start_s) / self.ramp_s + 1.0)
        down = self.ramp_s * _integrated_step((t - end) / self.ramp_s)
        # In the middle: half the ramp and half the scan have been turned.
        turned = up - down - 0.5 * self.ramp_s - 0.5 * self.duration_s
        return np.asarray(self.value_rad + self.rate_rad_s * turned)


@dataclass(frozen=True, slots=True)
class Swing:
    """A sine about `value_rad`, such as those that calibrate gyros."""

    amplitude_rad: float
    frequency_hz: float
    phase_rad: float = 0.0
    value_rad: float = 0.0

    def angle_rad(self, times_s: FloatArray) -> FloatArray:
        """Angles (...) at `times_s` (...)."""
        phase = 2.0 * np.pi * self.frequency_hz * np.asarray(times_s, dtype=np.float64)
        return np.asarray(self.value_rad + self.amplitude_rad * np.sin(phase + self.phase_rad))


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """Attitude over an orbit whose roll, pitch and yaw follow profiles.

    The nadir orbit frame, angles and order of `geoposition.orbit_frame`; with `yaw_steering` the
    yaw that lays X along the ground track comes first, `vibrations` come last, as in `Pointing`.
    """

    roll: AngleProfile = field(default_factory=Steady)
    pitch: AngleProfile = field(default_factory=Steady)
    yaw: AngleProfile = field(default_factory=Steady)
    yaw_steering: bool = True
    vibrations: tuple[Vibration, ...] = ()

    def R_gcrs_body(self, orbit: Orbit, times_s: ArrayLike) -> Rotation:
        """Inertial attitude at increasing `times_s` (n,)."""
        times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
        held = Pointing(yaw_steering=self.yaw_steering).R_gcrs_body(orbit, times)
        turned = held * R_orbit_body(
            self.roll.angle_rad(times), self.pitch.angle_rad(times), self.yaw.angle_rad(times)
        )
        for vibration in self.vibrations:
            turned = turned * Rotation.from_rotvec(vibration.turn_rad(times))
        return turned

    def R_itrs_body(self, orbit: Orbit, times_s: FloatArray) -> Rotation:
        """Earth-fixed attitude at increasing `times_s` (n,)."""
        return R_itrs_body(self.R_gcrs_body(orbit, times_s), orbit.epoch, times_s)

    def rate_rad_s(self, orbit: Orbit, times_s: ArrayLike) -> FloatArray:
        """Inertial rate (n, 3) in the body at increasing `times_s` (n,).

        Mean over 0.04 s with its second-order error removed: right to 1e-9 rad/s for motions
        slower than 1 Hz.
        """
        times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))

        def mean(half_s: float) -> FloatArray:
            before = self.R_gcrs_body(orbit, times - half_s)
            after = self.R_gcrs_body(orbit, times + half_s)
            turn = (before.inv() * after).as_quat()
            # In the axes of the middle, not of the start: the vector is along the axis of turn.
            return rotvec_from_quat_xyzw(turn) / (2.0 * half_s)

        return (4.0 * mean(_RATE_STEP_S) - mean(2.0 * _RATE_STEP_S)) / 3.0


def _smooth_step(share: FloatArray) -> FloatArray:
    """Rise from 0 to 1 while `share` does, with rate and acceleration 0 at both ends."""
    x = np.clip(share, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0))


def _integrated_step(share: FloatArray) -> FloatArray:
    """Integral of `_smooth_step` from 0: a half at 1, growing by one per one beyond."""
    x = np.clip(share, 0.0, 1.0)
    return x**4 * (2.5 + x * (x - 3.0)) + np.maximum(share - 1.0, 0.0)
