"""P's case: the simulated telemetry has the figures it claims."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.constants import GM_M3_S2, WGS84_A_M
from geoposition.errors import ArgumentError, SpanError
from geoposition.sensors.angular_band import SensorBand
from geoposition.sensors.angular_displacement import installation_undone
from geoposition.sensors.jitter_scene import (
    DEG_H_RAD_S,
    HEADS,
    PAPER_LINES,
    ZY3_LINE,
    JitterScene,
    JitterSceneOptions,
    simulate_jitter_scene,
)
from geoposition.sensors.kinematics import relative_rotvec_rad
from geoposition.sensors.simulate import ARCSEC_RAD


@pytest.fixture(scope="module")
def scene() -> JitterScene:
    return simulate_jitter_scene(seed=3)


def short(**changes: object) -> JitterScene:
    return simulate_jitter_scene(JitterSceneOptions(duration_s=4.0, **changes), seed=5)  # type: ignore[arg-type]


def test_sizes_and_spans(scene: JitterScene) -> None:
    assert len(scene.sensor) == 600_001
    assert scene.sensor.kind == "increment"
    assert scene.sensor.times_s[[0, -1]].tolist() == [-30.0, 30.0]
    assert len(scene.star) == 2 * 601
    assert scene.star.heads == HEADS


def test_the_motion_is_the_orbits_and_the_jitter_lines(scene: JitterScene) -> None:
    times = np.linspace(-30.0, 30.0, 61)
    rate = relative_rotvec_rad(scene.R_inertial_body(times).as_quat())
    mean_motion = np.sqrt(GM_M3_S2 / (WGS84_A_M + 490e3) ** 3)
    assert np.linalg.norm(rate, axis=1) == pytest.approx(mean_motion, rel=0.01)
    seconds = np.arange(10_000) / 10_000.0
    spectrum = 2.0 * np.abs(np.fft.rfft(scene.jitter_rad(seconds), axis=0)) / 10_000
    for line in PAPER_LINES:
        amplitude = spectrum[round(line.frequency_hz)] / ARCSEC_RAD
        assert amplitude == pytest.approx(line.amplitude_arcsec, abs=1e-9)
    spectrum[[200, 300, 350]] = 0.0
    assert spectrum.max() < 1e-12
    assert np.degrees(2 * 0.5 / 490e3) * 3600 == pytest.approx(2 * 0.210, rel=0.01)


def test_the_sensor_has_its_noise_and_drift(scene: JitterScene) -> None:
    truth = relative_rotvec_rad(scene.motion.quat_xyzw(scene.sensor.times_s))
    error = scene.sensor.increments_rad() - truth
    assert np.std(error, axis=0) == pytest.approx(0.015 * ARCSEC_RAD * 0.01, rel=0.01)
    drift = scene.installation.drift_rad_s
    assert np.abs(drift) == pytest.approx(0.5 * DEG_H_RAD_S, rel=1e-12)
    # the mean over 60 s: sigma_v / sqrt(60)
    assert np.abs(error.sum(axis=0) / 60.0 - drift).max() < 4 * 0.015 * ARCSEC_RAD / 60**0.5
    # independent from sample to sample
    assert abs(np.corrcoef(error[1:, 0], error[:-1, 0])[0, 1]) < 0.005


def test_the_heads_have_their_noise_in_the_body(scene: JitterScene) -> None:
    star = scene.star
    body = star.R_inertial_sensor
    for index, name in enumerate(star.heads):
        rows = star.head == index
        measured = body[rows] * scene.mounting.rotation(name).inv()
        error = (scene.R_inertial_body(star.times_s[rows]).inv() * measured).as_rotvec()
        assert np.std(error, axis=0) == pytest.approx(5.0 * ARCSEC_RAD, rel=0.1)
    boresights = [scene.mounting.rotation(name).apply([0.0, 0.0, 1.0]) for name in HEADS]
    assert boresights[0] @ boresights[1] == pytest.approx(np.cos(np.radians(80.0)), abs=1e-12)
    assert all(b[2] < 0.0 for b in boresights)  # away from the Earth, Z is down


def test_the_onboard_product_is_its_samples_joined_by_lines(scene: JitterScene) -> None:
    knots = np.arange(-300, 301) / 10.0
    error = (
        scene.R_inertial_body(knots).inv() * scene.onboard.rotation(knots)
    ).as_rotvec() / ARCSEC_RAD
    assert np.std(error, axis=0) == pytest.approx([0.5, 0.75, 0.5], rel=0.1)
    low, high = scene.onboard.rotation([0.0])[0], scene.onboard.rotation([0.1])[0]
    half = low * Rotation.from_rotvec(0.5 * (low.inv() * high).as_rotvec())
    assert (half.inv() * scene.onboard.rotation([0.05])[0]).magnitude() < 1e-12


def test_the_truth_is_an_attitude_for_the_imaging_models(scene: JitterScene) -> None:
    times = np.arange(-1000, 1001) / 10_000.0
    attitude = scene.true_attitude(times)
    assert attitude.frame == "gcrs"
    middle = times[:-1] + 5e-5
    error = (attitude.rotation(middle).inv() * scene.R_inertial_body(middle)).magnitude()
    assert error.max() < 0.001 * ARCSEC_RAD
    with pytest.raises(SpanError, match="jitter scene"):
        scene.R_inertial_body([31.0])


def test_the_same_seed_gives_the_same_telemetry() -> None:
    one, two, other = short(), short(), simulate_jitter_scene(JitterSceneOptions(duration_s=4.0))
    assert np.array_equal(one.sensor.values, two.sensor.values)
    assert np.array_equal(one.star.quat_xyzw, two.star.quat_xyzw)
    assert not np.array_equal(one.sensor.values, other.sensor.values)


def test_zy3_line_installation_and_band() -> None:
    slow = short(lines=(ZY3_LINE,))
    swing = slow.jitter_rad(np.linspace(-2.0, 2.0, 4001)) / ARCSEC_RAD
    assert np.abs(swing).max(axis=0) == pytest.approx([4.0, 4.0, 0.0], abs=1e-3)
    off = short(installation_arcsec=200.0, scale_ppm=500.0)
    clean = installation_undone(off.sensor, off.installation)
    truth = relative_rotvec_rad(off.motion.quat_xyzw(off.sensor.times_s))
    assert np.abs(np.sum(clean.increments_rad() - truth, axis=0)).max() < 0.2 * ARCSEC_RAD
    assert np.abs(np.sum(off.sensor.increments_rad() - truth, axis=0)).max() > 0.4 * ARCSEC_RAD
    felt = short(band=SensorBand(), drift_deg_h=0.0)
    assert np.abs(felt.sensor.increments_rad().sum(axis=0)).max() < 0.2 * ARCSEC_RAD


def test_impossible_options_are_refused() -> None:
    with pytest.raises(ArgumentError, match="positive"):
        JitterSceneOptions(duration_s=0.0)
