"""What the instruments of a pass measured: one draw per run, the same for all attitudes.

Star heads and their rates are those of T table 3.1 (4 Hz, 1e-5 in the quaternion's vector part,
so 2e-5 rad per axis; gyro at 10 Hz), the gyro's errors those of T table 4.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.ephemeris import Ephemeris
from geoposition.scripts.experiments.monte_carlo import DEG_H_RAD_S
from geoposition.scripts.experiments.thesis.scene import HALF_SPAN_S, Scene
from geoposition.scripts.experiments.thesis_ch4 import NOISE, TRUTH
from geoposition.sensors.gyro import simulate_increments
from geoposition.sensors.kinematics import relative_rotvec_rad
from geoposition.sensors.simulate import ARCSEC_RAD
from geoposition.sensors.simulate_telemetry import epochs_s, measured_ephemeris
from geoposition.sensors.star_sensor import StarHead, simulate_star_series
from geoposition.sensors.telemetry import GyroNoise, GyroParameters, GyroSeries, StarSeries

STAR_SIGMA_RAD: Final = 2e-5
HEADS_DEG: Final = 73.7564
"""Angle between the optical axes of ZY-3's heads 2 and 3. *Source*: T 5.2.2."""


@dataclass(frozen=True, slots=True, eq=False)
class Instruments:
    """What flies: rates, noise and errors of star heads, gyro, GPS and cameras' mounting."""

    star_hz: float = 4.0
    gyro_hz: float = 10.0
    gyro_noise: GyroNoise = NOISE
    gyro_errors: GyroParameters = TRUTH
    bias_sigma_rad_s: float = 0.2 * DEG_H_RAD_S
    gps_hz: float = 1.0
    gps_sigma_m: float = 0.05
    mounting_arcsec: float = 3.0
    heads: tuple[StarHead, ...] = field(default_factory=lambda: zy3_heads(STAR_SIGMA_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """One run's data; `mounting_error_rad` (3,) by camera is not known to the ground."""

    star: StarSeries
    gyro: GyroSeries
    ephemeris: Ephemeris
    mounting_error_rad: Mapping[str, FloatArray]


def zy3_heads(sigma_rad: float) -> tuple[StarHead, StarHead]:
    """Heads 2 and 3, which look up to either side of the zenith."""
    half = 0.5 * HEADS_DEG
    # The body's Z is down: 180 degrees about X is the zenith.
    return tuple(  # type: ignore[return-value]
        StarHead(name, sigma_rad, sigma_rad, Rotation.from_euler("X", 180.0 + off, degrees=True))
        for name, off in (("star-2", -half), ("star-3", half))
    )


def star_epochs_s(instruments: Instruments) -> FloatArray:
    """Epochs of the star heads, inside the gyro's."""
    return epochs_s(-HALF_SPAN_S, HALF_SPAN_S, instruments.star_hz)[1:-1]


def draw(scene: Scene, instruments: Instruments, random: np.random.SeedSequence) -> Telemetry:
    """Measure one pass; each instrument has a random stream of its own."""
    stars, turning, gps, mounts = (np.random.default_rng(s) for s in random.spawn(4))
    times = epochs_s(-HALF_SPAN_S, HALF_SPAN_S, instruments.gyro_hz)
    star = simulate_star_series(
        instruments.heads,
        [star_epochs_s(instruments)] * len(instruments.heads),
        scene.motion.R_inertial_body,
        stars,
    )
    turned = relative_rotvec_rad(scene.motion.quat_xyzw(times))
    gyro = simulate_increments(
        times, turned, instruments.gyro_noise, turning, instruments.gyro_errors
    ).series()
    seconds = epochs_s(-HALF_SPAN_S, HALF_SPAN_S, instruments.gps_hz)
    ephemeris = measured_ephemeris(scene.ephemeris, seconds, instruments.gps_sigma_m, gps)
    sigma = instruments.mounting_arcsec * ARCSEC_RAD
    return Telemetry(
        star, gyro, ephemeris, {name: sigma * mounts.standard_normal(3) for name in scene.models}
    )
