"""Compiled accumulation of points in the cells of a surface, and what cells then hold.

A cell holds: sum of weights, weighted mean height, weighted squares about it, weighted variances
of the points, and their count.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from geoposition.arrays import FloatArray

Layers: TypeAlias = NDArray[np.float32]

LAYERS: Final = 5
_LEAST_WEIGHT: Final = 0.05
"""A cell that only grazes a point's reach has no height of its own."""


@njit(cache=True, parallel=True, error_model="numpy")
def splat(
    points: FloatArray,
    sigma: NDArray[np.float32],
    north: float,
    west: float,
    per_cell: float,
    base_m: float,
    cells: Layers,
    top: int,
    bands: int,
) -> None:
    """Add points one by one: weight, mean, sum of squares about it, variances, count.

    Each band of rows looks at all points and takes its own: no two write to one cell.
    """
    rows, columns = cells.shape[0], cells.shape[1]
    for band in prange(bands):
        first, last = band * rows // bands, (band + 1) * rows // bands
        for k in range(len(points)):
            y = (north - points[k, 1]) * per_cell - 0.5 - top
            x = (points[k, 0] - west) * per_cell - 0.5
            if not (first - 1.0 < y < last and -1.0 < x < columns):
                continue
            i, j = math.floor(y), math.floor(x)
            v, u = y - i, x - j
            height, variance = points[k, 2] - base_m, sigma[k] * sigma[k]
            if not (math.isfinite(height) and math.isfinite(variance)):
                continue
            for di in range(2):
                r = i + di
                if not first <= r < last:
                    continue
                w_row = v if di else 1.0 - v
                for dj in range(2):
                    c = j + dj
                    w = w_row * (u if dj else 1.0 - u)
                    if not (0 <= c < columns and w > 0.0):
                        continue
                    total = cells[r, c, 0] + w
                    off = height - cells[r, c, 1]
                    mean = cells[r, c, 1] + off * w / total
                    cells[r, c, 2] += w * off * (height - mean)
                    cells[r, c, 0] = total
                    cells[r, c, 1] = mean
                    cells[r, c, 3] += w * variance
                    cells[r, c, 4] += 1.0


@njit(cache=True, parallel=True, error_model="numpy")
def layers_of(cells: Layers, base_m: float, out: Layers) -> None:
    """Heights, counts and errors (3, rows, columns) of accumulated cells."""
    for i in prange(cells.shape[0]):
        for j in range(cells.shape[1]):
            weight = cells[i, j, 0]
            if weight >= _LEAST_WEIGHT:
                out[0, i, j] = cells[i, j, 1] + base_m
                out[1, i, j] = cells[i, j, 4]
                out[2, i, j] = math.sqrt((cells[i, j, 2] + cells[i, j, 3]) / weight)
            else:
                out[0, i, j] = math.nan
                out[1, i, j] = 0.0
                out[2, i, j] = math.nan
