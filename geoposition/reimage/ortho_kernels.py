"""Compiled: where the pixels of an orthoimage lie in the image, from nodes and heights."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray
from geoposition.flags import Flag
from geoposition.terrain.mesh import surface

_FAST: Final = {"contract", "arcp", "nsz", "reassoc"}
_OK: Final = np.uint8(Flag.OK)
_NODATA: Final = np.uint8(Flag.NODATA)
_OUTSIDE_MODEL: Final = np.uint8(Flag.OUTSIDE_MODEL)
_OUTSIDE_TERRAIN: Final = np.uint8(Flag.OUTSIDE_TERRAIN)
_SLACK: Final = 1e-6
"""Of a pixel of the terrain: a border may come out of a rounding a hair outside."""


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def spread_nodes(nodes: FloatArray, step: int, out: FloatArray) -> None:
    """Fill `out` (rows, cols, 2) bilinearly from `nodes` (r, c, 2), `step` pixels apart."""
    rows, cols, _ = out.shape
    for row in prange(rows):
        a = row // step
        v = (row - a * step) / step
        for cell in range(nodes.shape[1] - 1):
            first = cell * step
            for k in range(2):
                left = nodes[a, cell, k] + v * (nodes[a + 1, cell, k] - nodes[a, cell, k])
                right = nodes[a, cell + 1, k]
                right += v * (nodes[a + 1, cell + 1, k] - nodes[a, cell + 1, k])
                slope = (right - left) / step
                for col in range(first, min(first + step, cols)):
                    out[row, col, k] = left + (col - first) * slope


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def places_at_heights(
    nodes: FloatArray,
    step: int,
    height_m: FloatArray,
    middle_m: float,
    half_m: float,
    line: FloatArray,
    sample: FloatArray,
) -> None:
    """Fill `line`, `sample` (rows, cols) with the places of pixels of `height_m` (rows, cols).

    `nodes` (r, c, 6) hold c0, c1, c2 of the line, then of the sample: polynomials in
    (height − middle) / half, `step` pixels apart.
    """
    rows, cols = height_m.shape
    for row in prange(rows):
        a = row // step
        v = (row - a * step) / step
        for cell in range(nodes.shape[1] - 1):
            first = cell * step
            l0 = nodes[a, cell, 0] + v * (nodes[a + 1, cell, 0] - nodes[a, cell, 0])
            l1 = nodes[a, cell, 1] + v * (nodes[a + 1, cell, 1] - nodes[a, cell, 1])
            l2 = nodes[a, cell, 2] + v * (nodes[a + 1, cell, 2] - nodes[a, cell, 2])
            s0 = nodes[a, cell, 3] + v * (nodes[a + 1, cell, 3] - nodes[a, cell, 3])
            s1 = nodes[a, cell, 4] + v * (nodes[a + 1, cell, 4] - nodes[a, cell, 4])
            s2 = nodes[a, cell, 5] + v * (nodes[a + 1, cell, 5] - nodes[a, cell, 5])
            b = cell + 1
            dl0 = nodes[a, b, 0] + v * (nodes[a + 1, b, 0] - nodes[a, b, 0]) - l0
            dl1 = nodes[a, b, 1] + v * (nodes[a + 1, b, 1] - nodes[a, b, 1]) - l1
            dl2 = nodes[a, b, 2] + v * (nodes[a + 1, b, 2] - nodes[a, b, 2]) - l2
            ds0 = nodes[a, b, 3] + v * (nodes[a + 1, b, 3] - nodes[a, b, 3]) - s0
            ds1 = nodes[a, b, 4] + v * (nodes[a + 1, b, 4] - nodes[a, b, 4]) - s1
            ds2 = nodes[a, b, 5] + v * (nodes[a + 1, b, 5] - nodes[a, b, 5]) - s2
            for col in range(first, min(first + step, cols)):
                u = (col - first) / step
                h = (height_m[row, col] - middle_m) / half_m
                line[row, col] = l0 + u * dl0 + h * (l1 + u * dl1 + h * (l2 + u * dl2))
                sample[row, col] = s0 + u * ds0 + h * (s1 + u * ds1 + h * (s2 + u * ds2))


@njit(cache=True, parallel=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def heights_on_mesh(
    heights_m: FloatArray, place: FloatArray, step: int, out: FloatArray, flag: FlagArray
) -> None:
    """Fill `out` (rows, cols) with `heights_m` at the pixels, `flag` where there is none.

    `place` (r, c, 2) are (row, col) in `heights_m` of nodes `step` pixels apart.
    """
    rows, cols = out.shape
    bottom, right = heights_m.shape[0] - 1.0, heights_m.shape[1] - 1.0
    for row in prange(rows):
        a = row // step
        v = (row - a * step) / step
        for cell in range(place.shape[1] - 1):
            first = cell * step
            y0 = place[a, cell, 0] + v * (place[a + 1, cell, 0] - place[a, cell, 0])
            x0 = place[a, cell, 1] + v * (place[a + 1, cell, 1] - place[a, cell, 1])
            b = cell + 1
            dy = (place[a, b, 0] + v * (place[a + 1, b, 0] - place[a, b, 0]) - y0) / step
            dx = (place[a, b, 1] + v * (place[a + 1, b, 1] - place[a, b, 1]) - x0) / step
            for col in range(first, min(first + step, cols)):
                y, x = y0 + (col - first) * dy, x0 + (col - first) * dx
                if not (-_SLACK <= y <= bottom + _SLACK and -_SLACK <= x <= right + _SLACK):
                    out[row, col] = np.nan
                    flag[row, col] = _OUTSIDE_TERRAIN
                    continue
                height = surface(heights_m, min(max(y, 0.0), bottom), min(max(x, 0.0), right))
                out[row, col] = height
                flag[row, col] = _OK if height == height else _NODATA


@njit(cache=True, parallel=True, error_model="numpy")
def settle_flags(
    line: FloatArray, sample: FloatArray, lines: int, samples: int, flag: FlagArray
) -> None:
    """Flag what is known of the ground and `OUTSIDE_MODEL`; NaN for places with any flag."""
    rows, cols = line.shape
    for row in prange(rows):
        for col in range(cols):
            if flag[row, col] == _OK:
                y, x = line[row, col], sample[row, col]
                if y >= -0.5 and y <= lines - 0.5 and x >= -0.5 and x <= samples - 0.5:
                    continue
                flag[row, col] = _OUTSIDE_MODEL
            line[row, col] = sample[row, col] = np.nan
