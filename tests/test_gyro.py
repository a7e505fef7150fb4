"""The gyro's simulated errors have the continuous model's covariance; known errors come out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoposition.errors import ArgumentError
from geoposition.sensors.gyro import (
    allan_deviation_rad_s,
    angle_variance_rad2,
    corrected,
    draw_parameters,
    simulate_increments,
    simulate_mean_rates,
    simulate_rates,
)
from geoposition.sensors.kinematics import integrated_rate_rad
from geoposition.sensors.telemetry import GyroNoise, GyroParameters, GyroSeries

NOISE = GyroNoise(1e-6, 3e-7)
QUIET = GyroNoise(1e-30, 0.0)
GENERAL = GyroParameters.of(
    [1e-6, -2e-6, 3e-6], [1.5e-3, 1e-3, 1.5e-3], [1e-3, 1.5e-3, 2e-3], [5e-4, 1e-3, 1.5e-3]
)


def thesis_rate(times_s: np.ndarray) -> np.ndarray:
    turns = [np.sin(0.01 * times_s), np.sin(0.002 * times_s), np.cos(0.001 * times_s)]
    return np.radians(0.1) * np.stack(turns, axis=-1)


def uneven_times() -> np.ndarray:
    return np.cumsum([0.0, 0.1, 0.4, 1.0, 0.2, 2.0, 0.3, 0.3])


def test_the_angle_spreads_as_the_continuous_model_says() -> None:
    times = uneven_times()
    runs = 20_000
    made = simulate_increments(
        times, np.zeros((len(times) - 1, 3)), NOISE, np.random.default_rng(1), runs=runs
    )
    angle = np.cumsum(made.values[:, 1:], axis=1)
    elapsed = times[1:] - times[0]
    expected = angle_variance_rad2(NOISE, elapsed)
    # sigma of a sample variance of 60,000 numbers: 0.6 %
    assert np.mean(angle**2, axis=(0, 2)) == pytest.approx(expected, rel=0.03)
    bias = made.bias_rad_s[:, 1:]
    walk = NOISE.rate_random_walk**2 * elapsed
    assert np.mean(bias**2, axis=(0, 2)) == pytest.approx(walk, rel=0.03)
    # angle and bias: sigma_u^2 t^2 / 2, Farrenkopf's cross-term
    cross = np.mean(angle * bias, axis=(0, 2))
    expected_cross = NOISE.rate_random_walk**2 * elapsed**2 / 2.0
    scale = np.sqrt(expected * walk / (3 * runs))
    assert np.all(np.abs(cross - expected_cross) < 4.0 * scale)


def test_the_step_and_the_bias_at_its_end_have_the_exact_covariance() -> None:
    noise, step = GyroNoise(1e-7, 1e-6), 3.0
    made = simulate_increments(
        [0.0, step], np.zeros((1, 3)), noise, np.random.default_rng(2), runs=60_000
    )
    pair = np.stack([made.values[:, 1].ravel(), made.bias_rad_s[:, 1].ravel()])
    v2, u2 = noise.angle_random_walk**2, noise.rate_random_walk**2
    exact = np.array(
        [[v2 * step + u2 * step**3 / 3, u2 * step**2 / 2], [u2 * step**2 / 2, u2 * step]]
    )
    assert np.cov(pair) == pytest.approx(exact, rel=0.02)


def test_allan_deviation_of_a_long_series() -> None:
    noise, step = GyroNoise(2e-6, 4e-7), 0.1
    times = step * np.arange(200_001)
    made = simulate_mean_rates(
        times, np.zeros((len(times) - 1, 3)), noise, np.random.default_rng(3)
    )
    angle = np.concatenate([[np.zeros(3)], np.cumsum(made.values[1:] * step, axis=0)])
    for samples in (1, 10, 100, 1000):
        # overlapping second differences of the angle
        second = angle[2 * samples :] - 2.0 * angle[samples:-samples] + angle[: -2 * samples]
        tau = samples * step
        measured = np.sqrt(np.mean(second**2) / (2.0 * tau**2))
        spread = 1.0 / np.sqrt(3.0 * len(times) / samples)
        assert measured == pytest.approx(allan_deviation_rad_s(noise, tau), rel=4 * spread + 1e-3)


def test_sampled_rates_walk_with_the_stated_angle_random_walk() -> None:
    times = uneven_times()
    noise = GyroNoise(1e-6, 0.0)
    made = simulate_rates(
        times, np.zeros((len(times), 3)), noise, np.random.default_rng(4), runs=20_000
    )
    angle = sum(
        made.values[:, k] * 0.5 * (times[min(k + 1, len(times) - 1)] - times[max(k - 1, 0)])
        for k in range(1, len(times) - 1)
    )
    inner = 0.5 * (times[-1] + times[-2] - times[1] - times[0])
    assert np.var(angle) == pytest.approx(noise.angle_random_walk**2 * inner, rel=0.03)


def test_general_errors_act_as_the_model_says_and_come_out() -> None:
    times = np.linspace(0.0, 600.0, 301)
    truth = integrated_rate_rad(thesis_rate, times)
    rng = np.random.default_rng(5)
    measured = simulate_increments(times, truth, QUIET, rng, GENERAL)
    by_hand = (np.eye(3) + GENERAL.matrix) @ truth[7] + 2.0 * GENERAL.bias_rad_s
    assert measured.values[8] == pytest.approx(by_hand, abs=1e-18)
    for made, true in (
        (measured, truth),
        (simulate_mean_rates(times, truth, QUIET, rng, GENERAL), truth / 2.0),
        (simulate_rates(times, thesis_rate(times), QUIET, rng, GENERAL), thesis_rate(times)[1:]),
    ):
        clean = corrected(made.series(), GENERAL)
        assert clean.kind == made.kind
        assert clean.values[1:] == pytest.approx(true, abs=1e-17)


def test_a_walking_bias_comes_out_down_to_the_white_noise() -> None:
    times = 0.5 * np.arange(5001)
    noise = GyroNoise(1e-7, 1e-6)
    made = simulate_increments(times, np.zeros((5000, 3)), noise, np.random.default_rng(6))
    clean = corrected(made.series(), GyroParameters.of(), made.bias_rad_s)
    rest = noise.angle_random_walk**2 * 0.5 + noise.rate_random_walk**2 * 0.5**3 / 12.0
    assert np.var(clean.values[1:]) == pytest.approx(rest, rel=0.04)


def test_runs_broadcast_and_keep_their_own_truth() -> None:
    parameters = draw_parameters(np.random.default_rng(7), 400, 1e-5, 2e-3, 1e-3)
    assert parameters.matrix.shape == (400, 3, 3)
    assert np.std(parameters.scale) == pytest.approx(2e-3, rel=0.1)
    times = np.arange(11.0)
    truth = integrated_rate_rad(thesis_rate, times)
    made = simulate_increments(times, truth, QUIET, np.random.default_rng(8), parameters)
    assert made.values.shape == made.bias_rad_s.shape == (400, 11, 3)
    lone = GyroParameters.of(
        parameters.bias_rad_s[3], parameters.scale[3], parameters.upper[3], parameters.lower[3]
    )
    assert corrected(made.series(3), lone).values[1:] == pytest.approx(truth, abs=1e-16)
    assert np.array_equal(made.series(3).values, made.values[3])


@given(st.integers(0, 2**32 - 1))
def test_the_same_seed_gives_the_same_series(seed: int) -> None:
    one, two = (
        simulate_increments([0.0, 1.0, 1.5], np.ones((2, 3)), NOISE, np.random.default_rng(seed))
        for _ in range(2)
    )
    assert np.array_equal(one.values, two.values)
    assert not one.values.flags.writeable


def test_misuse_is_refused_in_one_line() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ArgumentError, match="shape"):
        simulate_increments([0.0, 1.0], np.zeros((2, 3)), NOISE, rng)
    with pytest.raises(ArgumentError, match="shape"):
        simulate_rates([0.0, 1.0], np.zeros((1, 3)), NOISE, rng)
    with pytest.raises(ArgumentError, match="do not go together"):
        simulate_increments(
            [0.0, 1.0], np.zeros((1, 3)), NOISE, rng, draw_parameters(rng, 4, 1e-6), runs=5
        )
    with pytest.raises(ArgumentError, match="one run"):
        simulate_increments([0.0, 1.0], np.zeros((1, 3)), NOISE, rng, runs=5).series()
    series = GyroSeries.of([0.0, 1.0], np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match="gyro bias"):
        corrected(series, GyroParameters.of(), np.zeros((3, 3)))
