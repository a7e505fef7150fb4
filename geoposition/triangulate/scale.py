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

from geoposition.arrays import FloatArray
from geoposition.error_budget.image_scale import image_scale_at
from geoposition.error_budget.model_error import ModelError, image_error_covariance
from geoposition.errors import GeometryError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel

_GRID: Final = 9
_HEIGHTS: Final = 3
_LEAST_RANGE_M: Final = 200.0
CLEAR_PX: Final = 4.0
"""Twice the step of the differences."""
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
        clear_samples(model, _GRID),
        np.linspace(low, high, _HEIGHTS),
        indexing="ij",
    )
    place = np.stack(mesh, axis=-1).reshape(-1, 3)
    scale = image_scale_at(model, place[:, :2], place[:, 2])
    jacobian, good = scale.image_per_m, scale.good
    if good.sum() < 2 * TERMS:
        raise GeometryError("image scale: the model sees no ground over most of its image")
    centre = np.array([0.5 * (lines - 1), 0.5 * (samples - 1), 0.5 * (low + high)])
    extent = np.array([max(0.5 * lines, 1.0), max(0.5 * samples, 1.0), 0.5 * (high - low)])
    terms = quadratic_terms((place[good] - centre) / extent)
    packed = np.zeros(SCALE_SHAPE)
    packed[0] = np.concatenate([centre, 1.0 / extent])
    packed[2:] = np.linalg.lstsq(terms, jacobian[good].reshape(-1, 6), rcond=1e-12)[0]
    return packed


def clear_samples(model: SensorModel, count: int) -> FloatArray:
    """Choose `count` samples over the row, none so near a seam that differences would cross it.

    Lines jump by some pixels from one CCD to the next.
    """
    samples = np.linspace(0.0, model.shape[1] - 1.0, count)
    if isinstance(model, PushbroomModel):
        for detector in model.camera.detectors[1:]:
            seam = detector.first_sample - 0.5
            samples[np.abs(samples - seam) < CLEAR_PX] = seam + CLEAR_PX
    return samples


def quadratic_terms(p: FloatArray) -> FloatArray:
    """Monomials (..., 10) of a quadratic in p (..., 3), in the kernel's order."""
    a, b, c = p[..., 0], p[..., 1], p[..., 2]
    terms = [np.ones_like(a), a, b, c, a * a, b * b, c * c, a * b, a * c, b * c]
    return np.stack(terms, axis=-1)


def error_field(model: SensorModel, error: ModelError, packed: FloatArray) -> FloatArray:
    """Coefficients (TERMS, 3) of what `error` does to image points: px², of ll, ls, ss.

    Normalised as the model's image scale `packed`. See `error_budget.model_error`.
    """
    if error.nothing:
        return np.zeros((TERMS, 3))
    centre, extent = packed[0, :3], 1.0 / packed[0, 3:]
    mesh = np.meshgrid(*(c + e * np.linspace(-1, 1, n) for c, e, n in
                         zip(centre, extent, (_GRID, _GRID, _HEIGHTS), strict=True)),
                       indexing="ij")  # fmt: skip
    place = np.stack(mesh, axis=-1).reshape(-1, 3)
    covariance = image_error_covariance(model, error, place[:, :2], place[:, 2])
    values = covariance.reshape(-1, 4)[:, [0, 1, 3]]
    good = np.isfinite(values).all(axis=1)
    if good.sum() < 2 * TERMS:
        raise GeometryError("model error: the model sees no ground over most of its image")
    terms = quadratic_terms((place[good] - centre) / extent)
    found = np.linalg.lstsq(terms, values[good], rcond=1e-12)[0]
    return np.asarray(found, dtype=np.float64)


def field_covariance(
    field: FloatArray, packed: FloatArray, image_px: FloatArray, height_m: FloatArray
) -> FloatArray:
    """Covariances (n, 2, 2) of an `error_field` at image points (n, 2) and heights (n,)."""
    place = np.column_stack([image_px, height_m])
    ll, ls, ss = (quadratic_terms((place - packed[0, :3]) * packed[0, 3:]) @ field).T
    return np.stack([np.stack([ll, ls], axis=-1), np.stack([ls, ss], axis=-1)], axis=-2)
