"""Gyro against star sensor: simulated errors come back, mistakes are named, good data pass."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError, GeometryError
from geoposition.sensors.attitude_determination.checks.axis_angle import interpolate_rotations
from geoposition.sensors.attitude_determination.checks.gyro_check import (
    GyroCheckSettings,
    check_gyro,
)
from geoposition.sensors.attitude_determination.checks.gyro_samples import (
    GyroFlag,
    suspicious_samples,
)
from geoposition.sensors.kinematics import accumulated
from geoposition.sensors.telemetry import GyroKind, GyroSeries, Mounting, StarSeries

ARCSEC = np.pi / 648000.0
BIAS = np.array([1.0, -0.5, 1.5]) * np.radians(1.0) / 3600.0
FINE_S = 0.01
STEP_S = 0.1


def simulated(
    *,
    lag_s: float = 0.0,
    matrix: np.ndarray | None = None,
    drift: float = 0.0,
    kind: GyroKind = "rate",
    mean: bool = False,
    seed: int = 0,
    span_s: float = 1200.0,
) -> tuple[StarSeries, GyroSeries]:
    """A body that sways by degrees; star 4 Hz with 5", gyro 10 Hz with a small random walk."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(span_s / FINE_S) + 1) * FINE_S
    wave = 2.0 * np.pi * t[:, None] / [70.0, 50.0, 90.0]
    rate = [2e-3, 1e-3, 1.5e-3] * np.sin(wave + [0.0, 0.0, 1.0]) + [0.0, -1e-3, 0.0]
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * FINE_S, 0)])
    quats = accumulated([0.0, 0.0, 0.0, 1.0], np.diff(turned, axis=0))
    attitude = Rotation.from_rotvec([1.0, 0.2, 0.5]) * Rotation.from_quat(quats)
    every = round(STEP_S / FINE_S)
    means = np.diff(turned[::every], axis=0) / STEP_S
    true = np.concatenate([means[:1], means]) if mean else rate[::every]
    through = np.eye(3) if matrix is None else np.eye(3) + matrix
    times = t[::every]
    values = true @ through.T + BIAS + drift * (times[:, None] - 0.5 * span_s)
    values = values + 1e-6 * rng.standard_normal(values.shape)
    star = slice(200, -200, 25)
    noise = Rotation.from_rotvec(5.0 * ARCSEC * rng.standard_normal((len(t[star]), 3)))
    measured = StarSeries.of(t[star] + lag_s, (attitude[star] * noise).as_quat(), 5.0 * ARCSEC)
    return measured, GyroSeries.of(times, values, kind)


def test_good_data_are_valid() -> None:
    star, gyro = simulated()
    found = check_gyro(star, gyro)
    assert found.valid
    assert found.messages == ()
    assert np.all(np.abs(found.bias_rad_s - BIAS) < 4.0 * found.bias_sigma_rad_s)
    assert np.all(np.abs(found.scale) < 4.5 * found.scale_sigma)
    assert abs(found.lag_s) < 4.0 * found.lag_sigma_s
    assert found.lag_sigma_s < 0.005
    # Two star fixes at both ends of each interval are all that is left.
    rms = np.sqrt(np.mean(found.residual_rad**2, axis=0))
    np.testing.assert_allclose(rms, np.sqrt(2.0) * 5.0 * ARCSEC, rtol=0.25)
    # T figure 2.6: a constant bias makes the deviation grow in proportion to time.
    final = found.deviation_rad[-1] / (found.deviation_times_s[-1] - found.deviation_times_s[0])
    assert np.linalg.norm(final) == pytest.approx(np.linalg.norm(BIAS), rel=0.2)


def test_scatter_equals_the_stated_sigma() -> None:
    ratios = []
    for seed in range(30):
        found = check_gyro(*simulated(seed=seed, span_s=400.0))
        ratios.append(
            [
                *(found.bias_rad_s - BIAS) / found.bias_sigma_rad_s,
                *(found.scale / found.scale_sigma).ravel(),
                found.lag_s / found.lag_sigma_s,
            ]
        )
    spread = np.std(ratios, axis=0)
    # 13 numbers of 30 draws: 13 % each; the noise levels are estimates themselves.
    assert np.all((spread > 0.65) & (spread < 1.45))
    assert np.mean(spread) == pytest.approx(1.0, abs=0.12)


@given(
    lag=st.floats(-2.0, 2.0),
    scale=st.floats(-0.01, 0.01),
    misalignment=st.floats(-0.01, 0.01),
)
@settings(max_examples=8)
def test_errors_come_back(lag: float, scale: float, misalignment: float) -> None:
    matrix = np.array([[scale, misalignment, 0.0], [0.0, -scale, 0.0], [0.0, 0.0, 0.0]])
    found = check_gyro(*simulated(lag_s=lag, matrix=matrix))
    assert abs(found.lag_s - lag) < 5.0 * found.lag_sigma_s
    assert np.all(np.abs(found.scale - matrix) < 5.0 * found.scale_sigma)
    assert np.all(np.abs(found.bias_rad_s - BIAS) < 5.0 * found.bias_sigma_rad_s)


def test_drift_of_the_bias() -> None:
    drift = 2e-8
    found = check_gyro(*simulated(drift=drift))
    assert np.all(np.abs(found.drift_rad_s2 - drift) < 4.0 * found.drift_sigma_rad_s2)
    assert np.all(drift > 10.0 * found.drift_sigma_rad_s2)


