"""Orthoimages: every pixel of a map from the image, through the ground's height, window by window.

Per window the map's pixels are taken to longitude and latitude, and these into the image at
three heights, at nodes only; between the nodes both are bilinear, in the height quadratic. The
nodes are halved until both errors, measured at the middles of cells and between the heights, are
below a bound. The height of each pixel is the terrain's own, there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import BoolArray, FlagArray, FloatArray
from geoposition.constants import WGS84_A_M
from geoposition.datum import from_crs, to_crs
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag, has_result
from geoposition.locate import locate
from geoposition.reimage.ortho_kernels import places_at_heights, spread_nodes
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

DEFAULT_BOUND_PX: Final = 0.005
FIRST_STEP: Final = 64

_LEAST_STEP: Final = 1
_LARGEST_CELL_PX: Final = 64.0
"""In the image: a model answers for a margin around it that is larger."""
_PROBES: Final = 9
_LEAST_HALF_M: Final = 5.0
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
        place = to_crs(crs, ground.geodetic[seen])[:, :2]
        low = np.floor(place.min(axis=0) / resolution)
        high = np.ceil(place.max(axis=0) / resolution)
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


@dataclass(frozen=True, slots=True, eq=False)
class OrthoTask:
    """An image's `model` and the `terrain` it is brought to a map with.

    `bound_px` is what interpolation may cost; with `occlusion` ground that other ground hides
    from the camera is told from what is seen.
    """

    model: SensorModel
    terrain: Terrain
    occlusion: bool = False
    bound_px: float = DEFAULT_BOUND_PX


@dataclass(frozen=True, slots=True, eq=False)
class OrthoPlaces:
    """Where the pixels of a window lie in the image: `line`, `sample` (rows, cols), NaN if not.

    `flag` (rows, cols) is `OK`, `NODATA` or `OUTSIDE_TERRAIN` (no height), `OUTSIDE_MODEL`,
    or `NO_INTERSECTION` for ground hidden from the camera. `error_px` is the interpolation's
    error, measured.
    """

    line: FloatArray
    sample: FloatArray
    flag: FlagArray
    error_px: float


def ortho_window(task: OrthoTask, grid: OrthoGrid) -> OrthoPlaces:
    """Places in the image of the pixels of `grid`, a window of some hundred pixels a side."""
    ground = _spread(grid)
    found = task.terrain.height_at(ground)
    height = found.height_m
    known = np.isfinite(height)
    line, sample = np.full(grid.shape, np.nan), np.full(grid.shape, np.nan)
    flag: FlagArray = np.array(found.flag)
    if not known.any():
        return OrthoPlaces(line, sample, flag, 0.0)
    low, high = float(np.nanmin(height)), float(np.nanmax(height))
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), _LEAST_HALF_M)
    step = _first_step(task.model, grid, middle)
    while True:
        nodes = _nodes(task.model, grid, step, middle, half)
        error, lost_cells = _error(task.model, grid, nodes, step, middle, half)
        if (error <= task.bound_px and not lost_cells) or step <= _LEAST_STEP:
            break
        step //= 2
    places_at_heights(nodes, step, height, middle, half, line, sample)
    lines, samples = task.model.shape
    inside = (np.abs(line - 0.5 * (lines - 1)) <= 0.5 * lines) & (
        np.abs(sample - 0.5 * (samples - 1)) <= 0.5 * samples
    )
    flag[known & ~inside] = Flag.OUTSIDE_MODEL
    if task.occlusion:
        hidden = _hidden(task, grid, ground, line, sample, known & inside)
        flag[hidden] = Flag.NO_INTERSECTION
    lost = flag != Flag.OK
    line[lost] = sample[lost] = np.nan
    return OrthoPlaces(line, sample, flag, error)


def _axes(grid: OrthoGrid, step: int) -> tuple[FloatArray, FloatArray]:
    row, col = (step * np.arange(-(-max(n, 2) // step) + 1, dtype=np.float64) for n in grid.shape)
    return row, col


def _spread(grid: OrthoGrid) -> FloatArray:
    """Longitude and latitude (rows, cols, 2) of the pixels' centres, to a few millimetres."""
    out = np.empty((*grid.shape, 2))
    step = FIRST_STEP
    while True:
        row, col = _axes(grid, step)
        nodes = grid.geodetic(*np.meshgrid(row, col, indexing="ij"), 0.0)[..., :2]
        middle = grid.geodetic(
            *np.meshgrid(row[:-1] + 0.5 * step, col[:-1] + 0.5 * step, indexing="ij"), 0.0
        )[..., :2]
        mean = 0.25 * (nodes[1:, 1:] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[:-1, :-1])
        missed = float(np.nanmax(np.abs(mean - middle), initial=0.0)) * WGS84_A_M
        if missed < 1e-3 * max(_metres(grid), 0.1) or step <= _LEAST_STEP:
            break
        step //= 2
    spread_nodes(np.ascontiguousarray(nodes), step, out)
    return out


