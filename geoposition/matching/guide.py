"""Where the ground seen at a pixel of one image appears in another, as their models say.

Between a lowest and a highest height that is a short curve, here its chord. A match lies on it
up to the error of the models; across it (`across`) that error shows, along it (`along`) it
cannot be told from height.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.flags import has_result
from geoposition.matching.image import Window
from geoposition.sensor_model import SensorModel
from geoposition.triangulate.scale import TERMS, quadratic_terms

_GRID: Final = 6
_HEIGHTS: Final = 5
_LEAST_CHORD_PX: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Chords:
    """Chords in the second image of n points of the first.

    `low_px` (n, 2) is where the lowest ground appears, `along` (n, 2) the unit direction from
    there to the highest, `length_px` (n,) as far as that.
    """

    low_px: FloatArray
    along: FloatArray
    length_px: FloatArray

    def along_px(self, points_px: FloatArray) -> FloatArray:
        """How far along its chord each of `points_px` (n, 2) lies."""
        return np.asarray(np.sum((points_px - self.low_px) * self.along, axis=-1))

    def across_px(self, points_px: FloatArray) -> FloatArray:
        """How far beside its chord each of `points_px` (n, 2) lies."""
        off = points_px - self.low_px
        return np.asarray(off[..., 1] * self.along[..., 0] - off[..., 0] * self.along[..., 1])


@dataclass(frozen=True, slots=True, eq=False)
class Guide:
    """Image points of the second model over a window of the first, as a quadratic.

    `centre`, `extent` (3,) normalise (line, sample, height); `coefficients` (TERMS, 2).
    """

    centre: FloatArray
    extent: FloatArray
    coefficients: FloatArray
    heights_m: tuple[float, float]

    def at(self, first_px: FloatArray, height_m: FloatArray | float) -> FloatArray:
        """Points (n, 2) of the second image where `first_px` (n, 2) shows ground at `height_m`."""
        place = np.column_stack([first_px, np.broadcast_to(height_m, len(first_px))])
        return quadratic_terms((place - self.centre) / self.extent) @ self.coefficients

    def chords(self, first_px: FloatArray) -> Chords:
        """Chords of `first_px` (n, 2)."""
        low, high = (self.at(first_px, height) for height in self.heights_m)
        step = high - low
        length = np.hypot(step[:, 0], step[:, 1])
        # Images of one geometry have no parallax: any direction will do.
        still = length < _LEAST_CHORD_PX
        step[still], length[still] = (1.0, 0.0), 1.0
        along = step / length[:, None]
        length[still] = 0.0
        return Chords(low, along, length)

    def affine(self, first_px: FloatArray, along_px: FloatArray) -> FloatArray:
        """How the second image moves with the first, (n, 2, 2), on ground of constant height.

        `along_px` (n,) along the chords of `first_px` (n, 2) tells the heights.
        """
        low, high = self.heights_m
        length = np.maximum(self.chords(first_px).length_px, _LEAST_CHORD_PX)
        height = low + np.clip(along_px / length, 0.0, 1.0) * (high - low)
        out = np.empty((len(first_px), 2, 2))
        for k in range(2):
            step = np.eye(2)[k]
            ahead, behind = self.at(first_px + step, height), self.at(first_px - step, height)
            out[:, :, k] = 0.5 * (ahead - behind)
        return out


def guide(
    first: SensorModel, second: SensorModel, window: Window, heights_m: tuple[float, float]
) -> Guide | None:
    """Fit the guide over `window` of the first image, or None where the second sees too little."""
    low, high = heights_m
    mesh = np.meshgrid(
        np.linspace(window.line, window.line + window.lines - 1.0, _GRID),
        np.linspace(window.sample, window.sample + window.samples - 1.0, _GRID),
        np.linspace(low, high, _HEIGHTS),
        indexing="ij",
    )
    place = np.stack(mesh, axis=-1).reshape(-1, 3)
    ground = first.image_to_ground(place[:, :2], place[:, 2])
    seen = second.ground_to_image(ground.geodetic)
    good = has_result(ground.flag) & has_result(seen.flag)
    if good.sum() < 3 * TERMS:
        return None
    centre = 0.5 * (place.min(axis=0) + place.max(axis=0))
    extent = np.maximum(0.5 * np.ptp(place, axis=0), 1.0)
    terms = quadratic_terms((place[good] - centre) / extent)
    solution = np.linalg.lstsq(terms, seen.image_px[good], rcond=1e-10)
    coefficients, rank = np.asarray(solution[0], dtype=np.float64), solution[2]
    if rank < TERMS:
        return None
    return Guide(centre, extent, coefficients, heights_m)


def search_window(chart: Guide, window: Window, margin_px: float, extent: Window) -> Window | None:
    """Return the part of `extent` of the second image where the ground of `window` may appear."""
    line = np.linspace(window.line, window.line + window.lines - 1.0, _GRID)
    sample = np.linspace(window.sample, window.sample + window.samples - 1.0, _GRID)
    points = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1).reshape(-1, 2)
    seen = np.concatenate([chart.at(points, height) for height in chart.heights_m])
    first = np.floor(seen.min(axis=0) - margin_px)
    last = np.ceil(seen.max(axis=0) + margin_px)
    box = Window(int(first[0]), int(first[1]), *(int(n) + 1 for n in last - first))
    return box.within(extent)
