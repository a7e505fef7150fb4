"""Stereo input that makes no sense, told before anything is written: swapped, mixed up, empty."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np

from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.observations import TiePoints
from geoposition.product import Product
from geoposition.scripts.point_tables import flag_counts
from geoposition.triangulate import IntersectedPoints, triangulate

_ABSURD_PX: Final = 300.0
"""No orbit is so wrong; ties with such residuals belong to other products."""
_ABSURD_M: Final = 1000.0
"""Nor does ground lie so far off the heights that the models are made for."""
_SUSPECT_PX: Final = 5.0
_BETTER: Final = 0.25
"""Exchanged images must leave less than this part of the residual to be called swapped."""
_MOST_TIES: Final = 2000


def require_sense(
    products: Sequence[Product],
    ties: TiePoints,
    points: IntersectedPoints,
    min_convergence_rad: float,
) -> None:
    """Refuse ties without any point, and ties that belong to other products.

    `points` are the ties intersected as they are. Images given in the wrong order intersect as
    well, only worse than in the right one.
    """
    found = has_result(points.flag)
    residual = float(np.nanmedian(points.residual_px)) if found.any() else np.inf
    if residual > _SUSPECT_PX:
        _require_order(products, ties, residual, min_convergence_rad)
    if not found.any():
        reasons = ", ".join(f"{n} {name}" for name, n in flag_counts(points.flag).items())
        raise GeometryError(f"intersect: no point has a result ({reasons})")
    if residual > _ABSURD_PX:
        raise GeometryError(
            f"intersect: the image points miss the models by {residual:.0f} px (median): "
            "are these the products of the ties?"
        )
    ranges = [product.model.height_range_m for product in products]
    low, high = max(low for low, _ in ranges), min(high for _, high in ranges)
    height = float(np.nanmedian(points.geodetic[:, 2]))
    if low < high and not low - _ABSURD_M <= height <= high + _ABSURD_M:
        raise GeometryError(
            f"intersect: the points lie at {height:.0f} m (median), the models are made for "
            f"{low:.0f} .. {high:.0f} m: are these the products of the ties?"
        )


def _require_order(
    products: Sequence[Product],
    ties: TiePoints,
    residual_px: float,
    min_convergence_rad: float,
) -> None:
    """Refuse ties that fit far better with two products exchanged."""
    models = [product.model for product in products]
    points = np.unique(ties.ids)
    some = np.isin(ties.ids, points[:: max(1, len(points) // _MOST_TIES)])
    ties = ties.selected(some)
    for i, j in combinations(range(len(models)), 2):
        order = np.arange(len(models))
        order[[i, j]] = j, i
        exchanged = TiePoints(ties.ids, order[ties.product], ties.image_px, ties.covariance_px2)
        found = triangulate(models, exchanged, min_convergence_rad=min_convergence_rad)
        good = has_result(found.flag)
        if 2 * good.sum() < len(found.ids):
            continue
        instead = float(np.median(found.residual_px[good]))
        if instead < _BETTER * residual_px:
            before = "no point" if np.isinf(residual_px) else f"{residual_px:.1f} px"
            raise GeometryError(
                f"intersect: {products[i].path.name} and {products[j].path.name} seem swapped: "
                f"exchanged, their image points agree to {instead:.1f} px (median), "
                f"as given to {before}"
            )
