"""Separation of errors: the parts of simulated sums come back, each with its own size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.checks.error_split import (
    SplitSettings,
    split_errors,
)

PERIOD_S = 5600.0


def simulated(
    low: float, high: float, white: float, *, uneven: bool = False, seed: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Three orbits at 1 Hz: two harmonics, a wave of 60 s and white noise of these RMS values."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 3.0 * PERIOD_S)
    if uneven:
        times = times + rng.uniform(-0.3, 0.3, len(times))
    orbit = 2.0 * np.pi * times / PERIOD_S
    slow = low * np.sqrt(2.0) * (0.8 * np.sin(orbit + 1.0) + 0.6 * np.cos(2.0 * orbit))
    fast = high * np.sqrt(2.0) * np.sin(2.0 * np.pi * times / 60.0)
    return times, 1000.0 + slow + fast + white * rng.standard_normal(len(times))


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize(
    "chosen",
    [SplitSettings(PERIOD_S, high_hz=0.08), SplitSettings(low_hz=2e-3, high_hz=0.08)],
    ids=["harmonics", "low-pass"],
)
def test_parts_of_a_sum(uneven: bool, chosen: SplitSettings) -> None:
    times, values = simulated(8.0, 2.0, 5.0, uneven=uneven)
    found = split_errors(times, values, chosen)
    assert found.low_std[0] == pytest.approx(8.0, rel=0.03)
    assert found.high_std[0] == pytest.approx(2.0, rel=0.08)
    assert found.random_std[0] == pytest.approx(5.0, rel=0.03)
    assert found.harmonics == (chosen.orbit_period_s is not None)
    total = found.mean + found.low + found.high + found.random
    np.testing.assert_allclose(total, values, atol=1e-9)


def test_white_noise_is_random_alone() -> None:
    high = []
    for seed in range(10):
        found = split_errors(*simulated(0.0, 0.0, 5.0, seed=seed), SplitSettings(PERIOD_S))
        assert found.random_std[0] == pytest.approx(5.0, rel=0.03)
        assert found.low_std[0] < 0.3
        high.append(found.high_std[0])
    # Nothing is there: what is left of the high part is the scatter of its own estimate.
    assert np.median(high) < 0.5


def test_columns_are_apart() -> None:
    times, first = simulated(8.0, 0.0, 1.0)
    _, second = simulated(0.0, 3.0, 2.0, seed=2)
    found = split_errors(times, np.stack([first, second], axis=1), SplitSettings(PERIOD_S))
    assert found.low.shape == (len(times), 2)
    np.testing.assert_allclose(found.low_std, [8.0, 0.0], atol=0.2)
    np.testing.assert_allclose(found.high_std, [0.0, 3.0], atol=0.3)


def test_less_than_an_orbit_falls_back_to_the_cut_off() -> None:
    times, values = simulated(8.0, 2.0, 5.0)
    found = split_errors(times[:4000], values[:4000], SplitSettings(PERIOD_S))
    assert not found.harmonics
    assert found.summary()["low_frequency_model"] == "low-pass"


@given(scale=st.floats(1e-6, 1e3), offset=st.floats(-1e3, 1e3))
@settings(max_examples=20)
def test_sizes_scale_with_the_values(scale: float, offset: float) -> None:
    times, values = simulated(3.0, 2.0, 1.0)
    plain = split_errors(times[:3000], values[:3000])
    scaled = split_errors(times[:3000], scale * values[:3000] + offset)
    np.testing.assert_allclose(scaled.random_std, scale * plain.random_std, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(scaled.high_std, scale * plain.high_std, rtol=1e-4, atol=1e-8)


def test_cut_offs_must_rise() -> None:
    times, values = simulated(1.0, 1.0, 1.0)
    with pytest.raises(ArgumentError, match="must rise"):
        split_errors(times, values, SplitSettings(low_hz=0.2, high_hz=0.1))
    with pytest.raises(ArgumentError, match="half the sampling rate"):
        split_errors(times, values, SplitSettings(high_hz=0.6))
    with pytest.raises(ArgumentError, match="at least 32"):
        split_errors(times[:10], values[:10])
