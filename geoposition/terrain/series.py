"""Compiled: a line of sight, straight or bent, as polynomials of its range near one point."""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray
from geoposition.constants import WGS84_A_M, WGS84_B_M, WGS84_E2
from geoposition.terrain.grid import (
    LON_LAT,
    LONG,
    SCALAR,
    Grid,
    foot_point,
    lon_lat_position,
    normal_position,
)

SPAN_M: Final = 1000.0
"""A table's map is expanded through points so far from the centre."""
POLE_M: Final = 0.01
"""Within this of the axis the longitude stands still instead of spinning."""
GROUP: Final = 32
"""Rays expanded together. Their numbers are kept in flat arrays, number i of ray m at
i `GROUP` + m: with all distances constant the compiler uses the processor's vectors."""
TERMS: Final = 19


class Bend(NamedTuple):
    """How rays leave their straight lines: coefficients of one offset in ECEF.

    A point of height h of the ray of image point (line, sample) is off the straight ray by
    B1 d + B2 d² metres, d = h − `height_m`; B1, B2 are cubics in l = (line − `centre` 0) /
    `scale` 0 and s likewise: `coefficients` (2, 10, 3) of 1, l, s, l², ls, s², l³, l²s, ls², s³.
    Without `image_px` (n, 2), when that is empty, rays are straight.
    """

    image_px: FloatArray
    coefficients: FloatArray
    centre: FloatArray
    scale: FloatArray
    height_m: float


STRAIGHT: Final = Bend(np.zeros((0, 2)), np.zeros((2, 10, 3)), np.zeros(2), np.ones(2), 0.0)
Triple: TypeAlias = tuple[float, float, float]


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


@njit(**LONG)
def bend_group(bend: Bend, first: int, count: int, rays: FloatArray) -> None:
    """Fill numbers 6 to 11 of the group's `rays`, B1 and B2, for the rays from `first` on.

    Numbers 14 and 15 are left with the scaled line and sample.
    """
    c = bend.coefficients
    for m in range(count):
        rays[14 * GROUP + m] = (bend.image_px[first + m, 0] - bend.centre[0]) * bend.scale[0]
        rays[15 * GROUP + m] = (bend.image_px[first + m, 1] - bend.centre[1]) * bend.scale[1]
    for order in range(2):
        for axis in range(3):
            c0, c1, c2 = c[order, 0, axis], c[order, 1, axis], c[order, 2, axis]
            c3, c4, c5 = c[order, 3, axis], c[order, 4, axis], c[order, 5, axis]
            c6, c7, c8 = c[order, 6, axis], c[order, 7, axis], c[order, 8, axis]
            c9 = c[order, 9, axis]
            row = (6 + 3 * order + axis) * GROUP
            for m in range(GROUP):
                i, j = rays[14 * GROUP + m], rays[15 * GROUP + m]
                rays[row + m] = (
                    c0 + i * (c1 + i * (c3 + i * c6)) + j * (c2 + j * (c5 + j * c9))
                ) + i * j * (c4 + i * c7 + j * c8)


@njit(**SCALAR)
def series(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    b1: Triple,
    b2: Triple,
    bend_height_m: float,
    out: FloatArray,
    m: int,
) -> None:
    """Expand a ray about its point (x, y, z) into column m of `out`, without a branch.

    With east, north and up components (e, n, u) of the direction, radii N and M, p from the
    axis, a = e / (N + h), b = n / (M + h): lon' = e / p, lon'' = −2 lon' p' / p, lat' = b,
    lat'' = −(b (2 u + M') + lon' sin lat e) / (M + h), h' = u, h'' = b n + a e. For the normal:
    a E + b N, and κ (n E + e N) − a (2 u + N') / (N + h) E − b (2 u + M') / (M + h) N
    − (a² + b²) U, with κ = −a e² N sin lat cos lat / (W² (N + h) (M + h)), W² = 1 − e² sin² lat.

    A bent ray is its straight line plus B1 d + B2 d², with d as a polynomial of the range.
    """
    cos_lat, sin_lat, p, h = foot_point(x, y, z)
    spins = p > POLE_M
    inv_p = 1.0 / p if spins else 1.0 / POLE_M
    cos_lon = x * inv_p if spins else 1.0
    sin_lon = y * inv_p if spins else 0.0
    w2 = 1.0 / (1.0 - WGS84_E2 * sin_lat * sin_lat)
    normal = WGS84_A_M * math.sqrt(w2)
    meridian = normal * (1.0 - WGS84_E2) * w2
    inv_m = 1.0 / (meridian + h)
    inv_n = 1.0 / (normal + h)

    d = h - bend_height_m
    rate_x, rate_y, rate_z = (
        b1[0] + 2.0 * b2[0] * d,
        b1[1] + 2.0 * b2[1] * d,
        b1[2] + 2.0 * b2[2] * d,
    )
    straight_up = cos_lat * (cos_lon * dx + sin_lon * dy) + sin_lat * dz
    off_x, off_y, off_z = (
        (b1[0] + b2[0] * d) * d,
        (b1[1] + b2[1] * d) * d,
        (b1[2] + b2[2] * d) * d,
    )
    dx, dy, dz = dx + rate_x * straight_up, dy + rate_y * straight_up, dz + rate_z * straight_up

    p_rate = cos_lon * dx + sin_lon * dy
    e = cos_lon * dy - sin_lon * dx
    n = cos_lat * dz - sin_lat * p_rate
    u = cos_lat * p_rate + sin_lat * dz
    a, b = e * inv_n, n * inv_m
    h2 = 0.5 * (b * n + a * e)
    # what the offset adds at second order, and itself
    up2 = straight_up * straight_up
    add_x, add_y, add_z = (
        rate_x * h2 + b2[0] * up2,
        rate_y * h2 + b2[1] * up2,
        rate_z * h2 + b2[2] * up2,
    )
    add_p = cos_lon * add_x + sin_lon * add_y
    add_e = cos_lon * add_y - sin_lon * add_x
    add_n = cos_lat * add_z - sin_lat * add_p
    off_p = cos_lon * off_x + sin_lon * off_y
    off_e = cos_lon * off_y - sin_lon * off_x
    off_n = cos_lat * off_z - sin_lat * off_p

    bend = WGS84_E2 * w2 * sin_lat * cos_lat
    m_rate = 3.0 * meridian * bend * b
    lon1 = e * inv_p if spins else 0.0
    kappa = -a * bend * normal * inv_n * inv_m
    out[0 * GROUP + m] = cos_lon
    out[1 * GROUP + m] = sin_lon
    out[2 * GROUP + m] = cos_lat
    out[3 * GROUP + m] = sin_lat
    out[4 * GROUP + m] = h + cos_lat * off_p + sin_lat * off_z
    out[5 * GROUP + m] = u
    out[6 * GROUP + m] = h2 + cos_lat * add_p + sin_lat * add_z
    out[7 * GROUP + m] = p * p
    out[8 * GROUP + m] = off_e * inv_p if spins else 0.0
    out[9 * GROUP + m] = lon1
    out[10 * GROUP + m] = -lon1 * p_rate * inv_p + (add_e * inv_p if spins else 0.0)
    out[11 * GROUP + m] = off_n * inv_m
    out[12 * GROUP + m] = b
    out[13 * GROUP + m] = (add_n - 0.5 * (b * (2.0 * u + m_rate) + lon1 * sin_lat * e)) * inv_m
    out[14 * GROUP + m] = off_e * inv_n
    out[15 * GROUP + m] = a
    out[16 * GROUP + m] = (
        add_e - 0.5 * a * (2.0 * u + normal * bend * b)
    ) * inv_n + 0.5 * kappa * n
    out[17 * GROUP + m] = (add_n - 0.5 * b * (2.0 * u + m_rate)) * inv_m + 0.5 * kappa * e
    out[18 * GROUP + m] = -0.5 * (a * a + b * b)


