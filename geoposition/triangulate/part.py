"""What a solution works on: some points' observations, the models' scales, the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.error_budget.model_error import ModelError
from geoposition.observations import TiePoints
from geoposition.sensor_model import SensorModel
from geoposition.triangulate.scale import SCALE_SHAPE, TERMS, error_field, image_scale
from geoposition.triangulate.start import HeightStart, height_start


@dataclass(frozen=True, slots=True, eq=False)
class PartResult:
    """What `IntersectedPoints` holds, for some points; observations in the part's order."""

    geodetic: FloatArray
    covariance_enu_m2: FloatArray
    residual_px: FloatArray
    rays: IntArray
    convergence_rad: FloatArray
    flag: FlagArray
    image_residual_px: FloatArray
    redundancy: FloatArray
    systematic_enu_m2: FloatArray


@dataclass(frozen=True, slots=True)
class Scene:
    """The models, their image scales, and the height cubics of the pairs met so far.

    `errors` (models, TERMS, 3) are the `error_field`s of the models' own errors, if any.
    """

    models: tuple[SensorModel, ...]
    fields: FloatArray
    min_convergence_rad: float
    errors: FloatArray | None = None
    starts: dict[tuple[int, int], HeightStart | None] = field(default_factory=dict)

    def start_of(self, first: int, second: int) -> HeightStart | None:
        """Return the height cubic of two models, fitted when first asked for."""
        if (first, second) not in self.starts:
            fitted = height_start(self.models[first], self.models[second])
            self.starts[first, second] = fitted
        return self.starts[first, second]


@dataclass(frozen=True, slots=True)
class Part:
    """Observations of some points, by point; `root` (1 or observations, 2, 2) is L⁻¹."""

    start: IntArray
    product: IntArray
    image_px: FloatArray
    root: FloatArray

    @property
    def root_step(self) -> int:
        """0 where one `root` serves all observations, else 1."""
        return 0 if len(self.root) == 1 else 1

    @property
    def point(self) -> IntArray:
        """Point of each observation."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    def of_points(self, points: IntArray) -> tuple[Part, IntArray]:
        """Return the part with `points` alone, and its observations' rows in this one."""
        counts = np.diff(self.start)[points]
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        rows = np.repeat(self.start[points] - start[:-1], counts) + np.arange(start[-1])
        root = self.root if self.root_step == 0 else self.root[rows]
        return Part(start, self.product[rows], self.image_px[rows], root), rows


def image_scales(models: Sequence[SensorModel], ties: TiePoints) -> FloatArray:
    """Image scales (models, 2 + TERMS, 6) of the models that were used at all."""
    fields = np.zeros((len(models), *SCALE_SHAPE))
    for k in np.unique(ties.product):
        fields[k] = image_scale(models[int(k)])
    return fields


def error_fields(
    models: Sequence[SensorModel], errors: Sequence[ModelError | None], fields: FloatArray
) -> FloatArray | None:
    """Error fields (models, TERMS, 3) of the models in use; None where no error is stated."""
    stated = [
        (k, error)
        for k, error in enumerate(errors)
        if error is not None and not error.nothing and np.any(fields[k])
    ]
    if not stated:
        return None
    out = np.zeros((len(models), TERMS, 3))
    for k, error in stated:
        out[k] = error_field(models[k], error, fields[k])
    return out


def inverse_roots(covariance_px2: FloatArray) -> FloatArray:
    """L⁻¹ (n, 2, 2) of covariances L Lᵀ."""
    inverse = np.linalg.inv(np.linalg.cholesky(covariance_px2))
    return np.ascontiguousarray(inverse, dtype=np.float64)
