"""Heights over a mesh: where the mesh's nodes lie among a raster's own.

Between nodes that are close together the way from a map to a raster's pixels is a straight line,
so that the map's pixels find their heights without a thought for the Earth's shape.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from geoposition.arrays import FloatArray
from geoposition.terrain.grid import Grid, grid_position
from geoposition.terrain.raster import RasterTerrain
from geoposition.terrain.surfaces import Terrain
from geoposition.terrain.walk import surface

__all__ = ["HeightMesh", "height_mesh", "surface"]


@dataclass(frozen=True, slots=True, eq=False)
class HeightMesh:
    """Heights `height_m` (rows, cols) of a raster, NaN in holes.

    `place` (r, c, 2) is (row, col) there of each of the mesh's nodes; `lowest_m` and `highest_m`
    are the extremes of what lies among them.
    """

    height_m: FloatArray
    place: FloatArray
    lowest_m: float
    highest_m: float


def height_mesh(terrain: Terrain, lon_lat_rad: FloatArray) -> HeightMesh | None:
    """Heights over the mesh of nodes `lon_lat_rad` (r, c, 2); none if it is no raster's window."""
    if not isinstance(terrain, RasterTerrain) or not np.isfinite(lon_lat_rad).all():
        return None
    grid = terrain.grid_over(lon_lat_rad)
    if grid is None:
        return None
    place = np.empty(lon_lat_rad.shape)
    _places(grid, np.ascontiguousarray(lon_lat_rad), place)
    last = np.array(grid.height_m.shape) - 1
    if not np.isfinite(place).all():
        return None
    low = np.clip(np.floor(place.min(axis=(0, 1))).astype(int), 0, last)
    high = np.clip(np.ceil(place.max(axis=(0, 1))).astype(int), 0, last)
    part = grid.height_m[low[0] : high[0] + 1, low[1] : high[1] + 1]
    known = part[np.isfinite(part)]
    if not known.size:
        return None
    return HeightMesh(grid.height_m, place, float(known.min()), float(known.max()))


@njit(cache=True, parallel=True, error_model="numpy")
def _places(grid: Grid, lon_lat_rad: FloatArray, out: FloatArray) -> None:
    for i in prange(lon_lat_rad.shape[0]):
        for j in range(lon_lat_rad.shape[1]):
            lon, lat = lon_lat_rad[i, j, 0], lon_lat_rad[i, j, 1]
            cos_lat = math.cos(lat)
            out[i, j] = grid_position(
                grid, math.cos(lon), math.sin(lon), 1.0, cos_lat, math.sin(lat)
            )