def _metres(grid: OrthoGrid) -> float:
    """Size of a pixel, metres, roughly."""
    two = grid.geodetic(np.array([0.0, 1.0]), np.zeros(2), 0.0)
    return float(np.abs(two[1, 1] - two[0, 1]) * WGS84_A_M)


def _image(
    model: SensorModel, grid: OrthoGrid, row: FloatArray, col: FloatArray, height_m: float
) -> FloatArray:
    found = model.ground_to_image(grid.geodetic(*np.meshgrid(row, col, indexing="ij"), height_m))
    return np.where(has_result(found.flag)[..., None], found.image_px, np.nan)


def _first_step(model: SensorModel, grid: OrthoGrid, height_m: float) -> int:
    """Pixels between nodes that are not too far apart in the image."""
    row, col = (np.linspace(0.0, n - 1.0, _PROBES) for n in grid.shape)
    at = _image(model, grid, row, col, height_m)
    beside = _image(model, grid, row + 1.0, col + 1.0, height_m)
    stretch = float(np.nanmax(np.abs(beside - at), initial=0.0))
    step = FIRST_STEP
    while step > _LEAST_STEP and step * stretch > _LARGEST_CELL_PX:
        step //= 2
    return step


def _nodes(
    model: SensorModel, grid: OrthoGrid, step: int, middle_m: float, half_m: float
) -> FloatArray:
    row, col = _axes(grid, step)
    below, at, above = (
        _image(model, grid, row, col, middle_m + k * half_m) for k in (-1.0, 0.0, 1.0)
    )
    terms = np.stack([at, 0.5 * (above - below), 0.5 * (above + below) - at], axis=-1)
    return np.ascontiguousarray(terms.reshape(len(row), len(col), 6))


def _error(
    model: SensorModel,
    grid: OrthoGrid,
    nodes: FloatArray,
    step: int,
    middle_m: float,
    half_m: float,
) -> tuple[float, bool]:
    """Largest error at the middles of cells, at heights where a quadratic is worst.

    And whether a cell has no places though its middle is seen: a node of it lies too far out.
    """
    row, col = (axis[:-1] + 0.5 * step for axis in _axes(grid, step))
    mean = 0.25 * (nodes[1:, 1:] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[:-1, :-1])
    terms = mean.reshape(len(row), len(col), 2, 3)
    error, lost = 0.0, False
    for k in (-0.577, 0.0, 0.577):
        exact = _image(model, grid, row, col, middle_m + k * half_m)
        missed = np.abs(terms @ np.array([1.0, k, k * k]) - exact)
        error = max(error, float(np.nanmax(missed, initial=0.0)))
        lost |= bool(np.any(np.isnan(mean).any(axis=-1) & np.isfinite(exact).all(axis=-1)))
    return error, lost


def _hidden(
    task: OrthoTask,
    grid: OrthoGrid,
    ground: FloatArray,
    line: FloatArray,
    sample: FloatArray,
    asked: BoolArray,
) -> BoolArray:
    """Tell which pixels' lines of sight meet the ground elsewhere first, by over a pixel."""
    hidden = np.zeros(asked.shape, dtype=np.bool_)
    if not asked.any():
        return hidden
    image = np.stack([line[asked], sample[asked]], axis=-1)
    first = locate(task.model, image, task.terrain)
    apart = first.geodetic[:, :2] - ground[asked]
    apart[:, 0] *= np.cos(ground[asked][:, 1])
    metres = np.hypot(apart[:, 0], apart[:, 1]) * WGS84_A_M
    hidden[asked] = has_result(first.flag) & (metres > _metres(grid))
    return hidden


def block_means(
    values: NDArray[Any], valid: FlagArray, factor: int
) -> tuple[FloatArray, FlagArray]:
    """Means (bands, rows, cols) of the valid ones of `factor` x `factor` values, and if any."""
    bands, rows, cols = values.shape
    small = rows // factor, cols // factor
    blocks = small[0], factor, small[1], factor
    weight = (valid != 0).reshape(blocks)
    count = weight.sum(axis=(1, 3))
    total = np.where(weight, values.reshape(bands, *blocks), 0.0).sum(axis=(2, 4))
    return total / np.maximum(count, 1), (count > 0).astype(np.uint8)
