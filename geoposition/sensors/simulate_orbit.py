"""Simulated orbits: a satellite in the field of an oblate Earth, in the inertial frame.

Two-body attraction and the second zonal harmonic about the Earth's true pole, integrated with an
eighth-order Runge-Kutta method. Over the minutes of a scene what is left out (higher harmonics,
Sun, Moon, drag) moves the satellite by metres, smoothly: no interpolant or camera can tell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from geoposition.arrays import FloatArray, as_components, read_only
from geoposition.constants import GM_M3_S2, WGS84_A_M, WGS84_E2
from geoposition.errors import ArgumentError, ConvergenceError
from geoposition.frames import matrix_itrs_gcrs
from geoposition.timescale import Epoch

J2: Final = 1.08262982e-3
"""Second zonal harmonic of EGM2008, zero-tide, as in NGA.STND.0036 (2014)."""
_RELATIVE_TOLERANCE: Final = 1e-13


@dataclass(frozen=True, slots=True)
class Orbit:
    """A satellite's free motion, from its GCRS position and inertial velocity at `epoch`.

    `pole_gcrs` (3,) is the axis of the Earth's flattening.
    """

    epoch: Epoch
    position_gcrs_m: FloatArray
    velocity_gcrs_m_s: FloatArray
    pole_gcrs: FloatArray

    def __post_init__(self) -> None:
        for name in ("position_gcrs_m", "velocity_gcrs_m_s", "pole_gcrs"):
            object.__setattr__(self, name, read_only(as_components(getattr(self, name), 3, name)))

    @classmethod
    def over(
        cls,
        epoch: Epoch,
        lon_rad: float,
        lat_rad: float,
        altitude_m: float,
        inclination_rad: float,
        *,
        descending: bool = True,
    ) -> Orbit:
        """Nearly circular orbit that is above geodetic `lon_rad`, `lat_rad` at `epoch`.

        "Above" is towards the Earth's centre. `altitude_m` is the orbit's radius less the
        Earth's equatorial one, as orbits are quoted; `inclination_rad` is to the true equator.
        """
        if not (altitude_m > 1e5 and 0.0 < inclination_rad < np.pi):
            raise ArgumentError("orbit: an altitude over 100 km and an inclination expected")
        R_itrs_gcrs = matrix_itrs_gcrs(epoch, 0.0)
        pole = R_itrs_gcrs[2]
        geocentric = np.arctan((1.0 - WGS84_E2) * np.tan(lat_rad))
        cos_azimuth = np.cos(inclination_rad) / np.cos(geocentric)
        if abs(cos_azimuth) > 1.0:
            raise ArgumentError(
                f"orbit: an inclination of {np.degrees(inclination_rad):.2f} deg does not reach "
                f"latitude {np.degrees(lat_rad):.2f} deg"
            )
        up_itrs = [
            np.cos(geocentric) * np.cos(lon_rad),
            np.cos(geocentric) * np.sin(lon_rad),
            np.sin(geocentric),
        ]
        up = R_itrs_gcrs.T @ np.array(up_itrs)
        east = np.cross(pole, up)
        east /= np.linalg.norm(east)
        north = np.cross(up, east)
        sin_azimuth = np.sqrt(1.0 - cos_azimuth**2) * (-1.0 if descending else 1.0)
        radius = WGS84_A_M + altitude_m
        speed = np.sqrt(GM_M3_S2 / radius)
        return cls(epoch, radius * up, speed * (cos_azimuth * east + sin_azimuth * north), pole)

    def states(self, times_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """GCRS positions and inertial velocities (n, 3) at increasing `times_s` (n,)."""
        times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
        start = np.concatenate([self.position_gcrs_m, self.velocity_gcrs_m_s])
        states = np.empty((len(times), 6))
        for part, end in ((times < 0.0, np.min(times)), (times >= 0.0, np.max(times))):
            if np.any(part):
                asked = times[part][::-1] if end < 0.0 else times[part]
                found = self._integrate(start, float(end), asked)
                states[part] = found[::-1] if end < 0.0 else found
        return states[:, :3], states[:, 3:]

    def _integrate(self, start: FloatArray, end_s: float, asked_s: FloatArray) -> FloatArray:
        if end_s == 0.0:
            return np.repeat(start[None], len(asked_s), axis=0)

        def rate(_: float, state: FloatArray) -> FloatArray:
            return np.concatenate([state[3:], gravity(state[:3], self.pole_gcrs)])

        # The tolerance is of the state; steps are short enough for the dense output to keep it.
        solution = solve_ivp(
            rate,
            (0.0, end_s),
            start,
            method="DOP853",
            t_eval=asked_s,
            rtol=_RELATIVE_TOLERANCE,
            atol=1e-9,
            max_step=30.0,
        )
        if not solution.success:
            raise ConvergenceError(f"orbit: {solution.message}")
        return np.asarray(solution.y.T)


def gravity(position_m: ArrayLike, pole: ArrayLike) -> FloatArray:
    """Acceleration (..., 3) at `position_m` (..., 3), inertial axes; `pole` (3,) a unit vector.

    *Source*: gradient of `potential`; Vallado 2013, section 8.6.
    """
    r = as_components(position_m, 3, "position")
    k = as_components(pole, 3, "pole")
    r2 = np.sum(r * r, axis=-1, keepdims=True)
    z = np.sum(r * k, axis=-1, keepdims=True)
    factor = 1.5 * J2 * WGS84_A_M**2 / r2
    result: FloatArray = (
        -GM_M3_S2 / r2**1.5 * (r * (1.0 + factor * (1.0 - 5.0 * z * z / r2)) + 2.0 * factor * z * k)
    )
    return result


def potential(position_m: ArrayLike, pole: ArrayLike) -> FloatArray:
    """Potential energy (...) per mass at `position_m` (..., 3), J/kg, negative."""
    r = as_components(position_m, 3, "position")
    k = as_components(pole, 3, "pole")
    size = np.linalg.norm(r, axis=-1)
    sine = np.sum(r * k, axis=-1) / size
    oblate = J2 * (WGS84_A_M / size) ** 2 * 0.5 * (3.0 * sine**2 - 1.0)
    result: FloatArray = -GM_M3_S2 / size * (1.0 - oblate)
    return result
