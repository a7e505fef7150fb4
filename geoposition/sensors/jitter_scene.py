"""A satellite that shakes, seen by two star heads and a fast angular-displacement sensor.

The figures are those of a 0.5 m satellite at 490 km: 60 s of telemetry, increments at 10 kHz,
jitter lines at 200, 300 and 350 Hz of hundredths of an arcsecond. Where P leaves them open they
are chosen to give what P measured: *Source*: P section 3, figures 3, 4 and 7, table 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, read_only
from geoposition.attitude import Attitude
from geoposition.errors import ArgumentError
from geoposition.interpolation import within_span
from geoposition.rotation import continuous_quat
from geoposition.sensors.angular_band import SensorBand, band_limited
from geoposition.sensors.angular_displacement import Installation, simulate_angular_displacement
from geoposition.sensors.kinematics import (
    quat_from_rotvec_xyzw,
    quat_product_xyzw,
    relative_rotvec_rad,
)
from geoposition.sensors.simulate import ARCSEC_RAD
from geoposition.sensors.simulate_attitude import Pointing, Vibration
from geoposition.sensors.simulate_orbit import Orbit
from geoposition.sensors.simulate_telemetry import epochs_s
from geoposition.sensors.star_sensor import (
    StarHead,
    mounting_of,
    simulate_star_series,
)
from geoposition.sensors.telemetry import GyroNoise, GyroSeries, Mounting, StarSeries
from geoposition.timescale import Epoch

HEADS: Final = ("star-a", "star-b")

_KNOTS_HZ: Final = 4.0
_MARGIN_S: Final = 2.0
DEG_H_RAD_S: Final = np.pi / 180.0 / 3600.0


@dataclass(frozen=True, slots=True)
class JitterLine:
    """One line of the jitter: amplitudes in arcseconds about roll, pitch and yaw (X, Y, Z)."""

    frequency_hz: float
    amplitude_arcsec: tuple[float, float, float]


PAPER_LINES: Final = (
    JitterLine(200.0, (0.020, 0.025, 0.006)),
    JitterLine(300.0, (0.020, 0.025, 0.006)),
    JitterLine(350.0, (0.015, 0.020, 0.006)),
)
"""P figure 4: amplitudes up to 0.025 arcsec, the most of it in pitch and roll."""

ZY3_LINE: Final = JitterLine(0.65, (4.0, 4.0, 0.0))
"""What ZY-3 did in 2012: T section 2.4."""


@dataclass(frozen=True, slots=True)
class JitterSceneOptions:
    """Where, how long and how well: telemetry spans `duration_s`, centred on the place's pass.

    `drift_deg_h` is the sensor's constant drift about each axis, with random signs;
    `angle_random_walk_arcsec` per root second. With `band` the sensor feels only that.
    `installation_arcsec` and `scale_ppm` are sigmas of what is not known about the sensor.
    """

    epoch_utc: str = "2015-08-29T06:08:00Z"
    lon_deg: float = 113.05
    lat_deg: float = 34.45
    altitude_m: float = 490e3
    inclination_deg: float = 97.35
    roll_deg: float = 0.0
    yaw_steering: bool = True
    duration_s: float = 60.0
    lines: tuple[JitterLine, ...] = PAPER_LINES
    sensor_hz: float = 10_000.0
    angle_random_walk_arcsec: float = 0.015
    drift_deg_h: float = 0.5
    rate_random_walk_arcsec: float = 0.0
    installation_arcsec: float = 0.0
    scale_ppm: float = 0.0
    band: SensorBand | None = None
    star_hz: float = 10.0
    star_sigma_arcsec: float = 5.0
    onboard_hz: float = 10.0
    onboard_noise_arcsec: tuple[float, float, float] = (0.5, 0.75, 0.5)

    def __post_init__(self) -> None:
        rates = (self.duration_s, self.sensor_hz, self.star_hz, self.onboard_hz)
        if not all(rate > 0.0 for rate in rates):
            raise ArgumentError("jitter scene: a positive duration and positive rates expected")

    @property
    def sensor_noise(self) -> GyroNoise:
        """Noise of the angular-displacement sensor."""
        return GyroNoise(
            ARCSEC_RAD * self.angle_random_walk_arcsec, ARCSEC_RAD * self.rate_random_walk_arcsec
        )


@dataclass(frozen=True, slots=True, eq=False)
class JitterMotion:
    """Smooth pointing over an orbit, and jitter in the body on top of it: the truth.

    The quaternions of the pointing are splined, which at its millirads per second is exact to
    rounding and allows millions of epochs; all `vibrations` add to one small turn.
    """

    span_s: tuple[float, float]
    smooth: CubicSpline
    vibrations: tuple[Vibration, ...]

    @classmethod
    def of(
        cls,
        orbit: Orbit,
        pointing: Pointing,
        vibrations: tuple[Vibration, ...],
        span_s: tuple[float, float],
    ) -> JitterMotion:
        """Spline the `pointing` over `orbit` and shake it by `vibrations`, within a span."""
        knots = epochs_s(span_s[0] - _MARGIN_S, span_s[1] + _MARGIN_S, _KNOTS_HZ)
        quats = continuous_quat(pointing.R_gcrs_body(orbit, knots).as_quat())
        return cls(span_s, CubicSpline(knots, quats), vibrations)

    def jitter_rad(self, times_s: ArrayLike) -> FloatArray:
        """Rotation vectors (n, 3) in the body at `times_s` (n,)."""
        times = np.asarray(times_s, dtype=np.float64)
        turn = np.zeros((*times.shape, 3))
        for vibration in self.vibrations:
            turn += vibration.turn_rad(times)
        return turn

    def quat_xyzw(self, times_s: FloatArray) -> FloatArray:
        """R_inertial_body as quaternions (n, 4)."""
        quats = np.asarray(self.smooth(within_span(times_s, self.span_s, "jitter scene")))
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        return quat_product_xyzw(quats, quat_from_rotvec_xyzw(self.jitter_rad(times_s)))

    def R_inertial_body(self, times_s: FloatArray) -> Rotation:
        """Rotations (n,)."""
        return Rotation.from_quat(self.quat_xyzw(times_s))


@dataclass(frozen=True, slots=True, eq=False)
class JitterScene:
    """The truth, what the sensors sent down, and their mounting.

    Times are seconds from `orbit.epoch`, at which the satellite is above the place. `sensor` is
    the angular-displacement sensor's series (increments) in what is taken for the body's axes,
    `installation` its true drift and other errors, `onboard` the attitude product made on board:
    white noise on samples of the truth, linear between them.
    """

    options: JitterSceneOptions
    orbit: Orbit
    motion: JitterMotion
    star: StarSeries
    sensor: GyroSeries
    mounting: Mounting
    installation: Installation
    onboard: Attitude

    def R_inertial_body(self, times_s: ArrayLike) -> Rotation:
        """Return the true attitude at `times_s` (n,) of the span, at any rate."""
        return self.motion.R_inertial_body(np.asarray(times_s, dtype=np.float64))

    def jitter_rad(self, times_s: ArrayLike) -> FloatArray:
        """Return the jitter alone: rotation vectors (n, 3) in the body at `times_s` (n,)."""
        return self.motion.jitter_rad(times_s)

    def true_attitude(self, times_s: ArrayLike) -> Attitude:
        """Truth as the imaging models' input type: a spline through `times_s` (n,)."""
        quats = self.R_inertial_body(times_s).as_quat()
        return Attitude.from_samples(self.orbit.epoch, times_s, quats, "gcrs", "spline")


