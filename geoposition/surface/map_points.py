"""Many ground points near each other to map coordinates: a polynomial instead of the projection.

Over a few kilometres a map projection is a low polynomial of longitude and latitude. It is
fitted to the true projection at nodes around the points and checked at others; where it misses
by more than `TOLERANCE_M` (in degrees the like of it), the projection itself is used.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FloatArray, as_components
from geoposition.datum import to_crs

TOLERANCE_M: Final = 1e-3

_FEW: Final = 2000
_NODES: Final = 7
_DEGREE_M: Final = 111e3
_FAST = {"contract", "arcp", "nsz", "reassoc"}
_POWERS: Final = np.array([(i, j) for i in range(5) for j in range(5 - i)])


def to_map(crs: str | int, geodetic: FloatArray, geographic: bool = False) -> FloatArray:
    """Coordinates (n, 3) in `crs` of ground points (n, 3); heights stay ellipsoidal.

    As `datum.to_crs`, within `TOLERANCE_M`. `geographic`: whether `crs` is in degrees.
    """
    points = np.ascontiguousarray(as_components(geodetic, 3, "geodetic"))
    if len(points) < _FEW:
        return _exact(crs, points)
    low, high = horizontal_bounds(points)
    if not np.isfinite(low).all():
        return _exact(crs, points)
    centre, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-9)
    node = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    nodes, checks = _square(node), _square(np.linspace(-1.0, 1.0, _NODES - 1))
    exact = _exact(crs, _there(nodes, centre, half, points[0, 2]))[:, :2]
    base = exact.mean(axis=0)
    solution = np.linalg.lstsq(_terms(nodes), exact - base, rcond=1e-13)[0]
    misfit = _terms(checks) @ solution + base
    misfit -= _exact(crs, _there(checks, centre, half, points[0, 2]))[:, :2]
    if not np.max(np.abs(misfit)) <= (TOLERANCE_M / _DEGREE_M if geographic else TOLERANCE_M):
        return _exact(crs, points)
    out = np.empty_like(points)
    grid = np.zeros((5, 5, 2))
    grid[_POWERS[:, 0], _POWERS[:, 1]] = solution
    _project(points, centre, 1.0 / half, base, grid, out)
    return out


def horizontal_bounds(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest of the first two columns of `points` (n, 3); NaN and rows with it aside.

    Infinities the wrong way round where there is no point.
    """
    bounds = np.array([np.inf, np.inf, -np.inf, -np.inf])
    _bounds(points, bounds)
    return bounds[:2], bounds[2:]


@njit(cache=True, error_model="numpy")
def _bounds(points: FloatArray, out: FloatArray) -> None:
    x0, y0, x1, y1 = out
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if math.isfinite(x + y):
            x0, y0, x1, y1 = min(x, x0), min(y, y0), max(x, x1), max(y, y1)
    out[0], out[1], out[2], out[3] = x0, y0, x1, y1


def _exact(crs: str | int, points: FloatArray) -> FloatArray:
    out = to_crs(crs, points)
    out[..., 2] = points[..., 2]
    return out


def _square(side: FloatArray) -> FloatArray:
    return np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)


def _there(place: FloatArray, centre: FloatArray, half: FloatArray, height_m: float) -> FloatArray:
    return np.column_stack([centre + half * place, np.full(len(place), height_m)])


def _terms(place: FloatArray) -> FloatArray:
    powers: FloatArray = np.prod(place[:, None, :] ** _POWERS, axis=-1)
    return powers


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _project(
    points: FloatArray,
    centre: FloatArray,
    scale: FloatArray,
    base: FloatArray,
    c: FloatArray,
    out: FloatArray,
) -> None:
    for i in prange(len(points)):
        x, y = (points[i, 0] - centre[0]) * scale[0], (points[i, 1] - centre[1]) * scale[1]
        for k in range(2):
            total = 0.0
            for p in range(4, -1, -1):
                inner = 0.0
                for q in range(4 - p, -1, -1):
                    inner = inner * y + c[p, q, k]
                total = total * x + inner
            out[i, k] = base[k] + total
        out[i, 2] = points[i, 2]
