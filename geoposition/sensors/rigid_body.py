"""Rigid-body dynamics: how torques turn a satellite. *Source*: T (2.35), Euler's equations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from geoposition.arrays import (
    FloatArray,
    as_components,
    read_only,
    require_finite,
    require_increasing,
)
from geoposition.constants import GM_M3_S2
from geoposition.errors import ArgumentError, ConvergenceError
from geoposition.rotation import quat_multiply, rotate
from geoposition.sensors.simulate_orbit import Orbit

Torque: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]
"""Torque (3,) in N m in the body, at a time in s, under R_inertial_body (4,) and body rate (3,)."""

_RELATIVE_TOLERANCE: Final = 1e-12
_ORBIT_KNOT_S: Final = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class RigidBody:
    """Inertia tensor `inertia_kg_m2` (3, 3) about the centre of mass, in the body."""

    inertia_kg_m2: FloatArray

    def __post_init__(self) -> None:
        tensor = np.asarray(self.inertia_kg_m2, dtype=np.float64)
        if tensor.shape != (3, 3) or not np.all(np.isfinite(tensor)):
            raise ArgumentError("inertia: a finite tensor (3, 3) expected")
        if np.abs(tensor - tensor.T).max() > 1e-9 * np.abs(tensor).max():
            raise ArgumentError("inertia: a symmetric tensor expected")
        moments = np.linalg.eigvalsh(tensor)
        if moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise ArgumentError(
                "inertia: positive principal moments expected, none above the sum of the others"
            )
        object.__setattr__(self, "inertia_kg_m2", read_only(tensor))

    def momentum_n_m_s(self, rate_rad_s: ArrayLike) -> FloatArray:
        """Angular momentum (..., 3) in the body."""
        return np.asarray(as_components(rate_rad_s, 3, "rate") @ self.inertia_kg_m2)

    def energy_j(self, rate_rad_s: ArrayLike) -> FloatArray:
        """Energy of rotation (...)."""
        rate = as_components(rate_rad_s, 3, "rate")
        return np.asarray(0.5 * np.sum(self.momentum_n_m_s(rate) * rate, axis=-1))

    def acceleration_rad_s2(self, rate_rad_s: ArrayLike, torque_n_m: ArrayLike) -> FloatArray:
        """Angular acceleration (..., 3): J w' = M − w × J w. *Source*: T (2.35)."""
        rate = as_components(rate_rad_s, 3, "rate")
        net = as_components(torque_n_m, 3, "torque") - np.cross(rate, self.momentum_n_m_s(rate))
        return np.asarray(np.linalg.solve(self.inertia_kg_m2, net[..., None])[..., 0])

    def gravity_gradient_n_m(self, position_body_m: ArrayLike) -> FloatArray:
        """Torque (..., 3) of the Earth's point mass, of the body's position from its centre.

        3 GM / r^5 r × J r. *Source*: Markley & Crassidis 2014, (3.155).
        """
        r = as_components(position_body_m, 3, "position")
        size = np.linalg.norm(r, axis=-1, keepdims=True)
        return np.asarray(3.0 * GM_M3_S2 / size**5 * np.cross(r, self.momentum_n_m_s(r)))


@dataclass(frozen=True, slots=True, eq=False)
class RigidBodyMotion:
    """Simulated rotation: `quat_xyzw` (n, 4) R_inertial_body and body rate `rate_rad_s` (n, 3)."""

    times_s: FloatArray
    quat_xyzw: FloatArray
    rate_rad_s: FloatArray

    @property
    def R_inertial_body(self) -> Rotation:
        """The attitudes as rotations (n,)."""
        return Rotation.from_quat(np.array(self.quat_xyzw))


