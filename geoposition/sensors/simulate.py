"""Simulated three-line scenes with known truth: the satellite, its cameras and its telemetry.

The figures of `zy3_cameras` and `SceneOptions` are those published for ZY-3: a sun-synchronous
orbit of 506 km and 97.42 degrees, a nadir camera of 2.1 m and two of 3.5 m looking 22 degrees
forward and backward, GPS at 1 Hz and attitude at 4 Hz.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FlagArray, FloatArray
from geoposition.attitude import Attitude
from geoposition.corrections import ALL_CORRECTIONS, Corrections
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel
from geoposition.sensors.directions import CollinearDirections
from geoposition.sensors.line_camera import Ccd, LineCamera, Mounting
from geoposition.sensors.simulate_attitude import Pointing, Vibration
from geoposition.sensors.simulate_orbit import Orbit
from geoposition.sensors.simulate_telemetry import (
    epochs_s,
    measured_attitude,
    measured_ephemeris,
    true_attitude,
    true_ephemeris,
)
from geoposition.sensors.timing import ConstantLineRate
from geoposition.timescale import Epoch

ARCSEC_RAD: Final = np.pi / 180.0 / 3600.0
_TRUTH_HZ: Final = 16.0
_SEARCH_S: Final = 12.0
_SEARCH_STEP_S: Final = 0.01
_SPARE_S: Final = 6.0
"""Telemetry beyond the images: room for the model's margins and the interpolation's ends."""


@dataclass(frozen=True, slots=True)
class CameraDesign:
    """A line camera as built: optics, CCDs side by side, tilt and line period.

    The CCDs stand off the ideal line by `ccd_offset_px` along and `ccd_rotation_rad`, cyclically.
    """

    name: str
    tilt_rad: float
    focal_length_m: float
    pitch_m: float
    ccds: int
    ccd_samples: int
    lines: int
    line_period_s: float
    radial: tuple[float, ...] = ()
    ccd_offset_px: tuple[float, ...] = (0.0, 4.0, -3.0, 2.0)
    ccd_rotation_rad: tuple[float, ...] = (0.0, 2e-5, -3e-5, 1e-5)

    @property
    def samples(self) -> int:
        """Samples in an image row."""
        return self.ccds * self.ccd_samples

    def camera(self, epoch: Epoch, first_line_s: float, lever_arm_body_m: FloatArray) -> LineCamera:
        """Return the camera whose line 0 is taken `first_line_s` after `epoch`.

        Axes: X along track, Y right, Z down the optical axis. Samples count to the left, so that
        a descending pass gives an image with north up.
        """
        ccds = []
        for i in range(self.ccds):
            middle = i * self.ccd_samples + 0.5 * (self.ccd_samples - 1)
            x = self.ccd_offset_px[i % len(self.ccd_offset_px)] * self.pitch_m
            y = (0.5 * (self.samples - 1) - middle) * self.pitch_m
            angle = self.ccd_rotation_rad[i % len(self.ccd_rotation_rad)]
            # rotated about the CCD's middle: (0, −pitch) turned has x = sin(angle) pitch
            origin = (
                x - np.sin(angle) * self.pitch_m * middle,
                y + np.cos(angle) * self.pitch_m * middle,
            )
            directions = CollinearDirections(
                self.focal_length_m,
                (float(origin[0]), float(origin[1])),
                (0.0, -self.pitch_m),
                angle,
                radial=self.radial,
            )
            ccds.append(Ccd(self.ccd_samples, directions))
        mounting = Mounting(Rotation.from_rotvec([0.0, self.tilt_rad, 0.0]), lever_arm_body_m)
        timing = ConstantLineRate(epoch, first_line_s, self.line_period_s)
        return LineCamera(self.lines, timing, tuple(ccds), mounting)


def zy3_cameras() -> tuple[CameraDesign, ...]:
    """Forward, nadir and backward camera, in the order in which they see a place."""
    tilt = np.radians(22.0)
    oblique = CameraDesign(
        "forward", tilt, 1.7, 10e-6, 4, 4096, 16384, 0.5e-3, (0.012,), (0.0, 3.0, -2.0, 1.0)
    )
    nadir = CameraDesign("nadir", 0.0, 1.7, 7e-6, 3, 8192, 24576, 0.3e-3, (0.010,))
    return oblique, nadir, replace(oblique, name="backward", tilt_rad=-tilt)


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Where and when a scene is taken, how the satellite moves, how well that is measured.

    Angles are arcseconds where the name says so. `star_noise_arcsec` is white, per axis of the
    body and sample; `mounting_bias_arcsec` is the sigma of each camera's constant turn against
    the mounting that the measured models believe in.
    """

    epoch_utc: str = "2012-09-03T03:15:00Z"
    lon_deg: float = 113.0
    lat_deg: float = 34.5
    height_range_m: tuple[float, float] = (500.0, 2500.0)
    altitude_m: float = 506e3
    inclination_deg: float = 97.42
    yaw_steering: bool = True
    jitter_hz: float = 0.65
    jitter_arcsec: tuple[float, float, float] = (1.0, 1.2, 0.4)
    drift_arcsec: float = 10.0
    drift_period_s: float = 180.0
    gps_hz: float = 1.0
    gps_sigma_m: float = 0.05
    star_hz: float = 4.0
    star_noise_arcsec: tuple[float, float, float] = (0.8, 0.8, 1.6)
    mounting_bias_arcsec: float = 3.0
    lever_arm_body_m: tuple[float, float, float] = (0.4, -0.3, 0.9)
    corrections: Corrections = ALL_CORRECTIONS


