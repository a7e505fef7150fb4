"""Euler's equations: what must be conserved is, and closed forms come out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.constants import GM_M3_S2, WGS84_A_M
from geoposition.errors import ArgumentError
from geoposition.orbit_frame import R_inertial_orbit_nadir, orbit_angles
from geoposition.sensors.rigid_body import RigidBody, gravity_gradient, simulate_rotation
from geoposition.sensors.simulate_orbit import Orbit
from geoposition.timescale import Epoch

SATELLITE = RigidBody(np.array([[900.0, 20.0, -10.0], [20.0, 1200.0, 30.0], [-10.0, 30.0, 700.0]]))


def test_free_motion_keeps_energy_and_inertial_momentum() -> None:
    times = np.linspace(0.0, 600.0, 101)
    # near the middle axis: the turn that tumbles over
    motion = simulate_rotation(SATELLITE, times, [0.1, 0.2, 0.3, 0.9], [1.0, 0.02, 0.3])
    energy = SATELLITE.energy_j(motion.rate_rad_s)
    assert energy == pytest.approx(energy[0], rel=2e-10)
    momentum = motion.R_inertial_body.apply(SATELLITE.momentum_n_m_s(motion.rate_rad_s))
    assert np.abs(momentum - momentum[0]).max() < 1e-8 * np.linalg.norm(momentum[0])
    assert np.ptp(motion.rate_rad_s, axis=0).max() > 0.3  # it does move


def test_a_symmetric_body_precesses_at_the_closed_form() -> None:
    along, across, spin, wobble = 500.0, 800.0, 0.4, 0.05
    body = RigidBody(np.diag([across, across, along]))
    times = np.linspace(0.0, 300.0, 61)
    motion = simulate_rotation(body, times, [0, 0, 0, 1], [wobble, 0.0, spin])
    nutation = (along - across) / across * spin
    expected = np.stack(
        [wobble * np.cos(nutation * times), wobble * np.sin(nutation * times), 0 * times + spin], -1
    )
    assert motion.rate_rad_s == pytest.approx(expected, abs=1e-10)
    momentum = body.momentum_n_m_s(motion.rate_rad_s[0])
    precession = Rotation.from_rotvec(np.outer(times, momentum / across))
    own = Rotation.from_rotvec(np.outer(times, [0.0, 0.0, -nutation]))
    assert (motion.R_inertial_body.inv() * precession * own).magnitude().max() < 1e-9


def test_a_torque_about_a_principal_axis_spins_up() -> None:
    body = RigidBody(np.diag([900.0, 1200.0, 700.0]))
    times = np.linspace(0.0, 50.0, 11)
    motion = simulate_rotation(
        body, times, [0, 0, 0, 1], [0, 0, 0], (lambda t, q, w: np.array([0.0, 2.4, 0.0]),)
    )
    assert motion.rate_rad_s[:, 1] == pytest.approx(2.4 / 1200.0 * times, abs=1e-13)
    turned = Rotation.from_rotvec(np.outer(0.5 * 2e-3 * times**2, [0, 1, 0]))
    assert (motion.R_inertial_body.inv() * turned).magnitude().max() < 1e-11


def test_torques_change_inertial_momentum_by_their_integral() -> None:
    times = np.linspace(0.0, 100.0, 4001)

    def inertial(t: float, quat: np.ndarray, rate: np.ndarray) -> np.ndarray:
        return Rotation.from_quat(quat).inv().apply([0.3 * np.sin(0.1 * t), 0.2, -0.1])

    motion = simulate_rotation(SATELLITE, times, [0, 0, 0, 1], [0.01, 0.02, 0.03], (inertial,))
    momentum = motion.R_inertial_body.apply(SATELLITE.momentum_n_m_s(motion.rate_rad_s))
    gained = np.stack([3.0 * (1 - np.cos(0.1 * times)), 0.2 * times, -0.1 * times], -1)
    assert momentum - momentum[0] == pytest.approx(gained, abs=1e-8)


def test_gravity_gradient_librates_in_pitch_at_the_known_period() -> None:
    altitude = 500e3
    orbit = Orbit.over(Epoch.from_utc("2015-08-29T06:08:00Z"), 0.0, 0.0, altitude, np.radians(97.4))
    body = RigidBody(np.diag([1200.0, 1000.0, 400.0]))
    mean_motion = np.sqrt(GM_M3_S2 / (WGS84_A_M + altitude) ** 3)
    times = np.linspace(0.0, 5400.0, 541)
    frame = R_inertial_orbit_nadir(*orbit.states(times))
    start = (frame[0] * Rotation.from_euler("Y", 0.01)).as_quat()
    torque = gravity_gradient(body, orbit, 0.0, 5400.0)
    motion = simulate_rotation(body, times, start, [0.0, -mean_motion, 0.0], (torque,))
    pitch = orbit_angles(frame.inv() * motion.R_inertial_body).pitch_rad
    libration = mean_motion * np.sqrt(3.0 * (1200.0 - 400.0) / 1000.0)
    # J2 bends the circular orbit by a thousandth: the frame's rate with it
    design = np.stack(
        [
            np.cos(libration * times),
            np.sin(libration * times),
            np.ones_like(times),
            np.cos(2 * mean_motion * times),
            np.sin(2 * mean_motion * times),
        ],
        -1,
    )
    fit, *_ = np.linalg.lstsq(design, pitch)
    assert np.std(pitch - design @ fit) < 4e-4
    assert fit[0] == pytest.approx(0.01, rel=0.1)


def test_the_compiled_slope_is_eulers_equation() -> None:
    rate, torque, h = np.array([0.1, -0.2, 0.3]), np.array([5.0, -1.0, 2.0]), 1e-4
    motion = simulate_rotation(
        SATELLITE, [0.0, h, 2 * h], [0, 0, 0, 1], rate, (lambda t, q, w: torque,)
    )
    middle = SATELLITE.acceleration_rad_s2(motion.rate_rad_s[1], torque)
    slope = (motion.rate_rad_s[2] - motion.rate_rad_s[0]) / (2 * h)
    assert slope == pytest.approx(middle, abs=1e-9)


def test_gravity_gradient_vanishes_along_principal_axes() -> None:
    body = RigidBody(np.diag([900.0, 1200.0, 700.0]))
    torque = body.gravity_gradient_n_m(7e6 * np.concatenate([np.eye(3), [[0.6, 0.0, 0.8]]]))
    assert np.abs(torque[:3]).max() == 0.0
    by_hand = 3 * GM_M3_S2 / 7e6**3 * (900.0 - 700.0) * 0.6 * 0.8
    assert torque[3] == pytest.approx([0.0, by_hand, 0.0], rel=1e-12)


def test_impossible_bodies_are_refused() -> None:
    with pytest.raises(ArgumentError, match="symmetric"):
        RigidBody(np.array([[1.0, 0.1, 0], [0, 1, 0], [0, 0, 1]]))
    with pytest.raises(ArgumentError, match="principal"):
        RigidBody(np.diag([1.0, 1.0, 3.0]))
    with pytest.raises(ArgumentError, match="tensor"):
        RigidBody(np.eye(2))
    with pytest.raises(ArgumentError, match="start"):
        simulate_rotation(SATELLITE, [0.0, 1.0], [0, 0, 0, 0], [0, 0, 0])
    with pytest.raises(ArgumentError, match="increasing"):
        gravity_gradient(SATELLITE, None, 1.0, 1.0)  # type: ignore[arg-type]
