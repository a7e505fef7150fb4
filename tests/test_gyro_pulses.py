"""Pulses of skewed and redundant axes become body angles, to the pulse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.sensors.gyro_pulses import (
    GyroAxes,
    body_angles,
    pulses_of_counter,
    simulate_pulses,
)

TILT = np.radians(54.7)
PYRAMID = GyroAxes.of(
    [
        [np.sin(TILT) * np.cos(a), np.sin(TILT) * np.sin(a), np.cos(TILT)]
        for a in np.radians([45.0, 135.0, 225.0, 315.0])
    ],
    [1e-6, -1e-6, 2e-6, 1e-6],
)
TIMES = 0.1 * np.arange(2001)


def turning() -> np.ndarray:
    rate = np.stack([1e-3 * np.sin(0.2 * TIMES), 1e-3 + 0 * TIMES, -5e-4 * np.cos(0.1 * TIMES)], -1)
    return 0.1 * rate


def test_counts_come_back_to_the_pulse_and_never_drift() -> None:
    pulses = simulate_pulses(turning(), PYRAMID)
    assert np.array_equal(pulses, np.round(pulses))
    found = body_angles(TIMES, pulses, PYRAMID)
    error = np.cumsum(found.increments_rad - turning(), axis=0)
    assert np.abs(error).max() < 3e-6
    series = found.series()
    assert series.kind == "increment"
    assert found.rates_rad_s()[5] == pytest.approx(turning()[5] / 0.1, abs=4e-5)


@given(st.integers(0, 10**9), st.integers(3, 6))
def test_any_axes_that_span_space_give_the_turn(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    axes = rng.standard_normal((m, 3))
    unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    if np.linalg.svd(unit, compute_uv=False)[-1] < 0.05:
        return
    turns = rng.standard_normal((4, 3))
    scale = rng.uniform(0.5, 2.0, m)
    found = body_angles(np.arange(4.0), turns @ unit.T / scale, GyroAxes.of(axes, scale))
    assert found.increments_rad == pytest.approx(turns, abs=1e-11)
    assert found.residual_rad == pytest.approx(0.0, abs=1e-11)


def test_the_residual_tells_a_failing_axis() -> None:
    pulses = simulate_pulses(turning(), PYRAMID)
    pulses[1000:, 2] *= 1.5
    residual = body_angles(TIMES, pulses, PYRAMID).residual_rad
    assert np.abs(residual[1:1000]).max() < 2.5e-6
    assert np.abs(residual[1001:]).mean() > 3e-6


def test_a_dead_axis_of_four_is_borne_two_are_not() -> None:
    pulses = simulate_pulses(turning(), PYRAMID)
    pulses[500:700, 1] = np.nan
    found = body_angles(TIMES, pulses, PYRAMID)
    assert np.abs(found.increments_rad - turning()).max() < 8e-6
    assert np.isnan(found.residual_rad[600, 1])
    pulses[600, 0] = np.nan
    found = body_angles(TIMES, pulses, PYRAMID)
    assert np.flatnonzero(found.flag != Flag.OK).tolist() == [600]
    assert np.isnan(found.increments_rad[600]).all()
    with pytest.raises(GeometryError, match="sample 600"):
        found.series()


def test_noisier_axes_weigh_less() -> None:
    rng = np.random.default_rng(1)
    axes = np.concatenate([np.eye(3), np.eye(3)])
    sigma = np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])
    counts = sigma * rng.standard_normal((20_000, 6))
    found = body_angles(np.arange(20_000.0), counts, GyroAxes.of(axes, 1.0, sigma))
    assert np.var(found.increments_rad, axis=0) == pytest.approx(0.9, rel=0.04)


def test_counters_wrap() -> None:
    truth = np.array([[5.0], [5.0], [-9.0], [120.0], [-100.0], [7.0]])
    counter = np.mod(np.cumsum(truth, axis=0), 256)
    assert pulses_of_counter(counter, 8)[1:] == pytest.approx(truth[1:])
    signed = np.where(counter > 127, counter - 256, counter)
    assert pulses_of_counter(signed, 8)[1:] == pytest.approx(truth[1:])


def test_misuse_is_refused() -> None:
    with pytest.raises(GeometryError, match="one plane"):
        GyroAxes.of([[1, 0, 0], [0, 1, 0], [1, 1, 0]], 1e-6)
    with pytest.raises(ArgumentError, match="three"):
        GyroAxes.of(np.eye(3)[:2], 1e-6)
    with pytest.raises(ArgumentError, match="is zero"):
        GyroAxes.of(np.diag([1.0, 0.0, 1.0]), 1e-6)
    with pytest.raises(ArgumentError, match="per pulse"):
        GyroAxes.of(np.eye(3), 0.0)
    with pytest.raises(ArgumentError, match="shape"):
        body_angles([0.0, 1.0], np.zeros((3, 4)), PYRAMID)
    with pytest.raises(ArgumentError, match="bits"):
        pulses_of_counter(np.zeros((2, 3)), 1)
