"""Build `Grid`s: a window of heights together with its proven way from the Earth.

The table of a projected grid is refined until its error is below `TABLE_TOLERANCE_PX`. The
error of bilinear interpolation is at most the sum of those along u and along v, and these are
measured against the projection itself at the middle of every cell's sides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.constants import WGS84_A_M
from geoposition.ellipsoid import enu_axes
from geoposition.errors import GeometryError
from geoposition.terrain.grid import LON_LAT, TABLE, Grid
from geoposition.terrain.walk import pyramid

TABLE_TOLERANCE_PX: Final = 1e-4
_MAX_TABLE_NODES: Final = 3_000_000
_MARGIN_RAD: Final = 5000.0 / WGS84_A_M
"""The kernels expand a ray by up to 3.5 km; the table reaches as far beyond the grid."""

PlaneMap: TypeAlias = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Two coordinates to two others, arrays of one shape."""

_NO_ARRAY: Final = np.zeros((0, 0))


def normals(lon_rad: FloatArray, lat_rad: FloatArray) -> FloatArray:
    """Return unit ellipsoid normals (..., 3) in ECEF."""
    cos_lat = np.cos(lat_rad)
    return np.stack(
        [cos_lat * np.cos(lon_rad), cos_lat * np.sin(lon_rad), np.sin(lat_rad)], axis=-1
    )


def plane_axes(normal: FloatArray) -> FloatArray:
    """Rows: `normal` (3,), then east and north there: the frame of a gnomonic plane."""
    lon = np.arctan2(normal[1], normal[0])
    lat = np.arctan2(normal[2], np.hypot(normal[0], normal[1]))
    axes = enu_axes(np.array([lon, lat, 0.0])).T
    return np.ascontiguousarray(axes[[2, 0, 1]])


