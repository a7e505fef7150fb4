"""Where control would help most, before anyone goes to the field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geoposition.adjust import Block, best_layout
from geoposition.arrays import FloatArray
from geoposition.errors import ProductError
from geoposition.flags import has_result
from geoposition.scripts.adjust.request import PlanInput, RunInput
from geoposition.scripts.control_files import Heights, geodetic_of, read_control_file
from geoposition.sensor_model import SensorModel

_CHECK_SIDE = 11
_MARGIN = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Chosen points (n, 3), and the expected error in space (n), metres, after each of them."""

    candidates: int
    geodetic: FloatArray
    expected_rmse_m: FloatArray

    def as_dict(self) -> dict[str, object]:
        """Return the points in the order in which they help."""
        return {
            "candidates": self.candidates,
            "points": [
                {
                    "lon": float(np.degrees(place[0])),
                    "lat": float(np.degrees(place[1])),
                    "height": float(place[2]),
                    "expected_rmse_m": float(error),
                }
                for place, error in zip(self.geodetic, self.expected_rmse_m, strict=True)
            ],
        }


def planned(run: RunInput, models: tuple[SensorModel, ...], blocks: tuple[Block, ...]) -> Layout:
    """Choose points from a file, or from a grid over the ground that all images show."""
    plan = run.plan
    assert plan is not None
    ground = _common_ground(models, plan, _CHECK_SIDE)
    if isinstance(plan.candidates, int):
        candidates = _common_ground(models, plan, int(np.ceil(np.sqrt(plan.candidates))))
    else:
        table = read_control_file(plan.candidates).ground
        if table is None:
            raise ProductError(plan.candidates, "header", "columns id, lon, lat, height expected")
        candidates = geodetic_of(table, Heights())
        seen = np.all([has_result(m.ground_to_image(candidates).flag) for m in models], axis=0)
        candidates = candidates[seen]
    if len(candidates) < plan.count or len(ground) < 1:
        raise ProductError(
            run.path, "[plan] count",
            f"{plan.count} candidates that all images show expected, there are {len(candidates)}",
        )  # fmt: skip
    chosen, expected = best_layout(
        models, blocks, candidates, ground, plan.count,
        sigma_enu_m=np.array(plan.sigma_m), sigma_px=plan.image_sigma_px,
    )  # fmt: skip
    return Layout(len(candidates), candidates[chosen], expected)


def _common_ground(models: tuple[SensorModel, ...], plan: PlanInput, side: int) -> FloatArray:
    """Even points of the first image that all others show too."""
    first = models[0]
    low, high = first.height_range_m
    height = 0.5 * (low + high) if plan.height_m is None else plan.height_m
    share = np.linspace(_MARGIN, 1.0 - _MARGIN, side)
    lines, samples = first.shape
    mesh = np.meshgrid(share * (lines - 1.0), share * (samples - 1.0), indexing="ij")
    ground = first.image_to_ground(np.stack(mesh, axis=-1).reshape(-1, 2), height)
    seen = has_result(ground.flag)
    for model in models[1:]:
        seen &= np.asarray(model.ground_to_image(ground.geodetic).flag == 0)
    return ground.geodetic[seen]
