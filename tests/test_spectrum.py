"""Spectra and lines: densities of known noise, injected lines, scatter against stated sigmas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.signal.low_pass import low_pass, low_pass_gain
from geoposition.sensors.attitude_determination.signal.noise_floor import noise_floor
from geoposition.sensors.attitude_determination.signal.peaks import find_lines
from geoposition.sensors.attitude_determination.signal.spectrum import (
    SpectrumMethod,
    fourier_sums,
    highest_frequency_hz,
    spectrum,
)


def uneven_times(n: int, rng: np.random.Generator) -> np.ndarray:
    return np.cumsum(rng.choice([0.1, 0.2], n))


# Low pass -------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency_hz", [0.03, 0.05, 0.1, 0.2, 0.4])
@pytest.mark.parametrize("uneven", [False, True])
def test_low_pass_has_its_gain(frequency_hz: float, uneven: bool) -> None:
    rng = np.random.default_rng(1)
    times = np.arange(8000) * 0.1
    if uneven:
        times = times + rng.uniform(-0.03, 0.03, len(times))
    wave = np.exp(2j * np.pi * frequency_hz * times)
    passed = low_pass(times, wave.real, 0.1) + 1j * low_pass(times, wave.imag, 0.1)
    inner = slice(1000, -1000)
    gain = np.mean(passed[inner] / wave[inner])
    assert abs(gain - low_pass_gain(frequency_hz, 0.1)) < 3e-3


def test_low_pass_far_below_the_sampling_rate_equals_the_plain_one() -> None:
    # 0.02 Hz of 100 Hz goes through block means; of 4 Hz it does not.
    slow = np.arange(0.0, 400.0, 0.25)
    fast = np.arange(0.0, 400.0, 0.01)

    def signal(t: np.ndarray) -> np.ndarray:
        return np.sin(2 * np.pi * 0.01 * t) + 0.5 * np.cos(2 * np.pi * 0.03 * t)

    plain = np.interp(fast, slow, low_pass(slow, signal(slow), 0.02))
    inner = (fast > 100.0) & (fast < 300.0)
    np.testing.assert_allclose(low_pass(fast, signal(fast), 0.02)[inner], plain[inner], atol=4e-3)


@given(slope=st.floats(-1e3, 1e3), offset=st.floats(-1e3, 1e3), cutoff=st.floats(1e-3, 2.0))
@settings(max_examples=30)
def test_low_pass_keeps_straight_lines(slope: float, offset: float, cutoff: float) -> None:
    times = uneven_times(300, np.random.default_rng(3))
    line = slope * times + offset
    np.testing.assert_allclose(low_pass(times, line, cutoff), line, atol=1e-5)


# Spectra --------------------------------------------------------------------------------------


def test_fourier_sums_equal_the_direct_ones() -> None:
    rng = np.random.default_rng(2)
    times, values = np.sort(rng.uniform(0.0, 100.0, 400)), rng.standard_normal(400)
    direct = np.exp(-2j * np.pi * np.arange(500)[:, None] * 0.004 * times) @ values
    fast = fourier_sums(times, values, 0.004, 500)
    assert np.max(np.abs(fast - direct)) < 1e-9 * np.max(np.abs(direct))


@pytest.mark.parametrize("method", ["welch", "multitaper", "lomb-scargle"])
def test_white_noise_has_its_density_and_confidence(method: SpectrumMethod) -> None:
    rng = np.random.default_rng(4)
    times = np.arange(20000) * 0.1
    noise = 3.0 * rng.standard_normal((len(times), 2))
    found = spectrum(times, noise, method=method, segments=20)
    truth = 2.0 * 9.0 * 0.1
    inner = (found.frequency_hz > 0.1) & (found.frequency_hz < 4.9)
    ratio = found.density[inner] / truth
    assert abs(np.mean(ratio) - 1.0) < 0.02
    outside = np.mean((ratio * found.low > 1.0) | (ratio * found.high < 1.0))
    assert 0.03 < outside < 0.07  # stated: 5 %


def test_uneven_white_noise_has_its_density() -> None:
    rng = np.random.default_rng(5)
    times = uneven_times(20000, rng)
    found = spectrum(times, rng.standard_normal(len(times)), segments=16)
    assert found.method == "lomb-scargle"
    truth = 2.0 * (times[-1] - times[0]) / len(times)
    assert np.mean(found.density) == pytest.approx(truth, rel=0.02)


@pytest.mark.parametrize("method", ["welch", "lomb-scargle"])
def test_amplitude_of_a_line(method: SpectrumMethod) -> None:
    times = np.arange(16384) * 0.1
    found = spectrum(times, 0.7 * np.sin(2 * np.pi * 1.25 * times), method=method)
    assert np.max(found.amplitude()) == pytest.approx(0.7, rel=0.02)


def test_uneven_steps_need_their_method() -> None:
    times = uneven_times(200, np.random.default_rng(0))
    with pytest.raises(ArgumentError, match="needs even steps"):
        spectrum(times, times, method="welch")
    with pytest.raises(ArgumentError, match="at least 16"):
        spectrum([0.0, 1.0], [0.0, 1.0])


# Lines ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["even", "uneven", "random walk"])
def test_noise_alone_shows_no_lines(kind: str) -> None:
    alarms = 0
    for seed in range(120):
        rng = np.random.default_rng(seed)
        times = uneven_times(500, rng) if kind == "uneven" else np.arange(800) * 0.1
        noise = rng.standard_normal(len(times))
        if kind == "random walk":
            noise = np.cumsum(noise)
            noise -= low_pass(times, noise, 0.1)
        alarms += bool(find_lines(times, noise, lowest_hz=0.2, highest_hz=2.5, false_alarm=0.02))
    # Expected 2.4 of 120; more than 8 has a probability of 0.1 %.
    assert alarms <= 8


def test_floor_follows_steep_noise() -> None:
    rng = np.random.default_rng(6)
    frequency = np.arange(1, 4000) * 1e-3
    truth = frequency**-2.0
    floor, worth = noise_floor(frequency, truth * rng.exponential(size=len(frequency)))
    assert np.std(np.log(floor / truth)[20:]) < 0.25
    assert np.all(worth > 4.0)


@pytest.mark.parametrize("uneven", [False, True])
def test_scatter_equals_the_stated_sigma(uneven: bool) -> None:
    truth = np.array([0.73, 0.8, 0.4])
    off, stated = [], []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        times = uneven_times(600, rng) if uneven else np.arange(900) * 0.1
        frequency, amplitude, phase = truth
        values = amplitude * np.sin(2 * np.pi * frequency * (times - times[0]) + phase)
        values = values + rng.standard_normal(len(times))
        (line,) = find_lines(times, values, lowest_hz=0.1, highest_hz=2.5, false_alarm=0.05)[:1]
        off.append(np.array([line.frequency_hz, line.amplitude, line.phase_rad]) - truth)
        stated.append([line.sigma_frequency_hz, line.sigma_amplitude, line.sigma_phase_rad])
    ratio = np.array(off) / np.array(stated)
    # Three sigma of 150 draws, and 5 % more for the scatter of the noise floor itself.
    assert np.all(np.abs(np.std(ratio, axis=0) - 1.05) < 3.0 / np.sqrt(2.0 * 150.0))
    assert np.all(np.abs(np.mean(ratio, axis=0)) < 0.25)


def test_sigma_is_the_bound_of_rife_and_boorstyn() -> None:
    rng = np.random.default_rng(8)
    n, step, amplitude, sigma = 20000, 0.05, 0.3, 1.0
    times = np.arange(n) * step
    values = amplitude * np.sin(2 * np.pi * 2.0 * times) + sigma * rng.standard_normal(n)
    (line,) = find_lines(times, values, lowest_hz=0.1, highest_hz=10.0)
    frequency = np.sqrt(24.0 / n) * sigma / (amplitude * n * step * 2.0 * np.pi)
    assert line.sigma_frequency_hz == pytest.approx(frequency, rel=0.15)
    assert line.sigma_amplitude == pytest.approx(sigma * np.sqrt(2.0 / n), rel=0.15)
    assert line.sigma_phase_rad == pytest.approx(np.sqrt(8.0 / n) * sigma / amplitude, rel=0.15)


def test_periodic_uneven_steps_bring_no_ghosts() -> None:
    # 0.1, 0.2, 0.1, 0.2 s: every line has an image at 3.33 Hz less its frequency.
    rng = np.random.default_rng(9)
    times = np.concatenate([[0.0], np.cumsum(np.tile([0.1, 0.2], 600))])
    values = 4.0 * np.sin(2 * np.pi * 0.73 * times) + 2.0 * np.sin(2 * np.pi * 1.35 * times + 1.0)
    values = values + 0.3 * rng.standard_normal(len(times))
    lines = find_lines(times, values, lowest_hz=0.05, highest_hz=highest_frequency_hz(times))
    assert [round(line.frequency_hz, 2) for line in lines] == [0.73, 1.35]
    assert [line.amplitude for line in lines] == pytest.approx([4.0, 2.0], rel=0.03)


@given(
    frequency=st.floats(0.3, 4.5),
    phase=st.floats(-3.0, 3.0),
    amplitude=st.floats(0.5, 50.0),
)
@settings(max_examples=25)
def test_any_line_is_found(frequency: float, phase: float, amplitude: float) -> None:
    times = 100.0 + np.arange(1500) * 0.1
    values = amplitude * np.sin(2 * np.pi * frequency * (times - 100.0) + phase)
    values = values + 0.1 * np.random.default_rng(1).standard_normal(len(times))
    line = find_lines(times, values, lowest_hz=0.1, highest_hz=5.0)[0]
    assert abs(line.frequency_hz - frequency) < 6.0 * line.sigma_frequency_hz
    assert abs(line.amplitude - amplitude) < 6.0 * line.sigma_amplitude
    assert abs(np.angle(np.exp(1j * (line.phase_rad - phase)))) < 6.0 * line.sigma_phase_rad


def test_two_lines_a_few_bins_apart_are_two() -> None:
    times = np.arange(2000) * 0.1  # bins of 0.005 Hz
    values = np.sin(2 * np.pi * 1.0 * times) + 0.6 * np.sin(2 * np.pi * 1.02 * times + 1.0)
    values = values + 0.05 * np.random.default_rng(2).standard_normal(len(times))
    lines = find_lines(times, values, lowest_hz=0.1, highest_hz=5.0)
    assert len(lines) == 2
    assert lines[0].frequency_hz == pytest.approx(1.0, abs=2e-4)
    assert lines[1].frequency_hz == pytest.approx(1.02, abs=2e-4)


def test_too_narrow_a_band_is_refused() -> None:
    times = np.arange(200) * 0.1
    with pytest.raises(ArgumentError, match="too short"):
        find_lines(times, np.sin(times), lowest_hz=4.9, highest_hz=5.0)
