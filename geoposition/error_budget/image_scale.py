"""How ground and image move with each other, of any model: metres a pixel, and pixels a metre."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.flags import has_result
from geoposition.sensor_model import SensorModel

_STEP_PX: Final = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class ImageScale:
    """Movements at image points (n), in ECEF.

    `ground_per_px` (n, 3, 2) is how the ground point moves per line and per sample at constant
    height, metres; `image_per_m` (n, 2, 3) d(line, sample)/d(ground), which is blind along the
    line of sight. `direction_ecef` (n, 3) of the line of sight. Where `good` (n,) is false the
    numbers mean nothing.
    """

    ground_per_px: FloatArray
    image_per_m: FloatArray
    direction_ecef: FloatArray
    good: BoolArray


def image_scale_at(model: SensorModel, image_px: FloatArray, height_m: FloatArray) -> ImageScale:
    """Scale of `model` at `image_px` (n, 2) and ellipsoidal `height_m` (n,).

    With a, b the ground's movements per line and per sample and u the line of sight, pixels per
    metre are the first two rows of (a b u)⁻¹. Central differences over two pixels.
    """
    sides = np.array([[_STEP_PX, 0.0], [-_STEP_PX, 0.0], [0.0, _STEP_PX], [0.0, -_STEP_PX]])
    around = model.image_to_ground(image_px[:, None] + sides, height_m[:, None])
    sight = model.rays(image_px, height_m)
    good = has_result(around.flag).all(axis=1) & has_result(sight.flag)
    ground = geodetic_to_ecef(np.where(good[:, None, None], around.geodetic, 0.0))
    columns = np.empty((len(image_px), 3, 3))
    columns[:, :, 0] = (ground[:, 0] - ground[:, 1]) / (2.0 * _STEP_PX)
    columns[:, :, 1] = (ground[:, 2] - ground[:, 3]) / (2.0 * _STEP_PX)
    columns[:, :, 2] = sight.direction_ecef
    per_px = columns[:, :, :2].copy()
    # Where anything is missing a harmless matrix stands in; a flat one is no answer either.
    columns[~good] = np.eye(3)
    columns[:, :, 2] *= np.linalg.norm(columns[:, :, 0], axis=1, keepdims=True)
    good &= np.abs(np.linalg.det(columns)) > 1e-9 * np.abs(columns).max(axis=(1, 2)) ** 3
    columns[~good] = np.eye(3)
    inverse = np.asarray(np.linalg.inv(columns)[:, :2], dtype=np.float64)
    return ImageScale(per_px, inverse, sight.direction_ecef, good)