@dataclass(frozen=True, slots=True)
class SimulatedScene:
    """A scene: `true` and `measured` models by camera, telemetry, and the turns planted.

    `mounting_error_rad` (3,) by camera: R_body_camera of the measured model is the true one
    times exp of it.
    """

    options: SceneOptions
    orbit: Orbit
    centre_geodetic: FloatArray
    true: Mapping[str, PushbroomModel]
    measured: Mapping[str, PushbroomModel]
    true_attitude: Attitude
    measured_attitude: Attitude
    true_ephemeris: Ephemeris
    measured_ephemeris: Ephemeris
    mounting_error_rad: Mapping[str, FloatArray]


def simulate_scene(
    options: SceneOptions | None = None,
    seed: int = 0,
    cameras: tuple[CameraDesign, ...] | None = None,
) -> SimulatedScene:
    """Fly over the place of `options` with `cameras` (ZY-3's), all of them centred on it.

    The same seed gives the same scene to the last bit.
    """
    options = options or SceneOptions()
    designs = cameras or zy3_cameras()
    if len({design.name for design in designs}) != len(designs):
        raise ArgumentError("scene: each camera's name once expected")
    streams = np.random.SeedSequence(seed).spawn(4)
    motion, gps, star, mount = (np.random.default_rng(stream) for stream in streams)
    epoch = Epoch.from_utc(options.epoch_utc)
    orbit = Orbit.over(
        epoch,
        np.radians(options.lon_deg),
        np.radians(options.lat_deg),
        options.altitude_m,
        np.radians(options.inclination_deg),
    )
    pointing = Pointing(yaw_steering=options.yaw_steering, vibrations=_vibrations(options, motion))
    reach_s = _reach_s(options, designs)
    ephemeris = true_ephemeris(orbit, epochs_s(-reach_s, reach_s, 1.0))
    attitude = true_attitude(orbit, pointing, epochs_s(-reach_s, reach_s, _TRUTH_HZ))
    known = measured_ephemeris(
        ephemeris, epochs_s(-reach_s, reach_s, options.gps_hz)[1:-1], options.gps_sigma_m, gps
    )
    noise_rad = ARCSEC_RAD * np.array(options.star_noise_arcsec)
    seen = measured_attitude(
        attitude, epochs_s(-reach_s, reach_s, options.star_hz)[1:-1], noise_rad, star
    )

    def model(camera: LineCamera, where: Ephemeris, how: Attitude) -> PushbroomModel:
        return PushbroomModel(camera, where, how, options.corrections, options.height_range_m)

    centre = _centre(options, orbit, ephemeris, attitude)
    true, measured, errors = {}, {}, {}
    for design in designs:
        first_line_s = _first_line_s(options, design, centre, ephemeris, attitude)
        camera = design.camera(epoch, first_line_s, np.array(options.lever_arm_body_m))
        error = ARCSEC_RAD * options.mounting_bias_arcsec * mount.standard_normal(3)
        wrong = camera.with_parameters(
            {f"mounting_{axis}_rad": float(error[k]) for k, axis in enumerate("xyz")}
        )
        true[design.name] = model(camera, ephemeris, attitude)
        measured[design.name] = model(wrong, known, seen)
        errors[design.name] = error
    return SimulatedScene(
        options, orbit, centre, true, measured, attitude, seen, ephemeris, known, errors
    )


