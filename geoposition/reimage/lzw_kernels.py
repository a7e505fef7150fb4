"""Compiled: TIFF's LZW, for those who cannot read Zstandard.

*Source*: TIFF 6.0 section 13; the width of the codes changes one code early, as everywhere.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

_CLEAR: Final = 256
_END: Final = 257
_FIRST: Final = 258
_LAST: Final = 4094
_SLOTS: Final = 1 << 14
_SERIAL: Final[dict[str, Any]] = {"cache": True, "nogil": True, "error_model": "numpy"}


def lzw(content: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return `content` (n,) bytes, one or more, in LZW's codes."""
    out = np.empty(3 * len(content) // 2 + 64, np.uint8)
    return out[: _encode(content, np.empty(_SLOTS, np.int32), np.empty(_SLOTS, np.int16), out)]


@njit(**_SERIAL)
def _encode(
    content: NDArray[np.uint8],
    keys: NDArray[np.int32],
    codes: NDArray[np.int16],
    out: NDArray[np.uint8],
) -> int:
    """Fill `out`; return how many bytes. `keys` and `codes` are a hash table of the strings."""
    keys[:] = -1
    size, width, following = 0, 9, _FIRST
    held, bits = np.int64(_CLEAR), width
    string = np.int64(content[0])
    for k in range(1, len(content) + 1):
        slot, key = np.int64(-1), np.int64(0)
        if k < len(content):
            key = (string << 8) | np.int64(content[k])
            slot = (key * 40503 >> 4) & (_SLOTS - 1)
            while keys[slot] != -1 and keys[slot] != key:
                slot = (slot + 1) & (_SLOTS - 1)
            if keys[slot] == key:
                string = np.int64(codes[slot])
                continue
        held = (held << width) | string
        bits += width
        if slot >= 0:
            keys[slot] = key
            codes[slot] = following
            string = np.int64(content[k])
        following += 1
        if following == _LAST:
            held = (held << width) | _CLEAR
            bits += width
            keys[:] = -1
            width, following = 9, _FIRST
        elif following >= 1 << width:
            width += 1
        if slot < 0:
            held = (held << width) | _END
            bits += width
        while bits >= 8:
            bits -= 8
            out[size] = (held >> bits) & 255
            size += 1
        held &= (1 << bits) - 1
    while bits > 0:
        shift = bits - 8
        out[size] = (held >> shift if shift >= 0 else held << -shift) & 255
        size += 1
        bits -= 8
    return size
