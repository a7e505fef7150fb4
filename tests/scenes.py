"""Synthetic push-broom scenes of known truth, for tests: orbit, pointing, camera, timing.

The orbit is Keplerian in an inertial frame whose axes are the Earth-fixed ones at t = 0, and the
Earth turns uniformly about z: everything has a closed form. t = 0 is the middle of the image.
The body looks down: x along track, y to the right, z to the Earth's centre, before it is turned
by roll, pitch, yaw and jitter. SI units and radians, but for `_deg` arguments of `build`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude, QuaternionCurve
from geoposition.constants import EARTH_RATE_RAD_S, GM_M3_S2, WGS84_A_M
from geoposition.corrections import ALL_CORRECTIONS, Corrections
from geoposition.ephemeris import Ephemeris
from geoposition.frames import gcrs_from_itrs
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.directions import (
    CollinearDirections,
    Directions,
    PolynomialDirections,
    SplineDirections,
    TableDirections,
)
from geoposition.sensors.line_camera import Ccd, LineCamera, Mounting
from geoposition.sensors.timing import ConstantLineRate, LineTimeTable
from geoposition.timescale import Epoch

EPOCH = Epoch.from_utc("2021-06-21T10:30:00Z")
EARTH_RATE = np.array([0.0, 0.0, EARTH_RATE_RAD_S])

CameraKind = Literal["polynomial", "angles", "table", "collinear", "spline", "ccds"]
TimingKind = Literal["forward", "reverse", "table", "reverse table"]
AttitudeKind = Literal["slerp", "spline", "lagrange"]


@dataclass(frozen=True)
class Orbit:
    """Kepler orbit; `anomaly_rad` (mean, from perigee) and `node_rad` hold at t = 0."""

    semi_major_m: float = WGS84_A_M + 600e3
    eccentricity: float = 0.0
    inclination_rad: float = np.deg2rad(97.8)
    node_rad: float = 0.3
    perigee_rad: float = 0.0
    anomaly_rad: float = 0.8

    @classmethod
    def over(
        cls,
        lon_rad: float,
        lat_rad: float,
        altitude_m: float = 600e3,
        inclination_rad: float = np.deg2rad(97.8),
        eccentricity: float = 0.0,
    ) -> Orbit:
        """Orbit whose satellite ascends over a geocentric place at t = 0, at its perigee."""
        along = np.arcsin(np.clip(np.sin(lat_rad) / np.sin(inclination_rad), -1, 1))
        node = lon_rad - np.arctan2(np.cos(inclination_rad) * np.sin(along), np.cos(along))
        semi_major_m = (WGS84_A_M + altitude_m) / (1 - eccentricity)
        return cls(semi_major_m, eccentricity, inclination_rad, float(node), float(along), 0.0)

    def inertial(self, times_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities (..., 3) in the inertial frame."""
        t, e, a = np.asarray(times_s, dtype=np.float64), self.eccentricity, self.semi_major_m
        motion = np.sqrt(GM_M3_S2 / a**3)
        mean = self.anomaly_rad + motion * t
        big_e = mean + e * np.sin(mean)
        for _ in range(30):
            big_e = big_e - (big_e - e * np.sin(big_e) - mean) / (1 - e * np.cos(big_e))
        flat = np.sqrt(1 - e * e)
        rate = motion / (1 - e * np.cos(big_e))
        zero = np.zeros_like(t)
        plane = a * np.stack([np.cos(big_e) - e, flat * np.sin(big_e), zero], axis=-1)
        speed = a * np.stack([-np.sin(big_e) * rate, flat * np.cos(big_e) * rate, zero], axis=-1)
        turn = Rotation.from_euler("ZXZ", [self.node_rad, self.inclination_rad, self.perigee_rad])
        shape = plane.shape
        position = turn.apply(plane.reshape(-1, 3)).reshape(shape)
        return position, turn.apply(speed.reshape(-1, 3)).reshape(shape)

    def earth_fixed(self, times_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities (..., 3) relative to the turning Earth."""
        position, velocity = (_earth_turn(times_s, v) for v in self.inertial(times_s))
        return position, velocity - np.cross(EARTH_RATE, position)

    def gcrs(self, times_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """The Earth-fixed orbit taken to GCRS with the real Earth's orientation after `EPOCH`."""
        return gcrs_from_itrs(*self.earth_fixed(times_s), EPOCH, times_s)

    def R_ecef_nadir(self, times_s: ArrayLike) -> Rotation:
        """Axes along track (inertial), right, down at `times_s` (n,)."""
        position, velocity = (_earth_turn(times_s, v) for v in self.inertial(times_s))
        down = -position / np.linalg.norm(position, axis=-1, keepdims=True)
        right = np.cross(down, velocity)
        right /= np.linalg.norm(right, axis=-1, keepdims=True)
        return Rotation.from_matrix(np.stack([np.cross(right, down), right, down], axis=-1))

    @property
    def ground_speed_m_s(self) -> float:
        """Speed of the sub-satellite point at t = 0, about."""
        position, velocity = self.earth_fixed(0.0)
        return float(np.linalg.norm(velocity) * WGS84_A_M / np.linalg.norm(position))


def _earth_turn(times_s: ArrayLike, vectors: FloatArray) -> FloatArray:
    angle = EARTH_RATE_RAD_S * np.asarray(times_s, dtype=np.float64)
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)


