"""Pixels per metre over an image: d(line, sample)/d(ECEF), a quadratic in line, sample, height.

As `triangulate.scale`, which weights intersections; but here residuals are measured with it, so
no difference may be taken across the seam of two CCDs, where lines jump by some pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.adjust.residual_kernels import scale_matrices
from geoposition.arrays import FloatArray, IntArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.sensor_model import SensorModel
from geoposition.triangulate.scale import clear_samples, quadratic_terms

_LINES: Final = 17
_SAMPLES: Final = 9
_HEIGHTS: Final = 3
_STEP_PX: Final = 2.0
_LEAST_RANGE_M: Final = 200.0


@dataclass(frozen=True, slots=True, eq=False)
class ScaleField:
    """`coefficients` (10, 6) of the matrix, row by row, over (place − `centre`) / `extent`."""

    centre: FloatArray
    extent: FloatArray
    coefficients: FloatArray

    @classmethod
    def of(cls, model: SensorModel) -> ScaleField:
        """Fit the field; `GeometryError` where the model sees no ground."""
        low, high = model.height_range_m
        middle, half = 0.5 * (low + high), max(0.5 * (high - low), 0.5 * _LEAST_RANGE_M)
        lines, samples = model.shape
        mesh = np.meshgrid(
            np.linspace(0.0, lines - 1.0, _LINES),
            clear_samples(model, _SAMPLES),
            np.linspace(middle - half, middle + half, _HEIGHTS),
            indexing="ij",
        )
        place = np.stack(mesh, axis=-1).reshape(-1, 3)
        sides = np.array([[_STEP_PX, 0.0], [-_STEP_PX, 0.0], [0.0, _STEP_PX], [0.0, -_STEP_PX]])
        around = model.image_to_ground(place[:, None, :2] + sides, place[:, None, 2])
        sight = model.rays(place[:, :2], place[:, 2])
        good = has_result(around.flag).all(axis=1) & has_result(sight.flag)
        if good.sum() < 30:
            raise GeometryError("image scale: the model sees no ground over most of its image")
        ground = geodetic_to_ecef(around.geodetic[good])
        columns = np.empty((int(good.sum()), 3, 3))
        columns[:, :, 0] = (ground[:, 0] - ground[:, 1]) / (2.0 * _STEP_PX)
        columns[:, :, 1] = (ground[:, 2] - ground[:, 3]) / (2.0 * _STEP_PX)
        columns[:, :, 2] = sight.direction_ecef[good]
        jacobian = np.linalg.inv(columns)[:, :2].reshape(-1, 6)
        centre = np.array([0.5 * (lines - 1), 0.5 * (samples - 1), middle])
        extent = np.array([max(0.5 * lines, 1.0), max(0.5 * samples, 1.0), half])
        terms = quadratic_terms((place[good] - centre) / extent)
        coefficients = np.linalg.lstsq(terms, jacobian, rcond=1e-12)[0]
        return cls(centre, extent, coefficients)

    def at(self, image_px: FloatArray, height_m: FloatArray) -> FloatArray:
        """Matrices (n, 2, 3) at `image_px` (n, 2) and ground heights (n,)."""
        out = np.empty((len(image_px), 2, 3))
        scale_matrices(image_px, height_m, self.centre, 1.0 / self.extent, self.coefficients, out)
        return out


def scale_fields(models: Sequence[SensorModel], product: IntArray) -> dict[int, ScaleField]:
    """Return the fields of those `models` that have observations; `product` (n) numbers them."""
    return {int(image): ScaleField.of(models[int(image)]) for image in np.unique(product)}
