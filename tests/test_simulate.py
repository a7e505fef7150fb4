"""Simulated scenes obey the physics they claim, and repeat themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geoposition.constants import EARTH_RATE_RAD_S, GM_M3_S2, WGS84_A_M
from geoposition.ellipsoid import ecef_to_geodetic, geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.frames import matrix_itrs_gcrs
from geoposition.rotation import rotation_difference_rad
from geoposition.sensors.simulate import (
    ARCSEC_RAD,
    CameraDesign,
    SceneOptions,
    SimulatedScene,
    simulate_measurements,
    simulate_scene,
    zy3_cameras,
)
from geoposition.sensors.simulate_attitude import Pointing, Vibration, drift_angle_rad
from geoposition.sensors.simulate_orbit import Orbit, gravity, potential
from geoposition.timescale import Epoch

EPOCH = Epoch.from_utc("2012-09-03T03:15:00Z")
LON, LAT = np.radians(113.0), np.radians(34.5)
INCLINATION = np.radians(97.42)


@pytest.fixture(scope="module")
def orbit() -> Orbit:
    return Orbit.over(EPOCH, LON, LAT, 506e3, INCLINATION)


@pytest.fixture(scope="module")
def scene() -> SimulatedScene:
    return simulate_scene(seed=7)


# The orbit -----------------------------------------------------------------------------------


def test_gravity_is_the_slope_of_the_potential() -> None:
    rng = np.random.default_rng(1)
    pole = np.array([0.6, 0.0, 0.8])
    at = rng.normal(size=(20, 3))
    at *= 6.9e6 / np.linalg.norm(at, axis=1, keepdims=True)
    step = 100.0
    slope = np.stack(
        [
            (potential(at + d, pole) - potential(at - d, pole)) / (2 * step)
            for d in step * np.eye(3)
        ],
        axis=-1,
    )
    # central differences of a 1/r field: (step / r)^2 of 8 m/s^2
    np.testing.assert_allclose(gravity(at, pole), -slope, rtol=0, atol=1e-7)


def test_energy_and_momentum_about_the_pole_are_kept(orbit: Orbit) -> None:
    position, velocity = orbit.states(np.linspace(0.0, 5700.0, 58))
    energy = 0.5 * np.sum(velocity**2, axis=1) + potential(position, orbit.pole_gcrs)
    momentum = np.cross(position, velocity) @ orbit.pole_gcrs
    assert np.ptp(energy) < 1e-10 * abs(energy[0])
    assert np.ptp(momentum) < 1e-10 * abs(momentum[0])


def test_period_and_sun_synchronous_node(orbit: Orbit) -> None:
    times = np.linspace(0.0, 12 * 3600.0, 4321)
    position, velocity = orbit.states(times)
    pole = orbit.pole_gcrs
    height = position @ pole
    rising = np.flatnonzero((height[:-1] < 0) & (height[1:] >= 0))
    crossing = times[rising] - height[rising] * np.diff(times)[0] / np.diff(height)[rising]
    kepler_s = 2 * np.pi * np.sqrt((WGS84_A_M + 506e3) ** 3 / GM_M3_S2)
    assert np.diff(crossing).mean() == pytest.approx(kepler_s, rel=2e-3)
    # the node follows the Sun: 360 degrees a tropical year
    normal = np.cross(position, velocity)
    node = np.cross(pole, normal)
    east, north = np.eye(3)[0] - pole[0] * pole, np.cross(pole, np.eye(3)[0])
    angle = np.unwrap(np.arctan2(node @ north, node @ east))
    per_day = np.degrees(np.polyfit(times, angle, 1)[0]) * 86400.0
    assert per_day == pytest.approx(360.0 / 365.2422, rel=0.02)


def test_orbit_passes_over_the_place_and_goes_south(orbit: Orbit) -> None:
    to_itrs = matrix_itrs_gcrs(EPOCH, 0.0)
    place = geodetic_to_ecef([LON, LAT, 0.0])
    up = to_itrs @ orbit.position_gcrs_m
    assert np.linalg.norm(np.cross(up / np.linalg.norm(up), place / np.linalg.norm(place))) < 1e-9
    assert (to_itrs @ orbit.velocity_gcrs_m_s)[2] < 0
    normal = np.cross(orbit.position_gcrs_m, orbit.velocity_gcrs_m_s)
    tilt = np.arccos(normal @ orbit.pole_gcrs / np.linalg.norm(normal))
    assert tilt == pytest.approx(INCLINATION, abs=1e-12)
    north = Orbit.over(EPOCH, LON, LAT, 506e3, INCLINATION, descending=False)
    assert (to_itrs @ north.velocity_gcrs_m_s)[2] > 0


def test_there_and_back(orbit: Orbit) -> None:
    position, velocity = orbit.states([-40.0, 0.0, 60.0])
    np.testing.assert_array_equal(position[1], orbit.position_gcrs_m)
    for k, time in ((0, -40.0), (2, 60.0)):
        again = replace(orbit, position_gcrs_m=position[k], velocity_gcrs_m_s=velocity[k])
        back = again.states([-time])
        np.testing.assert_allclose(back[0][0], orbit.position_gcrs_m, rtol=0, atol=1e-6)
        np.testing.assert_allclose(back[1][0], orbit.velocity_gcrs_m_s, rtol=0, atol=1e-9)


def test_orbit_refuses_what_it_cannot_reach() -> None:
    with pytest.raises(ArgumentError, match="does not reach latitude 70"):
        Orbit.over(EPOCH, 0.0, np.radians(70.0), 506e3, np.radians(50.0))
    with pytest.raises(ArgumentError, match="altitude"):
        Orbit.over(EPOCH, 0.0, 0.0, 500.0, INCLINATION)


# The attitude --------------------------------------------------------------------------------


def test_body_looks_down_with_its_nose_along_the_track(orbit: Orbit) -> None:
    times = np.linspace(-40.0, 40.0, 81)
    position, velocity = orbit.states(times)
    body = Pointing().R_gcrs_body(orbit, times).as_matrix()
    down = -position / np.linalg.norm(position, axis=1, keepdims=True)
    np.testing.assert_allclose(body[:, :, 2], down, rtol=0, atol=1e-15)
    # over the turning Earth nothing moves sideways in the body
    moving = velocity - np.cross(EARTH_RATE_RAD_S * orbit.pole_gcrs, position)
    sideways = np.sum(body[:, :, 1] * moving, axis=1)
    assert np.max(np.abs(sideways)) < 1e-8 * 7e3
    # southward the Earth carries the ground to the left: the nose turns right, by 3.1 degrees
    yaw = np.degrees(drift_angle_rad(position, velocity, orbit.pole_gcrs))
    expected = np.degrees(EARTH_RATE_RAD_S * 6884e3 * np.cos(LAT) / 7609.0)
    assert yaw[40] == pytest.approx(expected, abs=0.1)


def test_pointing_angles_and_vibration(orbit: Orbit) -> None:
    times = np.linspace(0.0, 10.0, 2001)
    shake = Vibration(0.65, np.array([1.0, 2.0, 0.5]) * 1e-5, np.array([0.0, 1.0, 2.0]))
    still = Pointing(yaw_steering=False, roll_rad=0.1)
    turn = rotation_difference_rad(
        replace(still, vibrations=(shake,)).R_gcrs_body(orbit, times),
        still.R_gcrs_body(orbit, times),
    )
    np.testing.assert_allclose(turn, shake.turn_rad(times), rtol=0, atol=1e-13)
    assert np.max(turn, axis=0) == pytest.approx(shake.amplitude_rad, rel=1e-4)
    spectrum = np.abs(np.fft.rfft(turn[:-1, 0], 20000))
    assert np.fft.rfftfreq(20000, 0.005)[np.argmax(spectrum)] == pytest.approx(0.65, abs=0.02)
    # in the nadir frame positive roll looks to the left
    position, velocity = orbit.states(times[:1])
    left = np.cross(position[0], velocity[0])
    assert still.R_gcrs_body(orbit, times[:1]).as_matrix()[0, :, 2] @ left > 0
    with pytest.raises(ArgumentError, match="frequency"):
        Vibration(0.0, np.zeros(3), np.zeros(3))


# The scene -----------------------------------------------------------------------------------


def test_true_ephemeris_is_the_orbit(scene: SimulatedScene) -> None:
    times = np.arange(-30.0, 30.0) + 0.5
    position, _ = scene.orbit.states(times)
    expected = np.einsum("nij,nj->ni", matrix_itrs_gcrs(scene.orbit.epoch, times), position)
    np.testing.assert_allclose(scene.true_ephemeris.position_m(times), expected, atol=2e-6, rtol=0)


def test_true_attitude_looks_down_within_drift_and_jitter(scene: SimulatedScene) -> None:
    times = np.linspace(-35.0, 35.0, 701)
    axis = scene.true_attitude.rotation(times).as_matrix()[:, :, 2]
    down = -scene.true_ephemeris.position_m(times)
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    off = np.linalg.norm(np.cross(axis, down), axis=1) / ARCSEC_RAD
    options = scene.options
    most = np.hypot(*(options.drift_arcsec + np.array(options.jitter_arcsec[:2])))
    assert 5.0 < np.max(off) < most


def test_ground_samples_are_those_published(scene: SimulatedScene) -> None:
    for name, row_m, col_m in (("forward", 3.5, 3.3), ("nadir", 2.1, 2.1), ("backward", 3.5, 3.3)):
        model = scene.true[name]
        # off the seams of the CCDs
        pixel = np.array([[0.5, 0.3], [0.5, 0.3]]) * model.shape
        step = model.image_to_ground(pixel + [[1.0, 0.0], [0.0, 1.0]], 1000.0)
        ground = geodetic_to_ecef(step.geodetic)
        start = geodetic_to_ecef(model.image_to_ground(pixel[0], 1000.0).geodetic)
        size = np.linalg.norm(ground - start, axis=1)
        assert size == pytest.approx([row_m, col_m], abs=0.1), name


def test_images_share_a_centre_and_have_north_up(scene: SimulatedScene) -> None:
    centre = geodetic_to_ecef(scene.centre_geodetic)
    order = []
    for model in scene.true.values():
        lines, samples = model.shape
        corners = [[0, 0], [0, samples - 1], [lines - 1, 0], [(lines - 1) / 2, (samples - 1) / 2]]
        found = model.image_to_ground(corners, scene.centre_geodetic[2])
        assert np.all(found.flag == Flag.OK)
        lon, lat = found.geodetic[:, 0], found.geodetic[:, 1]
        assert lon[1] > lon[0]
        assert lat[2] < lat[0]
        # yaw steering keeps the three strips on each other
        assert np.linalg.norm(geodetic_to_ecef(found.geodetic[3]) - centre) < 500.0
        order.append(model.camera.timing.time_s(0.0))
    assert order == sorted(order)
    place = ecef_to_geodetic(centre)
    assert np.abs(np.degrees(place[:2]) - [113.0, 34.5]).max() < 0.01


def test_every_pixel_projects_back(scene: SimulatedScene) -> None:
    rng = np.random.default_rng(3)
    for model in (*scene.true.values(), *scene.measured.values()):
        pixel = rng.uniform(0.0, 1.0, (500, 2)) * (np.array(model.shape) - 1.0)
        ground = model.image_to_ground(pixel, rng.uniform(500.0, 2500.0, 500))
        back = model.ground_to_image(ground.geodetic)
        seam = np.any(
            [np.abs(pixel[:, 1] - d.last_sample) < 12 for d in model.camera.detectors], axis=0
        )
        assert np.max(np.abs(back.image_px - pixel)[~seam]) < 1e-5


def test_ccds_stand_as_designed() -> None:
    design = zy3_cameras()[0]
    camera = design.camera(EPOCH, 0.0, np.zeros(3))
    step = design.pitch_m / design.focal_length_m
    assert camera.shape == (design.lines, 16384)
    for k, ccd in enumerate(camera.detectors):
        middle = 0.5 * (ccd.first_sample + ccd.last_sample)
        x, y = camera.tangents(k, middle)
        r2 = (8192.0 * step) ** 2
        assert x == pytest.approx(design.ccd_offset_px[k] * step, abs=1e-9 + step * 2e-4)
        assert y == pytest.approx((8191.5 - middle) * step, rel=design.radial[0] * r2)
    # forward looks forward: its axis has a positive X in the body
    assert camera.R_body_camera.apply([0.0, 0.0, 1.0])[0] == pytest.approx(np.sin(np.radians(22)))


def test_telemetry_has_the_stated_noise(scene: SimulatedScene) -> None:
    options = scene.options
    curve = scene.measured_attitude.curve
    times = np.asarray(curve.knots_s)
    assert np.diff(times) == pytest.approx(1.0 / options.star_hz)
    error = rotation_difference_rad(curve.rotation(times), scene.true_attitude.rotation(times))
    sigma = np.array(options.star_noise_arcsec) * ARCSEC_RAD
    n = len(times)
    # a chi-square of n degrees has a relative deviation of sqrt(2 / n): four of them
    assert np.sum((error / sigma) ** 2, axis=0) / n == pytest.approx(1.0, abs=4 * np.sqrt(2 / n))
    assert scene.measured_attitude.covariance_rad2 is not None
    np.testing.assert_allclose(
        np.diagonal(scene.measured_attitude.covariance_rad2[0]), sigma**2, rtol=1e-12
    )
    seconds = np.asarray(scene.measured_ephemeris.curve.knots_s)
    off = scene.measured_ephemeris.position_m(seconds) - scene.true_ephemeris.position_m(seconds)
    chi2 = np.sum((off / options.gps_sigma_m) ** 2) / off.size
    assert chi2 == pytest.approx(1.0, abs=4 * np.sqrt(2 / off.size))


def test_mounting_errors_are_those_planted(scene: SimulatedScene) -> None:
    for name, error in scene.mounting_error_rad.items():
        found = rotation_difference_rad(
            scene.measured[name].camera.R_body_camera, scene.true[name].camera.R_body_camera
        )
        np.testing.assert_allclose(found, error, rtol=0, atol=1e-15)
        assert 0.1 * ARCSEC_RAD < np.linalg.norm(error) < 15 * ARCSEC_RAD


def test_same_seed_same_scene(scene: SimulatedScene) -> None:
    again, other = simulate_scene(seed=7), simulate_scene(seed=8)
    place = scene.centre_geodetic
    for name, model in scene.measured.items():
        seen = model.ground_to_image(place).image_px
        np.testing.assert_array_equal(again.measured[name].ground_to_image(place).image_px, seen)
        assert np.any(other.measured[name].ground_to_image(place).image_px != seen)


def test_measurements_have_the_stated_noise_and_stay_inside(scene: SimulatedScene) -> None:
    model = scene.true["nadir"]
    pixel = np.random.default_rng(4).uniform(0.1, 0.9, (4000, 2)) * model.shape
    ground = model.image_to_ground(pixel, 1000.0).geodetic
    outside = ground[:1] + [[0.5, 0.0, 0.0]]
    beyond = model.image_to_ground([-50.0, 5000.0], 1000.0).geodetic[None]
    image, flag = simulate_measurements(
        model, np.concatenate([ground, outside, beyond]), 0.3, np.random.default_rng(5)
    )
    truth = model.ground_to_image(ground).image_px
    n = truth.size
    spread = np.sum(((image[:-2] - truth) / 0.3) ** 2) / n
    assert spread == pytest.approx(1.0, abs=4 * np.sqrt(2 / n))
    assert np.all(np.isnan(image[-2:]))
    assert flag[-1] == Flag.OUTSIDE_IMAGE
    assert flag[-2] > Flag.OUTSIDE_IMAGE


def test_scene_refusals() -> None:
    camera = zy3_cameras()[1]
    with pytest.raises(ArgumentError, match="name once"):
        simulate_scene(cameras=(camera, camera))
    with pytest.raises(ArgumentError, match="does not reach"):
        simulate_scene(SceneOptions(lat_deg=86.0))


def test_a_scene_of_ones_own() -> None:
    design = CameraDesign("pan", 0.05, 8.0, 10e-6, 2, 2000, 3000, 1e-4)
    options = SceneOptions(lon_deg=-70.0, lat_deg=-33.0, height_range_m=(0.0, 5000.0))
    scene = simulate_scene(options, 1, (design,))
    assert list(scene.true) == ["pan"]
    place = np.degrees(scene.true["pan"].image_to_ground([1500.0, 1900.0], 2500.0).geodetic[:2])
    assert place == pytest.approx([-70.0, -33.0], abs=0.03)
