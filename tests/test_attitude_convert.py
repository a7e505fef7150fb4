"""Attitude between frames: against `frames` and closed forms, whatever the ephemeris carries."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError, SpanError
from geoposition.frames import R_itrs_gcrs, itrs_from_gcrs
from geoposition.orbit_frame import R_inertial_orbit, inertial_velocity_ecef
from geoposition.sensors.attitude_determination.convert import Orbit, convert
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.resample import at_times, regular_times
from geoposition.sensors.simulate_orbit import Orbit as FreeOrbit
from geoposition.timescale import Epoch

EPOCH = Epoch.from_utc("2012-01-11T02:00:00Z")
TIMES = np.arange(0.0, 301.0, 10.0)
ASKED = np.linspace(3.0, 297.0, 40)
FREE = FreeOrbit.over(EPOCH, 2.0, 0.5, 506e3, np.radians(97.42))
POSITION, VELOCITY = FREE.states(TIMES)
TRUTH = R_inertial_orbit(*FREE.states(ASKED))


def test_orbit_frame_from_inertial_samples() -> None:
    orbit = Orbit.of(TIMES, POSITION, VELOCITY, "gcrs")
    assert np.max((orbit.R_frame_orbit(ASKED).inv() * TRUTH).magnitude()) < 1e-9


@pytest.mark.parametrize("kind", ["earth-fixed", "inertial-on-itrs-axes"])
def test_both_kinds_of_earth_fixed_velocities_give_the_same_frame(kind: str) -> None:
    position, velocity = itrs_from_gcrs(POSITION, VELOCITY, EPOCH, TIMES)
    if kind != "earth-fixed":
        velocity = inertial_velocity_ecef(position, velocity)
    orbit = Orbit.of(TIMES, position, velocity, "itrs")
    found = R_itrs_gcrs(EPOCH, ASKED).inv() * orbit.R_frame_orbit(ASKED)
    # The nominal Earth rate is right to 2 mm/s of 7.6 km/s.
    assert np.max((found.inv() * TRUTH).magnitude()) < 3e-7
    ephemeris = orbit.ephemeris(EPOCH)
    middle = 0.5 * (TIMES[1:] + TIMES[:-1])
    exact, _ = itrs_from_gcrs(*FREE.states(middle), EPOCH, middle)
    assert np.max(np.linalg.norm(ephemeris.position_m(middle) - exact, axis=1)) < 0.1


def test_measured_velocities_are_used_not_the_rate_of_noisy_positions() -> None:
    rng = np.random.default_rng(2)
    times = np.arange(0.0, 301.0)
    position, velocity = FREE.states(times)
    position = position + 2.0 * rng.standard_normal(position.shape)
    velocity = velocity + 0.01 * rng.standard_normal(velocity.shape)
    orbit = Orbit.of(times, position, velocity, "gcrs")
    off = (orbit.R_frame_orbit(ASKED).inv() * TRUTH).magnitude()
    # The rate of these positions would be metres per second off: 1e-4 rad and more.
    assert np.sqrt(np.mean(off**2)) < 5e-6


def test_velocities_of_something_else_are_refused() -> None:
    with pytest.raises(ArgumentError, match="must be the rate of the positions"):
        Orbit.of(TIMES, POSITION, VELOCITY[::-1], "gcrs")
    with pytest.raises(ArgumentError, match="must be the rate"):
        Orbit.of(TIMES, POSITION, 1e-3 * VELOCITY, "gcrs")


FRAMES = ("inertial", "itrs", "orbit")


@pytest.mark.parametrize("source", FRAMES)
@pytest.mark.parametrize("target", FRAMES)
@pytest.mark.parametrize("axes", ["zenith", "nadir", "spot"])
def test_round_trips(source: str, target: str, axes: str) -> None:
    orbit = Orbit.of(TIMES, POSITION, VELOCITY, "gcrs")
    given = Rotation.random(len(ASKED), rng=np.random.default_rng(7))
    options = {"epoch": EPOCH, "orbit": orbit, "axes": axes}
    there = convert(given, ASKED, source, target, **options)  # type: ignore[arg-type]
    back = convert(there, ASKED, target, source, **options)  # type: ignore[arg-type]
    assert np.max((back.inv() * given).magnitude()) < 1e-13
    # By way of the third frame it is the same turn.
    for third in FRAMES:
        step = convert(given, ASKED, source, third, **options)  # type: ignore[arg-type]
        again = convert(step, ASKED, third, target, **options)  # type: ignore[arg-type]
        assert np.max((again.inv() * there).magnitude()) < 1e-13


def test_what_is_missing_is_said() -> None:
    given = Rotation.identity(2)
    with pytest.raises(ArgumentError, match="an epoch expected"):
        convert(given, [0.0, 1.0], "inertial", "itrs")
    with pytest.raises(ArgumentError, match="an ephemeris expected"):
        convert(given, [0.0, 1.0], "inertial", "orbit")
    orbit = Orbit.of(TIMES, POSITION, VELOCITY, "gcrs")
    with pytest.raises(SpanError):
        convert(given, [0.0, 301.0], "inertial", "orbit", orbit=orbit)


def estimate() -> AttitudeEstimate:
    times = np.array([0.0, 1.0, 3.0])
    rotation = Rotation.from_rotvec(np.outer(times, [0.1, 0.0, 0.0]))
    covariance = np.multiply.outer(np.array([1.0, 2.0, 4.0]), np.eye(6))
    bias = np.outer(times, [1.0, 2.0, 3.0])
    return AttitudeEstimate(times, rotation.as_quat(), bias, np.zeros((3, 9)), covariance)


def test_estimates_between_their_epochs() -> None:
    found = at_times(estimate(), [0.0, 0.5, 2.5, 3.0])
    np.testing.assert_allclose(
        found.R_inertial_body.as_rotvec()[:, 0], [0.0, 0.05, 0.25, 0.3], atol=1e-15
    )
    np.testing.assert_allclose(found.covariance[:, 0, 0], [1.0, 1.5, 3.5, 4.0])
    np.testing.assert_allclose(found.bias_rad_s[:, 2], [0.0, 1.5, 7.5, 9.0])
    with pytest.raises(SpanError):
        at_times(estimate(), [3.1])


def test_regular_times_end_within_the_span() -> None:
    np.testing.assert_allclose(regular_times(estimate(), 2.0), np.arange(7) / 2.0)
    assert regular_times(estimate(), 0.4)[-1] == 2.5
    assert len(regular_times(estimate(), 10.0)) == 31
    with pytest.raises(ArgumentError, match="a positive rate"):
        regular_times(estimate(), 0.0)
