"""Compiled: the tiles and the overviews of an image file, each in one thread without the GIL.

A tile is interleaved by pixel and differenced along its rows (TIFF's predictor 2); floats are
split into planes of bytes before (predictor 3). An overview's pixel is the mean of the four
below it that are not missing.

*Source*: TIFF 6.0 section 14; Adobe Photoshop TIFF Technical Note 3, "Floating point predictor".
"""

from __future__ import annotations

from typing import Any, Final

from numba import njit
from numpy.typing import NDArray

Pixels = NDArray[Any]

_SERIAL: Final[dict[str, Any]] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_SERIAL)
def cut_tile(pixels: Pixels, first_col: int, tile: Pixels) -> None:
    """Fill `tile` (rows, cols, bands) from `pixels` (bands, rows, cols); the edge is repeated."""
    bands, height, width = pixels.shape
    rows, cols, _ = tile.shape
    inside = min(cols, width - first_col)
    for row in range(rows):
        at = min(row, height - 1)
        for band in range(bands):
            source = pixels[band, at, first_col : first_col + inside]
            for col in range(inside):
                tile[row, col, band] = source[col]
            for col in range(inside, cols):
                tile[row, col, band] = source[inside - 1]


@njit(**_SERIAL)
def difference_rows(tile: Pixels) -> None:
    """Replace each value of `tile` (rows, cols, bands) by its step from the one on its left."""
    rows, cols, bands = tile.shape
    for row in range(rows):
        for band in range(bands):
            left = tile[row, 0, band]
            for col in range(1, cols):
                here = tile[row, col, band]
                tile[row, col, band] = here - left
                left = here


@njit(**_SERIAL)
def split_bytes(tile: Pixels, planes: Pixels) -> None:
    """Split `tile` (rows, cols, bands) of 32-bit words into `planes` (rows, 4 n) of bytes.

    High bytes are first; each is replaced by its step from the one `bands` bytes before.
    """
    rows, cols, bands = tile.shape
    n = cols * bands
    for row in range(rows):
        for col in range(cols):
            for band in range(bands):
                word = tile[row, col, band]
                for plane in range(4):
                    planes[row, plane * n + col * bands + band] = (word >> (24 - 8 * plane)) & 255
        for k in range(4 * n - 1, bands - 1, -1):
            planes[row, k] -= planes[row, k - bands]


@njit(**_SERIAL)
def halve_whole(pixels: Pixels, nodata: int, has_nodata: bool, out: Pixels) -> None:
    """Fill `out` (bands, r, c) with means of 2 x 2 whole numbers, halves rounded to even.

    Where all are `nodata` it stays; a mean that falls on it by chance moves up by one, or down
    where it is the type's highest value.
    """
    bands, height, width = pixels.shape
    _, rows, cols = out.shape
    for band in range(bands):
        for row in range(rows):
            upper = pixels[band, 2 * row]
            lower = pixels[band, min(2 * row + 1, height - 1)]
            target = out[band, row]
            if not has_nodata:
                for col in range(width // 2):
                    total = int(upper[2 * col]) + int(upper[2 * col + 1])
                    total += int(lower[2 * col]) + int(lower[2 * col + 1])
                    mean = total >> 2
                    rest = total & 3
                    target[col] = mean + ((rest + (mean & 1)) >= 3)
                for col in range(width // 2, cols):
                    total = int(upper[2 * col]) + int(lower[2 * col])
                    target[col] = (total >> 1) + (total & (total >> 1) & 1)
                continue
            for col in range(cols):
                total, count = 0, 0
                for k in range(2 * col, min(2 * col + 2, width)):
                    for value in (int(upper[k]), int(lower[k])):
                        if value != nodata:
                            total += value
                            count += 1
                if count == 0:
                    target[col] = nodata
                    continue
                mean = total // count
                rest = 2 * (total - mean * count)
                mean += rest > count or (rest == count and mean & 1)
                if mean == nodata:
                    mean += 1 if nodata <= 0 or total > mean * count else -1
                target[col] = mean


@njit(**_SERIAL)
def halve_float(pixels: Pixels, nodata: float, has_nodata: bool, out: Pixels) -> None:
    """Fill `out` (bands, r, c) with means of 2 x 2 floats, NaN and `nodata` left out."""
    bands, height, width = pixels.shape
    _, rows, cols = out.shape
    for band in range(bands):
        for row in range(rows):
            upper = pixels[band, 2 * row]
            lower = pixels[band, min(2 * row + 1, height - 1)]
            for col in range(cols):
                total, count, missing = 0.0, 0, float(upper[2 * col])
                for k in range(2 * col, min(2 * col + 2, width)):
                    for value in (upper[k], lower[k]):
                        if value == value and not (has_nodata and value == nodata):
                            total += value
                            count += 1
                out[band, row, col] = total / count if count > 0 else missing
