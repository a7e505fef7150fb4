"""By how much models disagree: the constant image errors that intersections reveal.

The intersection spreads a disagreement over the images: what an error b of one image leaves in
its own residuals is R b, R the mean redundancy of its observations. Of two images only the
component across the epipolar lines shows, half of it in each when they weigh alike; the
component along them moves the ground points instead, and no residual tells of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.observations import TiePoints
from geoposition.triangulate.points import IntersectedPoints

_NMAD: Final = 1.4826
_MEDIAN_VARIANCE: Final = np.pi / 2.0
"""Variance of a median over that of a mean, for normal errors."""
_UNSEEN: Final = 0.05
"""Directions in which less than this of an error shows count as not observable."""


@dataclass(frozen=True, slots=True, eq=False)
class RelativeBias:
    """Constant (line, sample) error of one image against the others, in pixels.

    `residual_px` (2,) is the median image residual, observed − projected, of the common
    least-squares points, `residual_sigma_px` (2,) its standard error. `bias_px` (2,) is the
    whole disagreement if this image alone is to blame: taken from its observations it makes the
    rays meet; `bias_sigma_px` (2,). `observable` (k, 2) are the unit directions that show at
    all, one for a pair; `bias_px` has nothing along others. `noise_px` is the standard deviation
    of the image points that the scatter of the residuals implies. `count` observations; NaN
    where there are none.
    """

    product: int
    residual_px: FloatArray
    residual_sigma_px: FloatArray
    bias_px: FloatArray
    bias_sigma_px: FloatArray
    observable: FloatArray
    noise_px: float
    count: int


def relative_bias(ties: TiePoints, points: IntersectedPoints) -> tuple[RelativeBias, ...]:
    """Estimate the bias of each product of `ties`, from its triangulation `points`.

    Robust: medians of the residuals, NMADs for their scatter. A `BLUNDER` does not count.
    """
    return tuple(_bias_of(int(k), ties, points) for k in np.unique(ties.product))


def _bias_of(product: int, ties: TiePoints, points: IntersectedPoints) -> RelativeBias:
    rows = ties.of_product(product)
    rows = rows[
        np.isfinite(points.image_residual_px[rows, 0])
        & np.isfinite(points.geodetic[points.point[rows], 0])
    ]
    n = len(rows)
    if n == 0:
        nothing = np.full(2, np.nan)
        return RelativeBias(
            product, nothing, nothing, nothing, nothing, np.empty((0, 2)), float("nan"), 0
        )
    residual = points.image_residual_px[rows]
    middle = np.median(residual, axis=0)
    redundancy = np.mean(points.redundancy[rows], axis=0)
    left, shown, right = np.linalg.svd(redundancy)
    seen = shown > _UNSEEN
    # Residuals scatter along the directions that show; there the NMAD is a standard deviation.
    along = (residual - middle) @ left
    scatter = _NMAD * np.median(np.abs(along - np.median(along, axis=0)), axis=0)
    error = np.sqrt(_MEDIAN_VARIANCE / n) * scatter
    inverse = np.where(seen, 1.0 / np.where(seen, shown, 1.0), 0.0)
    bias = right.T @ (inverse * (left.T @ middle))
    noise = scatter[seen] / np.sqrt(shown[seen])
    return RelativeBias(
        product=product,
        residual_px=middle,
        residual_sigma_px=np.sqrt(left**2 @ error**2),
        bias_px=bias,
        bias_sigma_px=np.sqrt(right.T**2 @ (inverse * error) ** 2),
        observable=right[seen] * np.sign(right[seen].sum(axis=1, keepdims=True)),
        noise_px=float(np.sqrt(np.mean(noise**2))) if seen.any() else float("nan"),
        count=n,
    )
