"""The pixels of a map: north up, square, in any coordinate reference system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.datum import from_crs
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import has_result
from geoposition.locate import locate
from geoposition.sensor_model import SensorModel
from geoposition.surface import map_extent
from geoposition.terrain import Terrain

_BORDER: Final = 33
_MOST_PIXELS: Final = 10**11


@dataclass(frozen=True, slots=True)
class OrthoGrid:
    """Pixels of a map: north up, square, `resolution` units of `crs` wide.

    The outer corner of the first one is at (`left`, `top`); `shape` is (rows, cols).
    """

    crs: str
    left: float
    top: float
    resolution: float
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        if not self.resolution > 0.0:
            raise ArgumentError(f"ortho: a positive resolution expected, got {self.resolution}")
        if min(self.shape) < 1 or self.shape[0] * self.shape[1] > _MOST_PIXELS:
            raise ArgumentError(f"ortho: {self.shape} pixels: too few or too many")

    @classmethod
    def around(cls, model: SensorModel, terrain: Terrain, crs: str, resolution: float) -> OrthoGrid:
        """Grid around what `model` sees of `terrain`, on whole multiples of the resolution."""
        if not resolution > 0.0:
            raise ArgumentError(f"ortho: a positive resolution expected, got {resolution}")
        lines, samples = model.shape
        rows = np.linspace(-0.5, lines - 0.5, _BORDER)
        cols = np.linspace(-0.5, samples - 0.5, _BORDER)
        image = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)
        ground = locate(model, image, terrain)
        seen = has_result(ground.flag)
        if not seen.any():
            raise GeometryError("ortho: the terrain has no height where the image looks")
        lowest, highest = map_extent(crs, ground.geodetic[seen])
        low, high = np.floor(lowest / resolution), np.ceil(highest / resolution)
        cols_rows = np.maximum(high - low, 1.0)
        if not np.isfinite(cols_rows).all() or np.prod(cols_rows) > _MOST_PIXELS:
            raise ArgumentError(f"ortho: {cols_rows[1]:g} x {cols_rows[0]:g} pixels are too many")
        return cls(
            crs,
            float(low[0] * resolution),
            float(high[1] * resolution),
            resolution,
            (int(cols_rows[1]), int(cols_rows[0])),
        )

    def window(self, row: int, col: int, rows: int, cols: int) -> OrthoGrid:
        """Grid of `rows` x `cols` pixels from (`row`, `col`) on."""
        left, top = self.left + col * self.resolution, self.top - row * self.resolution
        return OrthoGrid(self.crs, left, top, self.resolution, (rows, cols))

    def finer(self, factor: int) -> OrthoGrid:
        """Grid of the same extent with `factor` times as many rows and columns."""
        rows, cols = self.shape
        return OrthoGrid(
            self.crs, self.left, self.top, self.resolution / factor, (rows * factor, cols * factor)
        )

    def geodetic(self, row: FloatArray, col: FloatArray, height_m: float) -> FloatArray:
        """Ground points (..., 3) of fractional pixels `row`, `col` (...) at one height."""
        x = self.left + (col + 0.5) * self.resolution
        y = self.top - (row + 0.5) * self.resolution
        points = from_crs(self.crs, np.stack([x, y, np.zeros_like(x)], axis=-1))
        points[..., 2] = height_m
        return points
