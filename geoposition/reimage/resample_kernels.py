"""Compiled: pixel values at the places of a map, row by row in parallel.

The first pixel's centre is (0, 0); a place farther than half a pixel outside the image, or whose
nearest pixel is missing, has no value. At the border and beside missing pixels the kernel's
weights are those of the pixels that exist, made to sum to one.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray
from geoposition.reimage.sample_kernels import (
    BILINEAR,
    CUBIC,
    NEAREST,
    Float32Array,
    Pixels,
    careful_value,
    run_bilinear,
    run_cubic,
    run_lanczos,
    run_nearest,
)

BLOCK: Final = 32
"""Missing pixels are known by blocks of so many rows and columns."""


_FAST: Final = {"contract", "arcp", "nsz", "reassoc"}
_PLAIN: Final[dict[str, Any]] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": _FAST,
    "_nrt": False,
}


@njit(**_PLAIN)
def run_length(place: float, step: float, whole: float, most: int) -> int:
    """How many of place, place + step, ... stay within the pixel that begins at `whole`."""
    if step > 0.0:
        n = (whole + 1.0 - place) / step
    elif step < 0.0:
        n = (place - whole) / -step
    else:
        return most
    # one place that is out by rounding is as well served from here
    return most if n >= most else max(math.ceil(n), 1)


@njit(**_PLAIN)
def clear_of_holes(holes: FlagArray, i0: int, i1: int, j0: int, j1: int) -> bool:
    """Tell whether no block that reaches into rows i0..i1 and columns j0..j1 has a hole."""
    if holes.size == 0:
        return True
    for a in range(i0 // BLOCK, i1 // BLOCK + 1):
        for b in range(j0 // BLOCK, j1 // BLOCK + 1):
            if holes[a, b]:
                return False
    return True


@njit(cache=True, parallel=True, error_model="numpy")
def find_holes(image: Pixels, nodata: float, has_nodata: bool, holes: FlagArray) -> None:
    """Mark the blocks of `image` in which a pixel is missing."""
    rows, cols = image.shape
    for a in prange(holes.shape[0]):
        for b in range(holes.shape[1]):
            found = False
            for i in range(a * BLOCK, min((a + 1) * BLOCK, rows)):
                for j in range(b * BLOCK, min((b + 1) * BLOCK, cols)):
                    pixel = image[i, j]
                    found |= pixel != pixel or (has_nodata and pixel == nodata)
            holes[a, b] = found


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def resample_rows(
    image: Pixels,
    holes: FlagArray,
    places: FloatArray,
    node_step: int,
    first_col: int,
    origin_line: float,
    origin_sample: float,
    method: int,
    table: Float32Array,
    nodata: float,
    has_nodata: bool,
    low: float,
    high: float,
    half: float,
    fill: float,
    out: Pixels,
    valid: FlagArray,
) -> None:
    """Fill `out` (rows, cols) with values of `image`, and `valid` with 1 where there is one.

    `places` (rows, nodes, 2) are (line, sample) at every row of `out` and at the columns 0,
    `node_step`, 2 `node_step` ..., linear between them; the first column of `out` is column
    `first_col` of that count. The first pixel of `image` is at (`origin_line`,
    `origin_sample`). `half` is 0.5 where values become whole numbers, else 0.
    """
    rows, cols = out.shape
    height, width = image.shape
    before = 0 if method <= BILINEAR else (1 if method == CUBIC else 2)
    after = 0 if method == NEAREST else (1 if method == BILINEAR else (2 if method == CUBIC else 3))
    limits = np.float32(low), np.float32(high), np.float32(half)
    shift = 0.5 if method == NEAREST else 0.0
    for row in prange(rows):
        at = 0
        while at < cols:
            cell = min((first_col + at) // node_step, places.shape[1] - 2)
            stop = min((cell + 1) * node_step - first_col, cols)
            if cell == places.shape[1] - 2:
                stop = cols
            by_line = (places[row, cell + 1, 0] - places[row, cell, 0]) / node_step
            by_sample = (places[row, cell + 1, 1] - places[row, cell, 1]) / node_step
            ahead = first_col + at - cell * node_step
            line = places[row, cell, 0] + ahead * by_line - origin_line + shift
            sample = places[row, cell, 1] + ahead * by_sample - origin_sample + shift
            if not (abs(line) < 1e9 and abs(sample) < 1e9):
                for k in range(at, stop):
                    out[row, k] = fill
                    valid[row, k] = 0
                at = stop
                continue
            k = at
            while k < stop:
                y, x = line + (k - at) * by_line, sample + (k - at) * by_sample
                i, j = math.floor(y), math.floor(x)
                n = run_length(y, by_line, i, stop - k)
                n = run_length(x, by_sample - 1.0, j, n)
                quick = i >= before and i + after < height
                if j < before:
                    # careful up to where the kernel is inside
                    n = min(n, before - j)
                    quick = False
                elif j + after >= width:
                    quick = False
                else:
                    n = min(n, width - after - j)
                if holes.size > 0:
                    n = min(n, BLOCK)
                if quick and clear_of_holes(
                    holes, i - before, i + after, j - before, j + n - 1 + after
                ):
                    start = (
                        np.float32(y - i),
                        np.float32(by_line),
                        np.float32(x - j),
                        np.float32(by_sample - 1.0),
                    )
                    target = out[row, k : k + n]
                    if method == NEAREST:
                        run_nearest(image, i, j, target)
                    elif method == BILINEAR:
                        run_bilinear(image, i, j, start, limits, target)
                    elif method == CUBIC:
                        run_cubic(image, i, j, start, limits, target)
                    else:
                        run_lanczos(image, i, j, start, limits, table, target)
                    valid[row, k : k + n] = 1
                else:
                    for m in range(n):
                        value = careful_value(
                            image,
                            table,
                            nodata,
                            has_nodata,
                            method,
                            y + m * by_line - shift,
                            x + m * by_sample - shift,
                        )
                        good = value == value
                        out[row, k + m] = min(max(value, low), high) + half if good else fill
                        valid[row, k + m] = good
                k += n
            at = stop
