"""The angular-displacement sensor: installation, scale and response, made and taken out again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError, GeometryError
from geoposition.sensors.angular_band import SensorBand, band_limited, band_restored
from geoposition.sensors.angular_displacement import (
    Installation,
    fit_installation,
    installation_undone,
    rates_from_increments,
    simulate_angular_displacement,
)
from geoposition.sensors.attitude_determination.static.heads import fuse_heads
from geoposition.sensors.jitter_scene import (
    PAPER_LINES,
    JitterLine,
    JitterSceneOptions,
    simulate_jitter_scene,
)
from geoposition.sensors.kinematics import relative_rotvec_rad
from geoposition.sensors.telemetry import GyroNoise, GyroSeries

ARCSEC = np.radians(1.0 / 3600.0)
QUIET = GyroNoise(1e-30, 0.0)
small = st.floats(-0.01, 0.01)
triples = st.tuples(small, small, small).map(np.array)


def manoeuvre_increments(times: np.ndarray) -> np.ndarray:
    angle = [0.1 * np.sin(0.3 * times), 0.2 * np.sin(0.17 * times), 0.1 * np.sin(0.23 * times)]
    return np.diff(np.stack(angle, axis=-1), axis=0)


@given(triples, triples, triples)
def test_installation_is_a_general_gyro_and_comes_out(
    turn: np.ndarray, scale: np.ndarray, motion: np.ndarray
) -> None:
    installation = Installation(turn, scale, [1e-6, 0.0, -1e-6])
    times = np.array([0.0, 0.1])
    series = simulate_angular_displacement(
        times, motion[None], QUIET, np.random.default_rng(0), installation
    ).series()
    by_hand = (1 + scale) * Rotation.from_rotvec(turn).inv().apply(motion)
    assert series.values[1] == pytest.approx(by_hand + [1e-7, 0.0, -1e-7], abs=1e-16)
    assert installation_undone(series, installation).values[1] == pytest.approx(motion, abs=1e-15)


def test_rates_are_increments_over_their_steps() -> None:
    series = GyroSeries.of([0.0, 0.1, 0.3], [[9, 9, 9], [1, 2, 3], [1, 2, 3]], "increment")
    assert rates_from_increments(series).values[1:] == pytest.approx(
        np.array([[10, 20, 30], [5, 10, 15]])
    )


def test_installation_and_scale_are_found_within_their_sigmas() -> None:
    times = np.arange(60_001) / 1000.0
    truth = manoeuvre_increments(times)
    planted = Installation([2e-3, -1e-3, 5e-4], [1e-3, -2e-3, 5e-4], [2e-6, 1e-6, -3e-6])
    noise = GyroNoise(0.015 * ARCSEC, 0.0)
    series = simulate_angular_displacement(
        times, truth, noise, np.random.default_rng(1), planted
    ).series()
    coarse = times[::100]
    summed = np.add.reduceat(truth, np.arange(0, 60_000, 100))
    found = fit_installation(series, coarse, summed)
    error = np.concatenate(
        [
            found.installation.turn_rad - planted.turn_rad,
            found.installation.scale - planted.scale,
            found.installation.drift_rad_s - planted.drift_rad_s,
        ]
    )
    assert np.all(np.abs(error) < 4.0 * found.sigma)
    assert np.sum((error / found.sigma) ** 2) < 27.9  # 99.9 % of chi-squared with 9 degrees
    assert np.all(found.sigma[:6] < 2e-6)
    assert found.residual_rad == pytest.approx(noise.angle_random_walk * np.sqrt(0.1), rel=0.1)


def test_a_turn_about_one_axis_cannot_tell_the_errors_apart() -> None:
    times = np.arange(1001) / 100.0
    truth = np.tile([1e-3, 0.0, 0.0], (1000, 1))
    series = simulate_angular_displacement(times, truth, QUIET, np.random.default_rng(2)).series()
    with pytest.raises(GeometryError, match="apart"):
        fit_installation(series, times, truth)
    with pytest.raises(GeometryError, match="beyond"):
        fit_installation(series, times + 1.0, truth)


@pytest.mark.parametrize("frequency", [0.05, 0.2, 1.0, 20.0, 200.0, 350.0, 450.0])
def test_the_simulated_response_is_the_sensors(frequency: float) -> None:
    rate, band = 10_000.0, SensorBand()
    times = np.arange(int(rate * max(2.0, 40.0 / frequency if frequency < 1 else 12.0))) / rate
    angle = np.sin(2 * np.pi * frequency * times)
    series = GyroSeries.of(
        times, np.tile(np.gradient(angle, 1 / rate)[:, None], (1, 3)), "mean-rate"
    )
    felt = band_limited(series, band)
    late = slice(len(times) // 2, None)
    wave = np.exp(-2j * np.pi * frequency * times[late]) * np.hanning(len(times[late]))
    gain = (felt.values[late, 0] @ wave) / (series.values[late, 0] @ wave)
    assert abs(gain - band.response(frequency)) < 0.012 * max(abs(gain), 0.2)


def test_corners_and_slopes_of_the_response() -> None:
    band = SensorBand()
    gain = np.abs(band.response([0.0, 0.02, 0.2, 10.0, 450.0, 4500.0]))
    assert gain == pytest.approx([0.0, 0.01, 0.5**0.5, 1.0, 0.5**0.5, 0.01], abs=1e-4)


def test_steady_turning_is_not_felt_and_comes_back_from_a_slow_gyro() -> None:
    rate = 5000.0
    times = np.arange(int(40 * rate) + 1) / rate
    lines = ((0.65, 4.0), (3.0, 0.5), (200.0, 0.025), (350.0, 0.02))
    angle = 1.1e-3 * times + ARCSEC * sum(a * np.sin(2 * np.pi * f * times + f) for f, a in lines)
    truth = np.tile(np.diff(angle, prepend=angle[:1])[:, None], (1, 3))
    truth[0] = truth[1]
    full = GyroSeries.of(times, truth, "increment")
    felt = band_limited(full, SensorBand())
    assert abs(np.sum(felt.values[:, 0])) < 1e-3 * (angle[-1] - angle[0])
    every = int(rate / 20)
    slow_angle = np.tile(angle[::every, None], (1, 3))
    slow_values = np.diff(slow_angle, axis=0, prepend=slow_angle[:1])
    slow = GyroSeries.of(times[::every], slow_values, "increment")
    back = band_restored(felt, SensorBand(), slow)
    error = np.cumsum(back.values[1:, 0] - truth[1:, 0])
    inner = slice(int(4 * rate), int(36 * rate))
    flat = error[inner] - np.mean(error[inner])
    # What is left in the fast lines is the digital filter's warping, 1 % of them.
    assert np.std(flat) < 0.002 * ARCSEC
    for frequency, amplitude in lines:
        wave = np.exp(-2j * np.pi * frequency * times[1:][inner]) * np.hanning(len(flat))
        left = 2 * abs(flat @ wave) / np.sum(np.hanning(len(flat)))
        assert left < max(0.02 * 0.025, 2e-4 * amplitude) * ARCSEC


def test_stars_give_a_band_limited_sensor_what_it_misses() -> None:
    options = JitterSceneOptions(
        sensor_hz=2000.0, lines=(JitterLine(0.65, (1.0, 2.0, 0.5)), *PAPER_LINES), band=SensorBand()
    )
    scene = simulate_jitter_scene(options, seed=1)
    slow = fuse_heads(scene.star, scene.mounting).increments()
    back = band_restored(scene.sensor, SensorBand(), slow, crossover_hz=0.05)
    truth = relative_rotvec_rad(scene.motion.quat_xyzw(scene.sensor.times_s))
    error = np.cumsum(back.increments_rad() - truth, axis=0)
    high_pass = signal.butter(4, 0.3, "highpass", fs=2000.0, output="sos")
    inner = error[20_000:-20_000] - error[20_000:-20_000].mean(axis=0)
    # below 0.05 Hz the stars': 5 arcsec at 2 x 10 Hz
    assert np.abs(inner).max() < 1.5 * ARCSEC
    assert np.std(signal.sosfiltfilt(high_pass, inner, axis=0), axis=0).max() < 0.01 * ARCSEC
    missed = np.cumsum(scene.sensor.increments_rad() - truth, axis=0)[20_000:-20_000]
    assert np.std(signal.sosfiltfilt(high_pass, missed, axis=0), axis=0).max() > 0.2 * ARCSEC


def test_misuse_is_refused() -> None:
    times = np.arange(100.0)
    series = GyroSeries.of(times, np.zeros((100, 3)), "increment")
    with pytest.raises(ArgumentError, match="sampling rate"):
        band_limited(series, SensorBand())
    with pytest.raises(ArgumentError, match="mean rates expected"):
        band_limited(GyroSeries.of(times, np.zeros((100, 3))), SensorBand(0.01, 0.1))
    uneven = GyroSeries.of(times**1.1, np.zeros((100, 3)), "increment")
    with pytest.raises(ArgumentError, match="equal steps"):
        band_limited(uneven, SensorBand(0.01, 0.1))
    with pytest.raises(ArgumentError, match="0 < low < high"):
        SensorBand(2.0, 1.0)
    slow = GyroSeries.of([10.0, 20.0], np.zeros((2, 3)), "increment")
    with pytest.raises(GeometryError, match="cover"):
        band_restored(series, SensorBand(0.01, 0.2), slow)
    with pytest.raises(ArgumentError, match="crossover"):
        band_restored(series, SensorBand(0.01, 0.2), slow, crossover_hz=0.3)
