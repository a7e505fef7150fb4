"""Heights as the first image sees them: a coarse grid over its pixels, and how far to trust it.

It is what dense matching starts from, level by level. The second image is resampled as if the
ground were this surface; what is left to find is small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter, zoom

from geoposition.arrays import FloatArray
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.locate import locate
from geoposition.matching.image import Window
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

Grid32: TypeAlias = NDArray[np.float32]
_Heights: TypeAlias = Callable[[FloatArray], FloatArray]

_SMOOTH_NODES = 1.0
_NEIGHBOURS = 3
_PERCENT = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class HeightField:
    """Smooth heights over an image: bilinear between nodes, level beyond them.

    Node (i, j) lies at `first_px` (2,) + `step_px` · (i, j). The ground lies between
    `height_m` + `low_m` and `height_m` + `high_m` (rows, columns), as far as is known.
    """

    first_px: FloatArray
    step_px: float
    height_m: Grid32
    low_m: Grid32
    high_m: Grid32

    @property
    def place(self) -> FloatArray:
        """First line, first sample and 1 / step: what the kernels take."""
        return np.array([*self.first_px, 1.0 / self.step_px])

    def at(self, image_px: FloatArray) -> FloatArray:
        """Heights (n,) at `image_px` (n, 2)."""
        out = np.empty(len(image_px))
        _heights(self.height_m, self.place, np.ascontiguousarray(image_px), out)
        return out

    def node_px(self) -> FloatArray:
        """Places of the nodes (rows, columns, 2)."""
        rows, columns = self.height_m.shape
        mesh = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
        return np.stack(mesh, axis=-1) * self.step_px + self.first_px

    def over(self, window: Window, reach_px: float = 0.0) -> tuple[float, float, float, float]:
        """Lowest and highest height of the surface in `window`, least `low_m`, most `high_m`.

        The latter two leave out the extreme half per cents: lone blunders.
        """
        first = np.array([window.line, window.sample]) - reach_px
        last = first + (window.lines, window.samples) + 2.0 * reach_px
        size = np.array(self.height_m.shape)
        begin = np.floor((first - self.first_px) / self.step_px).astype(int)
        end = np.ceil((last - self.first_px) / self.step_px).astype(int) + 1
        begin = np.clip(begin, 0, size - 1)
        end = np.clip(end, begin + 1, size)
        part = np.s_[begin[0] : end[0], begin[1] : end[1]]
        height = self.height_m[part]
        low = np.percentile(self.low_m[part], _PERCENT)
        high = np.percentile(self.high_m[part], 100.0 - _PERCENT)
        return float(height.min()), float(height.max()), float(low), float(high)

    def within(self, low_m: float, high_m: float) -> HeightField:
        """Return the same surface, with the ground within `low_m` .. `high_m` of it."""
        low, high = (np.full_like(self.height_m, value) for value in (low_m, high_m))
        return HeightField(self.first_px, self.step_px, self.height_m, low, high)


def level_field(extent: Window, height_m: float, step_px: float) -> HeightField:
    """Return a field of one height over `extent`."""
    return _field(extent, step_px, lambda px: np.full(len(px), height_m))


def terrain_field(
    model: SensorModel, terrain: Terrain, extent: Window, step_px: float
) -> HeightField:
    """Return the heights of `terrain` where the image's lines of sight meet it.

    Holes are filled from around them; a `GeometryError` where hardly anything is met.
    """

    def heights(image_px: FloatArray) -> FloatArray:
        found = locate(model, image_px, terrain)
        good = has_result(found.flag)
        if good.mean() < 0.05:
            raise GeometryError("the DEM does not cover the ground that the image shows")
        return np.where(good, found.geodetic[:, 2], np.nan)

    return _field(extent, step_px, heights)


def field_of_heights(
    first_px: FloatArray, step_px: float, height_m: Grid32, low_m: float, high_m: float
) -> HeightField:
    """Return the field of matched heights (rows, columns), NaN where there are none.

    Smoothed and filled; the ground is taken to lie within what the neighbouring nodes have
    beside the smooth surface, less `low_m` and plus `high_m`. `GeometryError` without heights.
    """
    known = np.isfinite(height_m)
    if not known.any():
        raise GeometryError("dense matching: nothing matches at the coarsest scale")
    filled = fill_holes(height_m)
    smooth = gaussian_filter(filled, _SMOOTH_NODES).astype(np.float32)
    beside = np.where(known, height_m - smooth, 0.0).astype(np.float32)
    low = minimum_filter(beside, 2 * _NEIGHBOURS + 1) + np.float32(low_m)
    high = maximum_filter(beside, 2 * _NEIGHBOURS + 1) + np.float32(high_m)
    return HeightField(first_px, step_px, smooth, low, high)


def fill_holes(height: Grid32) -> Grid32:
    """Fill NaN (rows, columns) from around: means of ever larger blocks, bilinear between."""
    known = np.isfinite(height)
    if known.all() or not known.any():
        return height
    coarser = _halved(height)
    if min(height.shape) < 4 or coarser.shape == height.shape:
        return np.where(known, height, np.nanmean(height)).astype(np.float32)
    up = zoom(fill_holes(coarser), 2, order=1, mode="nearest", grid_mode=True)
    rows, columns = height.shape
    filled: Grid32 = np.where(known, height, up[:rows, :columns]).astype(np.float32)
    return filled


def _halved(height: Grid32) -> Grid32:
    rows, columns = (n + n % 2 for n in height.shape)
    padded = np.full((rows, columns), np.nan, dtype=np.float32)
    padded[: height.shape[0], : height.shape[1]] = height
    blocks = padded.reshape(rows // 2, 2, columns // 2, 2)
    count = np.isfinite(blocks).sum(axis=(1, 3))
    total = np.nansum(blocks, axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _field(extent: Window, step_px: float, heights: _Heights) -> HeightField:
    rows = max(2, int(np.ceil((extent.lines - 1) / step_px)) + 1)
    columns = max(2, int(np.ceil((extent.samples - 1) / step_px)) + 1)
    first = np.array([extent.line, extent.sample], dtype=np.float64)
    mesh = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    nodes = np.minimum(
        np.stack(mesh, axis=-1).reshape(-1, 2) * step_px + first,
        first + (extent.lines - 1, extent.samples - 1),
    )
    grid = fill_holes(heights(nodes).reshape(rows, columns).astype(np.float32))
    nothing = np.zeros_like(grid)
    return HeightField(first, step_px, grid, nothing, nothing)


@njit(cache=True, error_model="numpy", inline="always")
def height_scalar(nodes: Grid32, place: FloatArray, line: float, sample: float) -> float:
    """Height at one point for other kernels; the arguments are a `HeightField`'s."""
    y = (line - place[0]) * place[2]
    x = (sample - place[1]) * place[2]
    y = min(max(y, 0.0), nodes.shape[0] - 1.0)
    x = min(max(x, 0.0), nodes.shape[1] - 1.0)
    i, j = min(int(y), nodes.shape[0] - 2), min(int(x), nodes.shape[1] - 2)
    v, u = y - i, x - j
    upper = (1.0 - u) * nodes[i, j] + u * nodes[i, j + 1]
    lower = (1.0 - u) * nodes[i + 1, j] + u * nodes[i + 1, j + 1]
    height: float = (1.0 - v) * upper + v * lower
    return height


@njit(cache=True, parallel=True, error_model="numpy")
def _heights(nodes: Grid32, place: FloatArray, image_px: FloatArray, out: FloatArray) -> None:
    for k in prange(len(out)):
        out[k] = height_scalar(nodes, place, image_px[k, 0], image_px[k, 1])
