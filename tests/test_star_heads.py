"""Heads fused with their anisotropic noise; the weighted mean; mountings made orthogonal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.sensors.attitude_determination.static.heads import (
    fuse_heads,
    mounting_from_matrices,
)
from geoposition.sensors.attitude_determination.static.mean import weighted_mean
from geoposition.sensors.star_sensor import StarHead, mounting_of, simulate_star_series
from geoposition.sensors.telemetry import Mounting, StarSeries

ARCSEC = np.radians(1.0 / 3600.0)
HEADS = (
    StarHead("a", 3 * ARCSEC, 30 * ARCSEC, Rotation.from_euler("X", 130, degrees=True)),
    StarHead("b", 4 * ARCSEC, 25 * ARCSEC, Rotation.from_euler("YX", [20, -125], degrees=True)),
    StarHead("c", 6 * ARCSEC, 60 * ARCSEC, Rotation.from_euler("ZY", [50, 160], degrees=True)),
)
RATE = np.array([0.02, -0.01, 0.03])


def attitude(times_s: np.ndarray) -> Rotation:
    return Rotation.from_rotvec([0.3, -1.0, 0.7]) * Rotation.from_rotvec(np.outer(times_s, RATE))


def nees(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])


def assert_chi2(values: np.ndarray, freedom: int) -> None:
    low, high = chi2.ppf([0.0005, 0.9995], freedom * len(values)) / len(values)
    assert low < values.mean() < high


def test_fused_heads_are_as_good_as_they_say() -> None:
    times = 0.1 * np.arange(6000)
    series = simulate_star_series(HEADS, [times] * 3, attitude, np.random.default_rng(1))
    fused = fuse_heads(series, mounting_of(HEADS))
    assert fused.times_s == pytest.approx(times, abs=1e-12)
    assert np.all(fused.heads == 3)
    error = (fused.R_inertial_body.inv() * attitude(times)).as_rotvec()
    assert_chi2(nees(error, fused.covariance_rad2), 3)
    assert_chi2(fused.disagreement, 6)
    # no axis is worse than the best head's cross-axis noise allows: the boresights make up
    sigma = np.sqrt(np.einsum("nii->ni", fused.covariance_rad2))
    assert sigma.max() < 4 * ARCSEC
    information = sum(
        h.R_body_sensor.as_matrix() @ np.diag(h.sigma_rad**-2.0) @ h.R_body_sensor.as_matrix().T
        for h in HEADS
    )
    assert fused.covariance_rad2[7] == pytest.approx(np.linalg.inv(information), rel=1e-12)


def test_missing_heads_and_single_ones_keep_their_own_covariance() -> None:
    series = simulate_star_series(
        HEADS[:2], [[0.0, 1.0, 3.0], [1.0, 2.0]], attitude, np.random.default_rng(2)
    )
    fused = fuse_heads(series, mounting_of(HEADS))
    assert fused.times_s.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert fused.heads.tolist() == [1, 2, 1, 1]
    assert fused.disagreement[[0, 2, 3]] == pytest.approx(0.0, abs=1e-12)
    turned = HEADS[1].R_body_sensor.as_matrix()
    own = turned @ np.diag(HEADS[1].sigma_rad ** 2) @ turned.T
    assert fused.covariance_rad2[2] == pytest.approx(own, rel=1e-12)
    lone = series.R_inertial_sensor[3] * HEADS[1].R_body_sensor.inv()
    assert (lone.inv() * fused.R_inertial_body[2]).magnitude() < 1e-12


def test_epochs_that_do_not_coincide_are_carried_together() -> None:
    first = 0.5 * np.arange(4000)
    late = first + 0.04
    series = simulate_star_series(HEADS[:2], [first, late], attitude, np.random.default_rng(3))
    apart = fuse_heads(series, mounting_of(HEADS))
    assert len(apart.times_s) == 8000
    fused = fuse_heads(series, mounting_of(HEADS), tolerance_s=0.05)
    assert fused.times_s == pytest.approx(first + 0.02, abs=1e-12)
    error = (fused.R_inertial_body.inv() * attitude(fused.times_s)).as_rotvec()
    # 0.02 s at 0.037 rad/s are 150 arcsec: they must be gone
    assert np.abs(error.mean(axis=0)).max() < 4 * np.abs(np.std(error, axis=0)).max() / 60
    assert_chi2(nees(error, fused.covariance_rad2), 3)


def test_a_wrong_mounting_shows() -> None:
    times = np.arange(50.0)
    series = simulate_star_series(HEADS, [times] * 3, attitude, np.random.default_rng(4))
    wrong = dict(mounting_of(HEADS).R_body_sensor)
    wrong["b"] = wrong["b"] * Rotation.from_rotvec([60 * ARCSEC, 0.0, 0.0])
    fused = fuse_heads(series, Mounting(wrong))
    assert fused.disagreement.min() > chi2.ppf(0.9999, 6)


def test_signs_of_quaternions_do_not_matter() -> None:
    times = np.arange(20.0)
    series = simulate_star_series(HEADS, [times] * 3, attitude, np.random.default_rng(5))
    sign = np.where(np.random.default_rng(6).random(60) < 0.5, -1.0, 1.0)
    flipped = StarSeries.of(
        series.times_s,
        series.quat_xyzw * sign[:, None],
        series.sigma_cross_rad,
        series.sigma_bore_rad,
        series.head,
        series.heads,
    )
    one, two = (fuse_heads(s, mounting_of(HEADS)) for s in (series, flipped))
    assert (one.R_inertial_body.inv() * two.R_inertial_body).magnitude().max() < 1e-13
    assert np.all(np.sum(one.quat_xyzw[1:] * one.quat_xyzw[:-1], axis=1) > 0.0)


@settings(max_examples=40)
@given(st.integers(0, 10**9))
def test_turning_the_inertial_frame_turns_the_fused_attitude(seed: int) -> None:
    rng = np.random.default_rng(seed)
    series = simulate_star_series(HEADS, [[0.0, 1.0]] * 3, attitude, rng)
    turn = Rotation.random(rng=rng)
    turned = StarSeries.of(
        series.times_s,
        (turn * series.R_inertial_sensor).as_quat(),
        series.sigma_cross_rad,
        series.sigma_bore_rad,
        series.head,
        series.heads,
    )
    plain, moved = (fuse_heads(s, mounting_of(HEADS)) for s in (series, turned))
    expected = turn * plain.R_inertial_body
    assert (expected.inv() * moved.R_inertial_body).magnitude().max() < 1e-12


def test_mounting_matrices_are_projected_and_the_error_told() -> None:
    exact = Rotation.from_euler("ZXY", [0.3, -0.2, 1.0])
    skewed = exact.as_matrix() @ np.array([[1.0, 1e-4, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = mounting_from_matrices({"a": exact.as_matrix(), "b": skewed})
    assert found.error["a"] < 1e-14
    assert found.error["b"] == pytest.approx(1e-4 / np.sqrt(2.0), rel=1e-3)
    assert (found.mounting.rotation("b").inv() * exact).magnitude() == pytest.approx(5e-5, rel=1e-3)
    with pytest.raises(ArgumentError, match="mounting of bad"):
        mounting_from_matrices({"bad": np.diag([1.0, 1.0, -1.0])})
    with pytest.raises(ArgumentError, match="tolerance"):
        fuse_heads(StarSeries.of([0.0], [[0, 0, 0, 1]], 1e-5), tolerance_s=-1.0)


# The weighted mean ---------------------------------------------------------------------------


def test_the_mean_is_scipys_for_every_epoch() -> None:
    rng = np.random.default_rng(7)
    quats = rng.standard_normal((30, 5, 4))
    weights = rng.uniform(0.1, 2.0, (30, 5))
    found = weighted_mean(quats, weights)
    for k in range(30):
        outside = Rotation.from_quat(quats[k]).mean(weights[k])
        assert (outside.inv() * Rotation.from_quat(found.quat_xyzw[k])).magnitude() < 1e-9


def test_covariances_of_the_mean_against_monte_carlo() -> None:
    rng = np.random.default_rng(8)
    n, m = 10_000, 6
    sigma = np.array([1e-4, 2e-4, 3e-4, 2e-4, 1e-4, 5e-4])
    truth = Rotation.random(n, rng=rng)
    noise = sigma[:, None] * rng.standard_normal((n, m, 3))
    quats = np.stack([(truth * Rotation.from_rotvec(noise[:, i])).as_quat() for i in range(m)], 1)
    own = np.broadcast_to((sigma**2)[:, None, None] * np.eye(3), (n, m, 3, 3))
    told = weighted_mean(quats, sigma**-2.0, own)
    error = (Rotation.from_quat(told.quat_xyzw).inv() * truth).as_rotvec()
    assert_chi2(nees(error, told.covariance_rad2), 3)
    assert told.covariance_rad2[3] == pytest.approx(np.eye(3) / np.sum(sigma**-2.0), rel=1e-9)
    seen = weighted_mean(quats, sigma**-2.0)
    mean = seen.covariance_rad2.mean(axis=0)
    assert mean == pytest.approx(told.covariance_rad2[0], abs=0.02 * mean[0, 0])


def test_bad_samples_are_left_out_and_hopeless_epochs_flagged() -> None:
    good = Rotation.from_rotvec([[0.1, 0.2, 0.3]] * 2).as_quat()
    quats = np.stack([good, good, good, good])
    quats[1, 0] = np.nan
    quats[2] = np.nan
    quats[3] = [[0, 0, 0, 1], [1, 0, 0, 0]]
    found = weighted_mean(quats)
    assert found.flag.tolist() == [
        Flag.OK,
        Flag.OK,
        Flag.TOO_FEW_RAYS,
        Flag.WEAK_GEOMETRY,
    ]
    assert found.quat_xyzw[:2] == pytest.approx(good, abs=1e-12)
    assert np.isnan(found.quat_xyzw[2:]).all()
    assert np.isnan(found.residual_rad[1, 0]).all()
    assert np.isnan(found.covariance_rad2[1]).all()  # one sample scatters about nothing


def test_misuse_of_the_mean_is_refused() -> None:
    with pytest.raises(ArgumentError, match="list"):
        weighted_mean([0, 0, 0, 1])
    with pytest.raises(ArgumentError, match="negative"):
        weighted_mean([[0, 0, 0, 1]], [-1.0])
    with pytest.raises(ArgumentError, match="weights"):
        weighted_mean([[0, 0, 0, 1]], [1.0, 2.0])
    with pytest.raises(ArgumentError, match="covariances"):
        weighted_mean([[0, 0, 0, 1]], covariance_rad2=np.eye(3))
