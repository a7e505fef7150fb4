"""How the rays of a `SensorModel` leave their straight lines, as a smooth function of place."""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.rays import Rays
from geoposition.sensor_model import SensorModel
from geoposition.terrain.extremes import finite_extremes
from geoposition.terrain.series import Bend
from geoposition.terrain.surfaces import level_crossings

_GRID: Final = 7
_HEIGHTS: Final = 4


def fit_bend(
    model: SensorModel, image_px: FloatArray, height_m: float, low_m: float, high_m: float
) -> Bend | None:
    """Fit the offset of `model`'s points from its straight rays of `height_m`.

    Over the box of `image_px` (n, 2), which is not kept, and heights `low_m` .. `high_m`; none
    where the model answers for too little of that. How well it fits is for the caller to check.
    """
    if not len(image_px):
        return None
    # points that the model does not answer for must not stretch the box
    margin = 0.05 * np.array(model.shape) + 1.0
    limit = np.array(model.shape) + margin
    corners = np.zeros((2, 2))
    for axis in range(2):
        lowest, highest, known = finite_extremes(image_px[:, axis])
        if known:
            corners[:, axis] = image_px[[lowest, highest], axis]
    low, high = np.clip(corners, -margin, limit)
    centre, scale = 0.5 * (low + high), 1.0 / np.maximum(0.5 * (high - low), 1.0)
    unit = np.linspace(-1.0, 1.0, _GRID)
    levels = np.linspace(low_m, high_m, _HEIGHTS)
    i, j, level = (part.reshape(-1) for part in np.meshgrid(unit, unit, levels, indexing="ij"))
    points = centre + np.stack([i, j], axis=-1) / scale
    there = geodetic_to_ecef(model.image_to_ground(points, level).geodetic)
    straight: Rays = model.rays(points, height_m)
    offset = there - straight.at(level_crossings(straight, level).range_m)
    known = np.all(np.isfinite(offset), axis=-1)
    if np.count_nonzero(known) < 0.7 * len(known):
        return None
    i, j, offset = i[known], j[known], offset[known]
    extent = max(high_m - height_m, height_m - low_m, 1.0)
    away = ((level - height_m) / extent)[known, None]
    terms = np.stack([i**0, i, j, i * i, i * j, j * j, i**3, i * i * j, i * j * j, j**3], axis=-1)
    matrix = np.concatenate([terms * away, terms * away**2], axis=1)
    solution = np.linalg.lstsq(matrix, offset, rcond=1e-10)[0].reshape(2, 10, 3)
    solution[0] /= extent
    solution[1] /= extent**2
    return Bend(np.zeros((0, 2)), np.ascontiguousarray(solution), centre, scale, height_m)
