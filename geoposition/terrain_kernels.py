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

from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray
from geoposition.constants import WGS84_A_M, WGS84_B_M, WGS84_E2
from geoposition.terrain_grid import LON_LAT, SCALAR, Grid, foot_point, grid_position
from geoposition.terrain_walk import (
    ABOVE,
    AT_START,
    CROSSED,
    HOLE,
    MISSED,
    OUTSIDE,
    OVER_HOLE,
    OVER_OUTSIDE,
    PASSED,
    patch,
    surface,
    walk,
)

UNSETTLED: Final = 5
BAD: Final = 6
"""Statuses beyond those of `terrain_walk`."""

_BATCH: Final = 256
_WALK_M3: Final = 1e-3
"""(expansion length)³ / (distance from the axis)² below which the walk is right to about 1 mm."""
_EXACT_M3: Final = 1e-6
"""The same for a result right to about 1 µm."""
_BACK_M: Final = 2.0
_SPAN_M: Final = 1000.0
_POLE_M: Final = 0.01
_MAX_SEGMENTS: Final = 20000
_SHELL_SLACK_M: Final = 1.0
"""More than a grown ellipsoid differs from the surface of the same height."""


@njit(**SCALAR)
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


@njit(**SCALAR)
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
    # at a pole the longitude stands still instead of spinning
    spins = p > _POLE_M
    inv_p = 1.0 / p if spins else 1.0 / _POLE_M
    cos_lon, sin_lon = (x * inv_p, y * inv_p) if spins else (1.0, 0.0)
    p_rate = cos_lon * dx + sin_lon * dy
    e = cos_lon * dy - sin_lon * dx
    n = cos_lat * dz - sin_lat * p_rate
    u = cos_lat * p_rate + sin_lat * dz
    w2 = 1.0 / (1.0 - WGS84_E2 * sin_lat * sin_lat)
    w = math.sqrt(w2)
    meridian = WGS84_A_M * (1.0 - WGS84_E2) * w2 * w
    inv_m = 1.0 / (meridian + h)
    lat1 = n * inv_m
    lon1 = e * inv_p if spins else 0.0
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
            max(p * p, _POLE_M * _POLE_M),
        )
    # any other grid: through this point and one on each side, near because the grid may bend
    row, col = grid_position(grid, x, y, p, cos_lat, sin_lat)
    row1 = row2 = col1 = col2 = 0.0
    for side in (-1.0, 1.0):
        span = side * _SPAN_M
        x_side, y_side = x + span * dx, y + span * dy
        cos_lat, sin_lat, p, _ = foot_point(x_side, y_side, z + span * dz)
        row_side, col_side = grid_position(grid, x_side, y_side, p, cos_lat, sin_lat)
        row1 += (row_side - row) / (2.0 * span)
        row2 += (row_side - row) / (2.0 * span * span)
        col1 += (col_side - col) / (2.0 * span)
        col2 += (col_side - col) / (2.0 * span * span)
    return row, row1, row2, col, col1, col2, h, u, h2, WGS84_A_M * WGS84_A_M


@njit(**SCALAR)
def _finish(
    grid: Grid,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    t: float,
    rate_row: float,
    rate_col: float,
) -> tuple[float, float, float, float]:
    """Newton steps with exact conversions: (range, lon, lat, height) of the crossing."""
    x, y, height = 0.0, 0.0, math.nan
    cos_lat, sin_lat = 1.0, 0.0
    for _ in range(10):
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        cos_lat, sin_lat, p, h = foot_point(x, y, z)
        row, col = grid_position(grid, x, y, p, cos_lat, sin_lat)
        ground, by_row, by_col = patch(grid.height_m, row, col)
        up = sin_lat * dz + cos_lat * (x * dx + y * dy) / p if p > 0.0 else sin_lat * dz
        step = (ground - h) / (up - by_row * rate_row - by_col * rate_col)
        height = h
        if abs(h - ground) < 1e-7 or not abs(step) < 1.0:
            break
        t += step
    return t, math.atan2(y, x), math.atan2(sin_lat, cos_lat), height