def simulate_rotation(
    body: RigidBody,
    times_s: ArrayLike,
    quat_start_xyzw: ArrayLike,
    rate_start_rad_s: ArrayLike,
    torques: tuple[Torque, ...] = (),
) -> RigidBodyMotion:
    """Integrate attitude and rate from the first of `times_s` (n,) under the sum of `torques`.

    An eighth-order Runge-Kutta method holds energy and momentum of free motion to about 1e-10 of
    themselves over hundreds of turns. A torque that jumps belongs in a run of its own.
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "times")
    quat = require_finite(as_components(quat_start_xyzw, 4, "start quaternion"), "start quaternion")
    rate = require_finite(as_components(rate_start_rad_s, 3, "start rate"), "start rate")
    size = float(np.linalg.norm(quat))
    if quat.shape != (4,) or rate.shape != (3,) or not size > 0.0:
        raise ArgumentError("rigid body: one start quaternion (4,) and rate (3,) expected")
    if len(times) == 1:
        return RigidBodyMotion(read_only(times), read_only([quat / size]), read_only([rate]))

    inverse = np.asarray(np.linalg.inv(body.inertia_kg_m2), dtype=np.float64)

    def slope(t: float, state: FloatArray) -> FloatArray:
        torque = np.zeros(3)
        if torques:
            unit = state[:4] / np.sqrt(state[:4] @ state[:4])
            for part in torques:
                torque = torque + part(t, unit, state[4:])
        result: FloatArray = _slope(state, torque, body.inertia_kg_m2, inverse)
        return result

    solution = solve_ivp(
        slope,
        (times[0], times[-1]),
        np.concatenate([quat / size, rate]),
        method="DOP853",
        t_eval=times,
        rtol=_RELATIVE_TOLERANCE,
        atol=1e-14,
    )
    if not solution.success:
        raise ConvergenceError(f"rigid body: {solution.message}")
    states = solution.y.T
    unit = states[:, :4] / np.linalg.norm(states[:, :4], axis=1, keepdims=True)
    return RigidBodyMotion(read_only(times), read_only(unit), read_only(states[:, 4:]))


def gravity_gradient(body: RigidBody, orbit: Orbit, first_s: float, last_s: float) -> Torque:
    """Gravity-gradient torque along `orbit` between two times from its epoch."""
    if not first_s < last_s:
        raise ArgumentError("gravity gradient: an increasing span expected")
    knots = np.linspace(first_s, last_s, int(np.ceil((last_s - first_s) / _ORBIT_KNOT_S)) + 2)
    # Knots 10 s apart: the spline is within a millimetre of the orbit.
    position = CubicHermiteSpline(knots, *orbit.states(knots), extrapolate=True)

    def torque(time_s: float, quat_xyzw: FloatArray, rate_rad_s: FloatArray) -> FloatArray:
        x, y, z, w = quat_xyzw
        return body.gravity_gradient_n_m(np.array(rotate(-x, -y, -z, w, *position(time_s))))

    return torque


@njit(cache=True, error_model="numpy")
def _slope(
    state: FloatArray, torque: FloatArray, inertia: FloatArray, inverse: FloatArray
) -> FloatArray:
    """Return the derivative (7,) of quaternion and rate: T (2.28) and (2.35)."""
    slope = np.empty(7)
    x, y, z = state[4], state[5], state[6]
    slope[0], slope[1], slope[2], slope[3] = quat_multiply(
        state[0], state[1], state[2], state[3], 0.5 * x, 0.5 * y, 0.5 * z, 0.0
    )
    hx = inertia[0, 0] * x + inertia[0, 1] * y + inertia[0, 2] * z
    hy = inertia[1, 0] * x + inertia[1, 1] * y + inertia[1, 2] * z
    hz = inertia[2, 0] * x + inertia[2, 1] * y + inertia[2, 2] * z
    mx = torque[0] - (y * hz - z * hy)
    my = torque[1] - (z * hx - x * hz)
    mz = torque[2] - (x * hy - y * hx)
    for i in range(3):
        slope[4 + i] = inverse[i, 0] * mx + inverse[i, 1] * my + inverse[i, 2] * mz
    return slope
