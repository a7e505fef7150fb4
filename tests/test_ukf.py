"""The unscented filter: it is the extended one at arcseconds, and consistent where that is not."""

from __future__ import annotations

import numpy as np
import pytest
from attitude_scenes import ARCSEC, NOISE, settings, telemetry, turning
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.filters import ekf, ukf
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.gyro import draw_parameters
from geoposition.sensors.telemetry import GyroNoise, GyroParameters, GyroSeries, StarSeries

GYRO_TIMES = np.arange(0.0, 60.05, 0.1)
STAR_TIMES = np.arange(0.03, 60.0, 0.25)


@pytest.mark.parametrize(("model", "tolerance"), [("bias", 1e-4), ("general", 2e-2)])
def test_is_the_extended_filter_at_arcseconds(model: str, tolerance: float) -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    unscented = ukf.filter_forward(star, gyro, settings(model))
    extended = ekf.filter_forward(star, gyro, settings(model))
    np.testing.assert_array_equal(unscented.times_s, extended.times_s)
    off = unscented.error_rad(extended.R_inertial_body) / extended.sigma_rad
    assert np.abs(off).max() < tolerance
    np.testing.assert_allclose(unscented.sigma_rad, extended.sigma_rad, rtol=tolerance)


def test_neither_spread_nor_kappa_of_the_thesis_matters_at_arcseconds() -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    plain = ukf.filter_forward(star, gyro, settings())
    for points in (ukf.SigmaPoints(kappa=-3.0), ukf.SigmaPoints(alpha=0.1)):
        other = ukf.filter_forward(star, gyro, settings(), points=points)
        off = other.error_rad(plain.R_inertial_body) / plain.sigma_rad
        assert np.abs(off).max() < 1e-4


@pytest.mark.parametrize("states", [6, 15])
def test_sigma_points_have_mean_and_covariance(states: int) -> None:
    points = ukf.SigmaPoints(alpha=0.7, beta=2.0, kappa=1.0)
    spread, (centre, _, other) = points.weights(states)
    assert centre + 2 * states * other == pytest.approx(1.0)
    assert 2.0 * other * spread**2 == pytest.approx(1.0)


def test_refuses_points_without_spread() -> None:
    with pytest.raises(ArgumentError, match="must be positive"):
        ukf.SigmaPoints(kappa=-6.0).weights(6)


@pytest.mark.parametrize("model", ["bias", "general"])
def test_nees_and_nis_over_drawn_truths(model: str) -> None:
    runs, size = 40, 6 if model == "bias" else 15
    rng = np.random.default_rng(11)
    drawn = draw_parameters(rng, runs, 5e-6, *((2e-3, 2e-3) if size == 15 else ()))
    nees, nis, count = 0.0, 0.0, 0
    for run in range(runs):
        own = GyroParameters.of(
            drawn.bias_rad_s[run], drawn.scale[run], drawn.upper[run], drawn.lower[run]
        )
        noise = GyroNoise(NOISE.angle_random_walk, 0.0)
        star, gyro, truth = telemetry(
            GYRO_TIMES, STAR_TIMES, parameters=own, noise=noise, seed=100 + run
        )
        given = FusionSettings(noise, model, 5e-6)
        found = ukf.filter_forward(star, gyro, given)
        error = np.concatenate(
            [
                found.error_rad(truth[len(truth) - len(found.times_s) :])[-1],
                own.bias_rad_s - found.bias_rad_s[-1],
                np.concatenate([own.scale, own.upper, own.lower]) - found.parameters[-1],
            ]
        )[:size]
        sigma = np.sqrt(np.diag(found.covariance[-1]))
        unit = error / sigma
        nees += unit @ np.linalg.solve(found.covariance[-1] / np.outer(sigma, sigma), unit)
        squared = found.innovations.normalised_squared()[1:]
        nis, count = nis + squared.sum(), count + 3 * len(squared)
    low, high = chi2.ppf([0.025, 0.975], size * runs)
    assert low < nees < high
    low, high = chi2.ppf([0.025, 0.975], count)
    assert low < nis < high


def test_consistent_at_degrees_where_linearisation_ends() -> None:
    rng = np.random.default_rng(5)
    sigma = np.radians(8.0)
    star_times, gyro_times = np.arange(0.0, 20.1, 2.0), np.arange(0.0, 20.1, 0.5)
    given = FusionSettings(GyroNoise(1e-5, 0.0), bias_sigma_rad_s=np.radians(2.0))
    nees = []
    for seed in range(60):
        bias = rng.normal(0.0, np.radians(2.0), 3)
        star, gyro, truth = telemetry(
            gyro_times,
            star_times,
            sigma,
            GyroParameters.of(bias),
            GyroNoise(1e-5, 0.0),
            seed,
            rate=lambda t: 4.0 * turning(t),
        )
        found = ukf.filter_forward(star, gyro, given)
        error = np.concatenate([found.error_rad(truth)[-1], bias - found.bias_rad_s[-1]])
        nees.append(error @ np.linalg.solve(found.covariance[-1], error))
    assert np.mean(nees) < chi2.ppf(0.999, 6 * 60) / 60


def test_gate_leaves_blunders_out() -> None:
    star, gyro, truth = telemetry(GYRO_TIMES, STAR_TIMES)
    quats = np.array(star.quat_xyzw)
    wrong = np.arange(20, len(star), 17)
    turn = Rotation.from_rotvec(np.radians([0.3, -0.2, 0.1]))
    quats[wrong] = (Rotation.from_quat(quats[wrong]) * turn).as_quat()
    spoilt = StarSeries.of(star.times_s, quats, star.sigma_cross_rad)
    found = ukf.filter_forward(spoilt, gyro, settings(gate_probability=0.9999))
    assert not found.innovations.accepted[wrong].any()
    assert found.innovations.accepted.sum() == len(star) - len(wrong)
    error = found.error_rad(truth[len(truth) - len(found.times_s) :])
    assert np.abs(error[-100:]).max() < 6.0 * ARCSEC


def test_gap_in_the_gyro_and_uneven_steps() -> None:
    times = np.delete(GYRO_TIMES, np.r_[100:160, 301, 303, 350])
    star, gyro, _ = telemetry(times, STAR_TIMES)
    assert isinstance(gyro, GyroSeries)
    unscented = ukf.filter_forward(star, gyro, settings())
    extended = ekf.filter_forward(star, gyro, settings())
    off = unscented.error_rad(extended.R_inertial_body) / extended.sigma_rad
    assert np.abs(off).max() < 1e-2