def to_plane(axes: FloatArray, normal: FloatArray) -> FloatArray:
    """Gnomonic (u, v) (..., 2) of `normal` (..., 3); NaN beyond 84° from the middle."""
    w = normal @ axes[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv: FloatArray = (normal @ axes[1:].T) / np.where(w > 0.1, w, np.nan)[..., None]
    return uv


def from_plane(axes: FloatArray, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(lon_rad, lat_rad) of gnomonic coordinates."""
    normal = axes[0] + u[..., None] * axes[1] + v[..., None] * axes[2]
    lon = np.arctan2(normal[..., 1], normal[..., 0])
    return lon, np.arctan2(normal[..., 2], np.hypot(normal[..., 0], normal[..., 1]))


def _extremes(height_m: FloatArray) -> tuple[float, float]:
    lowest, highest = float(np.fmin.reduce(height_m, None)), float(np.fmax.reduce(height_m, None))
    return (0.0, 0.0) if np.isnan(lowest) else (lowest, highest)


def lon_lat_grid(height_m: FloatArray, from_grid: FloatArray) -> Grid:
    """Return the `Grid` of nodes at (lon, lat) = `from_grid` (2, 3) · (1, row, col), radians.

    The matrix may turn and shear; longitudes count without a seam, so a grid over the
    antimeridian just goes on beyond ±pi. A row of nodes at a pole is repeated beyond it, lest
    rounding puts a ray through the pole outside.
    """
    height_m, from_grid = _padded_at_poles(height_m, from_grid)
    rows, cols = height_m.shape
    lon, lat = from_grid @ np.array([1.0, 0.5 * (rows - 1), 0.5 * (cols - 1)])
    middle = np.array([np.cos(lon), np.sin(lon), np.cos(lat), np.sin(lat), 0.0, lat])
    middle[4] = np.arctan2(middle[1], middle[0])
    inverse = from_grid.copy()
    inverse[:, 0] -= lon, lat
    linear = np.linalg.inv(inverse[:, 1:])
    to_grid = np.column_stack([-linear @ inverse[:, 0], linear])
    maxima, levels = pyramid(height_m)
    lowest, highest = _extremes(height_m)
    return Grid(
        height_m,
        maxima,
        levels,
        lowest,
        highest,
        LON_LAT,
        middle,
        np.ascontiguousarray(to_grid),
        np.ascontiguousarray(inverse),
        _NO_ARRAY,
        np.zeros((0, 0, 2)),
        np.zeros(4),
    )


def _padded_at_poles(height_m: FloatArray, from_grid: FloatArray) -> tuple[FloatArray, FloatArray]:
    if from_grid[1, 2] != 0.0:
        return height_m, from_grid
    first = from_grid[1, 0]
    last = first + from_grid[1, 1] * (height_m.shape[0] - 1)
    at_pole = [abs(abs(lat) - 0.5 * np.pi) < 1e-9 for lat in (first, last)]
    if not any(at_pole):
        return height_m, from_grid
    shifted = from_grid.copy()
    shifted[:, 0] -= at_pole[0] * from_grid[:, 1]
    return np.pad(height_m, ((at_pole[0], at_pole[1]), (0, 0)), mode="edge"), shifted


def table_grid(height_m: FloatArray, to_grid: PlaneMap, from_grid: PlaneMap) -> Grid:
    """Return the `Grid` of nodes on any map.

    `to_grid` takes (lon, lat) in radians to (row, col), `from_grid` takes them back.

    Raises
    ------
    GeometryError
        The window is too wide for one plane, or the projection is not smooth in it.
    """
    rows, cols = height_m.shape
    along = np.linspace(0.0, 1.0, 33)
    border_row, border_col = np.meshgrid(along * (rows - 1), along * (cols - 1), indexing="ij")
    lon, lat = from_grid(np.array([0.5 * (rows - 1)]), np.array([0.5 * (cols - 1)]))
    axes = plane_axes(normals(lon, lat)[0])
    uv = to_plane(axes, normals(*from_grid(border_row, border_col))).reshape(-1, 2)
    if not np.all(np.isfinite(uv)):
        raise GeometryError("terrain: the window is wider than a plane can map")
    low, high = uv.min(axis=0), uv.max(axis=0)
    low, high = low - 0.01 * (high - low) - _MARGIN_RAD, high + 0.01 * (high - low) + _MARGIN_RAD
    table = _refined(axes, low, high, to_grid)
    maxima, levels = pyramid(height_m)
    lowest, highest = _extremes(height_m)
    n_v, n_u, _ = table.shape
    frame = [low[0], (n_u - 1) / (high[0] - low[0]), low[1], (n_v - 1) / (high[1] - low[1])]
    return Grid(
        height_m,
        maxima,
        levels,
        lowest,
        highest,
        TABLE,
        np.zeros(6),
        _NO_ARRAY,
        _NO_ARRAY,
        axes,
        table,
        np.array(frame),
    )


def _refined(axes: FloatArray, low: FloatArray, high: FloatArray, to_grid: PlaneMap) -> FloatArray:
    """Table of (row, col) (n_v, n_u, 2) that holds `TABLE_TOLERANCE_PX`."""
    step = 1e-3 * (high - low)
    middle = 0.5 * (low + high)
    cross = middle + step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    at_cross = np.stack(to_grid(*from_plane(axes, cross[:, 0], cross[:, 1])), axis=-1)
    slope = np.stack([at_cross[1] - at_cross[2], at_cross[3] - at_cross[4]]) / (2 * step[:, None])
    extent = 0.5 * np.abs(slope * (high - low)[:, None]).sum(axis=0) + 10.0

    def at(u: FloatArray, v: FloatArray) -> FloatArray:
        """Exact positions; NaN where the projection ends or jumps to the map's other side."""
        uv = np.stack(np.meshgrid(u, v), axis=-1)
        exact = np.stack(to_grid(*from_plane(axes, uv[..., 0], uv[..., 1])), axis=-1)
        straight = at_cross[0] + (uv - middle) @ slope
        with np.errstate(invalid="ignore"):
            jumped = ~np.all(np.abs(exact - straight) < 0.7 * extent, axis=-1)
        exact[jumped] = np.nan
        return exact

    n_u = n_v = 9
    while n_u * n_v <= _MAX_TABLE_NODES:
        u, v = np.linspace(low[0], high[0], n_u), np.linspace(low[1], high[1], n_v)
        table = at(u, v)
        along_u = np.abs(at(u[:-1] + 0.5 * np.diff(u), v) - 0.5 * (table[:, 1:] + table[:, :-1]))
        along_v = np.abs(at(u, v[:-1] + 0.5 * np.diff(v)) - 0.5 * (table[1:] + table[:-1]))
        worst_u = float(np.max(along_u, initial=0.0, where=np.isfinite(along_u)))
        worst_v = float(np.max(along_v, initial=0.0, where=np.isfinite(along_v)))
        if worst_u + worst_v <= TABLE_TOLERANCE_PX:
            return _continued(table)
        # errors go with the square of the step; each direction may have half of the bound
        n_u = int((n_u - 1) * _growth(worst_u)) + 2
        n_v = int((n_v - 1) * _growth(worst_v)) + 2
    raise GeometryError("terrain: the map projection is not smooth within the window")


def _growth(error_px: float) -> float:
    return float(np.clip(1.05 * np.sqrt(2.0 * error_px / TABLE_TOLERANCE_PX), 1.0, 16.0))


def _continued(table: FloatArray) -> FloatArray:
    """`table` with its NaN, beyond the end of a projection, continued as a cubic.

    No node of the grid is there; but rays near the border are expanded across it.
    """
    lost = ~np.all(np.isfinite(table), axis=-1)
    if lost.any():
        n_v, n_u, _ = table.shape
        v, u = np.meshgrid(np.linspace(-1, 1, n_v), np.linspace(-1, 1, n_u), indexing="ij")
        terms = np.stack([u**i * v**j for i in range(4) for j in range(4 - i)], axis=-1)
        coefficients = np.linalg.lstsq(terms[~lost], table[~lost], rcond=None)[0]
        table[lost] = terms[lost] @ coefficients
    return np.ascontiguousarray(table)
