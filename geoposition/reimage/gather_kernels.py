"""Compiled: whole numbers between pixels at places given one by one, some hundred at a time.

Where each pixel's neighbours lie and with what fractions is found in vectors; the neighbours of
one row are fetched as one word, which is what no vector does faster; the rest is vectors again.
"""

from __future__ import annotations

import sys
from typing import Any, Final, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from geoposition.arrays import FlagArray, FloatArray
from geoposition.reimage.sample_kernels import (
    BILINEAR,
    CUBIC,
    Float32Array,
    Pixels,
    careful_value,
    cubic_weights,
)

Words: TypeAlias = NDArray[Any]
_Index: TypeAlias = NDArray[np.int32]

_CHUNK: Final = 256
_ROWS: Final = 16
"""A tile of so many pixels: what it reads of a turned image stays in the nearest cache."""
_NEIGHBOURS: Final = {BILINEAR: 2, CUBIC: 4}
_WORDS: Final[dict[int, np.dtype[Any]]] = {
    2: np.dtype("<u2"),
    4: np.dtype("<u4"),
    8: np.dtype("<u8"),
}
_MOST: Final = 2**31
_FAST: Final = {"contract", "arcp", "nsz", "reassoc"}
_HOT: Final[dict[str, Any]] = {
    "cache": True,
    "_nrt": False,
    "error_model": "numpy",
    "fastmath": _FAST,
}


def words_of(image: Pixels, method: int) -> Words | None:
    """Neighbours (n,) of a row that `method` looks at, from each pixel on, as one word each.

    None where they cannot be read so: floats, other methods, images beyond 32-bit counts.
    """
    count = _NEIGHBOURS.get(method, 0)
    word = _WORDS.get(count * image.itemsize)
    if word is None or image.dtype.kind != "u" or sys.byteorder != "little":
        return None
    if min(image.shape) < count or image.size >= _MOST:
        return None
    return np.ndarray((image.size - count + 1,), word, image, strides=(image.itemsize,))


def bits_of(image: Pixels, words: Words) -> tuple[Any, Any]:
    """Bits of a pixel and a mask of them, in a kind of number that holds a word."""
    kind = np.uint32 if words.itemsize <= 4 else np.uint64
    size = 8 * image.itemsize
    return kind(size), kind((1 << size) - 1)


@njit(**_HOT)
def _split(
    line: FloatArray,
    sample: FloatArray,
    origin: tuple[Any, Any],
    limits: tuple[Any, Any, Any],
    width: np.int32,
    at: _Index,
    y: Float32Array,
    x: Float32Array,
    valid: FlagArray,
) -> None:
    """Where the pixel above and left of each place is, fractions, and whether all is inside.

    In the places' own precision: less a whole number and cut, they lose nothing.
    """
    low, end_line, end_sample = limits
    for k in range(len(line)):
        v, u = line[k] - origin[0], sample[k] - origin[1]
        clear = (v >= low) & (u >= low) & (v < end_line) & (u < end_sample)
        valid[k] = clear
        v, u = (v, u) if clear else (low, low)
        i, j = np.int32(v), np.int32(u)
        at[k] = i * width + j
        y[k], x[k] = np.float32(v - i), np.float32(u - j)


@njit(**_HOT)
def _fetch(words: Words, at: _Index, ahead: np.int32, out: Words) -> None:
    for k in range(len(at)):
        out[k] = words[np.uint64(np.uint32(at[k] + ahead))]


@njit(**_HOT)
def _bilinear(
    above: Words,
    below: Words,
    y: Float32Array,
    x: Float32Array,
    shift: Any,
    mask: Any,
    low: np.float32,
    high: np.float32,
    out: Pixels,
) -> None:
    half = np.float32(0.5)
    for k in range(len(out)):
        p, q, right = above[k], below[k], x[k]
        a, b = np.float32(np.int32(p & mask)), np.float32(np.int32((p >> shift) & mask))
        c, d = np.float32(np.int32(q & mask)), np.float32(np.int32((q >> shift) & mask))
        a += right * (b - a)
        c += right * (d - c)
        out[k] = np.int32(min(max(a + y[k] * (c - a), low), high) + half)


