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
from geoposition.constants import WGS84_A_M, WGS84_E2
from geoposition.terrain.grid import (
    FAST,
    LON_LAT,
    LONG,
    SCALAR,
    Grid,
    grid_position,
    normal_position,
)
from geoposition.terrain.series import (
    GROUP,
    TERMS,
    Bend,
    Triple,
    bend_group,
    grid_terms,
    series,
    shell_ranges,
)
from geoposition.terrain.straight_down import (
    FOUND,
    NORMAL,
    PLACE,
    ROWS,
    START,
    cross_group,
    place_group,
)
from geoposition.terrain.walk import (
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

_BATCH: Final = 2048
_WALK_M3: Final = 1e-3
"""(expansion length)³ / (distance from the axis)² below which the walk is right to about 1 mm."""
_EXACT_M3: Final = 1e-6
"""The same for a result right to about 1 µm."""
_TABLE_EXACT_M: Final = 100.0
"""Farther off, the place in a table is not a parabola of the range to `_finish` from."""
_BACK_M: Final = 2.0
_MAX_SEGMENTS: Final = 20000
_SHELL_SLACK_M: Final = 1.0
"""More than a grown ellipsoid differs from the surface of the same height."""


@njit(**SCALAR)
def _finish(
    grid: Grid,
    height: Triple,
    nx: Triple,
    ny: Triple,
    nz: Triple,
    s: float,
    rate_row: float,
    rate_col: float,
) -> tuple[float, float, float, float]:
    """Newton steps through the table itself: (s, lon, lat, height) of the crossing."""
    for _ in range(10):
        row, col = normal_position(
            grid,
            nx[0] + s * (nx[1] + s * nx[2]),
            ny[0] + s * (ny[1] + s * ny[2]),
            nz[0] + s * (nz[1] + s * nz[2]),
        )
        ground, by_row, by_col = patch(grid.height_m, row, col)
        up = height[1] + 2.0 * s * height[2]
        h = height[0] + s * (height[1] + s * height[2])
        step = (ground - h) / (up - by_row * rate_row - by_col * rate_col)
        if not abs(step) < 1.0:
            break
        s += step
        if abs(step) < 1e-3:  # what is left is of the order of its square
            break
    x = nx[0] + s * (nx[1] + s * nx[2])
    y = ny[0] + s * (ny[1] + s * ny[2])
    z = nz[0] + s * (nz[1] + s * nz[2])
    h = height[0] + s * (height[1] + s * height[2])
    return s, math.atan2(y, x), math.atan2(z, math.sqrt(x * x + y * y)), h


@njit(**SCALAR)
def _lon_lat(grid: Grid, row: float, col: float) -> tuple[float, float]:
    """Longitude within half a turn, and latitude, of a place in a `LON_LAT` grid."""
    g = grid.from_grid
    lon = g[0, 0] + g[0, 1] * row + g[0, 2] * col + grid.middle[4]
    lat = g[1, 0] + g[1, 1] * row + g[1, 2] * col + grid.middle[5]
    if lon > math.pi:
        lon -= 2.0 * math.pi
    elif lon <= -math.pi:
        lon += 2.0 * math.pi
    return lon, min(max(lat, -0.5 * math.pi), 0.5 * math.pi)


@njit(**LONG)
def _expand(
    rays: FloatArray, terms: FloatArray, bend_height_m: float, top_m: float, bottom_m: float
) -> None:
    """Expand a group of rays, each where it has its hint of a height (or is lowest).

    Two more terms follow those of `series`: how far it is to the top and to the bottom by the
    expansion, NaN where it gets there never or upwards.
    """
    for m in range(GROUP):
        ox, oy, oz = rays[m], rays[GROUP + m], rays[2 * GROUP + m]
        dx, dy, dz = rays[3 * GROUP + m], rays[4 * GROUP + m], rays[5 * GROUP + m]
        centre, _ = shell_ranges(ox, oy, oz, dx, dy, dz, rays[12 * GROUP + m])
        closest = -(ox * dx + oy * dy + oz * dz)
        centre = centre if centre == centre else closest
        centre = centre if centre > 0.0 else 0.0
        rays[13 * GROUP + m] = centre
        series(
            ox + centre * dx,
            oy + centre * dy,
            oz + centre * dz,
            dx,
            dy,
            dz,
            (rays[6 * GROUP + m], rays[7 * GROUP + m], rays[8 * GROUP + m]),
            (rays[9 * GROUP + m], rays[10 * GROUP + m], rays[11 * GROUP + m]),
            bend_height_m,
            terms,
            m,
        )
        h0, h1, h2 = terms[4 * GROUP + m], terms[5 * GROUP + m], terms[6 * GROUP + m]
        falls = h1 if h1 < 0.0 else math.nan
        top_root = math.sqrt(h1 * h1 - 4.0 * h2 * (h0 - top_m))
        bottom_root = math.sqrt(h1 * h1 - 4.0 * h2 * (h0 - bottom_m))
        slack = 0.01 / falls
        terms[TERMS * GROUP + m] = 2.0 * (h0 - top_m) / (top_root - falls) + slack
        terms[(TERMS + 1) * GROUP + m] = 2.0 * (h0 - bottom_m) / (bottom_root - falls) - slack


@njit(**SCALAR)
def _at(grid: Grid, terms: FloatArray, m: int, s: float) -> tuple[float, float, float, float]:
    """(s, lon, lat, height) of a crossing of ray `m` found at `s`."""
    height = _triple(terms, 4, m)
    row, col = _triple(terms, PLACE, m), _triple(terms, PLACE + 3, m)
    if grid.kind != LON_LAT:
        nx, ny, nz = (
            _triple(terms, NORMAL, m),
            _triple(terms, NORMAL + 3, m),
            _triple(terms, NORMAL + 6, m),
        )
        rate_row, rate_col = row[1] + 2.0 * s * row[2], col[1] + 2.0 * s * col[2]
        s, lon, lat, h = _finish(grid, height, nx, ny, nz, s, rate_row, rate_col)
        return s, lon, lat, h
    lon, lat = _lon_lat(
        grid, row[0] + s * (row[1] + s * row[2]), col[0] + s * (col[1] + s * col[2])
    )
    return s, lon, lat, height[0] + s * (height[1] + s * height[2])


@njit(**SCALAR)
def _triple(terms: FloatArray, first: int, m: int) -> Triple:
    return terms[first * GROUP + m], terms[(first + 1) * GROUP + m], terms[(first + 2) * GROUP + m]


@njit(**SCALAR)
def _cross(
    grid: Grid,
    bend_height_m: float,
    top_m: float,
    bottom_m: float,
    rays: FloatArray,
    terms: FloatArray,
    m: int,
) -> tuple[int, float, float, float, float]:
    """(status, range, lon, lat, height) of ray `m`, expanded about its hint in column m of `terms`.

    Column m of `rays`: origin, direction, B1, B2, hint, and the range of the expansion.
    """
    ox, oy, oz = rays[0 * GROUP + m], rays[1 * GROUP + m], rays[2 * GROUP + m]
    dx, dy, dz = rays[3 * GROUP + m], rays[4 * GROUP + m], rays[5 * GROUP + m]
    b1 = (rays[6 * GROUP + m], rays[7 * GROUP + m], rays[8 * GROUP + m])
    b2 = (rays[9 * GROUP + m], rays[10 * GROUP + m], rays[11 * GROUP + m])
    centre = rays[13 * GROUP + m]
    nan = math.nan
    start, end = centre, centre
    over = AT_START
    for segment in range(_MAX_SEGMENTS):
        if segment > 0:
            x, y, z = ox + centre * dx, oy + centre * dy, oz + centre * dz
            series(x, y, z, dx, dy, dz, b1, b2, bend_height_m, terms, m)
        row, col, nx, ny, nz, scale2 = grid_terms(grid, terms, m)
        h0, h1, h2 = terms[4 * GROUP + m], terms[5 * GROUP + m], terms[6 * GROUP + m]
        height = (h0, h1, h2)
        limit = _WALK_M3 * scale2
        reach = -1.0
        if segment == 0:
            # the way from top to bottom, by the expansion where it reaches that far
            up, down = terms[TERMS * GROUP + m], terms[(TERMS + 1) * GROUP + m]
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
        if math.isnan(row[0] + col[0]):
            return OUTSIDE, nan, nan, nan, nan
        status, s, over = walk(
            grid.height_m,
            grid.maxima_m,
            grid.levels,
            row,
            col,
            height,
            start - centre,
            reach,
            over,
            -1,
        )
        if status == CROSSED:
            if abs(s) * s * s > _EXACT_M3 * scale2 or (
                grid.kind != LON_LAT and abs(s) > _TABLE_EXACT_M
            ):
                centre += s
                start = max(centre - _BACK_M, start)
                over = ABOVE
                continue
            t = centre + s
            if t < 0.0:
                return MISSED, nan, nan, nan, nan
            if grid.kind != LON_LAT:
                s, lon, lat, h = _finish(
                    grid,
                    height,
                    nx,
                    ny,
                    nz,
                    s,
                    row[1] + 2.0 * s * row[2],
                    col[1] + 2.0 * s * col[2],
                )
                return CROSSED, centre + s, lon, lat, h
            lon, lat = _lon_lat(
                grid,
                row[0] + s * (row[1] + s * row[2]),
                col[0] + s * (col[1] + s * col[2]),
            )
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


@njit(**LONG)
def _cross_group(
    grid: Grid,
    bend_height_m: float,
    top_m: float,
    bottom_m: float,
    rays: FloatArray,
    terms: FloatArray,
    hint_m: float,
    exact_m: float,
    status: FlagArray,
    range_m: FloatArray,
    geodetic: FloatArray,
) -> float:
    """Cross the rays of a group; return the last height found, `hint_m` if none was."""
    for m in range(status.shape[0]):
        status[m] = BAD
        range_m[m] = geodetic[m, 0] = geodetic[m, 1] = geodetic[m, 2] = math.nan
        sums = rays[m] + rays[GROUP + m] + rays[2 * GROUP + m]
        sums *= rays[3 * GROUP + m] + rays[4 * GROUP + m] + rays[5 * GROUP + m]
        if not abs(sums) < math.inf:
            continue
        s = terms[FOUND * GROUP + m]
        start, end = terms[START * GROUP + m], terms[(TERMS + 1) * GROUP + m]
        scale2 = terms[7 * GROUP + m]
        if math.isnan(s) and end * end * end < _WALK_M3 * scale2 and start < end:
            # from the block's maximum on, cell by cell
            met, s, _ = walk(
                grid.height_m,
                grid.maxima_m,
                grid.levels,
                _triple(terms, PLACE, m),
                _triple(terms, PLACE + 3, m),
                _triple(terms, 4, m),
                start,
                end,
                ABOVE,
                0,
            )
            if met != CROSSED or not (abs(s) <= exact_m and abs(s) * s * s <= _EXACT_M3 * scale2):
                s = math.nan
        if rays[13 * GROUP + m] + s >= 0.0:
            status[m] = CROSSED
            s, geodetic[m, 0], geodetic[m, 1], geodetic[m, 2] = _at(grid, terms, m, s)
            range_m[m] = rays[13 * GROUP + m] + s
        else:
            status[m], range_m[m], geodetic[m, 0], geodetic[m, 1], geodetic[m, 2] = _cross(
                grid, bend_height_m, top_m, bottom_m, rays, terms, m
            )
        if status[m] == CROSSED:
            hint_m = geodetic[m, 2]
    return hint_m


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def crossings(
    grid: Grid,
    bend: Bend,
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

    `hint_m` (n,) are heights near those expected, or empty: then each group of rays takes
    that of the group before. Rays are expanded about the hint; that makes them fast, nothing
    else.
    """
    n = origin_ecef_m.shape[0]
    bent = bend.image_px.shape[0] > 0
    hinted = hint_m.shape[0] > 0
    exact_m = math.inf if grid.kind == LON_LAT else _TABLE_EXACT_M
    for batch in prange(-(-n // _BATCH)):
        hint = 0.5 * (top_m + bottom_m)
        terms = np.empty(ROWS * GROUP)
        rays = np.zeros(16 * GROUP)
        end = min((batch + 1) * _BATCH, n)
        for first in range(batch * _BATCH, end, GROUP):
            count = min(GROUP, end - first)
            for m in range(count):
                k = first + m
                for axis in range(3):
                    rays[axis * GROUP + m] = origin_ecef_m[k, axis]
                    rays[(3 + axis) * GROUP + m] = direction_ecef[k, axis]
                rays[12 * GROUP + m] = hint_m[k] if hinted else hint
            if bent:
                bend_group(bend, first, count, rays)
            _expand(rays, terms, bend.height_m, top_m, bottom_m)
            place_group(grid, terms)
            cross_group(grid, terms, _WALK_M3, _EXACT_M3, exact_m)
            hint = _cross_group(
                grid,
                bend.height_m,
                top_m,
                bottom_m,
                rays,
                terms,
                hint,
                exact_m,
                status[first : first + count],
                range_m[first : first + count],
                geodetic[first : first + count],
            )


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
