"""Fusion on real telemetry: withheld quaternions are met better with the gyro than without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.filters import ekf
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.smoothers import smooth
from geoposition.sensors.telemetry import GyroNoise, GyroSeries, StarSeries

ARCSEC = np.pi / 648000.0


def rms_arcsec(error_rad: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(error_rad**2, axis=1)))) / ARCSEC


def mro(folder: Path) -> tuple[FloatArray, Rotation, FloatArray]:
    """Times, R_inertial_body and rates in the reference frame, as recorded."""
    table = np.loadtxt(folder / "decoded.csv.gz", delimiter=",", comments="#")
    return table[:, 0], Rotation.from_quat(table[:, [2, 3, 4, 1]]).inv(), table[:, 5:8]


@pytest.mark.parametrize("year", ["mro_2007", "mro_2009"])
def test_mro_smoothed_beats_filtered_and_interpolated(real_data: Path, year: str) -> None:
    times, truth, rate_inertial = mro(real_data / "attitude" / year)
    kept = np.searchsorted(times, np.arange(times[0], times[-1], 10.0))
    times, truth, rate_inertial = (x[: kept[-1] + 1] for x in (times, truth, rate_inertial))
    withheld = np.ones(len(times), dtype=bool)
    withheld[kept] = False
    spline = RotationSpline(times[kept], truth[kept])
    # The rates are in reference axes: turned to the body by the kept samples alone.
    gyro = GyroSeries.of(times, spline(times).inv().apply(rate_inertial), "rate")
    star = StarSeries.of(times[kept], truth[kept].as_quat(), 0.3 * ARCSEC)
    settings = FusionSettings(GyroNoise(5e-6, 1e-7), bias_sigma_rad_s=1e-5)
    forward = rms_arcsec(ekf.filter_forward(star, gyro, settings).error_rad(truth)[withheld])
    smoothed = smooth.rts(star, gyro, settings)
    error = smoothed.error_rad(truth)[withheld]
    assert rms_arcsec(error) < 0.7 * forward
    for curve in (spline, Slerp(times[kept], truth[kept])):
        assert rms_arcsec(error) < 0.6 * rms_arcsec((curve(times).inv() * truth).as_rotvec())
    normalised = np.sum((error / smoothed.sigma_rad[withheld]) ** 2, axis=1)
    assert 1.0 < np.mean(normalised) < 9.0
    # As recorded, in inertial axes, they are refused with the reason.
    with pytest.raises(ArgumentError, match="inertial axes"):
        ekf.filter_forward(star, GyroSeries.of(times, rate_inertial, "rate"), settings)


def fermi(real_data: Path) -> tuple[FloatArray, Rotation, FloatArray]:
    path = real_data / "attitude" / "fermi" / "poshist_151013_first_half.csv.gz"
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return table[:, 0] - table[0, 0], Rotation.from_quat(table[:, 1:5]), table[:, 5:8]


def fermi_settings(model: str) -> FusionSettings:
    noise = GyroNoise(1.7e-5, 1e-10)
    return FusionSettings(noise, model, 2e-6, scale_sigma=5e-3, misalignment_sigma=5e-3)


def test_fermi_scale_and_misalignment_are_recovered(real_data: Path) -> None:
    times, truth, rate = fermi(real_data)
    star = StarSeries.of(times[::10], truth[::10].as_quat(), ARCSEC)
    gyro = GyroSeries.of(times, rate, "rate")
    estimate = smooth.rts(star, gyro, fermi_settings("general"))
    # The bias of measured = (I + S) true + bias; known are the corrections, of the other sign.
    bias = -np.median(estimate.bias_rad_s, axis=0) / ARCSEC
    np.testing.assert_allclose(bias, (0.017, 0.115, -0.202), rtol=0.0, atol=0.03)
    found = estimate.parameters[-1]
    assert 2200e-6 < np.abs(found).max() < 2600e-6
    # Each half of the data finds the same within what it states.
    halves = []
    for rows in (slice(0, 21600), slice(21600, None)):
        part = star.where((star.times_s >= times[rows][0]) & (star.times_s <= times[rows][-1]))
        series = GyroSeries.of(times[rows], rate[rows], "rate")
        halves.append(smooth.rts(part, series, fermi_settings("general")))
    apart = halves[0].parameters[-1] - halves[1].parameters[-1]
    variance = sum(np.diagonal(half.covariance[-1])[6:] for half in halves)
    assert np.sqrt(np.mean(apart**2 / variance)) < 3.0
    withheld = np.arange(len(times)) % 10 != 0
    forward = ekf.filter_forward(star, gyro, fermi_settings("general"))
    error = [rms_arcsec(e.error_rad(truth)[withheld]) for e in (forward, estimate)]
    assert error[1] < 0.6 * error[0]


def test_fermi_outage_is_predicted_better_with_the_general_gyro_model(real_data: Path) -> None:
    times, truth, rate = fermi(real_data)
    star = StarSeries.of(times[::10], truth[::10].as_quat(), ARCSEC)
    error: dict[str, list[float]] = {"bias": [], "general": []}
    for lost in range(10000, 42001, 4000):
        end = int(np.searchsorted(times, lost + 600.0))
        gyro = GyroSeries.of(times[:end], rate[:end], "rate")
        seen = star.where(star.times_s < lost)
        for model, found in error.items():
            estimate = ekf.filter_forward(seen, gyro, fermi_settings(model))
            found.append(rms_arcsec(estimate.error_rad(truth[:end])[-1:]))
    assert np.sqrt(np.mean(np.square(error["general"]))) < 0.7 * np.sqrt(
        np.mean(np.square(error["bias"]))
    )