@njit(**_HOT)
def _across(
    word: Any,
    weights: tuple[np.float32, np.float32, np.float32, np.float32],
    shift: Any,
    mask: Any,
) -> np.float32:
    a, b, c, d = weights
    value = a * np.float32(np.int32(word & mask))
    word = word >> shift
    value += b * np.float32(np.int32(word & mask))
    word = word >> shift
    value += c * np.float32(np.int32(word & mask))
    word = word >> shift
    value += d * np.float32(np.int32(word & mask))
    return value


@njit(**_HOT)
def _cubic(
    rows: Words,
    y: Float32Array,
    x: Float32Array,
    shift: Any,
    mask: Any,
    low: np.float32,
    high: np.float32,
    out: Pixels,
) -> None:
    half = np.float32(0.5)
    for k in range(len(out)):
        weights = cubic_weights(x[k])
        a, b, c, d = cubic_weights(y[k])
        value = a * _across(rows[0, k], weights, shift, mask) + b * _across(
            rows[1, k], weights, shift, mask
        )
        value += c * _across(rows[2, k], weights, shift, mask) + d * _across(
            rows[3, k], weights, shift, mask
        )
        out[k] = np.int32(min(max(value, low), high) + half)


@njit(**_HOT)
def _rest(
    image: Pixels,
    table: Float32Array,
    nodata: float,
    has_nodata: bool,
    method: int,
    line: FloatArray,
    sample: FloatArray,
    origin: tuple[float, float],
    limits: tuple[float, float, float],
    out: Pixels,
    valid: FlagArray,
) -> None:
    """Fill in with care what has been left out: the pixels at the border and outside."""
    some = np.uint8(1)
    for k in range(len(valid)):
        some &= valid[k]
    if some:
        return
    low, high, fill = limits
    for k in range(len(valid)):
        if not valid[k]:
            v, u = line[k] - origin[0], sample[k] - origin[1]
            value = careful_value(image, table, nodata, has_nodata, method, v, u)
            known = value == value
            out[k] = min(max(value, low), high) + 0.5 if known else fill
            valid[k] = known


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def resample_gathered(
    image: Pixels,
    words: Words,
    bits: tuple[Any, Any],
    line: FloatArray,
    sample: FloatArray,
    origin: tuple[float, float],
    method: int,
    table: Float32Array,
    nodata: float,
    has_nodata: bool,
    low: float,
    high: float,
    fill: float,
    out: Pixels,
    valid: FlagArray,
) -> None:
    """Fill `out` (rows, cols) with values at `line`, `sample` (rows, cols), bilinear or cubic.

    `words` are those of `words_of` for an `image` without missing pixels, `bits` those of a pixel
    and their mask; else as `resample_places`.
    """
    rows, cols = out.shape
    height, width = np.int32(image.shape[0]), np.int32(image.shape[1])
    cubic = method == CUBIC
    before = 1 if cubic else 0
    kind = line.dtype.type
    inside = kind(before), kind(height - 1 - before), kind(width - 1 - before)
    first = kind(origin[0]), kind(origin[1])
    low32, high32 = np.float32(low), np.float32(high)
    shift, mask = bits
    ends = low, high, fill
    for block in prange((rows + _ROWS - 1) // _ROWS):
        at = np.empty(_CHUNK, np.int32)
        fractions = np.empty((2, _CHUNK), np.float32)
        fetched = np.full((4, _CHUNK), mask)
        for start in range(0, cols, _CHUNK):
            stop = min(start + _CHUNK, cols)
            n = stop - start
            y, x = fractions[0, :n], fractions[1, :n]
            for row in range(block * _ROWS, min((block + 1) * _ROWS, rows)):
                v, u = line[row, start:stop], sample[row, start:stop]
                target, seen = out[row, start:stop], valid[row, start:stop]
                _split(v, u, first, inside, width, at[:n], y, x, seen)
                if cubic:
                    for k in range(4):
                        _fetch(words, at[:n], (k - 1) * width - np.int32(1), fetched[k, :n])
                    _cubic(fetched, y, x, shift, mask, low32, high32, target)
                else:
                    _fetch(words, at[:n], np.int32(0), fetched[0, :n])
                    _fetch(words, at[:n], width, fetched[1, :n])
                    _bilinear(
                        fetched[0, :n], fetched[1, :n], y, x, shift, mask, low32, high32, target
                    )
                _rest(image, table, nodata, has_nodata, method, v, u, origin, ends, target, seen)
