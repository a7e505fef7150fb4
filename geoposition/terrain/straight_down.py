"""Compiled: the common case of a crossing, a ray that comes down to its point unhindered.

Newton's steps from the expansion's centre find a crossing; that it is the first one is then
proved with the pyramid of block maxima, without following the ray. The ray is above the
maximum of each block around the point until it is over the next smaller block, down to the
point's cell. In that cell height above ground is a parabola, positive where the ray enters:
a root where it falls is the first. Where one of this does not hold nothing is said, and the
ray has to be followed.
"""

from __future__ import annotations

import math
from typing import Final

from numba import njit

from geoposition.arrays import FloatArray
from geoposition.terrain.grid import LON_LAT, LONG, SCALAR, Grid
from geoposition.terrain.series import GROUP, POLE_M, TERMS, grid_terms
from geoposition.terrain.walk import BLOCK_BITS

PLACE: Final = TERMS + 2
"""Row of `terms` where six numbers begin: the polynomials of row and column."""
NORMAL: Final = PLACE + 6
"""Row where nine numbers begin: the polynomials of the normal, for a `TABLE` grid."""
FOUND: Final = NORMAL + 9
"""Row of `terms` with the crossing relative to the centre, NaN where it is not proved."""
STEP: Final = FOUND + 1
CELL: Final = STEP + 1
BOX: Final = CELL + 2
CORNERS: Final = BOX + 2
LIMIT: Final = CORNERS + 4
RIGHT: Final = LIMIT + 1
"""Rows of intermediate results; `RIGHT` is 0, or NaN where the proof failed."""
START: Final = RIGHT + 1
"""Row with the range at which the ray is down to the maximum of its point's smallest block,
and to which it is proved to be above the ground; NaN where it is not."""
ROWS: Final = START + 1

_STEPS: Final = 4
_ENOUGH_M: Final = 1e-3
"""A Newton step so small leaves an error of the order of its square."""


@njit(**SCALAR)
def _arc(cos: float, sin: float, cos_0: float, sin_0: float) -> tuple[float, float]:
    """Angle beyond (cos_0, sin_0) by the arc sine's series, and the cosine that bounds it."""
    s = sin * cos_0 - cos * sin_0
    q = s * s
    tail = 945.0 / 42240.0 + q * (10395.0 / 599040.0)
    return s * (
        1.0
        + q * (1.0 / 6.0 + q * (3.0 / 40.0 + q * (15.0 / 336.0 + q * (105.0 / 3456.0 + q * tail))))
    ), cos * cos_0 + sin * sin_0


@njit(**LONG)
def place_group(grid: Grid, terms: FloatArray) -> None:
    """Fill the rows `PLACE` ... of `terms` for a group of expanded rays."""
    if grid.kind != LON_LAT:
        for m in range(GROUP):
            row, col, nx, ny, nz, _ = grid_terms(grid, terms, m)
            for order in range(3):
                terms[(PLACE + order) * GROUP + m] = row[order]
                terms[(PLACE + 3 + order) * GROUP + m] = col[order]
                terms[(NORMAL + order) * GROUP + m] = nx[order]
                terms[(NORMAL + 3 + order) * GROUP + m] = ny[order]
                terms[(NORMAL + 6 + order) * GROUP + m] = nz[order]
        return
    g = grid.to_grid
    g00, g01, g02, g10, g11, g12 = g[0, 0], g[0, 1], g[0, 2], g[1, 0], g[1, 1], g[1, 2]
    cos_lon0, sin_lon0 = grid.middle[0], grid.middle[1]
    cos_lat0, sin_lat0 = grid.middle[2], grid.middle[3]
    far = False
    for m in range(GROUP):
        lon, near_lon = _arc(terms[m], terms[GROUP + m], cos_lon0, sin_lon0)
        lat, near_lat = _arc(terms[2 * GROUP + m], terms[3 * GROUP + m], cos_lat0, sin_lat0)
        far |= not (near_lon > 0.995 and near_lat > 0.995)
        lon += terms[8 * GROUP + m]
        lat += terms[11 * GROUP + m]
        lon1, lon2 = terms[9 * GROUP + m], terms[10 * GROUP + m]
        lat1, lat2 = terms[12 * GROUP + m], terms[13 * GROUP + m]
        terms[PLACE * GROUP + m] = g00 + g01 * lon + g02 * lat
        terms[(PLACE + 1) * GROUP + m] = g01 * lon1 + g02 * lat1
        terms[(PLACE + 2) * GROUP + m] = g01 * lon2 + g02 * lat2
        terms[(PLACE + 3) * GROUP + m] = g10 + g11 * lon + g12 * lat
        terms[(PLACE + 4) * GROUP + m] = g11 * lon1 + g12 * lat1
        terms[(PLACE + 5) * GROUP + m] = g11 * lon2 + g12 * lat2
    if far:  # the series does not reach so far from the grid's middle
        for m in range(GROUP):
            row, col, _, _, _, _ = grid_terms(grid, terms, m)
            terms[PLACE * GROUP + m] = row[0]
            terms[(PLACE + 3) * GROUP + m] = col[0]


@njit(**SCALAR)
def _at(terms: FloatArray, first: int, m: int, s: float) -> float:
    """Value at `s` of the parabola in the rows `first` ... of `terms`."""
    second = terms[(first + 2) * GROUP + m]
    value: float = terms[first * GROUP + m] + s * (terms[(first + 1) * GROUP + m] + s * second)
    return value


@njit(**SCALAR)
def _rate(terms: FloatArray, first: int, m: int, s: float) -> float:
    """Its derivative."""
    rate: float = terms[(first + 1) * GROUP + m] + 2.0 * s * terms[(first + 2) * GROUP + m]
    return rate


