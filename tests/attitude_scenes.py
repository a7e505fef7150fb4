"""Simulated star and gyro telemetry for the tests of fusion."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.gyro import simulate_increments
from geoposition.sensors.kinematics import attitude_of_rate, integrated_rate_rad
from geoposition.sensors.star_sensor import noisy_quat_xyzw
from geoposition.sensors.telemetry import GyroNoise, GyroParameters, GyroSeries, StarSeries

ARCSEC = np.pi / 648000.0
NOISE = GyroNoise(1e-6, 1e-8)
START = Rotation.from_euler("ZXY", [40.0, -20.0, 65.0], degrees=True)


def turning(t: FloatArray) -> FloatArray:
    """A rate of up to 0.6 deg/s that moves about all axes."""
    waves = [np.sin(0.05 * t), np.cos(0.031 * t + 0.4), np.sin(0.017 * t + 1.0)]
    return np.radians(0.35) * np.stack(waves, axis=-1)


def telemetry(
    gyro_times_s: FloatArray,
    star_times_s: FloatArray,
    sigma_rad: float = 5.0 * ARCSEC,
    parameters: GyroParameters | None = None,
    noise: GyroNoise = NOISE,
    seed: int = 0,
    rate=turning,
) -> tuple[StarSeries, GyroSeries, Rotation]:
    """One head and a gyro of increments, and the true attitude at the gyro epochs."""
    rng = np.random.default_rng(seed)
    parameters = parameters or GyroParameters.of(rng.normal(0.0, 5e-6, 3))
    knots = np.union1d(gyro_times_s, star_times_s)
    truth = attitude_of_rate(rate, knots, START.as_quat())
    increments = integrated_rate_rad(rate, gyro_times_s)
    gyro = simulate_increments(gyro_times_s, increments, noise, rng, parameters).series()
    quats = noisy_quat_xyzw(truth[np.searchsorted(knots, star_times_s)], sigma_rad, rng)
    at_gyro = Rotation.from_quat(truth[np.searchsorted(knots, gyro_times_s)])
    return StarSeries.of(star_times_s, quats, sigma_rad), gyro, at_gyro


def settings(model: str = "bias", **changes) -> FusionSettings:
    """Noise as simulated and a prior that the drawn bias fits."""
    return FusionSettings(NOISE, model, **{"bias_sigma_rad_s": 5e-6, **changes})