def simulate_measurements(
    model: SensorModel, geodetic: FloatArray, sigma_px: float, rng: np.random.Generator
) -> tuple[FloatArray, FlagArray]:
    """Image points (n, 2) of ground points (n, 3), with white noise of `sigma_px` per axis.

    Flags as the model's; points outside the image are not measured and NaN too.
    """
    found = model.ground_to_image(geodetic)
    image = found.image_px + sigma_px * rng.standard_normal(found.image_px.shape)
    return np.where((found.flag == Flag.OK)[..., None], image, np.nan), found.flag


def _vibrations(options: SceneOptions, rng: np.random.Generator) -> tuple[Vibration, ...]:
    drift = Vibration(
        1.0 / options.drift_period_s,
        np.full(3, options.drift_arcsec * ARCSEC_RAD),
        rng.uniform(0.0, 2.0 * np.pi, 3),
    )
    jitter = Vibration(
        options.jitter_hz,
        ARCSEC_RAD * np.array(options.jitter_arcsec),
        rng.uniform(0.0, 2.0 * np.pi, 3),
    )
    return drift, jitter


def _look_s(options: SceneOptions, design: CameraDesign) -> float:
    """About when the camera sees the place below the satellite at 0, on a flat Earth."""
    return float(-options.altitude_m * 1.1 * np.tan(design.tilt_rad) / 7000.0)


def _reach_s(options: SceneOptions, designs: tuple[CameraDesign, ...]) -> float:
    return float(
        max(
            abs(_look_s(options, design)) + 0.6 * design.lines * design.line_period_s
            for design in designs
        )
        + 2.0 * _SPARE_S
    )


def _centre(
    options: SceneOptions, orbit: Orbit, ephemeris: Ephemeris, attitude: Attitude
) -> FloatArray:
    """Ground point (3,), at the middle height, that the body's Z axis meets at 0."""
    timing = ConstantLineRate(orbit.epoch, 0.0, 1e-2)
    straight = CollinearDirections(1.0, (0.0, 0.0), (0.0, -1e-5))
    camera = LineCamera.single((200, 200), timing, straight)
    model = PushbroomModel(camera, ephemeris, attitude, options.corrections, options.height_range_m)
    middle_m = 0.5 * sum(options.height_range_m)
    return model.image_to_ground([0.0, 0.0], middle_m).geodetic


def _first_line_s(
    options: SceneOptions,
    design: CameraDesign,
    centre: FloatArray,
    ephemeris: Ephemeris,
    attitude: Attitude,
) -> float:
    """Start of the image whose middle line passes `centre`."""
    strip = replace(
        design, lines=round(2.0 * _SEARCH_S / _SEARCH_STEP_S), line_period_s=_SEARCH_STEP_S
    )
    start_s = _look_s(options, design) - _SEARCH_S
    camera = strip.camera(ephemeris.epoch, start_s, np.array(options.lever_arm_body_m))
    model = PushbroomModel(camera, ephemeris, attitude, options.corrections, options.height_range_m)
    found = model.ground_to_image(centre)
    if found.flag != Flag.OK:
        raise GeometryError(f"scene: the {design.name} camera never sees the scene's centre")
    seen_s = start_s + float(found.image_px[0]) * _SEARCH_STEP_S
    # Whole nanoseconds, as time tags have: rounding in compiled code cannot change the scene.
    return round(seen_s - 0.5 * (design.lines - 1) * design.line_period_s, 9)