@njit(**SCALAR)
def _within(terms: FloatArray, m: int, s: float, size: float) -> bool:
    """Whether ray `m` is over its box, `size` cells wide, at `s`; false for NaN."""
    row = _at(terms, PLACE, m, s) - terms[BOX * GROUP + m]
    col = _at(terms, PLACE + 3, m, s) - terms[(BOX + 1) * GROUP + m]
    within: bool = (row >= 0.0) & (row <= size) & (col >= 0.0) & (col <= size)
    return within


@njit(**LONG)
def cross_group(
    grid: Grid, terms: FloatArray, walk_m3: float, exact_m3: float, exact_m: float
) -> None:
    """Fill the row `FOUND` of `terms`: first crossings where they can be proved, else NaN.

    `walk_m3` and `exact_m3` bound the cube of the ranges within which the expansion serves to
    find the cell and to give the result, over the squared distance from the axis; `exact_m`
    bounds the latter too.
    """
    height_m, maxima_m, levels = grid.height_m, grid.maxima_m, grid.levels
    rows, cols = height_m.shape
    last_row, last_col = rows - 2.0, cols - 2.0
    for m in range(GROUP):
        terms[FOUND * GROUP + m] = 0.0
    # In turns: places by vectors, heights one by one, steps by vectors.
    for _ in range(_STEPS):
        for m in range(GROUP):
            s = terms[FOUND * GROUP + m]
            row = _at(terms, PLACE, m, s)
            col = _at(terms, PLACE + 3, m, s)
            # written so that NaN becomes 0
            row = row if row > 0.0 else 0.0
            col = col if col > 0.0 else 0.0
            terms[CELL * GROUP + m] = math.floor(row if row < last_row else last_row)
            terms[(CELL + 1) * GROUP + m] = math.floor(col if col < last_col else last_col)
        for m in range(GROUP):
            i, j = int(terms[CELL * GROUP + m]), int(terms[(CELL + 1) * GROUP + m])
            terms[CORNERS * GROUP + m] = height_m[i, j]
            terms[(CORNERS + 1) * GROUP + m] = height_m[i, j + 1]
            terms[(CORNERS + 2) * GROUP + m] = height_m[i + 1, j]
            terms[(CORNERS + 3) * GROUP + m] = height_m[i + 1, j + 1]
        for m in range(GROUP):
            s = terms[FOUND * GROUP + m]
            y = _at(terms, PLACE, m, s) - terms[CELL * GROUP + m]
            x = _at(terms, PLACE + 3, m, s) - terms[(CELL + 1) * GROUP + m]
            z00 = terms[CORNERS * GROUP + m]
            by_x = terms[(CORNERS + 1) * GROUP + m] - z00
            by_y = terms[(CORNERS + 2) * GROUP + m] - z00
            by_xy = terms[(CORNERS + 3) * GROUP + m] - z00 - by_x - by_y
            slope = (
                _rate(terms, 4, m, s)
                - (by_y + by_xy * x) * _rate(terms, PLACE, m, s)
                - (by_x + by_xy * y) * _rate(terms, PLACE + 3, m, s)
            )
            step = (z00 + by_x * x + (by_y + by_xy * x) * y - _at(terms, 4, m, s)) / slope
            terms[FOUND * GROUP + m] = s + step
            terms[STEP * GROUP + m] = step if slope < 0.0 else math.nan
    # the last step's cell must hold the point, and the ray must fall there
    for m in range(GROUP):
        s = terms[FOUND * GROUP + m]
        scale2 = max(terms[7 * GROUP + m], POLE_M * POLE_M)
        right = (
            (abs(terms[STEP * GROUP + m]) <= _ENOUGH_M)
            & (abs(s) <= exact_m)
            & (abs(s) * s * s <= exact_m3 * scale2)
            & (_rate(terms, 4, m, s) < 0.0)
        )
        terms[BOX * GROUP + m] = terms[CELL * GROUP + m]
        terms[(BOX + 1) * GROUP + m] = terms[(CELL + 1) * GROUP + m]
        right &= _within(terms, m, s, 1.0)
        terms[RIGHT * GROUP + m] = 0.0 if right else math.nan
    size = 1.0
    for level in range(levels.shape[0]):
        bits = BLOCK_BITS * (level + 1)
        first, stride = levels[level, 0], levels[level, 2]
        for m in range(GROUP):
            i, j = int(terms[CELL * GROUP + m]), int(terms[(CELL + 1) * GROUP + m])
            terms[LIMIT * GROUP + m] = maxima_m[first + (i >> bits) * stride + (j >> bits)]
        wider = float(1 << bits)
        for m in range(GROUP):
            s = terms[FOUND * GROUP + m]
            scale2 = max(terms[7 * GROUP + m], POLE_M * POLE_M)
            # a ray's height is convex: its tangent is at the maximum no later than the ray
            up = s + (terms[LIMIT * GROUP + m] - _at(terms, 4, m, s)) / _rate(terms, 4, m, s)
            right = _within(terms, m, up, size) & (-up * up * up < walk_m3 * scale2)
            doubt = 0.0 if right else math.nan
            terms[RIGHT * GROUP + m] += doubt
            start = up if level == 0 else terms[START * GROUP + m] + doubt
            terms[START * GROUP + m] = start
            for part in range(2):
                low = math.floor(terms[(CELL + part) * GROUP + m] / wider) * wider
                terms[(BOX + part) * GROUP + m] = low
        size = wider
    for m in range(GROUP):
        terms[FOUND * GROUP + m] += terms[RIGHT * GROUP + m]
