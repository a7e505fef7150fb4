"""What an error of one image does to a point intersected from several.

The intersection is sum Jᵀ W J dP = sum Jᵀ W dx over the images. An error that moves the located
points of image k by dQ at constant height moves its image points by J_k dQ, hence the
intersected point by
    dP = (sum Jᵀ W J)⁻¹ J_kᵀ W_k J_k dQ .
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import BoolArray, FloatArray, as_components
from geoposition.error_budget.image_scale import image_scale_at
from geoposition.errors import ArgumentError
from geoposition.flags import has_result
from geoposition.sensor_model import SensorModel


def intersection_gains(
    models: Sequence[SensorModel],
    geodetic: ArrayLike,
    weights_per_px2: Sequence[FloatArray] | None = None,
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...], BoolArray]:
    """Gains (n, 3, 3) of `models` at ground points (n, 3): dP = gain_k dQ_k, ECEF both.

    With them pixels per metre J_k (n, 2, 3), and where all models see the point and their
    lines of sight meet well enough to solve (n,). `weights_per_px2` (2, 2) each; all equal
    if not given.
    """
    if len(models) < 2:
        raise ArgumentError("intersection: two or more models expected")
    points = as_components(geodetic, 3, "ground points").reshape(-1, 3)
    good = np.ones(len(points), dtype=np.bool_)
    scales, parts = [], []
    for k, model in enumerate(models):
        seen = model.ground_to_image(points)
        good &= has_result(seen.flag)
        scale = image_scale_at(model, np.nan_to_num(seen.image_px), points[:, 2])
        good &= scale.good
        weight = np.eye(2) if weights_per_px2 is None else np.asarray(weights_per_px2[k])
        scales.append(scale.image_per_m)
        parts.append(scale.image_per_m.transpose(0, 2, 1) @ weight @ scale.image_per_m)
    normal = np.sum(parts, axis=0)
    shown = np.linalg.eigvalsh(normal)
    good &= shown[:, 0] > 1e-9 * shown[:, 2]
    normal[~good] = np.eye(3)
    inverse = np.linalg.inv(normal)
    return tuple(inverse @ part for part in parts), tuple(scales), good
