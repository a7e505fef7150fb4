"""The relative bias of a stereo run, removed: ties say how much, the models take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.dense import mutual_shifts_px
from geoposition.error_budget.influence import ARCSEC_RAD
from geoposition.observations import TiePoints
from geoposition.sensor_model import SensorModel
from geoposition.triangulate import IntersectedPoints
from geoposition.triangulate.mend import mended


@dataclass(frozen=True, slots=True, eq=False)
class Removal:
    """Models that agree with the first one, and by what they were changed.

    `shift_px` (models, 2) is how their image points were moved; `turn_rad` by model (3,) the
    turn about the body axes, None for an RPC and for a model left alone.
    """

    models: tuple[SensorModel, ...]
    shift_px: FloatArray
    turn_rad: tuple[FloatArray | None, ...]

    def as_dicts(self) -> list[dict[str, object]]:
        """Return the changes by product, fit for JSON."""
        return [
            {
                "product": k,
                "shift_px": shift.tolist(),
                "attitude_arcsec": None if turn is None else (turn / ARCSEC_RAD).tolist(),
            }
            for k, (shift, turn) in enumerate(zip(self.shift_px, self.turn_rad, strict=True))
        ]


def remove_bias(
    models: Sequence[SensorModel], ties: TiePoints, points: IntersectedPoints
) -> Removal:
    """Make all models agree with the first one; `points` are the ties intersected as they are."""
    shifts = mutual_shifts_px(models, ties)
    height = points.geodetic[points.point, 2]
    middle = float(np.nanmedian(height)) if np.isfinite(height).any() else 0.0
    height = np.where(np.isfinite(height), height, middle)
    changed = []
    for k, model in enumerate(models):
        rows = ties.of_product(k)
        rows = rows[np.isfinite(ties.image_px[rows]).all(axis=1)]
        changed.append(mended(model, shifts[k], ties.image_px[rows], height[rows]))
    return Removal(
        tuple(change.model for change in changed),
        shifts,
        tuple(change.turn_rad for change in changed),
    )
