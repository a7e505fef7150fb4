"""Where the pixels of a lattice lie in an image: model and terrain between nodes."""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import FlagArray, FloatArray
from geoposition.flags import Flag, has_result
from geoposition.reimage.ortho import OrthoGrid
from geoposition.reimage.ortho_kernels import places_at_heights, spread_nodes
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

_BOUND_PX: Final = 0.005
_FIRST_STEP: Final = 32
_LEAST_STEP: Final = 4
_LEAST_HALF_M: Final = 5.0


def image_places(
    model: SensorModel,
    terrain: Terrain,
    grid: OrthoGrid,
    bound_px: float = _BOUND_PX,
    first_step: int = _FIRST_STEP,
) -> tuple[FloatArray, FlagArray]:
    """Image points (rows, cols, 2) of the pixels of `grid`, NaN where `flag` (rows, cols) says why.

    As `reimage.ortho_window`, without its care for pixels at the image's very border: cells of
    nodes, at most `first_step` pixels wide, that the model does not reach are left out.
    """
    height_at = terrain.height_at(_lon_lat(grid))
    height = height_at.height_m
    flag: FlagArray = np.array(height_at.flag)
    image = np.full((*grid.shape, 2), np.nan)
    known = np.isfinite(height)
    if not known.any():
        return image, flag
    low, high = float(np.nanmin(height)), float(np.nanmax(height))
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), _LEAST_HALF_M)
    step = first_step
    while True:
        nodes = _nodes(model, grid, step, 0.0, middle, half)
        between = _nodes(model, grid, step, 0.5 * step, middle, half)[:-1, :-1]
        mean = 0.25 * (nodes[1:, 1:] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[:-1, :-1])
        missed = np.abs(mean - between)[..., [0, 3]]
        if np.nanmax(missed, initial=0.0) <= bound_px or step <= _LEAST_STEP:
            break
        step //= 2
    line, sample = np.empty(grid.shape), np.empty(grid.shape)
    places_at_heights(nodes, step, height, middle, half, line, sample)
    image = np.stack([line, sample], axis=-1)
    ends = np.array(model.shape) - 0.5
    inside = np.all((image >= -0.5) & (image <= ends), axis=-1)
    flag[known & ~inside] = Flag.OUTSIDE_MODEL
    image[flag != Flag.OK] = np.nan
    return image, flag


def _lon_lat(grid: OrthoGrid) -> FloatArray:
    """Longitude and latitude (rows, cols, 2) of the pixels' centres."""
    out = np.empty((*grid.shape, 2))
    row, col = _axes(grid, _FIRST_STEP)
    nodes = grid.geodetic(*np.meshgrid(row, col, indexing="ij"), 0.0)[..., :2]
    spread_nodes(np.ascontiguousarray(nodes), _FIRST_STEP, out)
    return out


def _axes(grid: OrthoGrid, step: int) -> tuple[FloatArray, FloatArray]:
    row, col = (step * np.arange(-(-max(n, 2) // step) + 1, dtype=np.float64) for n in grid.shape)
    return row, col


def _nodes(
    model: SensorModel, grid: OrthoGrid, step: int, off: float, middle_m: float, half_m: float
) -> FloatArray:
    """Quadratics in the height (r, c, 6) of line and sample, `off` pixels from the nodes."""
    row, col = (axis + off for axis in _axes(grid, step))
    ground = grid.geodetic(*np.meshgrid(row, col, indexing="ij"), middle_m)
    images = []
    for k in (-1.0, 0.0, 1.0):
        ground[..., 2] = middle_m + k * half_m
        found = model.ground_to_image(ground)
        images.append(np.where(has_result(found.flag)[..., None], found.image_px, np.nan))
    below, at, above = images
    terms = np.stack([at, 0.5 * (above - below), 0.5 * (above + below) - at], axis=-1)
    return np.ascontiguousarray(terms.reshape(len(row), len(col), 6))