@pytest.mark.parametrize(
    ("kind", "mean", "said"),
    [
        ("rate", False, None),
        ("mean-rate", True, None),
        ("rate", True, "look like means"),
        ("mean-rate", False, "look instantaneous"),
    ],
)
def test_instantaneous_or_mean(kind: GyroKind, mean: bool, said: str | None) -> None:
    found = check_gyro(*simulated(kind=kind, mean=mean))
    assert found.valid == (said is None)
    assert said is None or said in found.messages[0]


def test_units_kinds_and_axes_are_named() -> None:
    star, gyro = simulated()

    def said(values: np.ndarray, kind: GyroKind = "rate") -> str:
        found = check_gyro(star, GyroSeries.of(gyro.times_s, values, kind))
        assert not found.valid
        return found.messages[0]

    assert "degrees" in said(np.degrees(gyro.values))
    assert "increments" in said(gyro.values * STEP_S)
    assert "rates" in said(np.array(gyro.values), "increment")
    assert "opposite sign" in said(-gyro.values)
    known = check_gyro(star, gyro)
    assert known.valid
    inside, R_inertial_body = interpolate_rotations(
        star.times_s, star.R_inertial_sensor, gyro.times_s
    )
    inertial = R_inertial_body.apply(np.array(gyro.values[inside]))
    found = check_gyro(star, GyroSeries.of(gyro.times_s[inside], inertial))
    assert "inertial axes" in found.messages[0]


def test_clocks_that_differ_are_named() -> None:
    found = check_gyro(*simulated(lag_s=0.3))
    assert found.lag_s == pytest.approx(0.3, abs=0.01)
    assert "star epochs are late by 0.30" in found.messages[0]


def test_spikes_and_stuck_samples_are_flagged() -> None:
    star, gyro = simulated()
    values = np.array(gyro.values)
    values[5000] += 0.01
    values[8000:8010] = values[8000]
    flags = suspicious_samples(GyroSeries.of(gyro.times_s, values))
    np.testing.assert_array_equal(np.flatnonzero(flags == GyroFlag.SPIKE), [5000])
    stuck = np.flatnonzero(flags == GyroFlag.STUCK)
    np.testing.assert_array_equal(stuck, np.arange(8000, 8010))
    found = check_gyro(star, GyroSeries.of(gyro.times_s, values))
    assert any("1 gyro samples are spikes" in text for text in found.messages)
    assert np.sum(found.suspicious) >= 1


def test_a_slow_fault_disagrees_with_the_star() -> None:
    # 30 s of a bias 100 times larger: no sample is a spike, yet the intervals show it.
    star, gyro = simulated()
    values = np.array(gyro.values)
    fault = (gyro.times_s > 600.0) & (gyro.times_s < 630.0)
    values[fault] += 1e-4
    found = check_gyro(star, GyroSeries.of(gyro.times_s, values))
    flagged = found.sample_flag == GyroFlag.DISAGREES
    assert np.mean(flagged[fault]) > 0.98
    assert np.sum(flagged & ~fault) <= 400
    assert np.all(np.abs(found.bias_rad_s - BIAS) < 6.0 * found.bias_sigma_rad_s)


def test_a_star_blunder_is_not_blamed_on_the_gyro() -> None:
    star, gyro = simulated()
    quats = np.array(star.quat_xyzw)
    quats[1000] = (Rotation.from_quat(quats[1000]) * Rotation.from_rotvec([0.01, 0, 0])).as_quat()
    spoilt = StarSeries.of(star.times_s, quats, 5.0 * ARCSEC)
    found = check_gyro(spoilt, gyro, settings=GyroCheckSettings(0.25))
    np.testing.assert_array_equal(found.star_suspect, [1000])
    assert np.all(found.sample_flag == GyroFlag.OK)


def test_mountings_and_heads_of_other_noise() -> None:
    star, gyro = simulated()
    mount = Rotation.from_rotvec([0.5, -0.3, 1.0])
    turned = (star.R_inertial_sensor * mount).as_quat()
    two = StarSeries.of(
        np.repeat(star.times_s, 2),
        np.stack([star.quat_xyzw, turned], axis=1).reshape(-1, 4),
        5.0 * ARCSEC,
        head=np.tile([0, 1], len(star)),
        heads=("a", "b"),
    )
    found = check_gyro(two, gyro, Mounting({"b": mount}))
    assert found.valid
    assert set(found.head.tolist()) == {0, 1}


def test_a_body_at_rest_shows_bias_but_no_scale() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(0.0, 600.0, 0.25)
    star = StarSeries.of(
        times, Rotation.from_rotvec(5.0 * ARCSEC * rng.standard_normal((2400, 3))).as_quat(), 2.4e-5
    )
    gyro = GyroSeries.of(times, BIAS + 1e-7 * rng.standard_normal((2400, 3)))
    found = check_gyro(star, gyro)
    assert np.all(np.abs(found.bias_rad_s - BIAS) < 4.0 * found.bias_sigma_rad_s)
    assert np.all(np.isnan(found.scale))
    assert np.isnan(found.lag_s)
    assert found.summary()["lag_s"] is None
    assert found.valid


def test_what_cannot_be_compared_is_refused() -> None:
    star, gyro = simulated(span_s=60.0)
    later = StarSeries.of(star.times_s + 1e4, star.quat_xyzw, 1e-5)
    with pytest.raises(GeometryError, match="never overlaps"):
        check_gyro(later, gyro)
    with pytest.raises(GeometryError, match="fewer than 3"):
        check_gyro(star, gyro, settings=GyroCheckSettings(40.0))
    with pytest.raises(ArgumentError, match="positive interval"):
        GyroCheckSettings(-1.0)
