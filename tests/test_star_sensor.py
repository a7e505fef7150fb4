"""Simulated star heads: noise about the right axes, slow errors, directions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError
from geoposition.sensors.star_sensor import (
    StarHead,
    ThermalDrift,
    mounting_of,
    noisy_quat_xyzw,
    orbit_periodic,
    simulate_star_series,
)
from geoposition.sensors.star_vectors import (
    direction_of_image_point,
    direction_of_star,
    grouped_by_epoch,
    simulate_star_vectors,
)

ARCSEC = np.radians(1.0 / 3600.0)


def attitude(times_s: np.ndarray) -> Rotation:
    return Rotation.from_rotvec(np.outer(times_s, [0.01, -0.02, 0.005]))


def test_noise_is_about_the_sensor_axes() -> None:
    head = StarHead("a", 3 * ARCSEC, 20 * ARCSEC, Rotation.from_euler("ZXY", [0.4, 1.0, -0.7]))
    times = 0.1 * np.arange(20_000)
    series = simulate_star_series([head], [times], attitude, np.random.default_rng(1))
    true = attitude(times) * head.R_body_sensor
    error = (true.inv() * series.R_inertial_sensor).as_rotvec()
    assert np.std(error, axis=0) == pytest.approx(head.sigma_rad, rel=0.02)
    assert np.abs(np.corrcoef(error.T) - np.eye(3)).max() < 0.03
    assert series.sigma_bore_rad[5] == head.sigma_bore_rad


def test_heads_are_merged_in_time_and_named() -> None:
    heads = [StarHead("a"), StarHead("b", R_body_sensor=Rotation.from_rotvec([1.0, 0.0, 0.0]))]
    series = simulate_star_series(
        heads, [[0.0, 1.0, 2.0], [0.5, 1.0]], attitude, np.random.default_rng(2)
    )
    assert series.times_s.tolist() == [0.0, 0.5, 1.0, 1.0, 2.0]
    assert series.head.tolist() == [0, 1, 0, 1, 0]
    assert series.heads == ("a", "b")
    back = series.R_inertial_sensor[1] * mounting_of(heads).rotation("b").inv()
    assert (attitude(np.array([0.5]))[0].inv() * back).magnitude() < 8 * 2.4e-5


def test_slow_errors_follow_orbit_and_temperature() -> None:
    period = 5600.0
    head = StarHead(
        sigma_cross_rad=1e-12,
        sigma_bore_rad=1e-12,
        low_frequency=orbit_periodic(
            period, [[20 * ARCSEC, 0.0, 0.0], [0.0, 5 * ARCSEC, 0.0]], [[0, 0, 0], [0, 1.0, 0]]
        ),
        drift=ThermalDrift([0, 0, 1e-9], [3 * ARCSEC, 0.0, 0.0], 900.0, start_s=100.0),
    )
    times = np.linspace(0.0, 2 * period, 1001)
    series = simulate_star_series([head], [times], attitude, np.random.default_rng(3))
    error = (attitude(times).inv() * series.R_inertial_sensor).as_rotvec()
    phase = 2 * np.pi * times / period
    since = np.maximum(times - 100.0, 0.0)
    expected = np.stack(
        [
            20 * ARCSEC * np.sin(phase) + 3 * ARCSEC * (1 - np.exp(-since / 900.0)),
            5 * ARCSEC * np.sin(2 * phase + 1.0),
            1e-9 * since,
        ],
        axis=-1,
    )
    assert error == pytest.approx(expected, abs=1e-10)


def test_runs_of_noise() -> None:
    true = attitude(np.arange(50.0)).as_quat()
    noisy = noisy_quat_xyzw(true, 1e-5, np.random.default_rng(4), runs=400)
    assert noisy.shape == (400, 50, 4)
    # the vector part of the error quaternion has half the noise (T table 3.1)
    error = Rotation.from_quat(np.tile(true, (400, 1))).inv() * Rotation.from_quat(
        noisy.reshape(-1, 4)
    )
    assert np.std(error.as_quat(canonical=True)[:, :3]) == pytest.approx(5e-6, rel=0.02)


@given(st.floats(0.0, 6.28), st.floats(-1.57, 1.57))
def test_star_directions(alpha: float, delta: float) -> None:
    v = direction_of_star(alpha, delta)
    assert np.linalg.norm(v) == pytest.approx(1.0, abs=1e-15)
    assert np.arcsin(v[2]) == pytest.approx(delta, abs=1e-7)


def test_image_points_look_along_plus_z() -> None:
    directions = direction_of_image_point([10.0, 13.0], [20.0, 20.0], 4.0, (10.0, 20.0))
    assert directions == pytest.approx(np.array([[0, 0, 1], [0.6, 0, 0.8]]), abs=1e-15)


def test_star_vectors_have_the_quest_noise_and_lie_in_the_field() -> None:
    rng = np.random.default_rng(5)
    catalogue = rng.standard_normal((3000, 3))
    catalogue /= np.linalg.norm(catalogue, axis=1, keepdims=True)
    heads = [StarHead("a"), StarHead("b", R_body_sensor=Rotation.from_rotvec([0.0, 1.2, 0.0]))]
    times = np.arange(200.0)
    rows = simulate_star_vectors(heads, times, attitude, catalogue, 1e-5, rng, max_stars=12)
    assert set(rows.head) == {0, 1}
    assert np.all(np.diff(rows.times_s) >= 0.0)
    assert np.all(rows.sensor[:, 2] > np.cos(np.radians(10.1)))
    truth = attitude(rows.times_s).inv().apply(np.array(rows.reference))
    error = rows.body(mounting_of(heads)) - truth
    along = np.sum(error * truth, axis=1)
    assert np.mean(np.sum(error**2, axis=1)) == pytest.approx(2e-10, rel=0.03)
    assert np.abs(along).max() < 1e-8
    groups = grouped_by_epoch(
        rows.times_s, rows.body(mounting_of(heads)), rows.reference, rows.sigma_rad
    )
    assert groups.body.shape == (200, groups.body.shape[1], 3)
    assert np.isfinite(groups.sigma_rad).sum() == len(rows)
    first = rows.times_s == 0.0
    assert np.array_equal(groups.reference[0, : first.sum()], rows.reference[first])


def test_misuse_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ArgumentError, match="one list of epochs"):
        simulate_star_series([StarHead()], [], attitude, rng)
    with pytest.raises(ArgumentError, match="positive noise"):
        StarHead("a", 0.0)
    with pytest.raises(ArgumentError, match="period"):
        orbit_periodic(0.0, [1e-5, 0, 0])
    with pytest.raises(ArgumentError, match="time constant"):
        ThermalDrift(time_constant_s=0.0)
    with pytest.raises(ArgumentError, match="one time"):
        grouped_by_epoch([0.0, 1.0], np.zeros((1, 3)), np.zeros((1, 3)), 1e-5)