def simulate_jitter_scene(options: JitterSceneOptions | None = None, seed: int = 0) -> JitterScene:
    """Fly, shake and measure; the same seed gives the same telemetry to the last bit."""
    options = options or JitterSceneOptions()
    streams = np.random.SeedSequence(seed).spawn(4)
    shake, stars, fast, board = (np.random.default_rng(stream) for stream in streams)
    orbit = Orbit.over(
        Epoch.from_utc(options.epoch_utc),
        np.radians(options.lon_deg),
        np.radians(options.lat_deg),
        options.altitude_m,
        np.radians(options.inclination_deg),
    )
    pointing = Pointing(roll_rad=np.radians(options.roll_deg), yaw_steering=options.yaw_steering)
    half_s = 0.5 * options.duration_s
    vibrations = tuple(_vibration(line, shake) for line in options.lines)
    motion = JitterMotion.of(orbit, pointing, vibrations, (-half_s, half_s))
    heads = _heads(options)
    star_times = _centred(options.duration_s, options.star_hz)
    star = simulate_star_series(heads, [star_times] * len(heads), motion.R_inertial_body, stars)
    installation = Installation(
        ARCSEC_RAD * options.installation_arcsec * fast.standard_normal(3),
        1e-6 * options.scale_ppm * fast.standard_normal(3),
        DEG_H_RAD_S * options.drift_deg_h * fast.choice([-1.0, 1.0], 3),
    )
    sensor = _sensor_series(options, installation, motion, fast)
    onboard_times = _centred(options.duration_s, options.onboard_hz)
    noise = np.array(options.onboard_noise_arcsec) * ARCSEC_RAD
    turn = Rotation.from_rotvec(noise * board.standard_normal((len(onboard_times), 3)))
    quats = (motion.R_inertial_body(onboard_times) * turn).as_quat()
    onboard = Attitude.from_samples(orbit.epoch, onboard_times, quats, "gcrs", "slerp")
    mounting = mounting_of(heads)
    return JitterScene(options, orbit, motion, star, sensor, mounting, installation, onboard)


def _vibration(line: JitterLine, rng: np.random.Generator) -> Vibration:
    amplitude = ARCSEC_RAD * np.array(line.amplitude_arcsec)
    return Vibration(line.frequency_hz, amplitude, rng.uniform(0.0, 2.0 * np.pi, 3))


def _heads(options: JitterSceneOptions) -> tuple[StarHead, ...]:
    """Two heads that look up and to the sides, their boresights 80 degrees apart."""
    sigma = ARCSEC_RAD * options.star_sigma_arcsec
    return tuple(
        # the body's Z is down: from +Z over X to 140 degrees to either side is 40 from zenith
        StarHead(name, sigma, sigma, Rotation.from_euler("X", angle, degrees=True))
        for name, angle in zip(HEADS, (140.0, -140.0), strict=True)
    )


def _sensor_series(
    options: JitterSceneOptions,
    installation: Installation,
    motion: JitterMotion,
    rng: np.random.Generator,
) -> GyroSeries:
    times = _centred(options.duration_s, options.sensor_hz)
    true = relative_rotvec_rad(motion.quat_xyzw(times))
    if options.band is not None:
        # What the axes feel is damped before it is read, noise and drift come after.
        head = np.concatenate([true[:1], true])
        true = band_limited(GyroSeries.of(times, head, "increment"), options.band).values[1:]
    noise = options.sensor_noise
    return simulate_angular_displacement(times, true, noise, rng, installation).series()


def _centred(duration_s: float, rate_hz: float) -> FloatArray:
    """Multiples of 1 / `rate_hz` within half the duration to either side of zero."""
    half = np.floor(0.5 * duration_s * rate_hz + 1e-6)
    return read_only(np.arange(-half, half + 1.0) / rate_hz)
