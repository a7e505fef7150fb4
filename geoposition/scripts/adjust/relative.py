"""What adjusting did to the images beside each other: changes, and how rays miss each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.flags import Flag, has_result
from geoposition.observations import TiePoints
from geoposition.scripts.adjust.solve import RunResult
from geoposition.sensor_model import SensorModel
from geoposition.triangulate import triangulate
from geoposition.triangulate.bias import relative_bias

_GRID: Final = 9


def image_change_px(before: SensorModel, after: SensorModel) -> FloatArray:
    """Mean over the image of adjusted less given image point (2) of the same ground."""
    if before is after:
        return np.zeros(2)
    lines, samples = before.shape
    mesh = np.meshgrid(
        np.linspace(0.0, lines - 1.0, _GRID), np.linspace(0.0, samples - 1.0, _GRID), indexing="ij"
    )
    image = np.stack(mesh, axis=-1).reshape(-1, 2)
    ground = before.image_to_ground(image, 0.5 * sum(before.height_range_m))
    good = has_result(ground.flag)
    if not good.any():
        return np.full(2, np.nan)
    seen = after.ground_to_image(ground.geodetic[good]).image_px - image[good]
    return np.asarray(np.nanmean(seen, axis=0))


def relative_facts(result: RunResult) -> dict[str, object] | None:
    """How the rays of matches miss each other, with the models as they came and adjusted."""
    ties = result.points.ties
    if ties is None and result.points.control is not None:
        ties = result.points.control.image
    if ties is None or len(np.unique(ties.product)) < 2:
        return None
    done = result.adjustment
    return {
        "before": _disagreement(done.base_models, ties),
        "after": _disagreement(done.models, ties),
        "change_px": _relative_change(result),
    }


def _relative_change(result: RunResult) -> list[dict[str, object]]:
    """Return what adjustment did to each image beyond what it did to the first."""
    done = result.adjustment
    moved = [image_change_px(a.model, b) for a, b in zip(result.images, done.models, strict=True)]
    return [
        {"id": image.id, "row": float(m[0] - moved[0][0]), "col": float(m[1] - moved[0][1])}
        for image, m in zip(result.images, moved, strict=True)
    ]


def _disagreement(models: Sequence[SensorModel], ties: TiePoints) -> dict[str, object]:
    points = triangulate(models, ties, blunder_factor=np.inf)
    good = points.flag == Flag.OK
    if not good.any():
        return {"intersected": 0}
    residual = points.residual_px[good]
    return {
        "intersected": int(good.sum()),
        "residual_px": {
            "median": float(np.median(residual)), "p95": float(np.percentile(residual, 95)),
        },
        "bias_px": [
            {"product": b.product, "row": float(b.bias_px[0]), "col": float(b.bias_px[1])}
            for b in relative_bias(ties, points)
        ],
    }  # fmt: skip