@dataclass(frozen=True)
class Jitter:
    """A sinusoidal turn about one body axis (0 roll, 1 pitch, 2 yaw)."""

    axis: int
    amplitude_rad: float
    frequency_hz: float
    phase_rad: float = 0.0


JITTERED = (
    Jitter(0, 1e-6, 100.0),
    Jitter(1, 1e-6, 100.0, 1.0),
    Jitter(0, np.deg2rad(4 / 3600), 0.65, 0.5),
    Jitter(1, np.deg2rad(4 / 3600), 0.65, 2.0),
)


@dataclass(frozen=True)
class Pointing:
    """Roll, pitch, yaw against the nadir frame, a steady pitch rate, and jitter."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    pitch_rate_rad_s: float = 0.0
    jitter: tuple[Jitter, ...] = ()

    def R_nadir_body(self, times_s: FloatArray) -> Rotation:
        """Body axes in the nadir frame at `times_s` (n,)."""
        one = np.ones(len(times_s))
        pitch = self.pitch_rad + self.pitch_rate_rad_s * times_s
        angles = np.stack([self.yaw_rad * one, self.roll_rad * one, pitch], axis=-1)
        small = np.zeros((len(times_s), 3))
        for j in self.jitter:
            phase = 2 * np.pi * j.frequency_hz * times_s + j.phase_rad
            small[:, j.axis] += j.amplitude_rad * np.sin(phase)
        return Rotation.from_euler("ZXY", angles) * Rotation.from_rotvec(small)


def camera_directions(kind: CameraKind, samples: int, ifov_rad: float) -> Directions:
    """Directions of one CCD of `samples` pixels, `ifov_rad` each, centred on the axis."""
    half = 0.5 * max(samples - 1, 200)
    reach = half * ifov_rad
    grid = np.linspace(-1, 1, 9)
    bow = 3 * ifov_rad
    if kind == "polynomial":
        x = [0.001, 2e-5 * reach, bow]
        return PolynomialDirections(x, [0.0, reach, 1e-4 * reach, 2e-4 * reach], half, half)
    if kind == "angles":
        x = [0.001, 2e-5 * reach, bow, bow / 9]
        return PolynomialDirections(x, [0.0, reach, 1e-4 * reach, 2e-4 * reach], half, half, True)
    if kind == "table":
        # Every pixel measured by itself: a kink at each.
        rng = np.random.default_rng(8)
        s = np.arange(max(samples, 2), dtype=np.float64)
        table = np.stack([0.001 + bow * ((s - half) / half) ** 2, (s - half) * ifov_rad], axis=-1)
        return TableDirections(s, table + rng.normal(0, 0.02 * ifov_rad, table.shape))
    if kind == "collinear":
        focal_mm, pitch_mm = 8800.0, 8800.0 * ifov_rad
        return CollinearDirections(
            focal_mm, (0.3, -half * pitch_mm), (0.0, pitch_mm), 2e-4, (0.1, -0.2), (1e-3, 1e-2)
        )
    if kind == "spline":
        table = np.stack([bow * grid**2, np.tan(reach * (grid + 2e-4 * grid**3))], axis=-1)
        return SplineDirections(half + half * grid, table)
    raise ValueError(kind)


def focal_plane(
    ccds: int, samples: int, ifov_rad: float, overlap_px: float, stagger_px: float
) -> tuple[Ccd, ...]:
    """CCDs of `samples` each; neighbours overlap (or gap, if negative), every other is ahead."""
    result = []
    total = ccds * samples - (ccds - 1) * overlap_px
    for i in range(ccds):
        first = i * (samples - overlap_px) - 0.5 * (total - 1)
        x = [(i % 2) * stagger_px * ifov_rad, 1e-6 * ifov_rad]
        y = [(first - i * samples) * ifov_rad, ifov_rad]
        result.append(Ccd(samples, PolynomialDirections(x, y)))
    return tuple(result)


@dataclass(frozen=True)
class Scene:
    """Camera, orbit data and what is to be corrected; `orbit` and `pointing` are the truth."""

    orbit: Orbit
    pointing: Pointing
    camera: LineCamera
    ephemeris: Ephemeris
    attitude: Attitude
    corrections: Corrections = ALL_CORRECTIONS
    height_range_m: tuple[float, float] = (-400.0, 9000.0)
    gsd_m: float = 0.7

    def model(self) -> PushbroomModel:
        """The rigorous model."""
        return PushbroomModel(
            self.camera, self.ephemeris, self.attitude, self.corrections, self.height_range_m
        )

    def with_corrections(self, corrections: Corrections) -> Scene:
        """The same scene, other corrections."""
        return replace(self, corrections=corrections)

    def grid(self, n: int = 21, margin: float = 0.0, heights_m: Sequence[float] = ()) -> Grid:
        """Image points over the scene and `margin` pixels around it, at several heights."""
        lines, samples = self.camera.shape
        line = np.linspace(-margin, lines - 1 + margin, n)
        sample = np.linspace(-margin, samples - 1 + margin, n)
        heights = np.array(heights_m or (-400.0, 0.0, 2500.0, 9000.0))
        px = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1).reshape(-1, 2)
        return Grid(np.tile(px, (len(heights), 1)), np.repeat(heights, len(px)))


@dataclass(frozen=True)
class Grid:
    """Image points (n, 2) and their heights (n,)."""

    image_px: FloatArray = field(repr=False)
    height_m: FloatArray = field(repr=False)


def line_timing(
    kind: TimingKind, lines: int, period_s: float, middle_s: float = 0.0
) -> ConstantLineRate | LineTimeTable:
    """Line times centred on `middle_s`; the tables change their rate by 0.1 % and back."""
    half = 0.5 * (lines - 1)
    sign = -1.0 if kind.startswith("reverse") else 1.0
    if not kind.endswith("table"):
        return ConstantLineRate(EPOCH, middle_s - sign * half * period_s, sign * period_s)
    table_lines = np.linspace(-0.6 * lines - 200, 1.6 * lines + 200, 24)
    wobble = 1e-3 * np.sin(np.arange(24)) * (table_lines[1] - table_lines[0])
    return LineTimeTable(
        EPOCH, table_lines, middle_s + sign * period_s * (table_lines - half + wobble)
    )


def build(
    shape: tuple[int, int] = (2000, 1500),
    *,
    orbit: Orbit | None = None,
    gsd_m: float = 0.7,
    roll_deg: float = 0.0,
    pitch_deg: float = 0.0,
    yaw_deg: float = 0.0,
    pitch_rate_rad_s: float = 0.0,
    jitter: tuple[Jitter, ...] = (),
    camera: CameraKind = "polynomial",
    ccds: tuple[Ccd, ...] | None = None,
    timing: TimingKind = "forward",
    mounting: Mounting | None = None,
    ephemeris_step_s: float = 1.0,
    attitude_step_s: float = 0.02,
    attitude: AttitudeKind = "slerp",
    corrections: Corrections = ALL_CORRECTIONS,
    height_range_m: tuple[float, float] = (-400.0, 9000.0),
    spare_s: float = 4.0,
    middle_s: float = 0.0,
    period_s: float | None = None,
) -> Scene:
    """Scene of `shape` (lines, samples), about `gsd_m` a pixel at nadir.

    `spare_s` is how far ephemeris and attitude reach beyond the model's margin. `middle_s` only
    renames the times: the seconds from `EPOCH` at which the scene's t = 0 lies.
    """
    orbit = orbit or Orbit.over(0.2, 0.75)
    lines, samples = shape
    altitude = float(np.linalg.norm(orbit.earth_fixed(0.0)[0])) - WGS84_A_M
    ifov, period = gsd_m / altitude, period_s or gsd_m / orbit.ground_speed_m_s
    if ccds is None:
        ccds = (Ccd(samples, camera_directions(camera, samples, ifov)),)
    line_camera = LineCamera(
        lines, line_timing(timing, lines, period, middle_s), ccds, mounting or Mounting()
    )
    reach = (0.56 * lines + 101) * period + spare_s
    times = _even(reach, ephemeris_step_s)
    ephemeris = Ephemeris.lagrange(EPOCH, times + middle_s, orbit.earth_fixed(times)[0])
    pointing = Pointing(*np.deg2rad([roll_deg, pitch_deg, yaw_deg]), pitch_rate_rad_s, jitter)
    times = _even(reach, attitude_step_s)
    quat = (orbit.R_ecef_nadir(times) * pointing.R_nadir_body(times)).as_quat()
    if attitude == "lagrange":
        series = Attitude(EPOCH, QuaternionCurve.lagrange(times + middle_s, quat))
    else:
        series = Attitude.from_samples(EPOCH, times + middle_s, quat, interpolation=attitude)
    return Scene(
        orbit, pointing, line_camera, ephemeris, series, corrections, height_range_m, gsd_m
    )


def _even(reach_s: float, step_s: float) -> FloatArray:
    n = max(int(np.ceil(reach_s / step_s)), 4)
    return np.arange(-n, n + 1) * step_s
