"""P's case as models: the scene's orbit and a 0.5 m camera, seen with this or that attitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.corrections import ALL_CORRECTIONS
from geoposition.ephemeris import Ephemeris
from geoposition.frames import R_itrs_gcrs, itrs_from_gcrs
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.smoothers.smooth import rts
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.jitter_scene import JitterScene
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.timing import ConstantLineRate

IFOV_RAD = 0.5 / 490e3
LINE_S = 2.1 / 30_000


@dataclass(frozen=True)
class Telling:
    """A scene, the image's `shape`, and how its models come about."""

    scene: JitterScene
    shape: tuple[int, int]

    @property
    def half_s(self) -> float:
        """Half the duration of the image."""
        return 0.5 * self.shape[0] * LINE_S

    def model(self, attitude: Attitude) -> PushbroomModel:
        """The rigorous model with an Earth-fixed `attitude`."""
        samples = self.shape[1]
        epoch = self.scene.orbit.epoch
        timing = ConstantLineRate(epoch, -self.half_s, LINE_S)
        half = 0.5 * (samples - 1)
        bow = 2.0 * IFOV_RAD
        directions = PolynomialDirections(
            [0.0, 0.0, bow], [0.0, half * IFOV_RAD, 0.0, 1e-4 * half * IFOV_RAD], half, half
        )
        camera = LineCamera.single(self.shape, timing, directions)
        times = np.arange(-20.0, 20.5, 0.5)
        position, _ = itrs_from_gcrs(*self.scene.orbit.states(times), epoch, times)
        ephemeris = Ephemeris.lagrange(epoch, times, position)
        return PushbroomModel(camera, ephemeris, attitude, ALL_CORRECTIONS, (-100.0, 1500.0))

    def earth_fixed(
        self, times_s: FloatArray, quat_xyzw: FloatArray, kind: str = "spline"
    ) -> Attitude:
        """Earth-fixed attitude through inertial samples."""
        from scipy.spatial.transform import Rotation

        epoch = self.scene.orbit.epoch
        turned = R_itrs_gcrs(epoch, times_s) * Rotation.from_quat(quat_xyzw)
        return Attitude.from_samples(epoch, times_s, turned.as_quat(), "itrs", kind)  # type: ignore[arg-type]

    def true(self) -> PushbroomModel:
        """With the true attitude, sampled far above the highest line."""
        reach = self.half_s * 1.1 + 0.05
        times = np.arange(-reach, reach, 1.0 / 20_000)
        return self.model(self.earth_fixed(times, self.scene.R_inertial_body(times).as_quat()))

    def onboard(self) -> PushbroomModel:
        """With the attitude made on board."""
        times = np.asarray(self.scene.onboard.curve.knots_s)
        quat = self.scene.onboard.rotation(times).as_quat()
        return self.model(self.earth_fixed(times, quat, "slerp"))

    def fused(self) -> tuple[PushbroomModel, FloatArray]:
        """With stars and the angular-displacement sensor smoothed; its sigmas (3,), rad."""
        scene = self.scene
        noise = scene.options.sensor_noise
        estimate = rts(scene.star, scene.sensor, FusionSettings(noise), scene.mounting)
        reach = self.half_s * 1.1 + 0.05
        keep = np.abs(estimate.times_s) <= reach
        model = self.model(
            self.earth_fixed(estimate.times_s[keep], np.array(estimate.quat_xyzw[keep]))
        )
        return model, np.asarray(estimate.sigma_rad[keep].mean(axis=0))
