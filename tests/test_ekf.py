"""The forward filter: its closed forms, its timeline, its statistics, its refusals."""

from __future__ import annotations

import numpy as np
import pytest
from attitude_scenes import ARCSEC, settings, telemetry, turning
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.errors import ArgumentError, GeometryError
from geoposition.rotation import skew
from geoposition.scripts.experiments.monte_carlo import Scene, simulate
from geoposition.sensors.attitude_determination.filters import ekf
from geoposition.sensors.attitude_determination.filters.forward import run_forward
from geoposition.sensors.attitude_determination.monte_carlo.batch import run_batch
from geoposition.sensors.attitude_determination.propagation import process_noise, transition
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.timeline import merge
from geoposition.sensors.gyro import draw_parameters
from geoposition.sensors.telemetry import (
    GyroNoise,
    GyroParameters,
    GyroSeries,
    Mounting,
    StarSeries,
)


def blocks(turn, step, M, sv2=0.0, su2=0.0, states=15):
    token = (0,) * states
    A, B, L2 = np.empty((3, 3)), np.empty((3, states - 3)), np.empty((3, 3))
    Qdd, Qdb = np.empty((3, 3)), np.empty((3, 3))
    factors = transition(token, *turn, step, M, A, B, L2)
    process_noise(token, *turn, step, sv2, su2, 0.0, factors, M, L2, Qdd, Qdb)
    return A, B, Qdd, Qdb


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 3.0, 17.0, 19.0, 100.0])
def test_transition_is_the_matrix_exponential(degrees: float) -> None:
    axis = np.array([0.48, -0.6, 0.64])
    step = 0.7
    rate = np.radians(degrees) * axis / step
    gyro = GyroParameters.of(
        scale=(2e-3, -1e-3, 5e-4), upper=(1e-3, 2e-3, 3e-3), lower=(-2e-3, 1e-3, 4e-4)
    )
    M = np.linalg.inv(np.eye(3) + gyro.matrix)
    F = np.zeros((15, 15))
    F[:3, :3] = -skew(rate)
    F[:3, 3:6] = -M
    for place, (row, column) in enumerate(
        [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2), (1, 0), (2, 0), (2, 1)]
    ):
        F[:3, 6 + place] = -M[:, row] * rate[column]
    Phi = expm(F * step)
    A, B, _, _ = blocks(rate * step, step, M)
    np.testing.assert_allclose(A, Phi[:3, :3], rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(B, Phi[:3, 3:], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("degrees", [0.0, 3.0, 100.0])
def test_process_noise_is_van_loans(degrees: float) -> None:
    step, sv2, su2 = 0.8, 2.0, 3.0
    rate = np.radians(degrees) * np.array([0.48, -0.6, 0.64]) / step
    F = np.zeros((6, 6))
    F[:3, :3], F[:3, 3:] = -skew(rate), -np.eye(3)
    noise = np.diag([sv2] * 3 + [su2] * 3)
    both = expm(np.block([[-F, noise], [np.zeros((6, 6)), F.T]]) * step)
    Q = both[6:, 6:].T @ both[:6, 6:]
    _, _, Qdd, Qdb = blocks(rate * step, step, np.eye(3), sv2, su2, 6)
    np.testing.assert_allclose(Qdd, Q[:3, :3], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(Qdb, Q[:3, 3:], rtol=0.0, atol=1e-13)


def textbook_filter(star, gyro, chosen):
    """A plain dense filter for samples at gyro epochs: the formulas of T (3.28)-(3.30)."""
    R, b = star.R_inertial_sensor[0], np.zeros(3)
    P = np.diag([star.sigma_cross_rad[0] ** 2] * 3 + [chosen.bias_sigma_rad_s**2] * 3)
    sv2, su2 = chosen.noise.angle_random_walk**2, chosen.noise.rate_random_walk**2
    found = {}
    line = merge(star, gyro, Mounting())
    for k, step in enumerate(np.diff(gyro.times_s), start=1):
        turn = line.turn_rad[k - 1] - b * step
        F = np.zeros((6, 6))
        F[:3, :3], F[:3, 3:] = -skew(turn / step), -np.eye(3)
        noise = np.diag([sv2] * 3 + [su2] * 3)
        both = expm(np.block([[-F, noise], [np.zeros((6, 6)), F.T]]) * step)
        Phi = both[6:, 6:].T
        P = Phi @ P @ Phi.T + Phi @ both[:6, 6:]
        R = R * Rotation.from_rotvec(turn)
        for m in np.flatnonzero(star.times_s == gyro.times_s[k]):
            z = (R.inv() * star.R_inertial_sensor[m]).as_rotvec()
            S = P[:3, :3] + star.sigma_cross_rad[m] ** 2 * np.eye(3)
            K = P[:, :3] @ np.linalg.inv(S)
            R, b = R * Rotation.from_rotvec((K @ z)[:3]), b + (K @ z)[3:]
            P = P - K @ S @ K.T
        found[k] = (R, b, P)
    return found


def test_equals_the_textbooks_dense_filter() -> None:
    times = np.cumsum(np.tile([0.1, 0.2, 0.13], 20))
    star, gyro, _ = telemetry(times, times[::4])
    estimate = ekf.filter_forward(star, gyro, settings())
    for k, (R, b, P) in textbook_filter(star, gyro, settings()).items():
        assert (estimate.R_inertial_body[k].inv() * R).magnitude() < 1e-13
        np.testing.assert_allclose(estimate.bias_rad_s[k], b, rtol=0.0, atol=1e-14)
        sigma = np.sqrt(np.diag(P))
        scaled = (estimate.covariance[k] - P) / np.outer(sigma, sigma)
        assert np.abs(scaled).max() < 1e-9


def test_covariance_stays_symmetric_and_positive_over_a_long_outage() -> None:
    star, gyro, _ = telemetry(np.arange(0.0, 4000.0), np.r_[0.0, 1.0, 2.0, 3998.0, 3999.0])
    general = settings("general", bias_sigma_rad_s=1e-4)
    covariance = ekf.filter_forward(star, gyro, general).covariance
    np.testing.assert_array_equal(covariance, np.swapaxes(covariance, 1, 2))
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    scaled = covariance / (sigma[:, :, None] * sigma[:, None, :])
    assert np.linalg.eigvalsh(scaled).min() > 0.0


@pytest.mark.parametrize("model", ["bias", "general"])
def test_nees_and_nis_are_in_their_bands(model: str) -> None:
    runs, span = 200, 120.0
    rng = np.random.default_rng(11)
    noise = GyroNoise(3e-6, 1e-7)
    ppm = 2e-3 if model == "general" else 0.0
    drawn = draw_parameters(rng, runs, 1e-5, ppm, ppm)
    place = Scene(turning, np.arange(0.0, span, 0.5), np.arange(0.0, span, 1.7), noise, 6 * ARCSEC)
    chosen = FusionSettings(noise, model, 1e-5, 2e-3, 2e-3)
    nees, nis, done = [], [], 0
    for chunk in simulate(place, drawn, runs, rng):
        result = run_batch(chunk.timelines, chunk.truth_quat_xyzw, chosen)
        rows = slice(done, done + len(chunk.timelines))
        done = rows.stop
        rest = chunk.bias_rad_s[:, -1]
        if model == "general":
            constants = (drawn.scale[rows], drawn.upper[rows], drawn.lower[rows])
            rest = np.concatenate([rest, *constants], axis=1)
        nees.append(result.last.nees(chunk.truth_quat_xyzw[-1], rest))
        nis.append(result.nis)
    samples = runs * (len(place.star_times_s) - 1)
    for mean, freedom in (
        (np.mean(np.concatenate(nees)), chosen.states * runs),
        (np.mean(np.concatenate(nis)), 3 * samples),
    ):
        count = runs if freedom == chosen.states * runs else samples
        low, high = chi2.ppf([0.025, 0.975], freedom) / count
        assert low < mean < high


def test_star_epochs_between_gyro_epochs_are_met_themselves() -> None:
    rate = np.array([0.01, -0.02, 0.03])
    truth = lambda t: Rotation.from_rotvec(np.outer(t, rate))  # noqa: E731
    gyro_times, star_times = np.arange(0.0, 20.0, 0.1), np.arange(0.03, 19.9, 0.25)
    gyro = GyroSeries.of(gyro_times, np.tile(rate, (200, 1)), "rate")
    star = StarSeries.of(star_times, truth(star_times).as_quat(), ARCSEC)
    estimate = ekf.filter_forward(star, gyro, settings())
    assert estimate.times_s[0] == gyro_times[1]
    assert np.abs(estimate.innovations.residual_rad[1:]).max() < 1e-13
    assert np.abs(estimate.error_rad(truth(estimate.times_s))).max() < 1e-13


def test_a_split_interval_follows_a_rate_that_changes_linearly() -> None:
    times = np.arange(0.0, 10.0, 0.5)
    rate = lambda t: np.stack([0.01 + 0.004 * t, 0.0 * t, 0.0 * t], axis=-1)  # noqa: E731
    star, gyro, _ = telemetry(
        times,
        np.arange(0.0, 9.5, 0.35),
        1e-12,
        GyroParameters.of(),
        GyroNoise(1e-15, 0.0),
        rate=rate,
    )
    for series in (gyro, GyroSeries.of(times, rate(times), "rate")):
        line = merge(star, series, Mounting())
        exact = 0.01 * line.times_s + 0.002 * line.times_s**2
        np.testing.assert_allclose(line.turn_rad[:, 0], np.diff(exact), rtol=0.0, atol=1e-12)


def test_sampled_rates_of_a_slew_are_integrated_to_the_third_degree() -> None:
    times = np.array([0.0, 1.0, 1.9, 3.0, 4.2, 5.0])
    rate = 1e-3 * np.stack([times**2, 0.0 * times, 0.0 * times], axis=-1)
    star = StarSeries.of([0.0], [[0.0, 0.0, 0.0, 1.0]], ARCSEC)
    line = merge(star, GyroSeries.of(times, rate, "rate"), Mounting())
    exact = np.diff(1e-3 * times**3 / 3.0)
    # Inner slopes of a parabola are exact; at both ends they are one-sided.
    np.testing.assert_allclose(line.turn_rad[1:-1, 0], exact[1:-1], rtol=0.0, atol=1e-16)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_turning_axes_need_no_fine_steps(kind: str) -> None:
    times = np.arange(0.0, 200.0)
    star, gyro, truth = telemetry(times, times, 1e-9, GyroParameters.of(), GyroNoise(1e-12, 0.0))
    if kind == "rate":
        fine = np.arange(0.0, 200.0, 0.25)
        star, _, truth = telemetry(fine, times, 1e-9, GyroParameters.of(), GyroNoise(1e-12, 0.0))
        gyro = GyroSeries.of(fine, turning(fine), "rate")
    one = star.where(np.arange(len(star)) < 1)
    chosen = settings(bias_sigma_rad_s=0.0)
    error = ekf.filter_forward(one, gyro, chosen).error_rad(truth)
    # Without the coning term the drift would be some hundred microradians.
    assert np.abs(error).max() < 1e-5


def test_heads_with_mountings_and_noise_of_their_own_axes() -> None:
    times = np.arange(0.0, 60.0, 0.5)
    _, gyro, truth = telemetry(times, times, 1e-9)
    rng = np.random.default_rng(3)
    mounting = Mounting({name: Rotation.from_rotvec(rng.normal(0.0, 1.0, 3)) for name in "ab"})
    quats, sigma = np.empty((240, 4)), np.array([4.0, 4.0, 40.0]) * ARCSEC
    for place, name in enumerate("ab"):
        noise = Rotation.from_rotvec(rng.normal(0.0, 1.0, (120, 3)) * sigma)
        quats[place::2] = (truth * mounting.rotation(name) * noise).as_quat()
    both = StarSeries.of(
        np.repeat(times, 2), quats, sigma[0], sigma[2], np.tile([0, 1], 120), ("a", "b")
    )
    estimate = ekf.filter_forward(both, gyro, settings(), mounting)
    assert np.mean(estimate.innovations.normalised_squared()[1:]) == pytest.approx(3.0, abs=0.35)
    only_a = both.where(both.head == 0)
    alone = ekf.filter_forward(only_a, gyro, settings(), mounting)
    bore = mounting.rotation("a").as_matrix()[:, 2]
    along = [bore @ e.covariance[-1, :3, :3] @ bore for e in (estimate, alone)]
    assert along[0] < 0.2 * along[1]


def test_gate_leaves_out_wild_samples_and_a_wild_start() -> None:
    times = np.arange(0.0, 100.0, 0.5)
    star, gyro, truth = telemetry(times, times)
    wild = np.isin(np.arange(200), [0, 1, 50, 120, 121])
    bent = star.R_inertial_sensor * Rotation.from_rotvec(np.outer(wild, [3e-3, -1e-3, 2e-3]))
    spoilt = StarSeries.of(times, bent.as_quat(), 5 * ARCSEC)
    estimate = ekf.filter_forward(spoilt, gyro, settings(gate_probability=0.9999))
    np.testing.assert_array_equal(estimate.innovations.accepted, ~wild)
    assert estimate.times_s[0] == times[2]
    assert np.abs(estimate.error_rad(truth[2:])).max() < 20 * ARCSEC
    assert np.isnan(estimate.innovations.residual_rad[:3]).all()


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
def test_a_gap_of_the_gyro_is_bridged_with_honest_variance(kind: str) -> None:
    times = np.arange(0.0, 120.0, 0.1)
    star, gyro, truth = telemetry(times, np.r_[0.0:40.0:1.0, 90.0:119.0:1.0])
    values = gyro.values if kind == "increment" else gyro.values / 0.1
    if kind == "rate":
        values = turning(times)
    keep = (times < 50.0) | (times > 62.0)
    broken = GyroSeries.of(times[keep], values[keep], kind)
    estimate = ekf.filter_forward(star, broken, settings())
    after = np.searchsorted(estimate.times_s, 62.05)
    error = estimate.error_rad(truth[keep])[after : after + 200]
    sigma = estimate.sigma_rad[after : after + 200]
    assert np.abs(error).max() > 1e-4  # the rates beside the gap cannot tell what was in it
    assert np.all(np.abs(error) < 4.0 * sigma)
    assert np.abs(estimate.error_rad(truth[keep])[-100:]).max() < 20 * ARCSEC


def test_an_increment_over_a_gap_is_taken_at_its_word() -> None:
    times = np.arange(0.0, 120.0, 0.1)
    star, gyro, truth = telemetry(times, np.r_[0.0:40.0:1.0])
    keep = (times < 50.0) | (times > 52.0)
    values = np.array(gyro.values)[keep]
    jump = int(np.flatnonzero(np.diff(times[keep]) > 1.0)[0]) + 1
    turn = (truth[keep][jump - 1].inv() * truth[keep][jump]).as_rotvec()
    values[jump] = turn
    estimate = ekf.filter_forward(star, GyroSeries.of(times[keep], values, "increment"), settings())
    assert np.all(np.abs(estimate.error_rad(truth[keep])) < 5.0 * estimate.sigma_rad)


def test_samples_outside_the_gyros_span_are_left_out() -> None:
    times = np.arange(10.0, 50.0, 0.5)
    star, gyro, _ = telemetry(np.arange(0.0, 60.0, 0.5), np.arange(0.0, 60.0))
    inner = GyroSeries.of(times, gyro.values[20:100], "increment")
    innovations = ekf.filter_forward(star, inner, settings()).innovations
    np.testing.assert_array_equal(
        innovations.accepted, (star.times_s >= 10.0) & (star.times_s <= 49.5)
    )


def test_no_overlap_is_refused() -> None:
    star, gyro, _ = telemetry(np.arange(0.0, 30.0), np.arange(0.0, 30.0))
    late = StarSeries.of(star.times_s + 100.0, star.quat_xyzw, ARCSEC)
    with pytest.raises(GeometryError, match="never overlaps"):
        ekf.filter_forward(late, gyro, settings())


SPOILT = {
    "inertial -> sensor": lambda s, g: (s.R_inertial_sensor.inv().as_quat(), g),
    "scalar first": lambda s, g: (s.quat_xyzw[:, [3, 0, 1, 2]], g),
    "opposite sign": lambda s, g: (s.quat_xyzw, -g),
    "in inertial axes": lambda s, g: (s.quat_xyzw, s.R_inertial_sensor.apply(np.array(g))),
    "in degrees": lambda s, g: (s.quat_xyzw, np.degrees(g)),
    "mounting": lambda s, g: (
        (s.R_inertial_sensor * Rotation.from_euler("Y", 90.0, degrees=True)).as_quat(),
        g,
    ),
}


@pytest.mark.parametrize("reading", SPOILT)
def test_a_wrong_convention_is_detected_and_named(reading: str) -> None:
    times = np.arange(0.0, 300.0)
    star, gyro, _ = telemetry(times, times)
    quats, values = SPOILT[reading](star, gyro.values)
    spoilt = StarSeries.of(times, quats, 5 * ARCSEC)
    with pytest.raises(ArgumentError, match=reading):
        ekf.filter_forward(spoilt, GyroSeries.of(times, values, "increment"), settings())


def test_a_body_at_rest_tells_nothing_about_conventions() -> None:
    rest = lambda t: np.zeros((*np.shape(t), 3))  # noqa: E731
    times = np.arange(0.0, 100.0)
    star, gyro, _ = telemetry(times, times, rate=rest)
    ekf.filter_forward(star, GyroSeries.of(times, -gyro.values, "increment"), settings())


def test_relinearised_pass_agrees_with_the_first_where_there_is_nothing_to_gain() -> None:
    times = np.arange(0.0, 200.0, 0.5)
    star, gyro, _ = telemetry(times, times[::2], parameters=GyroParameters.of())
    line = merge(star, gyro, Mounting())
    chosen = settings("general", scale_sigma=1e-9, misalignment_sigma=1e-9)
    plain = run_forward(line, chosen)
    again = run_forward(line, chosen, plain.rest[-1].copy())
    apart = Rotation.from_quat(plain.quat_xyzw).inv() * Rotation.from_quat(again.quat_xyzw)
    assert apart.magnitude().max() < 1e-5 * ARCSEC
