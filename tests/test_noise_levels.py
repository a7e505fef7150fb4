"""Noise levels: the truth within the stated uncertainty, and sense on real telemetry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from attitude_scenes import ARCSEC, settings, telemetry
from scipy.spatial.transform import Rotation

from geoposition.errors import GeometryError
from geoposition.sensors.attitude_determination.noise import noise_levels
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.gyro import simulate_rates
from geoposition.sensors.telemetry import GyroNoise, GyroSeries, StarSeries

TRUE = GyroNoise(3e-6, 2e-7)
GYRO_TIMES = np.arange(0.0, 300.05, 0.1)
STAR_TIMES = np.arange(0.03, 300.0, 0.25)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("walk", "drift", "star"), [(1.0, 1.0, 1.0), (30.0, 0.1, 3.0)])
def test_truth_lies_within_the_stated_uncertainty(seed, walk, drift, star) -> None:
    series, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES, noise=TRUE, seed=seed)
    told = StarSeries.of(series.times_s, series.quat_xyzw, star * series.sigma_cross_rad)
    given = settings()
    given = replace(
        given, noise=GyroNoise(walk * TRUE.angle_random_walk, drift * TRUE.rate_random_walk)
    )
    found = noise_levels.estimate_noise(told, gyro, given)
    levels = np.array(
        [
            found.noise.angle_random_walk / TRUE.angle_random_walk,
            found.noise.rate_random_walk / TRUE.rate_random_walk,
            found.cross_rad[0] / (5.0 * ARCSEC),
            found.bore_rad[0] / (5.0 * ARCSEC),
        ]
    )
    assert np.all(np.abs(np.log(levels)) < 3.0 * found.relative_sigma), (
        levels,
        found.relative_sigma,
    )
    assert np.all(found.relative_sigma[2:] < 0.05)
    assert found.relative_sigma[1] < 0.3
    assert found.mean_nis == pytest.approx(3.0, abs=0.1)
    np.testing.assert_allclose(found.rescaled(told).sigma_cross_rad, found.cross_rad[0])


def test_a_walk_that_cannot_be_seen_is_said_to_be_unknown() -> None:
    star, gyro, _ = telemetry(
        GYRO_TIMES[:601], STAR_TIMES[:200], noise=GyroNoise(3e-6, 0.0), seed=4
    )
    given = replace(settings(), noise=GyroNoise(3e-6, 0.0))
    found = noise_levels.estimate_noise(star, gyro, given)
    assert found.relative_sigma[1] > 0.5
    assert found.noise.rate_random_walk < 1e-6


def test_blunders_do_not_take_part() -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES, noise=TRUE, seed=5)
    wrong = np.arange(40, len(star), 60)
    quats = np.array(star.quat_xyzw)
    turn = Rotation.from_rotvec(np.radians([0.1, -0.1, 0.05]))
    quats[wrong] = (Rotation.from_quat(quats[wrong]) * turn).as_quat()
    spoilt = StarSeries.of(star.times_s, quats, star.sigma_cross_rad)
    found = noise_levels.estimate_noise(spoilt, gyro, replace(settings(), noise=TRUE))
    assert not found.used[wrong].any()
    assert found.cross_rad[0] == pytest.approx(5.0 * ARCSEC, rel=0.05)


def test_noise_of_sampled_rates_is_told_from_star_noise() -> None:
    times = np.arange(0.0, 600.05, 0.2)
    rng = np.random.default_rng(8)
    noise = GyroNoise(5e-6, 1e-9)
    gyro = simulate_rates(times, np.zeros((len(times), 3)), noise, rng).series()
    sigma = 0.35 * ARCSEC
    quats = Rotation.from_rotvec(sigma * rng.standard_normal((len(times), 3))).as_quat()
    star = StarSeries.of(times, quats, 1.0 * ARCSEC)
    given = FusionSettings(noise, bias_sigma_rad_s=1e-6)
    found = noise_levels.estimate_noise(star, gyro, given)
    assert found.hidden_rad > 0.5 * sigma
    assert found.cross_rad[0] == pytest.approx(sigma, rel=0.06)
    assert found.bore_rad[0] == pytest.approx(sigma, rel=0.08)
    assert found.noise.angle_random_walk == pytest.approx(5e-6, rel=0.06)


def test_refuses_too_few_samples() -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES[:10])
    with pytest.raises(GeometryError, match="at least 20"):
        noise_levels.estimate_noise(star, gyro, settings())


@pytest.mark.parametrize("name", ["mro_2007", "mro_2009"])
def test_mars_reconnaissance_orbiter(real_data: Path, name: str) -> None:
    table = np.loadtxt(real_data / "attitude" / name / "decoded.csv.gz", delimiter=",")
    times, quat, rate = table[:, 0], table[:, 1:5], table[:, 5:8]
    # Scalar first, reference to spacecraft; the rate is given in the reference frame.
    R_inertial_body = Rotation.from_quat(np.roll(quat, -1, axis=1)).inv()
    R_inertial_body = Rotation.from_quat(R_inertial_body.as_quat())
    gyro = GyroSeries.of(times, R_inertial_body.inv().apply(rate))
    star = StarSeries.of(times, R_inertial_body.as_quat(), 1.0 * ARCSEC)
    given = FusionSettings(GyroNoise(1e-6, 1e-9), bias_sigma_rad_s=1e-5)
    found = noise_levels.estimate_noise(star, gyro, given)
    step = np.median(np.diff(times))
    # Known of it: white rate noise of 1.1–1.3e-5 rad/s, attitude noise of 0.25–0.33 arcsec.
    assert 1.0e-5 < found.noise.angle_random_walk / np.sqrt(step) < 1.5e-5
    assert np.all((found.cross_rad > 0.2 * ARCSEC) & (found.cross_rad < 0.4 * ARCSEC))
