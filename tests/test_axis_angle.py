"""Optical-axis angles between star heads: closed forms, noise, drift, matching of epochs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from geoposition.errors import GeometryError
from geoposition.sensors.attitude_determination.checks.axis_angle import (
    angle_between_rad,
    axis_angles,
    interpolate_rotations,
)
from geoposition.sensors.telemetry import StarSeries

ARCSEC = np.pi / 648000.0
MOUNTS = {"a": [0.0, 0.0, 0.0], "b": [1.2, 0.0, 0.3], "c": [0.0, -1.7, 0.0]}


def body(times: np.ndarray) -> Rotation:
    """A body that turns as in orbit and shakes a little."""
    shake = 4.0 * ARCSEC * np.sin(2.0 * np.pi * 0.65 * times)[:, None]
    turn = Rotation.from_rotvec(times[:, None] * [0.0, -1.1e-3, 2e-4])
    return Rotation.from_rotvec([0.3, 0.2, 1.0]) * turn * Rotation.from_rotvec(shake * [1, 1, 0])


def heads(
    rates_hz: dict[str, float],
    *,
    span_s: float = 900.0,
    offset_s: dict[str, float] | None = None,
    sigma_rad: float = 0.0,
    drift_rad_s: float = 0.0,
    seed: int = 1,
) -> StarSeries:
    """Heads of known mounting; head b drifts about the axis that opens its angle to a."""
    rng = np.random.default_rng(seed)
    times, quats, index = [], [], []
    for number, (name, rate) in enumerate(rates_hz.items()):
        t = np.arange(0.0, span_s, 1.0 / rate) + (offset_s or {}).get(name, 0.0)
        mount = Rotation.from_rotvec(MOUNTS[name])
        if name == "b":
            axis = np.cross([0.0, 0.0, 1.0], mount.apply([0.0, 0.0, 1.0]))
            axis /= np.linalg.norm(axis)
            mount = Rotation.from_rotvec(drift_rad_s * t[:, None] * axis) * mount
        noise = Rotation.from_rotvec(sigma_rad * rng.standard_normal((len(t), 3)) * [1, 1, 8])
        times.append(t)
        quats.append((body(t) * mount * noise).as_quat())
        index.append(np.full(len(t), number))
    all_times = np.concatenate(times)
    order = np.argsort(all_times, kind="stable")
    return StarSeries.of(
        all_times[order],
        np.concatenate(quats)[order],
        max(sigma_rad, 1e-6),
        head=np.concatenate(index)[order],
        heads=tuple(rates_hz),
    )


def true_angle(a: str, b: str) -> float:
    axes = [Rotation.from_rotvec(MOUNTS[name]).apply([0.0, 0.0, 1.0]) for name in (a, b)]
    return float(np.arccos(axes[0] @ axes[1]))


def test_three_heads_at_common_epochs() -> None:
    pairs = axis_angles(heads({"a": 4.0, "b": 4.0, "c": 4.0}))
    assert [pair.sensors for pair in pairs] == [("a", "b"), ("a", "c"), ("b", "c")]
    for pair in pairs:
        assert len(pair.times_s) == 3600
        assert abs(pair.mean_rad - true_angle(*pair.sensors)) < 1e-12
        assert pair.std_rad < 1e-12


def test_noise_of_both_heads_and_no_boresight_noise() -> None:
    (pair,) = axis_angles(heads({"a": 4.0, "b": 4.0}, sigma_rad=5.0 * ARCSEC))
    # Turns about the boresights, 40 arc seconds, must not show.
    assert pair.std_rad == pytest.approx(np.sqrt(2.0) * 5.0 * ARCSEC, rel=0.05)
    assert abs(pair.mean_rad - true_angle("a", "b")) < 4.0 * pair.std_rad / np.sqrt(3600.0)


def test_drift_and_its_sigma() -> None:
    per_hour = 20.0 * ARCSEC
    off, sigmas = [], []
    for seed in range(60):
        star = heads(
            {"a": 2.0, "b": 2.0}, sigma_rad=4.0 * ARCSEC, drift_rad_s=per_hour / 3600.0, seed=seed
        )
        (pair,) = axis_angles(star)
        off.append(pair.drift_rad_s - per_hour / 3600.0)
        sigmas.append(pair.drift_sigma_rad_s)
    assert np.std(off) / np.mean(sigmas) == pytest.approx(1.0, abs=0.25)
    assert abs(np.mean(off)) < 4.0 * np.mean(sigmas) / np.sqrt(60.0)
    assert pair.noise_rad <= pair.std_rad


@pytest.mark.parametrize("offset_s", [0.0, 0.05, 0.125])
def test_heads_of_other_epochs_are_interpolated(offset_s: float) -> None:
    # The common shake of 4" at 0.65 Hz must not leak through the interpolation.
    (pair,) = axis_angles(heads({"a": 4.0, "b": 8.0}, offset_s={"b": offset_s}))
    assert len(pair.times_s) > 3590
    assert pair.std_rad < 0.01 * ARCSEC
    assert abs(pair.mean_rad - true_angle("a", "b")) < 0.01 * ARCSEC


def test_gaps_are_not_bridged() -> None:
    star = heads({"a": 4.0, "b": 4.0}, offset_s={"b": 0.1})
    keep = (star.head == 0) | (star.times_s < 300.0) | (star.times_s > 500.0)
    (pair,) = axis_angles(star.where(keep))
    assert not np.any((pair.times_s > 300.2) & (pair.times_s < 500.0))
    assert pair.std_rad < 0.1 * ARCSEC


def test_what_cannot_be_paired_is_refused() -> None:
    star = heads({"a": 4.0, "b": 4.0})
    with pytest.raises(GeometryError, match="two star heads"):
        axis_angles(star.where(star.head == 0))
    apart = (star.head == 0) == (star.times_s < 400.0)
    with pytest.raises(GeometryError, match="same time"):
        axis_angles(star.where(apart))


def test_summary_has_the_contracts_units() -> None:
    (pair,) = axis_angles(heads({"a": 4.0, "b": 4.0}, sigma_rad=5.0 * ARCSEC))
    found = pair.summary()
    assert found["sensors"] == ["a", "b"]
    assert found["mean_deg"] == pytest.approx(np.degrees(true_angle("a", "b")), abs=1e-3)
    assert found["std_arcsec"] == pytest.approx(7.07, rel=0.05)
    assert found["n"] == 3600


@given(angle=st.floats(0.0, np.pi))
@settings(max_examples=50)
def test_angle_is_exact_also_near_its_ends(angle: float) -> None:
    a, b = np.array([0.0, 0.0, 1.0]), np.array([np.sin(angle), 0.0, np.cos(angle)])
    assert abs(float(angle_between_rad(a, b)) - angle) < 1e-15 + 1e-15 * angle


@given(st.lists(st.floats(0.0, 89.5), min_size=1, max_size=20))
@settings(max_examples=25)
def test_interpolation_follows_a_smooth_turn(at: list[float]) -> None:
    times = np.arange(0.0, 90.0, 0.25)
    keep, found = interpolate_rotations(times, body(times), np.array(at))
    assert np.all(keep)
    # Cubic through 4 Hz samples of 4√2" at 0.65 Hz: (w dt)^4 A / 24 × 15 / 16 in the end steps.
    assert np.max((body(np.array(at)).inv() * found).magnitude()) < 0.26 * ARCSEC
