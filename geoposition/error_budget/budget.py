"""The error budget of one image and of an intersection: a unit of each error, on the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FloatArray
from geoposition.ellipsoid import enu_axes
from geoposition.error_budget.image_scale import image_scale_at
from geoposition.error_budget.influence import ARCSEC_RAD, influence
from geoposition.error_budget.pair import intersection_gains
from geoposition.errors import GeometryError
from geoposition.flags import Flag, has_result
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel

_GRID: Final = 5
_HEIGHTS: Final = 41
_INNER: Final = 0.02
"""Points of a budget keep this part of the image away from its edges."""
_ORBIT_AXES: Final = ("along track", "left", "up")


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """What one unit of an error does, in metres.

    `image` is the number of the image at fault; `enu_m` the movement at the image's middle,
    east, north, up; `horizontal_m` its length in plan; `most_m` the longest movement in space
    over the image.
    """

    image: int
    cause: str
    unit: str
    enu_m: tuple[float, float, float]
    horizontal_m: float
    most_m: float

    def as_dict(self) -> dict[str, object]:
        """Return the facts by name."""
        return {
            "image": self.image,
            "cause": self.cause,
            "unit": self.unit,
            "enu_m": list(self.enu_m),
            "horizontal_m": self.horizontal_m,
            "most_m": self.most_m,
        }


@dataclass(frozen=True, slots=True)
class Budget:
    """Lines of a budget at `geodetic` (3,), of one image or of several intersected ones."""

    geodetic: tuple[float, float, float]
    images: int
    lines: tuple[BudgetLine, ...]

    def as_dict(self) -> dict[str, object]:
        """Return the facts by name; degrees."""
        lon, lat, height = self.geodetic
        return {
            "lon_deg": float(np.degrees(lon)),
            "lat_deg": float(np.degrees(lat)),
            "height_m": height,
            "images": self.images,
            "lines": [line.as_dict() for line in self.lines],
        }


def movements(
    model: SensorModel, image_px: FloatArray, height_m: FloatArray
) -> Mapping[tuple[str, str], FloatArray]:
    """Movements (n, 3) in ECEF of located points at constant height, by (cause, unit).

    Of a rigorous model per arcsecond about body and orbit axes, per metre of the satellite's
    position, per millisecond; of any model per pixel. The height's line alone leaves the height.
    """
    found: dict[tuple[str, str], FloatArray] = {}
    scale = image_scale_at(model, image_px, height_m)
    if isinstance(model, PushbroomModel):
        moves = influence(model, image_px, height_m)
        for i, axis in enumerate("xyz"):
            found[f"turn about body {axis}", "1″"] = ARCSEC_RAD * moves.turn_body_m[:, :, i]
        for i, axis in enumerate(_ORBIT_AXES):
            found[f"turn about orbit {axis}", "1″"] = ARCSEC_RAD * moves.turn_orbit_m[:, :, i]
        for i, axis in enumerate(_ORBIT_AXES):
            found[f"orbit {axis}", "1 m"] = moves.position_m[:, :, i]
        found["line time", "1 ms"] = 1e-3 * moves.time_m
    found["image row", "1 px"] = scale.ground_per_px[:, :, 0]
    found["image column", "1 px"] = scale.ground_per_px[:, :, 1]
    return found


def image_budget(model: SensorModel, height_m: float | None = None) -> Budget:
    """Budget of points located on a surface of `height_m`; the middle of the model's heights."""
    height = float(np.mean(model.height_range_m)) if height_m is None else height_m
    image = _places(model)
    heights = np.full(len(image), height)
    located = model.image_to_ground(image, heights)
    good = has_result(located.flag)
    if not good[0]:
        raise GeometryError("error budget: the image's middle sees no ground")
    axes = enu_axes(np.where(good[:, None], located.geodetic, 0.0))
    found = dict(movements(model, image, heights))
    up = axes[:, :, 2]
    u = model.rays(image, heights).direction_ecef
    found["height of the surface", "1 m"] = u / np.einsum("ni,ni->n", u, up)[:, None]
    lines = [_line(0, *name, moved, axes, good) for name, moved in found.items()]
    return Budget(_place(located.geodetic[0]), 1, tuple(lines))


def pair_budget(models: Sequence[SensorModel], height_m: float | None = None) -> Budget:
    """Budget of points intersected from `models`, one image at fault at a time.

    A `GeometryError` where the images have no ground in common.
    """
    points = _common_ground(models, height_m)
    # The most central point first: it stands for the middle.
    off = np.linalg.norm(points[:, :2] - points[:, :2].mean(axis=0), axis=1)
    points = points[np.argsort(off, kind="stable")]
    gains, _, good = intersection_gains(models, points)
    if not good[0]:
        raise GeometryError("error budget: the lines of sight are too nearly parallel")
    axes = enu_axes(points)
    lines = []
    for k, model in enumerate(models):
        seen_px = model.ground_to_image(points).image_px
        for name, moved in movements(model, seen_px, points[:, 2]).items():
            shift = np.einsum("nij,nj->ni", gains[k], moved)
            lines.append(_line(k, *name, shift, axes, good))
    return Budget(_place(points[0]), len(models), tuple(lines))


def _common_ground(models: Sequence[SensorModel], height_m: float | None) -> FloatArray:
    """Ground points (n, 3) that all images show, at the height where most of them do."""
    lows, highs = zip(*(model.height_range_m for model in models), strict=True)
    heights = np.linspace(min(lows), max(highs), _HEIGHTS) if height_m is None else [height_m]
    image = _places(models[0], 3 * _GRID)
    best = np.empty((0, 3))
    for height in heights:
        ground = models[0].image_to_ground(image, float(height))
        points = ground.geodetic[has_result(ground.flag)]
        for model in models:
            points = points[model.ground_to_image(points).flag == Flag.OK]
        if len(points) > len(best):
            best = points
    if not len(best):
        raise GeometryError("error budget: the images have no ground in common")
    return best


def _places(model: SensorModel, count: int = _GRID) -> FloatArray:
    """Image points: the middle, then a grid over the image."""
    lines, samples = model.shape
    part = np.linspace(_INNER, 1.0 - _INNER, count)
    grid = np.stack(np.meshgrid(part * (lines - 1), part * (samples - 1)), axis=-1).reshape(-1, 2)
    return np.concatenate([[[0.5 * (lines - 1), 0.5 * (samples - 1)]], grid])


def _line(
    image: int, cause: str, unit: str, moved: FloatArray, axes: FloatArray, good: BoolArray
) -> BudgetLine:
    enu = np.einsum("nji,nj->ni", axes, moved)
    east, north, up = (float(value) for value in enu[0])
    most = float(np.nanmax(np.linalg.norm(enu[good], axis=1)))
    return BudgetLine(image, cause, unit, (east, north, up), float(np.hypot(east, north)), most)


def _place(geodetic: FloatArray) -> tuple[float, float, float]:
    lon, lat, height = (float(value) for value in geodetic)
    return lon, lat, height
