"""A ZY-3 pass over Songshan: how the satellite really moves, and what its cameras truly see.

Orbit and cameras are ZY-3's as published. The body follows the ground track and shakes at
0.65 Hz by 4 arcsec about roll and pitch, what ZY-3 did in 2012. *Source*: T 2.4, T 5.3.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.ephemeris import Ephemeris
from geoposition.errors import GeometryError
from geoposition.flags import Flag
from geoposition.frames import R_itrs_body
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.jitter_scene import ZY3_LINE, JitterMotion
from geoposition.sensors.simulate import (
    ARCSEC_RAD,
    CameraDesign,
    SceneOptions,
    simulate_scene,
)
from geoposition.sensors.simulate_attitude import Pointing, Vibration
from geoposition.sensors.simulate_orbit import Orbit
from geoposition.sensors.simulate_telemetry import epochs_s, true_ephemeris
from geoposition.timescale import Epoch

EPOCH_UTC: Final = "2012-02-03T03:15:00Z"
"""The day of T's images."""
HALF_SPAN_S: Final = 150.0
"""Telemetry before and after the pass over the field's middle."""
HEIGHTS_M: Final = (300.0, 1500.0)
TRUTH_HZ: Final = 16.0

_DRIFT_ARCSEC: Final = 10.0
_DRIFT_PERIOD_S: Final = 180.0
_PAD_S: Final = 4.0
_EDGE_PX: Final = 400.0
_SEAM_PX: Final = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """True motion and true models by camera; times are seconds from `orbit.epoch`.

    `window_s` holds all images and what interpolation needs around them.
    """

    orbit: Orbit
    motion: JitterMotion
    ephemeris: Ephemeris
    models: Mapping[str, PushbroomModel]
    window_s: tuple[float, float]

    @property
    def epoch(self) -> Epoch:
        """Instant from which the times count."""
        return self.orbit.epoch

    def image_span_s(self, name: str) -> tuple[float, float]:
        """First and last line's time of one image."""
        model = self.models[name]
        low, high = np.sort(model.camera.timing.time_s(np.array([0.0, model.shape[0] - 1.0])))
        return float(low), float(high)

    def attitude(self, times_s: FloatArray, R_inertial_body: Rotation) -> Attitude:
        """Earth-fixed attitude, a spline through inertial ones at `times_s` within the window."""
        low, high = self.window_s
        kept = np.flatnonzero((times_s >= low) & (times_s <= high))
        times = times_s[kept]
        quats = R_itrs_body(R_inertial_body[kept], self.epoch, times).as_quat()
        return Attitude.from_samples(self.epoch, times, quats, "itrs", "spline")


def zy3_scene(cameras: Sequence[CameraDesign], seed: int) -> Scene:
    """Fly over Songshan; `seed` sets the phases of the motion."""
    still = SceneOptions(
        epoch_utc=EPOCH_UTC,
        height_range_m=HEIGHTS_M,
        jitter_arcsec=(0.0, 0.0, 0.0),
        drift_arcsec=0.0,
        star_noise_arcsec=(0.0, 0.0, 0.0),
        gps_sigma_m=0.0,
        mounting_bias_arcsec=0.0,
    )
    calm = simulate_scene(still, 0, tuple(cameras))
    orbit = calm.orbit
    rng = np.random.default_rng(seed)
    drift = Vibration(
        1.0 / _DRIFT_PERIOD_S,
        np.full(3, _DRIFT_ARCSEC * ARCSEC_RAD),
        rng.uniform(0.0, 2.0 * np.pi, 3),
    )
    jitter = Vibration(
        ZY3_LINE.frequency_hz,
        ARCSEC_RAD * np.array(ZY3_LINE.amplitude_arcsec),
        rng.uniform(0.0, 2.0 * np.pi, 3),
    )
    pointing = Pointing(yaw_steering=still.yaw_steering, vibrations=(drift,))
    motion = JitterMotion.of(orbit, pointing, (jitter,), (-HALF_SPAN_S, HALF_SPAN_S))
    ephemeris = true_ephemeris(orbit, epochs_s(-HALF_SPAN_S, HALF_SPAN_S, 1.0))
    scene = Scene(orbit, motion, ephemeris, calm.true, (0.0, 0.0))
    spans = np.array([scene.image_span_s(name) for name in calm.true])
    # The models answer for a margin around the image, of which 5 % is time.
    pad = _PAD_S + 0.05 * float(np.max(spans[:, 1] - spans[:, 0]))
    window = float(spans.min()) - pad, float(spans.max()) + pad
    scene = replace(scene, window_s=window)
    times = epochs_s(*window, TRUTH_HZ)[1:-1]
    truth = scene.attitude(times, motion.R_inertial_body(times))
    models = {
        name: replace(model, ephemeris=ephemeris, attitude=truth)
        for name, model in calm.true.items()
    }
    return replace(scene, models=models)


def common_ground(scene: Scene, count: int, rng: np.random.Generator) -> FloatArray:
    """Ground points (count, 3) that all images show, strewn over plan and heights.

    None lies on a seam between CCDs: who marks a point does so in the image of one CCD, while
    noise could move a simulated mark to the next one, some pixels ahead.
    """
    models = list(scene.models.values())
    edge = min(_EDGE_PX, 0.05 * min(models[0].shape))
    image = rng.uniform(edge, np.array(models[0].shape) - edge, (8 * count, 2))
    heights = rng.uniform(*HEIGHTS_M, len(image))
    ground = models[0].image_to_ground(image, heights).geodetic
    good = np.ones(len(ground), dtype=np.bool_)
    for model in models:
        found = model.ground_to_image(ground)
        seams = np.array([ccd.last_sample + 0.5 for ccd in model.camera.detectors])
        off = np.abs(found.image_px[:, 1, None] - seams).min(axis=1)
        good &= (found.flag == Flag.OK) & (off > _SEAM_PX)
    if good.sum() < count:
        raise GeometryError(f"scene: {count} points that all images show expected")
    return ground[good][:count]
