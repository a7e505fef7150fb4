"""The smoothers: against dense least squares, against each other, and against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from attitude_scenes import ARCSEC, settings, telemetry, turning
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.errors import ArgumentError
from geoposition.scripts.experiments.monte_carlo import Scene, simulate
from geoposition.sensors.attitude_determination.filters import ekf
from geoposition.sensors.attitude_determination.monte_carlo.batch import run_batch
from geoposition.sensors.attitude_determination.propagation import process_noise, transition
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.smoothers import smooth
from geoposition.sensors.attitude_determination.timeline import merge
from geoposition.sensors.gyro import draw_parameters
from geoposition.sensors.telemetry import GyroNoise, GyroParameters, Mounting, StarSeries

PARAMETERS = GyroParameters.of(
    (2e-6, -3e-6, 4e-6), (1500e-6, 1000e-6, -1500e-6), (1e-3, 1.5e-3, 2e-3), (5e-4, -1e-3, 1.5e-3)
)
SMOOTHERS = [smooth.rts, smooth.two_filter]


def joint_covariance(star, gyro, chosen):
    """Covariance of the states at all knots together, from prior, steps and samples: dense."""
    line = merge(star, gyro, Mounting())
    bias = ekf.filter_forward(star, gyro, chosen).bias_rad_s
    n, knots = 6, len(line.times_s)
    sv2, su2 = chosen.noise.angle_random_walk**2, chosen.noise.rate_random_walk**2
    spread = np.eye(n * knots)
    noise = [np.diag([star.sigma_cross_rad[0] ** 2] * 3 + [chosen.bias_sigma_rad_s**2] * 3)]
    for k, step in enumerate(line.step_s):
        A, B, L2 = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
        Qdd, Qdb, M = np.empty((3, 3)), np.empty((3, 3)), np.eye(3)
        turn = line.turn_rad[k] - bias[k] * step
        factors = transition((0,) * 6, *turn, step, M, A, B, L2)
        process_noise((0,) * 6, *turn, step, sv2, su2, 0.0, factors, M, L2, Qdd, Qdb)
        noise.append(np.block([[Qdd, Qdb], [Qdb.T, su2 * step * np.eye(3)]]))
        here, after = slice(n * k, n * k + n), slice(n * k + n, n * k + 2 * n)
        spread[after] += np.block([[A, B], [np.zeros((3, 3)), np.eye(3)]]) @ spread[here]
    prior = spread @ block_diag(*noise) @ spread.T
    measured = np.zeros((3 * (len(star) - 1), n * knots))
    for row, m in enumerate(range(1, len(star))):
        k = int(np.searchsorted(line.times_s, star.times_s[m]))
        measured[3 * row : 3 * row + 3, n * k : n * k + 3] = np.eye(3)
    S = measured @ prior @ measured.T + star.sigma_cross_rad[0] ** 2 * np.eye(len(measured))
    return prior - prior @ measured.T @ np.linalg.solve(S, measured @ prior)


@pytest.mark.parametrize("smoother", SMOOTHERS)
def test_covariances_of_any_two_epochs_are_those_of_dense_least_squares(smoother) -> None:
    times = np.cumsum(np.tile([0.5, 0.8, 0.3], 5))
    star, gyro, _ = telemetry(times, times[[0, 3, 4, 9, 13]])
    estimate = smoother(star, gyro, settings(), lag="state")
    dense = joint_covariance(star, gyro, settings())
    sigma = np.sqrt(np.diag(dense))
    for i in range(15):
        for j in range(15):
            place = np.ix_(range(6 * i, 6 * i + 6), range(6 * j, 6 * j + 6))
            found = smooth.cross_covariance(estimate, i, j)
            scale = np.outer(sigma[6 * i : 6 * i + 6], sigma[6 * j : 6 * j + 6])
            np.testing.assert_allclose(found / scale, dense[place] / scale, rtol=0.0, atol=2e-7)
    np.testing.assert_array_equal(estimate.lag_one, estimate.lag_state[:, :3, :3])


@pytest.mark.parametrize("smoother", SMOOTHERS)
def test_lag_one_reaches_over_star_epochs_between_gyro_epochs(smoother) -> None:
    times = np.arange(0.0, 12.0)
    star, gyro, _ = telemetry(times, np.array([0.4, 2.5, 2.7, 5.0, 7.1, 10.6]))
    estimate = smoother(star, gyro, settings())
    # The same series with the star epochs among the gyro's, its turns as the timeline split them.
    line = merge(star, gyro, Mounting())
    fine = smoother(star, type(gyro).of(
        line.times_s, np.concatenate([line.turn_rad[:1], line.turn_rad]), "increment"
    ), settings(), lag="state")  # fmt: skip
    places = np.searchsorted(line.times_s, times)
    for k in range(11):
        chain = smooth.cross_covariance(fine, int(places[k]), int(places[k + 1]))[:3, :3]
        np.testing.assert_allclose(estimate.lag_one[k], chain, rtol=1e-5, atol=1e-16)


@pytest.mark.parametrize("model", ["bias", "general"])
def test_rts_and_two_filter_agree_to_rounding(model: str) -> None:
    times = np.cumsum(np.tile([0.1, 0.2, 0.1], 400))
    star_times = np.arange(0.33, 155.0, 0.75)
    star, gyro, _ = telemetry(times, star_times, parameters=PARAMETERS)
    one, other = (f(star, gyro, settings(model)) for f in SMOOTHERS)
    assert (one.R_inertial_body.inv() * other.R_inertial_body).magnitude().max() < 1e-8 * ARCSEC
    sigma = np.sqrt(np.diagonal(one.covariance, axis1=1, axis2=2))
    scale = sigma[:, :, None] * sigma[:, None, :]
    assert np.abs((one.covariance - other.covariance) / scale).max() < 1e-7
    assert np.abs(one.lag_one - other.lag_one).max() < 1e-7 * scale[:, :3, :3].max()
    assert np.abs(one.bias_rad_s - other.bias_rad_s).max() < 1e-7 * sigma[:, 3:6].min()


def test_smoothed_is_filtered_at_the_end_and_better_before() -> None:
    times = np.arange(0.0, 300.0, 0.5)
    star, gyro, truth = telemetry(times, times[::2])
    forward, smoothed = (f(star, gyro, settings()) for f in (ekf.filter_forward, smooth.rts))
    np.testing.assert_allclose(smoothed.covariance[-1], forward.covariance[-1], rtol=1e-12)
    assert np.all(smoothed.sigma_rad <= forward.sigma_rad * (1.0 + 1e-12))
    rms = [np.sqrt(np.mean(e.error_rad(truth) ** 2)) for e in (forward, smoothed)]
    assert rms[1] < 0.8 * rms[0]


def test_epochs_before_the_first_star_sample_follow_from_the_gyro() -> None:
    times = np.arange(0.0, 300.0, 0.5)
    normalised = []
    for seed in range(300):
        star, gyro, truth = telemetry(times, np.arange(100.2, 299.0, 1.0), seed=seed)
        estimate = smooth.rts(star, gyro, settings())
        assert len(estimate.times_s) == len(times)
        error = estimate.error_rad(truth)[:200:50]
        covariance = estimate.covariance[:200:50, :3, :3]
        solved = np.linalg.solve(covariance, error[..., None])[..., 0]
        normalised.append(np.sum(error * solved, axis=1)[0])
    low, high = chi2.ppf([0.025, 0.975], 3 * 300) / 300
    assert low < np.mean(normalised) < high
    assert np.all(np.diff(estimate.sigma_rad[:190:50, 0]) < 0.0)


def test_lag_one_goes_on_before_the_first_star_sample() -> None:
    times = np.arange(0.0, 40.0)
    star, gyro, _ = telemetry(times, np.arange(10.4, 39.0, 1.0))
    estimate = smooth.rts(star, gyro, settings())
    backward = np.einsum("kii->ki", estimate.lag_one) / estimate.sigma_rad[:-1] ** 2
    assert np.all(np.abs(backward - 1.0) < 0.5)
    correlation = np.einsum("kii->ki", estimate.lag_one) / (
        estimate.sigma_rad[:-1] * estimate.sigma_rad[1:]
    )
    assert np.all((correlation[:9] > 0.9) & (correlation[:9] <= 1.0))
    assert abs(correlation[10, 0] - correlation[9, 0]) < 0.05


def test_large_scale_errors_do_not_bend_the_result() -> None:
    times = np.arange(0.0, 1500.0, 0.25)
    star, gyro, truth = telemetry(times, times[::4], 1e-9, PARAMETERS, GyroNoise(1e-11, 0.0))
    # Noise is stated far larger than it is and the prior wide: what remains is the linearisation.
    honest = StarSeries.of(star.times_s, star.quat_xyzw, 5 * ARCSEC)
    estimate = smooth.rts(honest, gyro, FusionSettings(
        GyroNoise(3e-7, 0.0), "general", 1e-5, 2e-2, 2e-2
    ))  # fmt: skip
    found = estimate.parameters[-1]
    expected = np.concatenate([PARAMETERS.scale, PARAMETERS.upper, PARAMETERS.lower])
    assert np.abs(found - expected).max() < 0.01e-6
    assert np.abs(estimate.error_rad(truth)).max() < 0.01 * ARCSEC


@pytest.mark.parametrize("method", ["rts", "two-filter"])
@pytest.mark.parametrize("model", ["bias", "general"])
def test_nees_is_in_its_band(model: str, method) -> None:
    runs, rng = 150, np.random.default_rng(5)
    noise = GyroNoise(3e-6, 1e-7)
    ppm = 2e-3 if model == "general" else 0.0
    drawn = draw_parameters(rng, runs, 1e-5, ppm, ppm)
    times = np.arange(0.0, 120.0, 0.5)
    place = Scene(turning, times, np.arange(0.0, 119.0, 1.7), noise, 6 * ARCSEC)
    chosen = FusionSettings(noise, model, 1e-5, 2e-3, 2e-3)
    nees, done = [], 0
    for chunk in simulate(place, drawn, runs, rng):
        result = run_batch(chunk.timelines, chunk.truth_quat_xyzw, chosen, method)
        rows = slice(done, done + len(chunk.timelines))
        done = rows.stop
        rest = chunk.bias_rad_s[:, 0]
        if model == "general":
            constants = (drawn.scale[rows], drawn.upper[rows], drawn.lower[rows])
            rest = np.concatenate([rest, *constants], axis=1)
        nees.append(result.first.nees(chunk.truth_quat_xyzw[0], rest))
    low, high = chi2.ppf([0.025, 0.975], chosen.states * runs) / runs
    assert low < np.mean(np.concatenate(nees)) < high


def test_a_star_sample_alone_is_its_own_smoothed_attitude() -> None:
    times = np.arange(0.0, 10.0)
    star, gyro, _ = telemetry(times, np.array([4.0]))
    for smoother in SMOOTHERS:
        estimate = smoother(star, gyro, settings())
        assert (estimate.R_inertial_body[4].inv() * star.R_inertial_sensor[0]).magnitude() < 1e-15
        np.testing.assert_allclose(estimate.sigma_rad[4], 5 * ARCSEC, rtol=1e-12)


def test_cross_covariance_wants_a_smoothed_estimate_and_epochs_in_it() -> None:
    times = np.arange(0.0, 10.0)
    star, gyro, _ = telemetry(times, times)
    with pytest.raises(ArgumentError, match="lag-one"):
        smooth.cross_covariance(ekf.filter_forward(star, gyro, settings()), 0, 1)
    with pytest.raises(ArgumentError, match=r"epochs 0 \.\. 9"):
        smooth.cross_covariance(smooth.rts(star, gyro, settings()), 0, 10)


def test_mounted_heads_of_two_rates_give_one_attitude() -> None:
    times = np.arange(0.0, 100.0, 0.25)
    star, gyro, truth = telemetry(times, times[::2])
    turned = Rotation.from_euler("XY", [80.0, 20.0], degrees=True)
    slow = star.where(np.arange(len(star)) % 7 == 3)
    quats = np.concatenate([star.quat_xyzw, (slow.R_inertial_sensor * turned).as_quat()])
    stamps = np.concatenate([star.times_s, slow.times_s + 0.1])
    shifted = Rotation.from_rotvec(0.1 * turning(slow.times_s + 0.05))
    quats[len(star) :] = (slow.R_inertial_sensor * shifted * turned).as_quat()
    order = np.argsort(stamps, kind="stable")
    both = StarSeries.of(
        stamps[order],
        quats[order],
        5 * ARCSEC,
        None,
        np.repeat([0, 1], [len(star), len(slow)])[order],
        ("a", "b"),
    )
    estimate = smooth.rts(both, gyro, settings(), Mounting({"b": turned}))
    assert estimate.innovations.accepted.all()
    assert np.abs(estimate.error_rad(truth)).max() < 15 * ARCSEC