@njit(**SCALAR)
def _cross(
    grid: Grid,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    top_m: float,
    bottom_m: float,
    hint_m: float,
) -> tuple[int, float, float, float, float]:
    """(status, range, lon, lat, height) of one ray between two heights.

    Starting the expansion where the ray has height `hint_m` makes it fast, nothing else.
    """
    nan = math.nan
    centre, _ = shell_ranges(ox, oy, oz, dx, dy, dz, hint_m)
    if math.isnan(centre):
        centre = -(ox * dx + oy * dy + oz * dz)
    centre = max(centre, 0.0)
    start, end = centre, centre
    over = AT_START
    for segment in range(_MAX_SEGMENTS):
        r0, r1, r2, c0, c1, c2, h0, h1, h2, scale2 = _expand(grid, ox, oy, oz, dx, dy, dz, centre)
        limit = _WALK_M3 * scale2
        reach = -1.0
        if segment == 0:
            # the way from top to bottom, by the expansion where it reaches that far
            disc_top = h1 * h1 - 4.0 * h2 * (h0 - top_m)
            disc_bottom = h1 * h1 - 4.0 * h2 * (h0 - bottom_m)
            if h1 < 0.0 and disc_top > 0.0 and disc_bottom > 0.0:
                up = 2.0 * (h0 - top_m) / (-h1 + math.sqrt(disc_top)) + 0.01 / h1
                down = 2.0 * (h0 - bottom_m) / (-h1 + math.sqrt(disc_bottom)) - 0.01 / h1
                if centre + up >= 0.0 and -up * up * up < limit and down * down * down < limit:
                    start, end, reach = centre + up, centre + down, down
            if reach < 0.0:
                start, leave = shell_ranges(ox, oy, oz, dx, dy, dz, top_m + _SHELL_SLACK_M)
                if math.isnan(start) or leave < 0.0:
                    return MISSED, nan, nan, nan, nan
                start = max(start, 0.0)
                end, _ = shell_ranges(ox, oy, oz, dx, dy, dz, bottom_m - _SHELL_SLACK_M)
                if math.isnan(end):
                    end = leave
                if end < start:
                    return MISSED, nan, nan, nan, nan
                centre = start
                continue
        else:
            # shorter than allowed, since near a pole the allowance shrinks on the way
            reach = min(end - centre, max(0.7 * limit ** (1.0 / 3.0), 0.01))
        if math.isnan(r0 + c0):
            return OUTSIDE, nan, nan, nan, nan
        status, s, over = walk(
            grid.height_m,
            grid.maxima_m,
            grid.levels,
            r0,
            r1,
            r2,
            c0,
            c1,
            c2,
            h0,
            h1,
            h2,
            start - centre,
            reach,
            over,
        )
        if status == CROSSED:
            if abs(s) * s * s > _EXACT_M3 * scale2 or (grid.kind != LON_LAT and abs(s) > 100.0):
                centre += s
                start = max(centre - _BACK_M, start)
                over = ABOVE
                continue
            t = centre + s
            if t < 0.0:
                return MISSED, nan, nan, nan, nan
            if grid.kind != LON_LAT:
                t, lon, lat, height = _finish(
                    grid, ox, oy, oz, dx, dy, dz, t, r1 + 2.0 * s * r2, c1 + 2.0 * s * c2
                )
                return CROSSED, t, lon, lat, height
            row = r0 + s * (r1 + s * r2)
            col = c0 + s * (c1 + s * c2)
            g = grid.from_grid
            lon = g[0, 0] + g[0, 1] * row + g[0, 2] * col + grid.middle[4]
            lat = g[1, 0] + g[1, 1] * row + g[1, 2] * col + grid.middle[5]
            if lon > math.pi:
                lon -= 2.0 * math.pi
            elif lon <= -math.pi:
                lon += 2.0 * math.pi
            lat = min(max(lat, -0.5 * math.pi), 0.5 * math.pi)
            return CROSSED, t, lon, lat, h0 + s * (h1 + s * h2)
        if status != PASSED:
            return status, nan, nan, nan, nan
        if not centre + reach < end - 1e-6:
            if over == OVER_HOLE:
                return HOLE, nan, nan, nan, nan
            if over == OVER_OUTSIDE:
                return OUTSIDE, nan, nan, nan, nan
            return PASSED, nan, nan, nan, nan
        start = centre + reach
        centre = start
    return UNSETTLED, nan, nan, nan, nan


