"""Compiled: follow a ray, given by second-order polynomials, down onto a grid of heights.

A pyramid of block maxima lets the ray skip what it is above of; below, it goes cell by cell
(after Amanatides and Woo 1987) and solves each bilinear patch, so no ridge is stepped over.

A hole, or the ground outside the grid, is taken to be no higher than the known ground next to
it: a ray that passes over it and comes out above the surface goes on; one that sinks below its
block's maximum while over the hole, or comes out below the surface, met it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FloatArray, IntArray
from geoposition.terrain.grid import LONG, SCALAR

CROSSED: Final = 0
PASSED: Final = 1
"""Above the surface down to the end of the ray."""
HOLE: Final = 2
OUTSIDE: Final = 3
MISSED: Final = 4
"""The ray starts below the surface."""

ABOVE: Final = 0
OVER_HOLE: Final = 1
OVER_OUTSIDE: Final = 2
AT_START: Final = 3
"""What the ray is over, carried from one walk to the next."""

BLOCK_BITS: Final = 3
"""Each pyramid level merges 8 by 8 blocks of the one below."""


@njit(**SCALAR)
def _snapped(part: float) -> float:
    """Put a place that is a node but for rounding on it, so that holes beside do not count."""
    if part < 1e-8:
        return 0.0
    return 1.0 if part > 1.0 - 1e-8 else part


@njit(**SCALAR)
def surface(height_m: FloatArray, row: float, col: float) -> float:
    """Bilinear height between nodes; NaN outside, and where a node that has weight is a hole."""
    rows, cols = height_m.shape
    if not (row >= 0.0 and col >= 0.0 and row <= rows - 1 and col <= cols - 1):
        return math.nan
    i = min(int(row), rows - 2)
    j = min(int(col), cols - 2)
    y = _snapped(row - i)
    x = _snapped(col - j)
    z = 0.0
    if y < 1.0 and x < 1.0:
        z += (1.0 - y) * (1.0 - x) * height_m[i, j]
    if y < 1.0 and x > 0.0:
        z += (1.0 - y) * x * height_m[i, j + 1]
    if y > 0.0 and x < 1.0:
        z += y * (1.0 - x) * height_m[i + 1, j]
    if y > 0.0 and x > 0.0:
        z += y * x * height_m[i + 1, j + 1]
    return z


@njit(**SCALAR)
def patch(height_m: FloatArray, row: float, col: float) -> tuple[float, float, float]:
    """Height and its derivatives by row and column; the edge cell serves a little outside."""
    i = min(max(math.floor(row), 0), height_m.shape[0] - 2)
    j = min(max(math.floor(col), 0), height_m.shape[1] - 2)
    y = row - i
    x = col - j
    z00 = height_m[i, j]
    by_x = height_m[i, j + 1] - z00
    by_y = height_m[i + 1, j] - z00
    by_xy = height_m[i + 1, j + 1] - z00 - by_x - by_y
    return z00 + by_x * x + (by_y + by_xy * x) * y, by_y + by_xy * x, by_x + by_xy * y


@njit(**SCALAR)
def _settle(
    height_m: FloatArray,
    r0: float,
    r1: float,
    r2: float,
    c0: float,
    c1: float,
    c2: float,
    h0: float,
    h1: float,
    h2: float,
    s: float,
) -> tuple[bool, float]:
    """Newton steps on the expanded ray from `s`; false where they lead away from it."""
    start = s
    for _ in range(12):
        z, by_row, by_col = patch(height_m, r0 + s * (r1 + s * r2), c0 + s * (c1 + s * c2))
        f = h0 + s * (h1 + s * h2) - z
        slope = h1 + 2.0 * s * h2 - by_row * (r1 + 2.0 * s * r2) - by_col * (c1 + 2.0 * s * c2)
        step = -f / slope
        if not abs(s + step - start) < 1.0:
            return abs(f) < 1e-4, s
        s += step
        if abs(step) < 1e-3:  # what is left is of the order of its square
            return True, s
    return abs(f) < 1e-4, s


@njit(**LONG)
def walk(
    height_m: FloatArray,
    maxima_m: FloatArray,
    levels: IntArray,
    row_terms: tuple[float, float, float],
    col_terms: tuple[float, float, float],
    height_terms: tuple[float, float, float],
    s: float,
    s_end: float,
    over: int,
    level: int,
) -> tuple[int, float, int]:
    """Follow an expanded ray from `s` to `s_end`: what it met, where, what it is over.

    The terms are the polynomials (value, first, second) of row, column and height in s.
    `level` is that of the blocks to begin with, 0 for cells, or −1: about as wide as the way.
    """
    r0, r1, r2 = row_terms
    c0, c1, c2 = col_terms
    h0, h1, h2 = height_terms
    rows, cols = height_m.shape
    for _ in range(8):  # from outside, go to the border first
        row = r0 + s * (r1 + s * r2)
        col = c0 + s * (c1 + s * c2)
        v_row = r1 + 2.0 * s * r2
        v_col = c1 + 2.0 * s * c2
        ahead = 0.0
        if row < 0.0:
            ahead = -row / v_row if v_row > 0.0 else math.inf
        elif row > rows - 1:
            ahead = (rows - 1 - row) / v_row if v_row < 0.0 else math.inf
        if col < 0.0:
            ahead = max(ahead, -col / v_col if v_col > 0.0 else math.inf)
        elif col > cols - 1:
            ahead = max(ahead, (cols - 1 - col) / v_col if v_col < 0.0 else math.inf)
        if ahead <= 0.0:
            break
        over = OVER_OUTSIDE
        s += ahead + 1e-6
        if not s < s_end:
            return PASSED, s_end, over
    i = min(max(int(row), 0), rows - 2)
    j = min(max(int(col), 0), cols - 2)
    top = levels.shape[0]
    if level < 0:
        span = max(
            abs((s_end - s) * (r1 + (s_end + s) * r2)), abs((s_end - s) * (c1 + (s_end + s) * c2))
        )
        level = 1
        while level < top and span > 16 << (BLOCK_BITS * (level - 1)):
            level += 1
    while True:
        row = r0 + s * (r1 + s * r2)
        col = c0 + s * (c1 + s * c2)
        v_row = r1 + 2.0 * s * r2
        v_col = c1 + 2.0 * s * c2
        bits = BLOCK_BITS * level
        bi = i >> bits
        bj = j >> bits
        ds = s_end - s
        side = 0
        if v_row > 0.0:
            d = (((bi + 1) << bits) - row) / v_row
            if d < ds:
                ds, side = d, 1
        elif v_row < 0.0:
            d = ((bi << bits) - row) / v_row
            if d < ds:
                ds, side = d, 2
        if v_col > 0.0:
            d = (((bj + 1) << bits) - col) / v_col
            if d < ds:
                ds, side = d, 3
        elif v_col < 0.0:
            d = ((bj << bits) - col) / v_col
            if d < ds:
                ds, side = d, 4
        ds = max(ds, 0.0)
        h = h0 + s * (h1 + s * h2)
        if level > 0:
            limit = maxima_m[levels[level - 1, 0] + bi * levels[level - 1, 2] + bj]
            down = True
            if h > limit:
                # h is convex along a ray: its tangent reaches the maximum no later than it
                v_h = h1 + 2.0 * s * h2
                d = (limit - h) / v_h if v_h < 0.0 else math.inf
                over = OVER_HOLE if limit == -math.inf else ABOVE
                if d < ds:
                    s += d
                    i = min(max(int(r0 + s * (r1 + s * r2)), bi << bits), ((bi + 1) << bits) - 1)
                    j = min(max(int(c0 + s * (c1 + s * c2)), bj << bits), ((bj + 1) << bits) - 1)
                    i = min(i, rows - 2)
                    j = min(j, cols - 2)
                else:
                    down = False
            if down:
                level -= 1
                continue
        else:
            z00 = height_m[i, j]
            z01 = height_m[i, j + 1]
            z10 = height_m[i + 1, j]
            z11 = height_m[i + 1, j + 1]
            s_out = s + ds
            h_out = h0 + s_out * (h1 + s_out * h2)
            if math.isnan(z00 + z01 + z10 + z11):
                limit = maxima_m[(i >> BLOCK_BITS) * levels[0, 2] + (j >> BLOCK_BITS)]
                if min(h, h_out) < limit:
                    return HOLE, s, over
                over = OVER_HOLE
            elif h_out > max(max(z00, z01), max(z10, z11)) and h > h_out:
                over = ABOVE
            else:
                by_x = z01 - z00
                by_y = z10 - z00
                by_xy = z11 - z00 - by_x - by_y
                x, y = col - j, row - i
                f0 = h - (z00 + by_x * x + (by_y + by_xy * x) * y)
                if f0 <= 0.0 and over != ABOVE:
                    if over == AT_START:
                        return MISSED, s, over
                    return (HOLE if over == OVER_HOLE else OUTSIDE), s, over
                over = ABOVE
                s_mid = s + 0.5 * ds
                x, y = c0 + s_mid * (c1 + s_mid * c2) - j, r0 + s_mid * (r1 + s_mid * r2) - i
                f_mid = h0 + s_mid * (h1 + s_mid * h2) - (z00 + by_x * x + (by_y + by_xy * x) * y)
                x, y = c0 + s_out * (c1 + s_out * c2) - j, r0 + s_out * (r1 + s_out * r2) - i
                f1 = h_out - (z00 + by_x * x + (by_y + by_xy * x) * y)
                # over one cell f is a parabola to far below a millimetre
                a2 = 2.0 * (f0 + f1 - 2.0 * f_mid)
                a1 = 4.0 * f_mid - f1 - 3.0 * f0
                disc = a1 * a1 - 4.0 * a2 * f0
                part = -1.0
                if f0 <= 0.0:
                    part = 0.0
                elif f1 <= 0.0:
                    part = 2.0 * f0 / (-a1 + math.sqrt(max(disc, 0.0)))
                elif a2 > 0.0 and a1 < 0.0 and a1 > -2.0 * a2 and disc >= 0.0:
                    part = 2.0 * f0 / (-a1 + math.sqrt(disc))
                if part >= 0.0:
                    # one Newton step on this patch mostly is all there is to do
                    s_met = s + min(part, 1.0) * ds
                    v_row, v_col = r1 + 2.0 * s_met * r2, c1 + 2.0 * s_met * c2
                    x, y = c0 + s_met * (c1 + s_met * c2) - j, r0 + s_met * (r1 + s_met * r2) - i
                    f0 = h0 + s_met * (h1 + s_met * h2) - z00 - by_x * x - (by_y + by_xy * x) * y
                    step = f0 / (
                        (by_y + by_xy * x) * v_row
                        + (by_x + by_xy * y) * v_col
                        - h1
                        - 2.0 * s_met * h2
                    )
                    x += step * v_col
                    y += step * v_row
                    inside = x >= 0.0 and x <= 1.0 and y >= 0.0 and y <= 1.0
                    if inside and abs(step) < 1e-3:
                        return CROSSED, s_met + step, over
                    met, s_met = _settle(
                        height_m, r0, r1, r2, c0, c1, c2, h0, h1, h2, s + min(part, 1.0) * ds
                    )
                    if met:
                        return CROSSED, s_met, over
        s += ds
        if side == 0:
            return PASSED, s, over
        i_was, j_was = i, j
        if side == 1:
            i = (bi + 1) << bits
        elif side == 2:
            i = (bi << bits) - 1
        elif side == 3:
            j = (bj + 1) << bits
        else:
            j = (bj << bits) - 1
        if level > 0:
            if side <= 2:
                j = int(c0 + s * (c1 + s * c2))
                j = min(max(j, bj << bits), ((bj + 1) << bits) - 1)
            else:
                i = int(r0 + s * (r1 + s * r2))
                i = min(max(i, bi << bits), ((bi + 1) << bits) - 1)
            i = min(i, rows - 2) if side > 2 else i
            j = min(j, cols - 2) if side <= 2 else j
        if i < 0 or j < 0 or i > rows - 2 or j > cols - 2:
            return OUTSIDE, s, over
        changed = (i ^ i_was) | (j ^ j_was)
        while level < top and changed >> (BLOCK_BITS * (level + 1)) != 0:
            level += 1


@njit(cache=True, parallel=True, error_model="numpy")
def _base_maxima(height_m: FloatArray, out: FloatArray) -> None:
    size = 1 << BLOCK_BITS
    for bi in prange(out.shape[0]):
        for bj in range(out.shape[1]):
            highest = -math.inf
            for i in range(max(bi * size - 1, 0), min((bi + 1) * size + 2, height_m.shape[0])):
                for j in range(max(bj * size - 1, 0), min((bj + 1) * size + 2, height_m.shape[1])):
                    if height_m[i, j] > highest:
                        highest = height_m[i, j]
            out[bi, bj] = highest


def pyramid(height_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Maxima of blocks of 8, 64, 512... cells, flat, and each level's (offset, rows, columns).

    Each block counts one node more on every side, so that a ray placed wrongly by less than a
    cell is still skipped rightly. A block of holes has the maximum −inf.
    """
    size = 1 << BLOCK_BITS
    rows, cols = (-(-(n - 1) // size) for n in height_m.shape)
    level = np.empty((rows, cols))
    _base_maxima(height_m, level)
    flat, table, offset = [], [], 0
    while True:
        flat.append(level.ravel())
        table.append((offset, *level.shape))
        offset += level.size
        if max(level.shape) == 1:
            return np.concatenate(flat), np.array(table, dtype=np.int64)
        padding = [(0, -n % size) for n in level.shape]
        padded = np.pad(level, padding, constant_values=-np.inf)
        level = padded.reshape(padded.shape[0] // size, size, -1, size).max(axis=(1, 3))
