"""Pre-processing of raw star telemetry: what is wrong is found, what is real is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.checks.outliers import OutlierSettings
from geoposition.sensors.attitude_determination.checks.preprocess import (
    PreprocessSettings,
    SampleFlag,
    preprocess,
    sample_flag_labels,
)
from geoposition.sensors.attitude_determination.checks.time_order import forward_rows

ARCSEC = np.pi / 648000.0
STEP_S = 0.25
CROSS, BORE = 5.0 * ARCSEC, 40.0 * ARCSEC


def truth(times: np.ndarray, *, slew: bool = False) -> Rotation:
    """Orbital turn and 4" jitter; with `slew`, 0.1 deg/s² up to 1 deg/s and down again."""
    jitter = 4.0 * ARCSEC * np.sin(2.0 * np.pi * 0.65 * times)[:, None] * [1.0, 1.0, 0.3]
    turned = Rotation.from_rotvec(times[:, None] * [0.0, -1.1e-3, 0.0])
    if slew:
        rate = np.radians(0.1)
        since = np.clip(times - times[len(times) // 3], 0.0, 20.0)
        angle = np.where(
            since < 10.0, 0.5 * rate * since**2, rate * (20 * since - 0.5 * since**2 - 100)
        )
        turned = turned * Rotation.from_rotvec(angle[:, None] * [1.0, 0.0, 0.0])
    return Rotation.from_rotvec([0.3, 0.2, 1.0]) * turned * Rotation.from_rotvec(jitter)


def measured(times: np.ndarray, rng: np.random.Generator, *, slew: bool = False) -> np.ndarray:
    noise = rng.standard_normal((len(times), 3)) * [CROSS, CROSS, BORE]
    quats: np.ndarray = (truth(times, slew=slew) * Rotation.from_rotvec(noise)).as_quat()
    return quats


def clean(times: np.ndarray, quats: np.ndarray, **more: object):
    return preprocess(times, quats, CROSS, BORE, **more)


@pytest.mark.parametrize("slew", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3])
def test_blunders_are_found_and_replaced(share: float, slew: bool) -> None:
    rng = np.random.default_rng(3)
    times = np.arange(2000) * STEP_S
    quats = measured(times, rng, slew=slew)
    bad = rng.random(len(times)) < share
    # From 0.1 degree, far below what a slew turns between samples, to anywhere.
    size = np.radians(10.0 ** rng.uniform(-1.0, 2.0, (len(times), 1)))
    kick = Rotation.from_rotvec(rng.standard_normal((len(times), 3)) * size)
    quats[bad] = (Rotation.from_quat(quats) * kick).as_quat()[bad]
    found = clean(times, quats)
    flagged = found.flag == SampleFlag.OUTLIER_REPLACED
    np.testing.assert_array_equal(flagged, bad)
    off = (truth(times, slew=slew).inv() * found.star.R_inertial_sensor).as_rotvec()
    # Replaced by the model: better than a measurement, apart from the jitter it smooths away.
    assert np.all(np.sqrt(np.mean(off**2, axis=0)) < 1.1 * np.array([CROSS, CROSS, BORE]))
    assert np.max(np.abs(off[bad] / [CROSS, CROSS, BORE]), initial=0.0) < 4.0
    np.testing.assert_allclose(found.noise_rad["star"], [CROSS, CROSS, BORE], rtol=0.3)


def test_an_abrupt_manoeuvre_is_left_alone() -> None:
    # 1 deg/s from one sample to the next, both ways: no polynomial follows, yet it is real.
    rng = np.random.default_rng(4)
    times = np.arange(1200) * STEP_S
    angle = np.radians(np.clip(times - 100.0, 0.0, 15.0))
    turn = Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0])
    noise = Rotation.from_rotvec(CROSS * rng.standard_normal((len(times), 3)))
    found = preprocess(times, (turn * noise).as_quat(), CROSS)
    assert np.all(found.flag == SampleFlag.OK)


@pytest.mark.parametrize("frequency_hz", [0.02, 0.05, 0.1, 0.2, 0.65, 1.7])
def test_strong_jitter_is_left_alone(frequency_hz: float) -> None:
    rng = np.random.default_rng(5)
    times = np.arange(1500) * STEP_S
    wave = 0.01 * np.sin(2.0 * np.pi * frequency_hz * times)[:, None] * [1.0, 0.5, 0.0]
    quats = (Rotation.from_rotvec(wave) * Rotation.from_quat(measured(times, rng))).as_quat()
    assert np.all(clean(times, quats).flag == SampleFlag.OK)


@pytest.mark.parametrize("coherent", [False, True])
def test_a_burst_of_blunders_is_no_motion(coherent: bool) -> None:
    rng = np.random.default_rng(6)
    times = np.arange(1000) * STEP_S
    quats = measured(times, rng)
    burst = slice(400, 415)
    kick = np.radians(2.0) * (np.ones((15, 3)) if coherent else rng.standard_normal((15, 3)))
    quats[burst] = (Rotation.from_quat(quats[burst]) * Rotation.from_rotvec(kick)).as_quat()
    found = clean(times, quats)
    expected = np.zeros(len(times), dtype=bool)
    expected[burst] = True
    np.testing.assert_array_equal(found.flag == SampleFlag.OUTLIER_REPLACED, expected)