@njit(**SCALAR)
def grid_terms(
    grid: Grid, terms: FloatArray, m: int
) -> tuple[Triple, Triple, Triple, Triple, Triple, float]:
    """Polynomials of row and column, and of the normal for a table, from `series`.

    The last is the square of the length that scales the third order.
    """
    cos_lon, sin_lon, cos_lat, sin_lat = (
        terms[0 * GROUP + m],
        terms[1 * GROUP + m],
        terms[2 * GROUP + m],
        terms[3 * GROUP + m],
    )
    lat1 = terms[12 * GROUP + m]
    if grid.kind == LON_LAT:
        row, col = lon_lat_position(
            grid, cos_lon, sin_lon, cos_lat, sin_lat, terms[8 * GROUP + m], terms[11 * GROUP + m]
        )
        lon1, lon2, lat2 = terms[9 * GROUP + m], terms[10 * GROUP + m], terms[13 * GROUP + m]
        g = grid.to_grid
        none = (0.0, 0.0, 0.0)
        return (
            (row, g[0, 1] * lon1 + g[0, 2] * lat1, g[0, 1] * lon2 + g[0, 2] * lat2),
            (col, g[1, 1] * lon1 + g[1, 2] * lat1, g[1, 1] * lon2 + g[1, 2] * lat2),
            none,
            none,
            none,
            max(terms[7 * GROUP + m], POLE_M * POLE_M),
        )
    off_e, a, east2 = terms[14 * GROUP + m], terms[15 * GROUP + m], terms[16 * GROUP + m]
    off_n, north2, up2 = terms[11 * GROUP + m], terms[17 * GROUP + m], terms[18 * GROUP + m]
    nx = (
        cos_lat * cos_lon - off_e * sin_lon - off_n * sin_lat * cos_lon,
        -a * sin_lon - lat1 * sin_lat * cos_lon,
        -east2 * sin_lon - north2 * sin_lat * cos_lon + up2 * cos_lat * cos_lon,
    )
    ny = (
        cos_lat * sin_lon + off_e * cos_lon - off_n * sin_lat * sin_lon,
        a * cos_lon - lat1 * sin_lat * sin_lon,
        east2 * cos_lon - north2 * sin_lat * sin_lon + up2 * cos_lat * sin_lon,
    )
    nz = (sin_lat + off_n * cos_lat, lat1 * cos_lat, north2 * cos_lat + up2 * sin_lat)
    # through this point and one on each side, near because the table's map bends too
    row, col = normal_position(grid, nx[0], ny[0], nz[0])
    row1 = row2 = col1 = col2 = 0.0
    for side in (-1.0, 1.0):
        t = side * SPAN_M
        row_side, col_side = normal_position(
            grid,
            nx[0] + t * (nx[1] + t * nx[2]),
            ny[0] + t * (ny[1] + t * ny[2]),
            nz[0] + t * (nz[1] + t * nz[2]),
        )
        row1 += (row_side - row) * (0.5 / t)
        row2 += (row_side - row) * (0.5 / (t * t))
        col1 += (col_side - col) * (0.5 / t)
        col2 += (col_side - col) * (0.5 / (t * t))
    return (row, row1, row2), (col, col1, col2), nx, ny, nz, WGS84_A_M * WGS84_A_M
