"""Control beside ground points: heights known from a DEM, and control split into roles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import BoolArray, FloatArray, IntArray, read_only
from geoposition.errors import ArgumentError
from geoposition.flags import has_result
from geoposition.observations import ControlPoints, Ids, TiePoints
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain
from geoposition.triangulate import triangulate


@dataclass(frozen=True, slots=True, eq=False)
class HeightControl:
    """Ellipsoidal heights (n) of tie points by id, with standard deviations; NaN where unknown."""

    ids: Ids
    height_m: FloatArray
    sigma_m: FloatArray

    def __post_init__(self) -> None:
        n = len(self.ids)
        height = read_only(self.height_m)
        sigma = read_only(np.broadcast_to(np.asarray(self.sigma_m, dtype=np.float64), (n,)))
        if height.shape != (n,):
            raise ArgumentError(f"heights: one per id expected, got {n} and {height.shape}")
        if np.any(sigma <= 0.0):
            raise ArgumentError("heights: positive standard deviations expected")
        object.__setattr__(self, "height_m", height)
        object.__setattr__(self, "sigma_m", sigma)

    def of_points(self, ids: Ids) -> tuple[FloatArray, FloatArray]:
        """Heights and sigmas of points `ids` (m); NaN for those without."""
        order = np.argsort(self.ids, kind="stable")
        mine = np.asarray(self.ids)[order]
        at = np.searchsorted(mine, ids)
        at[at == len(mine)] = 0
        found = mine[at] == ids if len(mine) else np.zeros(len(ids), dtype=bool)
        row = order[at] if len(mine) else np.zeros(len(ids), dtype=np.int64)
        nan = np.full(len(ids), np.nan)
        if not len(mine):
            return nan, nan
        return (
            np.where(found, self.height_m[row], np.nan),
            np.where(found, self.sigma_m[row], np.nan),
        )


def selected_control(control: ControlPoints, points: BoolArray | IntArray) -> ControlPoints:
    """Return the control points `points`, a mask or indices, with their measurements."""
    ids = control.ids[points]
    image = control.image
    if image is not None:
        image = image.selected(np.isin(image.ids, ids))
    return ControlPoints(ids, control.geodetic[points], control.covariance_enu_m2[points], image)


def split_control(
    control: ControlPoints, check_ids: Sequence[str | int] | ArrayLike
) -> tuple[ControlPoints, ControlPoints]:
    """Control and check points; an id that is not there is an `ArgumentError`."""
    wanted = np.asarray(list(check_ids), dtype=control.ids.dtype)  # type: ignore[arg-type]
    unknown = wanted[~np.isin(wanted, control.ids)]
    if len(unknown):
        raise ArgumentError(f"check points: no point {unknown[0]} among the control points")
    check = np.isin(control.ids, wanted)
    return selected_control(control, ~check), selected_control(control, check)


def terrain_heights(
    models: Sequence[SensorModel], ties: TiePoints, terrain: Terrain, sigma_m: float
) -> HeightControl:
    """Heights of `terrain` where the tie points intersect with `models` as they are.

    Where the models are off by much, so are the places: adjust, then ask again with the adjusted
    models, until the heights settle. Points without an intersection or terrain have none.
    """
    found = triangulate(models, ties, blunder_factor=np.inf)
    height = np.full(len(found.ids), np.nan)
    rows = np.flatnonzero(has_result(found.flag))
    if len(rows):
        heights = terrain.height_at(found.geodetic[rows])
        height[rows] = np.where(has_result(heights.flag), heights.height_m, np.nan)
    return HeightControl(found.ids, height, np.full(len(height), sigma_m))
