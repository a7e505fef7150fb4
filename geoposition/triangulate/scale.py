"""How image points move with the ground, over a whole image: the weights of an intersection.

d(line, sample)/d(ground, ECEF) of a model, from its own lines of sight on a grid: with a, b the
movements on the ground per line and per sample at constant height and u the line of sight, it is
the first two rows of (a b u)⁻¹, so that movements along the line of sight do not show. Over an
image it varies slowly: a quadratic in (line, sample, height) follows it closely, far better
than a weight needs.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.sensor_model import SensorModel

_GRID: Final = 9
_HEIGHTS: Final = 3
_STEP_PX: Final = 2.0
_LEAST_RANGE_M: Final = 200.0
TERMS: Final = 10
"""Terms of the quadratic: 1, l, s, h, l², s², h², l s, l h, s h."""
SCALE_SHAPE: Final = (2 + TERMS, 6)
"""Shape of the packed coefficients."""


def image_scale(model: SensorModel) -> FloatArray:
    """Coefficients of the field, packed (2 + TERMS, 6).

    Row 0 holds the centre (line, sample, height) and 1 / extent that normalise, row 1 is
    unused; the rest are the terms' coefficients of the matrix (2, 3), row by row, px/m.
    `GeometryError` where the model sees no ground.
    """
    lines, samples = model.shape
    low, high = model.height_range_m
    low, high = (
        min(low, 0.5 * (low + high - _LEAST_RANGE_M)),
        max(high, 0.5 * (low + high + _LEAST_RANGE_M)),
    )
    mesh = np.meshgrid(
        np.linspace(0.0, lines - 1.0, _GRID),
        np.linspace(0.0, samples - 1.0, _GRID),
        np.linspace(low, high, _HEIGHTS),
        indexing="ij",
    )
    place = np.stack(mesh, axis=-1).reshape(-1, 3)
    jacobian, good = _jacobian(model, place[:, :2], place[:, 2])
    if good.sum() < 2 * TERMS:
        raise GeometryError("image scale: the model sees no ground over most of its image")
    centre = np.array([0.5 * (lines - 1), 0.5 * (samples - 1), 0.5 * (low + high)])
    extent = np.array([max(0.5 * lines, 1.0), max(0.5 * samples, 1.0), 0.5 * (high - low)])
    terms = quadratic_terms((place[good] - centre) / extent)
    packed = np.zeros(SCALE_SHAPE)
    packed[0] = np.concatenate([centre, 1.0 / extent])
    packed[2:] = np.linalg.lstsq(terms, jacobian[good].reshape(-1, 6), rcond=1e-12)[0]
    return packed


def quadratic_terms(p: FloatArray) -> FloatArray:
    """Monomials (..., 10) of a quadratic in p (..., 3), in the kernel's order."""
    a, b, c = p[..., 0], p[..., 1], p[..., 2]
    terms = [np.ones_like(a), a, b, c, a * a, b * b, c * c, a * b, a * c, b * c]
    return np.stack(terms, axis=-1)


def _jacobian(
    model: SensorModel, image_px: FloatArray, height_m: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """d(line, sample)/d(ECEF) (n, 2, 3), and where it was found (n,)."""
    sides = np.array([[_STEP_PX, 0.0], [-_STEP_PX, 0.0], [0.0, _STEP_PX], [0.0, -_STEP_PX]])
    around = model.image_to_ground(image_px[:, None] + sides, height_m[:, None])
    sight = model.rays(image_px, height_m)
    good = has_result(around.flag).all(axis=1) & has_result(sight.flag)
    ground = geodetic_to_ecef(np.where(good[:, None, None], around.geodetic, 0.0))
    columns = np.empty((len(image_px), 3, 3))
    columns[:, :, 0] = (ground[:, 0] - ground[:, 1]) / (2.0 * _STEP_PX)
    columns[:, :, 1] = (ground[:, 2] - ground[:, 3]) / (2.0 * _STEP_PX)
    columns[:, :, 2] = sight.direction_ecef
    # Where anything is missing a harmless matrix stands in; a flat one is no answer either.
    columns[~good] = np.eye(3)
    columns[:, :, 2] *= np.linalg.norm(columns[:, :, 0], axis=1, keepdims=True)
    good &= np.abs(np.linalg.det(columns)) > 1e-9 * np.abs(columns).max(axis=(1, 2)) ** 3
    columns[~good] = np.eye(3)
    inverse = np.linalg.inv(columns)
    return np.asarray(inverse[:, :2], dtype=np.float64), good
