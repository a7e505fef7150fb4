"""What observations of one image need of its model: lines of sight, scales, frames, times.

Computed once, with the model as it came; the corrections of the unknowns then turn and move the
lines of sight in closed form (`residuals`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geoposition.adjust.scale_field import ScaleField
from geoposition.arrays import FlagArray, FloatArray
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel
from geoposition.timescale import Epoch

_FRAMES = 513


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """The body's axes over the lines of a rigorous model, and what else is the image's own.

    `R_ecef_body` (g, 3, 3) at even lines from `first_line`, `step_lines` apart; between them the
    matrices are interpolated linearly, wrong by some 1e-9 rad, which only turns the axes of small
    corrections. `R_body_camera` (3, 3).
    """

    first_line: float
    step_lines: float
    R_ecef_body: FloatArray
    R_body_camera: FloatArray

    @classmethod
    def of(cls, model: SensorModel) -> Frames:
        """Return the frames of a rigorous model; of any other, placeholders."""
        if not isinstance(model, PushbroomModel):
            return cls(0.0, 1.0, np.repeat(np.eye(3)[None], 2, axis=0), np.eye(3))
        first, last = model.covered_lines
        lines = np.linspace(first, last, _FRAMES)
        timing, attitude = model.camera.timing, model.attitude
        times = timing.time_s(lines) + (timing.epoch - attitude.epoch)
        turns = attitude.rotation(np.clip(times, *attitude.span_s)).as_matrix()
        mounting = np.ascontiguousarray(model.camera.R_body_camera.as_matrix())
        return cls(first, float(lines[1] - lines[0]), np.ascontiguousarray(turns), mounting)


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Observations (n) of one image: `image_px` (n, 2), their lines of sight, their scale.

    `origin_ecef_m`, `direction_ecef` (n, 3), exact near the heights they were made for; `scale`
    (n, 2, 3) pixels per metre on the ground, d(line, sample)/d(ECEF); `flag` (n,).
    """

    image_px: FloatArray
    origin_ecef_m: FloatArray
    direction_ecef: FloatArray
    scale: FloatArray
    flag: FlagArray

    @classmethod
    def of(
        cls, model: SensorModel, field: ScaleField, image_px: FloatArray, height_m: FloatArray
    ) -> Sights:
        """Lines of sight of `image_px` (n, 2) for ground near `height_m` (n,)."""
        rays = model.rays(image_px, height_m)
        scale = field.at(image_px, height_m)
        return cls(
            np.ascontiguousarray(image_px),
            rays.origin_ecef_m,
            rays.direction_ecef,
            np.ascontiguousarray(scale),
            rays.flag,
        )


def line_times_s(model: SensorModel, lines: FloatArray, epoch: Epoch) -> FloatArray:
    """Seconds from `epoch` at which `lines` (n,) of a rigorous model were taken."""
    assert isinstance(model, PushbroomModel)
    timing = model.camera.timing
    result: FloatArray = timing.time_s(lines) + (timing.epoch - epoch)
    return result
