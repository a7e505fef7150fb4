"""A model whose image points are moved by a constant: how a relative bias is taken out.

For an RPC that is a change of its offsets. For a rigorous model it is, over a narrow field of
view, a constant turn of the attitude, told in pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components
from geoposition.errors import ArgumentError
from geoposition.flags import has_result
from geoposition.observations import TiePoints
from geoposition.rays import Rays
from geoposition.sensor_model import GroundPoints, ImagePoints, SensorModel
from geoposition.triangulate import relative_bias, triangulate

_FEWEST: int = 20


@dataclass(frozen=True, slots=True, eq=False)
class ShiftedModel:
    """`model` with its image points moved by `shift_px` (2,) = (line, sample); a `SensorModel`."""

    model: SensorModel
    shift_px: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (lines, samples)."""
        return self.model.shape

    @property
    def height_range_m(self) -> tuple[float, float]:
        """Ellipsoidal heights the model is meant for, lowest and highest."""
        return self.model.height_range_m

    def image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> GroundPoints:
        """Locate `image_px` (..., 2) at ellipsoidal `height_m` (...)."""
        return self.model.image_to_ground(self._own(image_px), height_m)

    def ground_to_image(self, geodetic: ArrayLike) -> ImagePoints:
        """Project `geodetic` (..., 3) = (lon_rad, lat_rad, height_m)."""
        seen = self.model.ground_to_image(geodetic)
        return ImagePoints(seen.image_px + self.shift_px, seen.flag)

    def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
        """Lines of sight of `image_px` (..., 2), exact at `height_m` (...)."""
        return self.model.rays(self._own(image_px), height_m)

    def _own(self, image_px: ArrayLike) -> FloatArray:
        return as_components(image_px, 2, "image_px") - self.shift_px


def mutual_shifts_px(models: Sequence[SensorModel], ties: TiePoints) -> FloatArray:
    """Shifts (models, 2) that make all models agree with the first one, from tie points.

    Of the second image only what lies across its epipolar lines shows; along them it cannot be
    told from height. A further image is compared with the points that those before it give, so
    that both its components show. Medians, deaf to blunders. An image without ties to the first
    is an `ArgumentError`.
    """
    ties.require_products(len(models))
    shifts = np.zeros((len(models), 2))
    for k in range(1, len(models)):
        shifts[k] = _against_earlier(models, ties, shifts, k)
    return shifts


def shifted_models(models: Sequence[SensorModel], shifts_px: FloatArray) -> list[SensorModel]:
    """Return the models moved by `shifts_px` (models, 2); one that does not move as it is."""
    return [
        ShiftedModel(model, shift) if np.any(shift) else model
        for model, shift in zip(models, shifts_px, strict=True)
    ]


def _against_earlier(
    models: Sequence[SensorModel], ties: TiePoints, shifts_px: FloatArray, k: int
) -> FloatArray:
    if k > 1:
        mended = shifted_models(models[:k], shifts_px[:k])
        earlier = triangulate(mended, ties.selected(ties.product < k))
        rows = ties.of_product(k)
        _, mine, theirs = np.intersect1d(ties.ids[rows], earlier.ids, return_indices=True)
        good = has_result(earlier.flag[theirs])
        rows, theirs = rows[mine[good]], theirs[good]
        seen = models[k].ground_to_image(earlier.geodetic[theirs])
        off = (ties.image_px[rows] - seen.image_px)[has_result(seen.flag)]
        if len(off) >= _FEWEST:
            return np.asarray(np.median(off, axis=0), dtype=np.float64)
    both = ties.selected((ties.product == 0) | (ties.product == k))
    pair = TiePoints(both.ids, np.where(both.product == k, 1, 0), both.image_px)
    found = relative_bias(pair, triangulate([models[0], models[k]], pair))
    if len(found) < 2 or found[1].count == 0:
        raise ArgumentError(f"ties: image {k} has none with the first one")
    return found[1].bias_px