def test_everything_that_can_be_wrong_with_rows() -> None:
    rng = np.random.default_rng(7)
    times = np.arange(600) * STEP_S
    quats = measured(times, rng)
    quats[::3] *= -1.0  # signs mean nothing
    quats[50], quats[60], quats[70] = 0.0, np.nan, quats[70] * 1.5
    times_raw, quats_raw = times.copy(), quats.copy()
    times_raw[100] += 1000.0  # one wrong time must not condemn all that follow
    times_raw[110] -= 20.1
    times_raw[120] = np.nan
    keep = np.ones(600, dtype=bool)
    keep[200:204] = False  # short gap, to be filled
    keep[300:400] = False  # long gap, to be left
    order = np.sort(np.concatenate([np.flatnonzero(keep), [150, 151, 152]]))  # sent twice
    found = clean(times_raw[order], quats_raw[order])
    labels = sample_flag_labels(found.input_flag)
    assert {name: int(np.sum(labels == name)) for name in np.unique(labels)} == {
        "ok": 490,
        "duplicate": 3,
        "backwards": 3,
        "broken": 3,
    }
    # Four lost samples and the three dropped for their times are filled.
    assert found.counts["star"]["gap"] == 7
    assert found.counts["star"]["sign_flip"] > 200
    assert np.all(np.diff(found.star.times_s) > 0.0)
    assert not np.any((found.star.times_s > 75.0) & (found.star.times_s < 99.9))
    off = (truth(found.star.times_s).inv() * found.star.R_inertial_sensor).as_rotvec()
    assert np.max(np.abs(off / [CROSS, CROSS, BORE])) < 5.0
    assert np.all(np.einsum("ij,ij->i", found.star.quat_xyzw[1:], found.star.quat_xyzw[:-1]) > 0)
    assert len(found.measured) == 490
    measured_rows = found.row[found.flag == SampleFlag.OK]
    np.testing.assert_array_equal(times_raw[order][measured_rows], found.measured.times_s)


def test_heads_are_judged_apart() -> None:
    rng = np.random.default_rng(8)
    times = np.repeat(np.arange(400) * STEP_S, 2)
    head = np.tile([0, 1], 400)
    quats = measured(times, rng)
    quats[1::2] = (Rotation.from_quat(quats[1::2]) * Rotation.from_rotvec([1.0, 0, 0])).as_quat()
    quats[301] = quats[300]  # head b says what head a says: a blunder
    found = clean(times, quats, head=head, heads=("a", "b"))
    assert found.counts["a"]["outlier_replaced"] == 0
    assert found.counts["b"]["outlier_replaced"] == 1
    assert found.input_flag[301] == SampleFlag.OUTLIER_REPLACED
    np.testing.assert_array_equal(found.star.head[:4], [0, 1, 0, 1])


def test_steps_that_alternate_are_no_gaps() -> None:
    rng = np.random.default_rng(9)
    times = np.cumsum(rng.choice([0.1, 0.2], 800))
    found = clean(times, measured(times, rng))
    assert found.counts["star"]["gap"] == 0
    assert np.all(found.flag == SampleFlag.OK)


def test_the_same_draws_every_time_and_a_window_of_ones_own() -> None:
    rng = np.random.default_rng(10)
    times = np.arange(500) * STEP_S
    quats = measured(times, rng)
    quats[[33, 34, 200]] = Rotation.from_rotvec([2.0, 1.0, 0.0]).as_quat()
    first, second = clean(times, quats), clean(times, quats)
    np.testing.assert_array_equal(first.star.quat_xyzw, second.star.quat_xyzw)
    chosen = PreprocessSettings(OutlierSettings(window_s=10.0, degree=3), longest_gap_s=0.0)
    found = clean(times, quats, settings=chosen)
    np.testing.assert_array_equal(np.flatnonzero(found.flag), [33, 34, 200])


@pytest.mark.parametrize("n", [1, 2, 3, 6, 9, 12, 15, 22])
def test_short_series_pass(n: int) -> None:
    times = np.arange(n) * STEP_S
    found = clean(times, measured(times, np.random.default_rng(11)))
    assert len(found.star) == n
    assert np.all(found.flag == SampleFlag.OK)


def test_noiseless_motion_has_no_outliers() -> None:
    times = np.arange(300) * STEP_S
    turn = Rotation.from_rotvec(times[:, None] * [0.0, -1.1e-3, 0.0])
    assert np.all(clean(times, turn.as_quat()).flag == SampleFlag.OK)


def test_unusable_input_is_refused() -> None:
    times = np.arange(20.0)
    with pytest.raises(ArgumentError, match="not unit"):
        clean(times, np.full((20, 4), 3.0))
    with pytest.raises(ArgumentError, match="no usable sample"):
        clean(times, np.zeros((20, 4)))
    with pytest.raises(ArgumentError, match="n > 0"):
        clean([], np.empty((0, 4)))
    with pytest.raises(ArgumentError, match="head indices"):
        clean(times, np.tile([0.0, 0, 0, 1], (20, 1)), head=3)
    with pytest.raises(ArgumentError, match="degree"):
        OutlierSettings(degree=9)


@given(st.permutations(range(12)), st.sets(st.integers(0, 11), max_size=4))
@settings(max_examples=60)
def test_forward_rows_increase_and_are_most(order: list[int], broken: set[int]) -> None:
    times = np.array(order, dtype=float)
    usable = np.array([k not in broken for k in range(12)])
    forward, duplicate = forward_rows(times, usable)
    assert np.all(np.diff(times[forward]) > 0.0)
    assert not np.any(duplicate)
    # Longest increasing subsequence, the slow way.
    best = np.ones(12, dtype=int)
    for i in range(12):
        for j in range(i):
            if times[j] < times[i]:
                best[i] = max(best[i], best[j] + 1)
    assert np.sum(forward) == best.max()
