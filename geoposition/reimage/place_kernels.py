"""Compiled: pixel values at places given one by one, as an orthoimage needs them."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FlagArray, FloatArray
from geoposition.reimage.resample_kernels import clear_of_holes
from geoposition.reimage.sample_kernels import (
    BILINEAR,
    CUBIC,
    NEAREST,
    Float32Array,
    Pixels,
    careful_value,
    cubic_weights,
)

_FAST: Final = {"contract", "arcp", "nsz", "reassoc"}
_INLINE: Final[dict[str, Any]] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": _FAST,
    "forceinline": True,
    "_nrt": False,
}


@njit(**_INLINE)
def _bilinear(image: Pixels, i: int, j: int, y: np.float32, x: np.float32) -> np.float32:
    a, b = np.float32(image[i, j]), np.float32(image[i, j + 1])
    c, d = np.float32(image[i + 1, j]), np.float32(image[i + 1, j + 1])
    a += x * (b - a)
    c += x * (d - c)
    return a + y * (c - a)


@njit(**_INLINE)
def _cubic(image: Pixels, i: int, j: int, y: np.float32, x: np.float32) -> np.float32:
    a, b, c, d = cubic_weights(x)
    rows = cubic_weights(y)
    value = np.float32(0.0)
    for k in range(4):
        row = image[i + k - 1, j - 1 : j + 3]
        part = a * np.float32(row[0]) + b * np.float32(row[1])
        part += c * np.float32(row[2]) + d * np.float32(row[3])
        value += rows[k] * part
    return value


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def resample_places(
    image: Pixels,
    holes: FlagArray,
    line: FloatArray,
    sample: FloatArray,
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
    """Fill `out` (rows, cols) with values at `line`, `sample` (rows, cols); as `resample_rows`."""
    rows, cols = out.shape
    height, width = image.shape
    before = 0 if method == BILINEAR else (1 if method == CUBIC else 2)
    after = 1 if method == BILINEAR else (2 if method == CUBIC else 3)
    low32, high32, half32 = np.float32(low), np.float32(high), np.float32(half)
    quick = method in (BILINEAR, CUBIC)
    for row in prange(rows):
        for col in range(cols):
            at_line, at_sample = line[row, col] - origin_line, sample[row, col] - origin_sample
            good = False
            clear = quick and at_line >= before and at_sample >= before
            if clear and at_line < height - after and at_sample < width - after:
                i, j = int(at_line), int(at_sample)
                y, x = np.float32(at_line - i), np.float32(at_sample - j)
                if clear_of_holes(holes, i - before, i + after, j - before, j + after):
                    good = True
                    if method == BILINEAR:
                        value = _bilinear(image, i, j, y, x)
                    else:
                        value = _cubic(image, i, j, y, x)
                    out[row, col] = min(max(value, low32), high32) + half32
                    valid[row, col] = 1
            if not good:
                found = careful_value(image, table, nodata, has_nodata, method, at_line, at_sample)
                known = not math.isnan(found)
                if method == NEAREST:
                    out[row, col] = found if known else fill
                else:
                    out[row, col] = min(max(found, low), high) + half if known else fill
                valid[row, col] = known


@njit(cache=True, parallel=True, error_model="numpy")
def extremes(line: FloatArray, sample: FloatArray, out: FloatArray) -> None:
    """Fill `out` (rows, 4) with lowest and highest line, then sample, of each row's places."""
    rows, cols = line.shape
    for row in prange(rows):
        low_y, high_y, low_x, high_x = math.inf, -math.inf, math.inf, -math.inf
        for col in range(cols):
            y, x = line[row, col], sample[row, col]
            if y == y and x == x:
                low_y, high_y = min(low_y, y), max(high_y, y)
                low_x, high_x = min(low_x, x), max(high_x, x)
        out[row, 0], out[row, 1], out[row, 2], out[row, 3] = low_y, high_y, low_x, high_x
