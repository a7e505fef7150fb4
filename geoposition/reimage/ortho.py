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
from geoposition.flags import Flag, has_result
from geoposition.locate import locate
from geoposition.reimage.ortho_grid import OrthoGrid
from geoposition.reimage.ortho_kernels import (
    heights_on_mesh,
    places_at_heights,
    settle_flags,
    spread_nodes,
)
from geoposition.reimage.place_kernels import extremes
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain
from geoposition.terrain.mesh import height_mesh

__all__ = [
    "DEFAULT_BOUND_PX",
    "FIRST_STEP",
    "OrthoGrid",
    "OrthoPlaces",
    "OrthoTask",
    "block_means",
    "ortho_window",
]

DEFAULT_BOUND_PX: Final = 0.005
FIRST_STEP: Final = 64

_LEAST_STEP: Final = 1
_LARGEST_CELL_PX: Final = 64.0
"""In the image: a model answers for a margin around it that is larger."""
_PROBES: Final = 9
_LEAST_HALF_M: Final = 5.0


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

    @property
    def bounds_px(self) -> tuple[FloatArray, FloatArray] | None:
        """Lowest and highest (line, sample); none if no pixel has a place."""
        each = np.empty((len(self.line), 4))
        extremes(self.line, self.sample, each)
        low, high = each[:, ::2].min(axis=0), each[:, 1::2].max(axis=0)
        return (low, high) if np.all(low <= high) else None


def ortho_window(task: OrthoTask, grid: OrthoGrid) -> OrthoPlaces:
    """Places in the image of the pixels of `grid`, a window of some million pixels."""
    line, sample = np.empty(grid.shape), np.empty(grid.shape)
    height, flag, (low, high) = _heights(task.terrain, grid)
    if not low <= high:
        line.fill(np.nan)
        sample.fill(np.nan)
        return OrthoPlaces(line, sample, flag, 0.0)
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), _LEAST_HALF_M)
    step = _first_step(task.model, grid, middle)
    while True:
        nodes = _nodes(task.model, grid, step, middle, half)
        error, lost_cells = _error(task.model, grid, nodes, step, middle, half)
        if (error <= task.bound_px and not lost_cells) or step <= _LEAST_STEP:
            break
        step //= 2
    places_at_heights(nodes, step, height, middle, half, line, sample)
    settle_flags(line, sample, *task.model.shape, flag)
    if task.occlusion:
        hidden = _hidden(task, grid, line, sample, flag == Flag.OK)
        flag[hidden] = Flag.NO_INTERSECTION
        line[hidden] = sample[hidden] = np.nan
    return OrthoPlaces(line, sample, flag, error)


def _heights(
    terrain: Terrain, grid: OrthoGrid
) -> tuple[FloatArray, FlagArray, tuple[float, float]]:
    """Heights and flags (rows, cols) of the pixels' centres, and bounds of the heights."""
    nodes, step = _ground_nodes(grid)
    mesh = height_mesh(terrain, nodes)
    if mesh is not None:
        height, flag = np.empty(grid.shape), np.empty(grid.shape, np.uint8)
        heights_on_mesh(mesh.height_m, mesh.place, step, height, flag)
        return height, flag, (mesh.lowest_m, mesh.highest_m)
    found = terrain.height_at(_spread(grid, nodes, step))
    known = found.height_m[np.isfinite(found.height_m)]
    bounds = (float(known.min()), float(known.max())) if known.size else (np.inf, -np.inf)
    return found.height_m, np.array(found.flag), bounds


def _axes(grid: OrthoGrid, step: int) -> tuple[FloatArray, FloatArray]:
    row, col = (step * np.arange(-(-max(n, 2) // step) + 1, dtype=np.float64) for n in grid.shape)
    return row, col


def _ground_nodes(grid: OrthoGrid) -> tuple[FloatArray, int]:
    """Longitude and latitude (r, c, 2) of nodes so close that a line between them will do.

    And how many pixels lie between them.
    """
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
            return np.ascontiguousarray(nodes), step
        step //= 2


def _spread(grid: OrthoGrid, nodes: FloatArray, step: int) -> FloatArray:
    """Longitude and latitude (rows, cols, 2) of the pixels' centres, to a few millimetres."""
    out = np.empty((*grid.shape, 2))
    spread_nodes(nodes, step, out)
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
    line: FloatArray,
    sample: FloatArray,
    asked: BoolArray,
) -> BoolArray:
    """Tell which pixels' lines of sight meet the ground elsewhere first, by over a pixel."""
    hidden = np.zeros(asked.shape, dtype=np.bool_)
    if not asked.any():
        return hidden
    ground = _spread(grid, *_ground_nodes(grid))[asked]
    image = np.stack([line[asked], sample[asked]], axis=-1)
    first = locate(task.model, image, task.terrain)
    apart = first.geodetic[:, :2] - ground
    apart[:, 0] *= np.cos(ground[:, 1])
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
