"""P's satellite over a field: its telemetry, and its camera with this or that attitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.corrections import ALL_CORRECTIONS
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ConvergenceError
from geoposition.frames import R_itrs_gcrs
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.experiments.jitter.cases import (
    ALTITUDE_M,
    IFOV_RAD,
    LINE_S,
    Case,
    Size,
)
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.jitter_scene import (
    JitterScene,
    JitterSceneOptions,
    simulate_jitter_scene,
)
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.simulate_attitude import Pointing
from geoposition.sensors.simulate_orbit import Orbit
from geoposition.sensors.simulate_telemetry import true_attitude, true_ephemeris
from geoposition.sensors.timing import ConstantLineRate
from geoposition.timescale import Epoch

INCLINATION_DEG: Final = 97.35

_TRUTH_HZ: Final = 20_000.0
_BOW_PX: Final = 2.0
"""How far the ends of the line of detectors lie along the track."""
_STRETCH: Final = 1e-4
_SPARE_S: Final = 0.05
_AIM_RAD: Final = 1e-7
_MOST_AIMS: Final = 20
_HEIGHT_SPARE_M: Final = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A case with its simulated telemetry; models of its image come from it."""

    case: Case
    size: Size
    scene: JitterScene

    @property
    def epoch(self) -> Epoch:
        """Middle of the image; all times count from it."""
        return self.scene.orbit.epoch

    def ephemeris(self) -> Ephemeris:
        """Positions every second: the truth, as precise orbits are to a few centimetres."""
        half = np.floor(0.5 * self.size.telemetry_s)
        return true_ephemeris(self.scene.orbit, np.arange(-half, half + 1.0))

    def true_model(self) -> PushbroomModel:
        """With the true attitude, sampled far above the highest line of the jitter."""
        reach = 1.1 * self.size.half_s + _SPARE_S
        times = np.arange(-reach, reach, 1.0 / _TRUTH_HZ)
        quat = self.scene.R_inertial_body(times).as_quat()
        turned = R_itrs_gcrs(self.epoch, times) * Rotation.from_quat(quat)
        attitude = Attitude.from_samples(self.epoch, times, turned.as_quat(), "itrs", "spline")
        return camera_model(self.case, self.size, self.ephemeris(), attitude)

    def onboard_model(self) -> PushbroomModel:
        """With the attitude made on board: what comes with the image."""
        times = np.asarray(self.scene.onboard.curve.knots_s)
        turned = R_itrs_gcrs(self.epoch, times) * self.scene.onboard.rotation(times)
        attitude = Attitude.from_samples(self.epoch, times, turned.as_quat(), "itrs", "slerp")
        return camera_model(self.case, self.size, self.ephemeris(), attitude)


def sight(case: Case, size: Size) -> Sighting:
    """Fly over the case's field and measure; the same case gives the same telemetry."""
    lon_deg, lat_deg = np.degrees(_below_satellite(case, size)).tolist()
    options = JitterSceneOptions(
        epoch_utc=case.epoch_utc,
        lon_deg=lon_deg,
        lat_deg=lat_deg,
        altitude_m=ALTITUDE_M,
        inclination_deg=INCLINATION_DEG,
        roll_deg=case.published.side_swing_deg,
        duration_s=size.telemetry_s,
        lines=case.lines,
    )
    return Sighting(case, size, simulate_jitter_scene(options, case.seed))


def camera_model(
    case: Case, size: Size, ephemeris: Ephemeris, attitude: Attitude
) -> PushbroomModel:
    """Rigorous model of one CCD whose middle line is taken at the ephemeris's epoch."""
    shape = size.lines, size.samples
    half = 0.5 * (size.samples - 1)
    timing = ConstantLineRate(ephemeris.epoch, -0.5 * (size.lines - 1) * LINE_S, LINE_S)
    directions = PolynomialDirections(
        np.array([0.0, 0.0, _BOW_PX * IFOV_RAD]),
        np.array([0.0, half * IFOV_RAD, 0.0, _STRETCH * half * IFOV_RAD]),
        half,
        half,
    )
    low, high = case.relief_m
    heights = low - _HEIGHT_SPARE_M, high + _HEIGHT_SPARE_M
    camera = LineCamera.single(shape, timing, directions)
    return PushbroomModel(camera, ephemeris, attitude, ALL_CORRECTIONS, heights)


def planned_model(case: Case, size: Size) -> PushbroomModel:
    """Model of the image as it is planned, without jitter: where it will lie to a few metres."""
    return _planned(case, size, _below_satellite(case, size))


def _planned(case: Case, size: Size, below_rad: FloatArray) -> PushbroomModel:
    epoch = Epoch.from_utc(case.epoch_utc)
    pointing = Pointing(roll_rad=float(np.radians(case.published.side_swing_deg)))
    inclination = float(np.radians(INCLINATION_DEG))
    orbit = Orbit.over(epoch, below_rad[0], below_rad[1], ALTITUDE_M, inclination)
    times = np.arange(-12.0, 13.0)
    attitude = true_attitude(orbit, pointing, times)
    return camera_model(case, size, true_ephemeris(orbit, times), attitude)


def _below_satellite(case: Case, size: Size) -> FloatArray:
    """Longitude and latitude to be above, so that the image's middle lies on the field's."""
    wanted = np.radians(case.centre_deg)
    middle = np.array([0.5 * (size.lines - 1), 0.5 * (size.samples - 1)])
    height = float(np.mean(case.relief_m))
    place: FloatArray = wanted.copy()
    for _ in range(_MOST_AIMS):
        model = _planned(case, size, place)
        away = wanted - model.image_to_ground(middle, height).geodetic[:2]
        if np.max(np.abs(away)) < _AIM_RAD:
            return place
        place = place + away
    raise ConvergenceError(f"{case.name}: no orbit from which the field is seen to the side")