@njit(cache=True, parallel=True, error_model="numpy")
def crossings(
    grid: Grid,
    origin_ecef_m: FloatArray,
    direction_ecef: FloatArray,
    top_m: float,
    bottom_m: float,
    hint_m: FloatArray,
    status: FlagArray,
    range_m: FloatArray,
    geodetic: FloatArray,
) -> None:
    """Fill `status` (n,), `range_m` (n,) and `geodetic` (n, 3) for n rays.

    `hint_m` (n,) are heights near those expected, or empty: then each ray takes that of the
    one before.
    """
    n = origin_ecef_m.shape[0]
    for batch in prange(-(-n // _BATCH)):
        hint = 0.5 * (top_m + bottom_m)
        for k in range(batch * _BATCH, min((batch + 1) * _BATCH, n)):
            ox, oy, oz = origin_ecef_m[k, 0], origin_ecef_m[k, 1], origin_ecef_m[k, 2]
            dx, dy, dz = direction_ecef[k, 0], direction_ecef[k, 1], direction_ecef[k, 2]
            status[k] = BAD
            range_m[k] = geodetic[k, 0] = geodetic[k, 1] = geodetic[k, 2] = math.nan
            if not abs((ox + oy + oz) * (dx + dy + dz)) < math.inf:
                continue
            if hint_m.shape[0] > 0 and abs(hint_m[k]) < math.inf:
                hint = hint_m[k]
            status[k], range_m[k], geodetic[k, 0], geodetic[k, 1], geodetic[k, 2] = _cross(
                grid, ox, oy, oz, dx, dy, dz, top_m, bottom_m, hint
            )
            if status[k] == CROSSED:
                hint = geodetic[k, 2]


@njit(cache=True, parallel=True, error_model="numpy")
def heights(grid: Grid, lon_lat_rad: FloatArray, out: FloatArray, inside: FlagArray) -> None:
    """Fill `out` (n,) with heights at (lon, lat) (n, 2), `inside` where the grid reaches."""
    for k in prange(lon_lat_rad.shape[0]):
        lon, lat = lon_lat_rad[k, 0], lon_lat_rad[k, 1]
        cos_lat = math.cos(lat)
        row, col = grid_position(grid, math.cos(lon), math.sin(lon), 1.0, cos_lat, math.sin(lat))
        rows, cols = grid.height_m.shape
        # a border point may come out of the longitude's rounding a hair outside
        if -1e-6 <= row <= rows - 1 + 1e-6:
            row = min(max(row, 0.0), rows - 1.0)
        if -1e-6 <= col <= cols - 1 + 1e-6:
            col = min(max(col, 0.0), cols - 1.0)
        inside[k] = row >= 0.0 and col >= 0.0 and row <= rows - 1 and col <= cols - 1
        out[k] = surface(grid.height_m, row, col)


@njit(cache=True, parallel=True, error_model="numpy")
def bracket_directions(
    origin_ecef_m: FloatArray,
    direction_ecef: FloatArray,
    top_m: float,
    bottom_m: float,
    out: FloatArray,
) -> None:
    """Fill `out` (2 n, 3): directions of the normals where each ray enters the two heights.

    The normals are those of the ellipsoid, not unit, wrong by up to 50 m of ground at 12 km.
    NaN where a ray passes above the top or starts beyond it; a ray that never comes down to
    the bottom has the place where it leaves the top instead.
    """
    n = origin_ecef_m.shape[0]
    for k in prange(n):
        ox, oy, oz = origin_ecef_m[k, 0], origin_ecef_m[k, 1], origin_ecef_m[k, 2]
        dx, dy, dz = direction_ecef[k, 0], direction_ecef[k, 1], direction_ecef[k, 2]
        start, leave = shell_ranges(ox, oy, oz, dx, dy, dz, top_m + _SHELL_SLACK_M)
        end, _ = shell_ranges(ox, oy, oz, dx, dy, dz, bottom_m - _SHELL_SLACK_M)
        if math.isnan(end):
            end = leave
        if leave < 0.0 or end < 0.0:
            start = math.nan
        elif start < 0.0:
            start = 0.0
        for part in range(2):
            t = start if part == 0 else end
            row = k + part * n
            out[row, 0] = (ox + t * dx) * (1.0 / WGS84_A_M)
            out[row, 1] = (oy + t * dy) * (1.0 / WGS84_A_M)
            out[row, 2] = (oz + t * dz) * (1.0 / (WGS84_A_M * (1.0 - WGS84_E2)))
