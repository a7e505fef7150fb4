"""The pieces of work: inputs made once, and each contender's place in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.rpc.model import RpcModel
from geoposition.scripts.bench.scenes import RigorousScene


@dataclass(frozen=True, slots=True)
class RpcWork:
    """Image points (n, 2), heights (n,) and ground points (n, 3) that belong together."""

    model: RpcModel
    image_px: FloatArray
    height_m: FloatArray
    geodetic: FloatArray

    @property
    def points(self) -> int:
        """How many there are."""
        return len(self.image_px)

    def degrees(self, rows: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns lon, lat in degrees and height of `rows`, each contiguous."""
        ground = self.geodetic[rows]
        lon, lat = np.degrees(ground[:, 0]), np.degrees(ground[:, 1])
        return lon, lat, np.ascontiguousarray(ground[:, 2])

    def pixels(self, rows: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns line, sample and height of `rows`, each contiguous."""
        image = self.image_px[rows]
        line, sample = np.ascontiguousarray(image[:, 0]), np.ascontiguousarray(image[:, 1])
        return line, sample, np.ascontiguousarray(self.height_m[rows])


@dataclass(frozen=True, slots=True)
class RigorousWork:
    """Image points (n, 2) at one height, and ground points (n, 3) at various heights."""

    scene: RigorousScene
    image_px: FloatArray
    height_m: float
    geodetic: FloatArray

    @property
    def points(self) -> int:
        """How many there are."""
        return len(self.image_px)


def every(points: int, wanted: int) -> slice:
    """Rows spread over all points, about `wanted` of them."""
    return slice(None, None, max(points // max(wanted, 1), 1))


def smooth_heights(image_px: FloatArray, low_m: float, high_m: float) -> FloatArray:
    """Heights (n,) between two, as hills are: waves over the image."""
    u = image_px[:, 0] / 900.0
    v = image_px[:, 1] / 700.0
    share = 0.5 + 0.25 * np.sin(u + 0.3 * v) + 0.25 * np.sin(v - 0.2 * u)
    heights: FloatArray = low_m + (high_m - low_m) * share
    return heights
