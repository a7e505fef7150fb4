"""The complementary filter: its frequency response, its covariance, and what T's pairing costs."""

from __future__ import annotations

import numpy as np
import pytest
from attitude_scenes import ARCSEC, START, settings, telemetry
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.filters import complementary, ukf
from geoposition.sensors.gyro import draw_parameters
from geoposition.sensors.telemetry import GyroParameters, GyroSeries, StarSeries

GYRO_TIMES = np.arange(0.0, 120.05, 0.1)
STAR_TIMES = np.arange(0.05, 120.0, 0.25)


def still(star_error_rad, bias_rad_s=0.0) -> tuple[StarSeries, GyroSeries]:
    """A body at rest: star error about x, gyro without noise."""
    times = np.arange(0.0, 2000.01, 0.1)
    error = star_error_rad(times)[:, None] * np.array([1.0, 0.0, 0.0])
    quats = (START * Rotation.from_rotvec(error)).as_quat()
    values = np.full((len(times), 3), [bias_rad_s, 0.0, 0.0])
    return StarSeries.of(times, quats, 5.0 * ARCSEC), GyroSeries.of(times, values, "mean-rate")


@pytest.mark.parametrize("cutoff_hz", [0.01, 0.05])
def test_half_the_power_of_the_star_error_passes_at_the_cutoff(cutoff_hz: float) -> None:
    star, gyro = still(lambda t: 10.0 * ARCSEC * np.sin(2.0 * np.pi * cutoff_hz * t))
    found = complementary.filter_forward(star, gyro, settings(), cutoff_hz=cutoff_hz)
    late = found.times_s > 1000.0
    passed = (START.inv() * found.R_inertial_body).as_rotvec()[late, 0]
    power = 2.0 * np.mean(passed**2) / (10.0 * ARCSEC) ** 2
    # The pole is exact for the sampling, so the response is the continuous one's but for the hold.
    assert power == pytest.approx(0.5, rel=0.01)


def test_drift_is_tracked_without_offset() -> None:
    star, gyro = still(lambda t: 0.0 * t, bias_rad_s=3e-6)
    found = complementary.filter_forward(star, gyro, settings(), cutoff_hz=0.02)
    assert found.bias_rad_s[-1, 0] == pytest.approx(3e-6, rel=1e-9)
    assert abs((START.inv() * found.R_inertial_body[-1]).as_rotvec()[0]) < 1e-12


def test_stated_covariance_is_that_of_its_gains() -> None:
    runs = 60
    rng = np.random.default_rng(2)
    drawn = draw_parameters(rng, runs, 5e-6)
    nees = 0.0
    for run in range(runs):
        own = GyroParameters.of(drawn.bias_rad_s[run])
        star, gyro, truth = telemetry(GYRO_TIMES, STAR_TIMES, parameters=own, seed=run)
        found = complementary.filter_forward(star, gyro, settings(), cutoff_hz=0.05)
        error = found.error_rad(truth[len(truth) - len(found.times_s) :])[-1]
        nees += error @ np.linalg.solve(found.covariance[-1, :3, :3], error)
    low, high = chi2.ppf([0.025, 0.975], 3 * runs)
    assert low < nees < high


def test_two_heads_of_one_epoch_are_averaged_by_weight() -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    twice = StarSeries.of(
        np.repeat(star.times_s, 2),
        np.repeat(star.quat_xyzw, 2, axis=0),
        np.repeat(star.sigma_cross_rad, 2) * np.sqrt(2.0),
        head=np.tile([0, 1], len(star)),
        heads=("a", "b"),
    )
    one = complementary.filter_forward(star, gyro, settings())
    two = complementary.filter_forward(twice, gyro, settings())
    # Only the start differs: its attitude comes from one head.
    np.testing.assert_allclose(two.error_rad(one.R_inertial_body)[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(two.sigma_rad[-1], one.sigma_rad[-1], rtol=1e-9)


def test_paired_with_the_unscented_filter_the_covariance_is_too_small() -> None:
    squared = {"alone": 0.0, "paired": 0.0}
    runs = 30
    for run in range(runs):
        star, gyro, truth = telemetry(GYRO_TIMES, STAR_TIMES, seed=run)
        truth = truth[1:]
        for name, found in (
            ("alone", ukf.filter_forward(star, gyro, settings())),
            ("paired", complementary.cf_ukf(star, gyro, settings(), cutoff_hz=0.2)),
        ):
            error = found.error_rad(truth)[-1]
            squared[name] += error @ np.linalg.solve(found.covariance[-1, :3, :3], error)
    assert squared["paired"] > chi2.ppf(0.999, 3 * runs)
    assert squared["alone"] < chi2.ppf(0.999, 3 * runs)


def test_a_cutoff_beyond_all_rates_gives_the_unscented_filter_back() -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    plain = ukf.filter_forward(star, gyro, settings())
    paired = complementary.cf_ukf(star, gyro, settings(), cutoff_hz=100.0)
    np.testing.assert_allclose(paired.error_rad(plain.R_inertial_body), 0.0, atol=1e-15)


def test_refuses_what_it_cannot_do() -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    with pytest.raises(ArgumentError, match="drift only"):
        complementary.filter_forward(star, gyro, settings("general"))
    with pytest.raises(ArgumentError, match="cut-off"):
        complementary.cf_ukf(star, gyro, settings(), cutoff_hz=0.0)
