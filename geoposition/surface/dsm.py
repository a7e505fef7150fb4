"""Points gridded to a surface: a GeoTIFF of heights, counts and errors, in bounded memory.

A point adds to the four cells whose centres are around it, with bilinear weights. Per cell, with
w the weights, h the heights and s their standard deviations:
    height = Σ w h / Σ w ,
    error = sqrt(Σ w s² / Σ w + Σ w (h − height)² / Σ w) ,
    count = how many points have a part in it.
Errors do not shrink with the count: neighbouring matches share most of their windows. What is
being accumulated lies in a scratch file and is mapped where a tile needs it.

*Source*: West 1979, Comm. ACM 22(9), for means and variances of weighted values one by one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np
import rasterio
from numba import get_num_threads
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import CRSError
from rasterio.fill import fillnodata
from rasterio.transform import Affine, from_origin
from rasterio.windows import Window

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError
from geoposition.surface.cell_kernels import LAYERS, Layers, layers_of, splat
from geoposition.surface.map_points import horizontal_bounds

BANDS: Final = ("height", "count", "error")

_BLOCK: Final = 512
_STRIP: Final = 1024
_FILL_CELLS: Final = 100
_MOST_CELLS: Final = 40_000_000_000
_CACHE_MB: Final = 64


@dataclass(frozen=True, slots=True)
class DsmGrid:
    """Cells of `resolution`, in the units of `crs`, from the north-west corner (`west`, `north`).

    Corners are whole multiples of the resolution, so that surfaces of one kind fit together.
    """

    crs: str
    resolution: float
    west: float
    north: float
    shape: tuple[int, int]

    @classmethod
    def around(cls, crs: str | int, resolution: float, low: FloatArray, high: FloatArray) -> Self:
        """Return the grid that covers the map coordinates from `low` (2,) to `high` (2,)."""
        if not (math.isfinite(resolution) and resolution > 0.0):
            raise ArgumentError(f"resolution: a positive number expected, got {resolution}")
        west, south = (math.floor(float(value) / resolution) for value in low[:2])
        east, north = (math.ceil(float(value) / resolution) for value in high[:2])
        shape = (north - south, east - west)
        if min(shape) < 1 or shape[0] * shape[1] > _MOST_CELLS:
            raise ArgumentError(
                f"resolution {resolution:g}: a surface of {shape[0]} x {shape[1]} cells is no use"
            )
        named = f"EPSG:{crs}" if isinstance(crs, int) else crs
        return cls(named, resolution, west * resolution, north * resolution, shape)

    def transform(self, row: int = 0, column: int = 0) -> Affine:
        """Return the transform of the part that begins at a cell."""
        step = self.resolution
        return from_origin(self.west + column * step, self.north - row * step, step, step)


def is_geographic(crs: str | int) -> bool:
    """Whether `crs` counts in degrees; one that nobody knows is an `ArgumentError`."""
    try:
        return bool(CRS.from_user_input(crs).is_geographic)
    except CRSError:
        raise ArgumentError(f"unknown coordinate reference system {str(crs)[:60]!r}") from None


class Surface:
    """A surface being made: `add` points, then `write`; a context manager that tidies up.

    `scratch` is a folder with room for 20 bytes per cell. `base_m` is a height near the points'.
    """

    def __init__(self, grid: DsmGrid, scratch: str | PathLike[str], base_m: float = 0.0):
        self.grid = grid
        self.points = 0
        self._base_m = base_m
        self._path = Path(scratch) / "surface.cells"
        self._bounds: list[int] | None = None
        size = 4 * LAYERS * grid.shape[0] * grid.shape[1]
        with self._path.open("wb") as file:
            file.truncate(size)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with suppress(OSError):
            self._path.unlink()

    @property
    def bounds(self) -> tuple[int, int, int, int]:
        """First row, first column, and the ones after the last, of cells that points touched."""
        if self._bounds is None:
            raise GeometryError("surface: no point lies in it")
        top, left, bottom, right = self._bounds
        return top, left, bottom, right

    def add(self, map_points: FloatArray, sigma_m: NDArray[np.float32]) -> None:
        """Add points (n, 3) in the grid's system, with standard deviations (n,) of height."""
        grid = self.grid
        points = np.ascontiguousarray(map_points)
        low, high = horizontal_bounds(points)
        if not np.isfinite(low).all():
            return
        top, bottom = _reach(grid.north - high[1], grid.north - low[1], grid, 0)
        left, right = _reach(low[0] - grid.west, high[0] - grid.west, grid, 1)
        if top >= bottom or left >= right:
            return
        cells = self._cells("r+")
        splat(
            points,
            sigma_m,
            grid.north,
            grid.west,
            1.0 / grid.resolution,
            self._base_m,
            cells[top:bottom],
            top,
            get_num_threads(),
        )
        del cells
        self.points += len(points)
        mine = [top, left, bottom, right]
        old = self._bounds or mine
        self._bounds = [
            *(min(a, b) for a, b in zip(old[:2], mine[:2], strict=True)),
            *(max(a, b) for a, b in zip(old[2:], mine[2:], strict=True)),
        ]

    def write(
        self,
        path: str | PathLike[str],
        *,
        fill: bool = False,
        tags: Mapping[str, str] | None = None,
    ) -> None:
        """Write the cells that have points: a tiled GeoTIFF of the bands `BANDS`.

        NaN where there is no height. With `fill` holes inside the surface are interpolated from
        within 100 cells; their count is 0 and they have no error. Write to a temporary place:
        the file grows block by block.
        """
        top, left, bottom, right = self.bounds
        profile = {
            "driver": "GTiff",
            "dtype": "float32",
            "count": len(BANDS),
            "height": bottom - top,
            "width": right - left,
            "crs": CRS.from_user_input(self.grid.crs),
            "transform": self.grid.transform(top, left),
            "nodata": float("nan"),
            "tiled": True,
            "blockxsize": _BLOCK,
            "blockysize": _BLOCK,
            "compress": "deflate",
            "zlevel": 1,
            "num_threads": 2,
            "interleave": "band",
            "BIGTIFF": "IF_SAFER",
        }
        with rasterio.Env(GDAL_CACHEMAX=_CACHE_MB), rasterio.open(path, "w", **profile) as out:
            for row in range(top, bottom, _STRIP):
                for column in range(left, right, _STRIP):
                    self._write_block(out, row, column, fill)
            out.update_tags(
                AREA_OR_POINT="Area",
                HEIGHTS="metres above the WGS 84 ellipsoid",
                **(tags or {}),
            )
            out.descriptions = BANDS
            out.units = ("metre", "", "metre")

    def _write_block(
        self, out: rasterio.io.DatasetWriter, row: int, column: int, fill: bool
    ) -> None:
        top, left, bottom, right = self.bounds
        margin = _FILL_CELLS if fill else 0
        rows = max(top, row - margin), min(bottom, row + _STRIP + margin)
        columns = max(left, column - margin), min(right, column + _STRIP + margin)
        cells = self._cells("r")
        part = np.array(cells[rows[0] : rows[1], columns[0] : columns[1]])
        del cells
        layers = np.empty((len(BANDS), *part.shape[:2]), dtype=np.float32)
        layers_of(part, self._base_m, layers)
        if fill:
            layers[0] = _filled(layers[0])
        inner = np.s_[
            row - rows[0] : row - rows[0] + min(_STRIP, bottom - row),
            column - columns[0] : column - columns[0] + min(_STRIP, right - column),
        ]
        block = layers[(slice(None), *inner)]
        out.write(block, window=Window(column - left, row - top, *block.shape[:0:-1]))

    def _cells(self, mode: str) -> Layers:
        shape = (*self.grid.shape, LAYERS)
        return np.memmap(self._path, dtype=np.float32, mode=mode, shape=shape)  # type: ignore[call-overload, no-any-return]


def _reach(low: float, high: float, grid: DsmGrid, axis: int) -> tuple[int, int]:
    """First row or column that points touch from `low` to `high`, and the one after the last."""
    first, last = (math.floor(value / grid.resolution - 0.5) for value in (low, high))
    return max(first, 0), min(last + 2, grid.shape[axis])


def _filled(height: Layers) -> Layers:
    """Fill holes that have heights on all four sides; what lies outside stays empty."""
    known = np.isfinite(height)
    if known.all() or not known.any():
        return height
    inside = np.ones_like(known)
    for axis in (0, 1):
        inside &= np.logical_or.accumulate(known, axis=axis)
        inside &= np.flip(np.logical_or.accumulate(np.flip(known, axis), axis=axis), axis)
    whole = fillnodata(
        np.where(known, height, np.float32(0.0)),
        mask=known.astype(np.uint8),
        max_search_distance=_FILL_CELLS,
        smoothing_iterations=0,
        nodata=float("nan"),
    )
    filled: Layers = np.where(known | inside, whole, np.float32(np.nan)).astype(np.float32)
    return filled
