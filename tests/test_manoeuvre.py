"""Profiles are smooth and go where they say; the attitude they make turns at the rate it says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError
from geoposition.orbit_frame import R_inertial_orbit_nadir, orbit_angles
from geoposition.sensors.kinematics import attitude_of_rate
from geoposition.sensors.manoeuvre import Manoeuvre, Scan, Slews, Steady, Swing
from geoposition.sensors.simulate_attitude import Pointing, Vibration
from geoposition.sensors.simulate_orbit import Orbit
from geoposition.timescale import Epoch


@pytest.fixture(scope="module")
def orbit() -> Orbit:
    epoch = Epoch.from_utc("2015-08-29T06:08:00Z")
    return Orbit.over(epoch, np.radians(113.0), np.radians(34.5), 490e3, np.radians(97.35))


def derivative(profile, times: np.ndarray, h: float = 1e-3) -> np.ndarray:
    return (profile.angle_rad(times + h) - profile.angle_rad(times - h)) / (2 * h)


def test_slews_rest_before_between_and_after() -> None:
    slews = Slews([10.0, 60.0], [20.0, 40.0], np.radians([0.0, 30.0, -20.0]))
    still = slews.angle_rad(np.array([-5.0, 10.0, 30.0, 45.0, 60.0, 100.0, 500.0]))
    assert np.degrees(still) == pytest.approx([0, 0, 30, 30, 30, -20, -20], abs=1e-12)
    assert np.degrees(slews.angle_rad(np.array([20.0, 80.0]))) == pytest.approx([15.0, 5.0])
    times = np.linspace(10.0, 30.0, 20_001)
    rate = derivative(slews, times)
    assert rate.max() == pytest.approx(1.875 * np.radians(30.0) / 20.0, rel=1e-6)
    acceleration = np.gradient(rate, times)
    assert np.abs(acceleration).max() == pytest.approx(5.774 * np.radians(30) / 400, rel=1e-3)
    assert np.abs(acceleration[[2, -3]]).max() < 1e-4 * np.abs(acceleration).max() * 100


def test_a_scan_has_its_rate_and_rests_around_it() -> None:
    scan = Scan(100.0, 20.0, np.radians(-0.5), np.radians(3.0), ramp_s=8.0)
    inside = np.linspace(100.0, 120.0, 50)
    assert derivative(scan, inside) == pytest.approx(np.radians(-0.5), abs=1e-9)
    assert scan.angle_rad(np.array(110.0)) == pytest.approx(np.radians(3.0), abs=1e-15)
    outside = np.array([0.0, 91.9, 128.1, 300.0])
    assert derivative(scan, outside) == pytest.approx(0.0, abs=1e-12)
    turned = np.degrees(scan.angle_rad(np.array([0.0, 300.0])) - scan.value_rad)
    assert turned == pytest.approx([7.0, -7.0], abs=1e-9)  # (20 + 8) * 0.25


def test_steady_profiles_are_the_plain_pointing(orbit: Orbit) -> None:
    times = np.linspace(-20.0, 20.0, 9)
    jitter = (Vibration(0.65, np.full(3, 1e-5), np.array([0.0, 1.0, 2.0])),)
    plain = Pointing(0.1, -0.05, 0.02, vibrations=jitter)
    guided = Manoeuvre(Steady(0.1), Steady(-0.05), Steady(0.02), vibrations=jitter)
    apart = plain.R_gcrs_body(orbit, times).inv() * guided.R_gcrs_body(orbit, times)
    assert apart.magnitude().max() < 1e-14
    apart = plain.R_itrs_body(orbit, times).inv() * guided.R_itrs_body(orbit, times)
    assert apart.magnitude().max() < 1e-14


def test_the_angles_in_the_orbit_frame_follow_the_profiles(orbit: Orbit) -> None:
    times = np.linspace(0.0, 100.0, 51)
    made = Manoeuvre(
        Slews([20.0], [40.0], [0.0, 0.4]),
        Scan(40.0, 20.0, 2e-3),
        Swing(0.05, 0.02),
        yaw_steering=False,
    )
    frame = R_inertial_orbit_nadir(*orbit.states(times))
    angles = orbit_angles(frame.inv() * made.R_gcrs_body(orbit, times))
    assert angles.roll_rad == pytest.approx(made.roll.angle_rad(times), abs=1e-12)
    assert angles.pitch_rad == pytest.approx(made.pitch.angle_rad(times), abs=1e-12)
    assert angles.yaw_rad == pytest.approx(made.yaw.angle_rad(times), abs=1e-12)


def test_integrating_the_rate_gives_the_attitude(orbit: Orbit) -> None:
    times = np.linspace(0.0, 60.0, 61)
    made = Manoeuvre(Slews([10.0], [40.0], [0.0, 0.5]), Swing(0.1, 0.02), Steady(0.1))
    truth = made.R_gcrs_body(orbit, times)
    quats = attitude_of_rate(
        lambda t: made.rate_rad_s(orbit, t), times, truth[0].as_quat(), substeps=4
    )
    assert (truth.inv() * Rotation.from_quat(quats)).magnitude().max() < 5e-9


def test_misuse_is_refused() -> None:
    with pytest.raises(ArgumentError, match="one angle more"):
        Slews([0.0], [1.0], [0.0])
    with pytest.raises(ArgumentError, match="before the next"):
        Slews([0.0, 1.0], [2.0, 1.0], [0.0, 1.0, 2.0])
    with pytest.raises(ArgumentError, match="ramp"):
        Scan(0.0, 1.0, 0.1, ramp_s=0.0)
