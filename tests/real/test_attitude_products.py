"""Checks of real telemetry: GRACE-FO's heads, jitter and cleaning of MRO, Chandrayaan-2, Fermi."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.sensors.attitude_determination.checks.axis_angle import axis_angles
from geoposition.sensors.attitude_determination.checks.gyro_check import check_gyro
from geoposition.sensors.attitude_determination.checks.preprocess import SampleFlag, preprocess
from geoposition.sensors.attitude_determination.jitter.lines import (
    AXES,
    jitter_from_attitude,
    jitter_from_gyro,
)
from geoposition.sensors.readers.gracefo import read_sca1a
from geoposition.sensors.telemetry import GyroSeries, StarSeries

ARCSEC = np.pi / 648000.0


def decoded(path: Path) -> tuple[np.ndarray, Rotation, np.ndarray]:
    """Times, R_inertial_body and what follows: C(q) turns reference to body, scalar first."""
    rows = np.loadtxt(path / "decoded.csv.gz", delimiter=",")
    return rows[:, 0], Rotation.from_quat(rows[:, 1:5], scalar_first=True).inv(), rows[:, 5:]


def body_rates(path: Path) -> tuple[np.ndarray, Rotation, GyroSeries]:
    times, attitude, rates = decoded(path)
    return times, attitude, GyroSeries.of(times, attitude.inv().apply(rates), "mean-rate")


# GRACE-FO C -----------------------------------------------------------------------------------


def test_axis_angles_of_grace_fo(real_data: Path) -> None:
    star = read_sca1a(real_data / "attitude" / "gracefo_c" / "SCA1A_2023-06-01_C_04.txt")
    found = {pair.sensors: pair.summary() for pair in axis_angles(star)}
    expected = {
        ("sca1", "sca2"): (80.969, 4.0),
        ("sca1", "sca3"): (80.211, 3.5),
        ("sca2", "sca3"): (100.075, 2.8),
    }
    assert set(found) == set(expected)
    for pair, (mean, std) in expected.items():
        assert found[pair]["mean_deg"] == pytest.approx(mean, abs=5e-4)
        assert found[pair]["std_arcsec"] == pytest.approx(std, abs=0.05)
        assert found[pair]["n"] == 33
    # 16 s tell nothing about hours: the drift's sigma says so.
    assert all(pair["drift_sigma_arcsec_per_h"] > 300.0 for pair in found.values())


def test_raw_heads_of_grace_fo_are_clean(real_data: Path) -> None:
    star = read_sca1a(real_data / "attitude" / "gracefo_c" / "SCA1A_2023-06-01_C_04.txt")
    found = preprocess(
        star.times_s,
        star.quat_xyzw,
        star.sigma_cross_rad,
        star.sigma_bore_rad,
        star.head,
        star.heads,
    )
    assert np.all(found.flag == SampleFlag.OK)
    for noise in found.noise_rad.values():
        assert np.all((noise[:2] > 1.0 * ARCSEC) & (noise[:2] < 4.0 * ARCSEC))
        assert 20.0 * ARCSEC < noise[2] < 40.0 * ARCSEC


# Jitter ---------------------------------------------------------------------------------------


def test_spectrum_of_chandrayaan_2(real_data: Path) -> None:
    times, attitude, _ = decoded(real_data / "attitude" / "chandrayaan2")
    found = jitter_from_attitude(times, attitude)
    assert found.highest_hz == pytest.approx(3.9, abs=0.05)  # half of 7.8 Hz
    # One line shared by roll and pitch at 3.047 Hz: 0.1", the same from both axes.
    shared = [
        next(p for p in found.axes[axis] if abs(p.frequency_hz - 3.047) < 1e-3)
        for axis in ("roll", "pitch")
    ]
    for peak in shared:
        assert 0.05 * ARCSEC < peak.amplitude_rad < 0.2 * ARCSEC
        assert peak.false_alarm < 1e-6
    apart = abs(shared[0].frequency_hz - shared[1].frequency_hz)
    assert apart < 4.0 * np.hypot(*(p.sigma_frequency_hz for p in shared))
    # Steep: slow motion of arc seconds, hundredths of that at the end of the band.
    density = found.spectrum.density[:, 0]
    assert np.median(density[:5]) > 1e3 * np.median(density[-50:])


@pytest.mark.parametrize("year", ["mro_2007", "mro_2009"])
def test_uneven_steps_of_mro_bring_no_lines_of_their_own(real_data: Path, year: str) -> None:
    times, attitude, gyro = body_rates(real_data / "attitude" / year)
    from_attitude = jitter_from_attitude(times, attitude)
    from_gyro = jitter_from_gyro(gyro)
    assert sum(len(from_attitude.axes[axis]) for axis in AXES) <= 4
    assert sum(len(from_gyro.axes[axis]) for axis in AXES) <= 4
    # Pitch shakes by 0.1" at 1 and 2 Hz, multiples of the on-board clock; each year one of the
    # two instruments is quiet enough to show it.
    seen = from_gyro if year == "mro_2007" else from_attitude
    pitch = [peak.frequency_hz for peak in seen.axes["pitch"]]
    assert sorted(pitch) == pytest.approx([1.0, 2.0], abs=3e-3)


# Gyro and cleaning ----------------------------------------------------------------------------


def test_rates_of_mro_are_means_in_the_reference_frame(real_data: Path) -> None:
    times, attitude, gyro = body_rates(real_data / "attitude" / "mro_2007")
    star = StarSeries.of(times, attitude.as_quat(), 0.3 * ARCSEC).where(
        np.arange(len(times)) % 50 == 0
    )
    _, _, rates = decoded(real_data / "attitude" / "mro_2007")
    as_given = check_gyro(star, GyroSeries.of(times, rates))
    assert "gyro values are in inertial axes" in as_given.messages[0]
    instant = check_gyro(star, GyroSeries.of(times, gyro.values, "rate"))
    assert "look like means" in instant.messages[0]
    mean = check_gyro(star, gyro)
    assert abs(mean.lag_s) < 2.0 * mean.lag_sigma_s
    assert np.all(np.sqrt(np.mean(mean.residual_rad**2, axis=0)) < 8.0 * ARCSEC)


def test_slews_of_fermi_are_no_blunders(real_data: Path) -> None:
    rows = np.loadtxt(
        real_data / "attitude" / "fermi" / "poshist_151013_first_half.csv.gz",
        delimiter=",",
        skiprows=1,
    )
    times = rows[:, 0] - rows[0, 0]
    found = preprocess(times, rows[:, 1:5], 1.0 * ARCSEC)
    assert found.counts["star"]["outlier_replaced"] == 0
    assert found.counts["star"]["gap"] == 7
    star = StarSeries.of(times[::10], rows[::10, 1:5], 1.0 * ARCSEC)
    check = check_gyro(star, GyroSeries.of(times, rows[:, 5:8]))
    # Measured = true + bias: the sign is that of the contract.
    np.testing.assert_allclose(check.bias_rad_s / ARCSEC, [-0.017, -0.115, 0.202], atol=0.025)
    assert 1e-3 < np.max(np.abs(check.scale)) < 3e-3


def test_planted_blunders_in_mro_are_found(real_data: Path) -> None:
    times, attitude, _ = decoded(real_data / "attitude" / "mro_2007")
    rng = np.random.default_rng(1)
    bad = rng.random(len(times)) < 0.2
    kick = Rotation.from_rotvec(rng.standard_normal((len(times), 3)) * np.radians(1.0))
    quats = np.where(bad[:, None], (attitude * kick).as_quat(), attitude.as_quat())
    found = preprocess(times, quats, 1.0 * ARCSEC)
    flagged = found.input_flag == SampleFlag.OUTLIER_REPLACED
    assert np.sum(bad & ~flagged) == 0
    assert np.sum(flagged & ~bad) <= 10
    rows = found.row[found.row >= 0]
    off = (attitude[rows].inv() * found.star.R_inertial_sensor[found.row >= 0]).magnitude()
    assert np.median(off[flagged[rows]]) < 1.5 * ARCSEC
