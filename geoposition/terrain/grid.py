"""A grid of heights as the kernels see it: nodes, and the way from the Earth to them.

Two ways: grids of longitude and latitude are affine; every other grid goes through a table of
(row, column) over the gnomonic plane of the grid's middle, where every map projection is
smooth, poles and antimeridian included.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

from numba import njit

from geoposition.arrays import FloatArray, IntArray
from geoposition.constants import WGS84_A_M, WGS84_B_M, WGS84_E2

FAST: Final = {"contract", "arcp", "nsz"}
"""The freedoms of fast-math that NaN and infinity survive."""
SCALAR: Final[dict[str, Any]] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": FAST,
    "forceinline": True,
    "_nrt": False,
}
"""How small scalar kernels are compiled: inlined, since a grid's many fields are dear to pass
on, and without the runtime's reference counts, since they allocate nothing. Each halves the
time. An edit here needs the caches of those that inline it removed."""
LONG: Final[dict[str, Any]] = {**SCALAR, "forceinline": False}
"""How those are compiled that are too long to be inlined."""

LON_LAT: Final = 0
TABLE: Final = 1

_SECOND_E2_B: Final = WGS84_E2 / (1.0 - WGS84_E2) * WGS84_B_M


class Grid(NamedTuple):
    """Ellipsoidal heights at nodes, as the kernels need them.

    Attributes
    ----------
    height_m
        (rows, cols), NaN in holes.
    maxima_m, levels
        Pyramid of block maxima (`terrain_walk.pyramid`).
    lowest_m, highest_m
        Extremes of `height_m`.
    kind
        `LON_LAT` or `TABLE`.
    middle
        (cos lon, sin lon, cos lat, sin lat, lon, lat) of the middle (`LON_LAT`).
    to_grid, from_grid
        (2, 3) affine (1, lon, lat) → (row, col) and (1, row, col) → (lon, lat), angles counted
        from the middle, longitudes within half a turn of it (`LON_LAT`).
    axes
        (3, 3) rows: the middle's normal and the two axes of the gnomonic plane (`TABLE`).
    table, table_frame
        (n_v, n_u, 2) of (row, col), and (u of the first node, nodes per u, v ..., nodes per v).
    """

    height_m: FloatArray
    maxima_m: FloatArray
    levels: IntArray
    lowest_m: float
    highest_m: float
    kind: int
    middle: FloatArray
    to_grid: FloatArray
    from_grid: FloatArray
    axes: FloatArray
    table: FloatArray
    table_frame: FloatArray


@njit(**SCALAR)
def foot_point(x_m: float, y_m: float, z_m: float) -> tuple[float, float, float, float]:
    """Return (cos lat, sin lat, distance from the axis, height) without an angle.

    Latitude within 2 µm on the ground and height within 10 nm from −12 to 700 km.
    *Source*: Bowring 1985, Survey Review 28(218), eqs. 8 and 5.
    """
    p2 = x_m * x_m + y_m * y_m
    p = math.sqrt(p2)
    r = math.sqrt(p2 + z_m * z_m)
    s = WGS84_B_M * z_m * (r + _SECOND_E2_B)
    c = WGS84_A_M * p * r
    scale = 1.0 / math.sqrt(s * s + c * c)
    s *= scale
    c *= scale
    s = z_m + _SECOND_E2_B * s * s * s
    c = p - WGS84_E2 * WGS84_A_M * c * c * c
    scale = 1.0 / math.sqrt(s * s + c * c)
    s *= scale
    c *= scale
    return c, s, p, p * c + z_m * s - WGS84_A_M * math.sqrt(1.0 - WGS84_E2 * s * s)


@njit(**SCALAR)
def table_position(table: FloatArray, frame: FloatArray, u: float, v: float) -> tuple[float, float]:
    """Return (row, col) at (u, v): bilinear in the table, linear beyond its border."""
    fu = (u - frame[0]) * frame[1]
    fv = (v - frame[2]) * frame[3]
    if not (abs(fu) < 1e9 and abs(fv) < 1e9):
        return math.nan, math.nan
    n_v, n_u, _ = table.shape
    x = min(max(fu, 0.0), n_u - 1.0)
    y = min(max(fv, 0.0), n_v - 1.0)
    j = min(int(x), n_u - 2)
    i = min(int(y), n_v - 2)
    beyond_u, beyond_v = fu - x, fv - y
    x -= j
    y -= i
    a, b, c, d = table[i, j, 0], table[i, j + 1, 0], table[i + 1, j, 0], table[i + 1, j + 1, 0]
    by_u = (b - a) + (d - c - b + a) * y
    by_v = (c - a) + (d - c - b + a) * x
    row = a + (b - a) * x + by_v * y + by_u * beyond_u + by_v * beyond_v
    a, b, c, d = table[i, j, 1], table[i, j + 1, 1], table[i + 1, j, 1], table[i + 1, j + 1, 1]
    by_u = (b - a) + (d - c - b + a) * y
    by_v = (c - a) + (d - c - b + a) * x
    col = a + (b - a) * x + by_v * y + by_u * beyond_u + by_v * beyond_v
    return row, col


@njit(**SCALAR)
def _angle(cos: float, sin: float, cos_0: float, sin_0: float) -> float:
    """Angle of (cos, sin) beyond that of (cos_0, sin_0), within half a turn."""
    s = sin * cos_0 - cos * sin_0
    c = cos * cos_0 + sin * sin_0
    if c < 0.995:
        return math.atan2(s, c)
    # the arc sine's series: twice as fast as atan2, and right to rounding within 0.1 rad
    q = s * s
    tail = 945.0 / 42240.0 + q * (10395.0 / 599040.0)
    return s * (
        1.0
        + q * (1.0 / 6.0 + q * (3.0 / 40.0 + q * (15.0 / 336.0 + q * (105.0 / 3456.0 + q * tail))))
    )


@njit(**SCALAR)
def lon_lat_position(
    grid: Grid,
    cos_lon: float,
    sin_lon: float,
    cos_lat: float,
    sin_lat: float,
    more_lon: float,
    more_lat: float,
) -> tuple[float, float]:
    """Return (row, col) of a place, and a little more, in a `LON_LAT` grid."""
    lon = _angle(cos_lon, sin_lon, grid.middle[0], grid.middle[1]) + more_lon
    lat = _angle(cos_lat, sin_lat, grid.middle[2], grid.middle[3]) + more_lat
    g = grid.to_grid
    return g[0, 0] + g[0, 1] * lon + g[0, 2] * lat, g[1, 0] + g[1, 1] * lon + g[1, 2] * lat


@njit(**SCALAR)
def normal_position(grid: Grid, nx: float, ny: float, nz: float) -> tuple[float, float]:
    """Return (row, col) of a normal, of any length, in a `TABLE` grid; NaN far from it."""
    axes = grid.axes
    w = axes[0, 0] * nx + axes[0, 1] * ny + axes[0, 2] * nz
    if not w > 0.02:
        return math.nan, math.nan
    inv_w = 1.0 / w
    u = (axes[1, 0] * nx + axes[1, 1] * ny + axes[1, 2] * nz) * inv_w
    v = (axes[2, 0] * nx + axes[2, 1] * ny + axes[2, 2] * nz) * inv_w
    row, col = table_position(grid.table, grid.table_frame, u, v)
    return row, col


@njit(**SCALAR)
def grid_position(
    grid: Grid, x: float, y: float, p: float, cos_lat: float, sin_lat: float
) -> tuple[float, float]:
    """Return (row, col) over a foot point; (x, y, p) may be any multiple of the real ones."""
    if grid.kind == LON_LAT:
        k = 1.0 / p if p > 0.0 else 0.0
        row, col = lon_lat_position(grid, k * x, k * y, cos_lat, sin_lat, 0.0, 0.0)
        return row, col
    k = cos_lat / p if p > 0.0 else 0.0
    row, col = normal_position(grid, k * x, k * y, sin_lat)
    return row, col
