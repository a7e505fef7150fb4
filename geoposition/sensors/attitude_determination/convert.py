"""Attitude between the inertial, the Earth-fixed and the orbit frame.

The orbit frame comes from an ephemeris: from Earth-fixed positions and velocities with the
Earth's rotation added, which for an Earth-fixed attitude needs no epoch, or from inertial ones.
An epoch is needed only between the inertial and the Earth-fixed frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, as_components, require_increasing
from geoposition.ephemeris import Ephemeris, Frame, earth_fixed_velocity
from geoposition.errors import ArgumentError
from geoposition.frames import R_itrs_gcrs
from geoposition.interpolation import LagrangeCurve, SplineCurve
from geoposition.orbit_frame import (
    inertial_velocity_ecef,
    nadir_orbit_axes,
    spot_orbit_axes,
    zenith_orbit_axes,
)
from geoposition.timescale import Epoch

AttitudeFrame: TypeAlias = Literal["inertial", "itrs", "orbit"]
OrbitAxes: TypeAlias = Literal["zenith", "nadir", "spot"]

_AXES: Final[dict[str, Callable[[FloatArray, FloatArray], FloatArray]]] = {
    "zenith": zenith_orbit_axes,
    "nadir": nadir_orbit_axes,
    "spot": spot_orbit_axes,
}
_POINTS: Final = 8
_VELOCITY_TOLERANCE_M_S: Final = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Orbit:
    """Position and inertial velocity over a span, both on the axes of `frame`.

    They are interpolated apart, as measured velocities are far quieter than the rate of measured
    positions, and the direction of flight is what the orbit frame hangs on.
    """

    position: LagrangeCurve
    velocity: LagrangeCurve
    frame: Frame

    @classmethod
    def of(
        cls, times_s: ArrayLike, position_m: ArrayLike, velocity_m_s: ArrayLike, frame: Frame
    ) -> Orbit:
        """Orbit through positions and velocities (n, 3), n >= 2.

        On Earth-fixed axes the velocities may be Earth-fixed or inertial ones: the positions
        tell. Velocities that are not the rate of the positions at all are an `ArgumentError`.
        """
        times = require_increasing(np.asarray(times_s, dtype=np.float64), "ephemeris times")
        position = as_components(position_m, 3, "positions")
        velocity = as_components(velocity_m_s, 3, "velocities")
        if len(times) < 2 or not position.shape == velocity.shape == (len(times), 3):
            raise ArgumentError("ephemeris: a position and a velocity for each of 2 or more times")
        # Means over the steps, by Simpson's rule on the velocities, forgive noise.
        step = np.diff(times)[:, None]
        curve = LagrangeCurve(times, velocity, _POINTS)
        middle = curve.value(0.5 * (times[1:] + times[:-1]))
        mean = (velocity[1:] + 4.0 * middle + velocity[:-1]) / 6.0
        moved = np.diff(position, axis=0) / step
        turning = inertial_velocity_ecef(position, np.zeros_like(position))
        turned = 0.5 * (turning[1:] + turning[:-1])
        plain = _typical(mean - moved)
        if frame == "gcrs":
            miss, inertial = plain, velocity
        else:
            inertial_kind = _typical(mean - turned - moved)
            miss = min(plain, inertial_kind)
            inertial = velocity if inertial_kind < plain else velocity + turning
        if miss > _VELOCITY_TOLERANCE_M_S:
            raise ArgumentError(
                f"ephemeris: velocities must be the rate of the positions, they miss it by "
                f"{miss:.3g} m/s"
            )
        return cls(
            LagrangeCurve(times, position, _POINTS), LagrangeCurve(times, inertial, _POINTS), frame
        )

    def R_frame_orbit(self, times_s: FloatArray, axes: OrbitAxes = "zenith") -> Rotation:
        """Orbit frame components to those of the ephemeris's frame at `times_s` (n,)."""
        matrices = _AXES[axes](self.position.value(times_s), self.velocity.value(times_s))
        return Rotation.from_matrix(matrices)

    def ephemeris(self, epoch: Epoch) -> Ephemeris:
        """Ephemeris through the same samples, whose times count from `epoch`."""
        position, velocity = self.position.values, self.velocity.values
        if self.frame == "itrs":
            velocity = earth_fixed_velocity(position, velocity)
        curve = SplineCurve.hermite(self.position.times_s, position, velocity)
        return Ephemeris(epoch, curve, self.frame)


def convert(
    R_from_body: Rotation,
    times_s: ArrayLike,
    source: AttitudeFrame,
    target: AttitudeFrame,
    *,
    epoch: Epoch | None = None,
    orbit: Orbit | None = None,
    axes: OrbitAxes = "zenith",
) -> Rotation:
    """Turn attitudes (n,) body to `source` at `times_s` (n,) into body to `target`.

    `times_s` count from `epoch`, which is needed wherever the Earth's turning comes in; an
    `orbit` is needed for the orbit frame. Outside the ephemeris's span a `SpanError`.
    """
    times = np.asarray(times_s, dtype=np.float64)
    if source == target:
        return R_from_body
    if "orbit" not in (source, target):
        R_itrs_inertial = _earth(epoch, times)
        if target == "itrs":
            return R_itrs_inertial * R_from_body
        return R_itrs_inertial.inv() * R_from_body
    if orbit is None:
        raise ArgumentError("attitude: an ephemeris expected, for the orbit frame")
    R_other_orbit = orbit.R_frame_orbit(times, axes)
    other = target if source == "orbit" else source
    if (other == "itrs") != (orbit.frame == "itrs"):
        R_itrs_inertial = _earth(epoch, times)
        turn = R_itrs_inertial if other == "itrs" else R_itrs_inertial.inv()
        R_other_orbit = turn * R_other_orbit
    if source == "orbit":
        return R_other_orbit * R_from_body
    return R_other_orbit.inv() * R_from_body


def _earth(epoch: Epoch | None, times: FloatArray) -> Rotation:
    if epoch is None:
        raise ArgumentError("attitude: an epoch expected, between inertial and Earth-fixed frames")
    return R_itrs_gcrs(epoch, times)


def _typical(difference: FloatArray) -> float:
    return float(np.median(np.linalg.norm(difference, axis=1)))
