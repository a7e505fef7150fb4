"""What ties say of images before they are matched densely: relative bias, and whose they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.dense import mutual_shifts_px, shifted_models
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.observations import TiePoints
from geoposition.product import Product
from geoposition.sensor_model import SensorModel
from geoposition.triangulate import triangulate

_SWAPPED: Final = 3.0
"""So many times smaller residuals, with and without the bias, are no accident."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """What ties say: the shifts that make the models agree, and the ties' ground points."""

    shifts_px: FloatArray
    residual_px: tuple[float, float]
    first_px: FloatArray
    geodetic: FloatArray


def agree(models: Sequence[SensorModel], ties: TiePoints) -> Agreement:
    """Find the relative bias of the models and the ties' ground points without it."""
    shifts = mutual_shifts_px(models, ties)
    as_is = triangulate(models, ties)
    mended = triangulate(shifted_models(models, shifts), ties)
    good = has_result(mended.flag)
    if not good.any():
        raise GeometryError("dsm: no tie point of the images can be intersected")
    medians = tuple(float(np.nanmedian(points.residual_px)) for points in (as_is, mended))
    rows = ties.of_product(0)
    _, mine, theirs = np.intersect1d(ties.ids[rows], mended.ids[good], return_indices=True)
    return Agreement(
        shifts,
        (medians[0], medians[1]),
        np.array(ties.image_px[rows[mine]]),
        mended.geodetic[good][theirs],
    )


def require_own_images(
    products: Sequence[Product],
    models: Sequence[SensorModel],
    ties: TiePoints,
    agreement: Agreement,
) -> None:
    """Refuse a pair whose images suit each other's models clearly better than their own."""
    if len(models) != 2:
        return
    other = agree(models[::-1], ties).residual_px
    if all(_SWAPPED * a < b for a, b in zip(other, agreement.residual_px, strict=True)):
        raise GeometryError(
            f"{products[0].path.name} and {products[1].path.name}: the images are swapped, each "
            f"suits the other's model ({other[0]:.1f} px apart instead of "
            f"{agreement.residual_px[0]:.1f})"
        )
