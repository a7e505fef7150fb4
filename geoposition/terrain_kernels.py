"""Compiled: where lines of sight first meet a grid of heights, point by point in parallel.

Along a ray, (row, column, height) is expanded to second order about an exactly converted
point. The expansion serves within `_WALK_M3` of its centre to find the cell, and within
`_EXACT_M3` to give the result; beyond, it is made anew, so that results are right to about a
micrometre however long the way through the mountains is. The height found for the ray before
is where the next is expanded: neighbours need one conversion each.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray
from geoposition.constants import WGS84_A_M, WGS84_B_M, WGS84_E2
from geoposition.flags import Flag
from geoposition.terrain_grid import LON_LAT, Grid, foot_point, grid_position
from geoposition.terrain_walk import (
    AT_START,
    CROSSED,
    HOLE,
    OUTSIDE,
    OVER_HOLE,
    OVER_OUTSIDE,
    PASSED,
    surface,
    walk,
)

_BATCH: Final = 256
_WALK_M3: Final = 1e-3
"""(expansion length)³ / (distance from the axis)² below which the walk is right to about 1 mm."""
_EXACT_M3: Final = 1e-6
"""The same for a result right to about 1 µm."""
_BACK_M: Final = 2.0
_MAX_SEGMENTS: Final = 20000
_SHELL_SLACK_M: Final = 1.0
"""More than a grown ellipsoid differs from the surface of the same height."""


@njit(cache=True, error_model="numpy")
def shell_ranges(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, height_m: float
) -> tuple[float, float]:
    """Ranges where a ray enters and leaves the ellipsoid grown by `height_m`; NaN if never.

    The grown ellipsoid (a + h, b + h) is within 2 cm of the surface of height h up to 9 km.
    """
    p = 1.0 / (WGS84_A_M + height_m)
    q = 1.0 / (WGS84_B_M + height_m)
    ux, uy, uz = dx * p, dy * p, dz * q
    wx, wy, wz = ox * p, oy * p, oz * q
    a = ux * ux + uy * uy + uz * uz
    b = ux * wx + uy * wy + uz * wz
    # the distance of the line from the centre, without the cancellation of b² − ac
    cx, cy, cz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    root = math.sqrt(a - (cx * cx + cy * cy + cz * cz))
    return (-b - root) / a, (-b + root) / a


@njit(cache=True, error_model="numpy")
def _expand(
    grid: Grid,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    centre_m: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Coefficients (value, first, second) of row, column, height, and the length scale squared.

    For a lon/lat grid in closed form: with east, north and up components (e, n, u) of the
    direction, lon' = e / p, lon'' = −2 lon' p' / p, lat' = n / (M + h),
    lat'' = −(lat' u + lon' sin lat e + lat' (M' + u)) / (M + h), h' = u,
    h'' = lat' n + lon' cos lat e.
    """
    x, y, z = ox + centre_m * dx, oy + centre_m * dy, oz + centre_m * dz
    cos_lat, sin_lat, p, h = foot_point(x, y, z)
    inv_p = 1.0 / p if p > 1e-6 else 1e6
    cos_lon, sin_lon = (x * inv_p, y * inv_p) if p > 1e-6 else (1.0, 0.0)
    p_rate = cos_lon * dx + sin_lon * dy
    e = cos_lon * dy - sin_lon * dx
    n = cos_lat * dz - sin_lat * p_rate
    u = cos_lat * p_rate + sin_lat * dz
    w2 = 1.0 / (1.0 - WGS84_E2 * sin_lat * sin_lat)
    w = math.sqrt(w2)
    meridian = WGS84_A_M * (1.0 - WGS84_E2) * w2 * w
    inv_m = 1.0 / (meridian + h)
    lat1 = n * inv_m
    lon1 = e * inv_p
    h2 = 0.5 * (lat1 * n + e * e * cos_lat * inv_p)
    if grid.kind == LON_LAT:
        m_rate = 3.0 * meridian * WGS84_E2 * w2 * sin_lat * cos_lat * lat1
        lon2 = -lon1 * p_rate * inv_p
        lat2 = -0.5 * (lat1 * (2.0 * u + m_rate) + lon1 * sin_lat * e) * inv_m
        row, col = grid_position(grid, x, y, p, cos_lat, sin_lat)
        g = grid.to_grid
        return (
            row,
            g[0, 1] * lon1 + g[0, 2] * lat1,
            g[0, 1] * lon2 + g[0, 2] * lat2,
            col,
            g[1, 1] * lon1 + g[1, 2] * lat1,
            g[1, 1] * lon2 + g[1, 2] * lat2,
            h,
            u,
            h2,
            p * p,
        )
    # any other grid: through three points; they stay near because the grid may bend
    scale2 = WGS84_A_M * WGS84_A_M
    span = 1000.0
    row, col = grid_position(grid, x, y, p, cos_lat, sin_lat)
    x, y, z = x - span * dx, y - span * dy, z - span * dz
    cos_lat, sin_lat, p, _ = foot_point(x, y, z)
    row_a, col_a = grid_position(grid, x, y, p, cos_lat, sin_lat)
    x, y, z = x + 2.0 * span * dx, y + 2.0 * span * dy, z + 2.0 * span * dz
    cos_lat, sin_lat, p, _ = foot_point(x, y, z)
    row_b, col_b = grid_position(grid, x, y, p, cos_lat, sin_lat)
    k1, k2 = 0.5 / span, 0.5 / (span * span)
    return (
        row,
        (row_b - row_a) * k1,
        (row_a + row_b - 2.0 * row) * k2,
        col,
        (col_b - col_a) * k1,
        (col_a + col_b - 2.0 * col) * k2,
        h,
        u,
        h2,
        scale2,
    )
