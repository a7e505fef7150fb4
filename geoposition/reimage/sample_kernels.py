"""Compiled: the values between pixels, by runs of neighbours, or one by one with care.

A map that hardly turns or stretches leads, along a row, to neighbours of neighbours for long
runs of pixels: within such a run the pixels are read one after the other, in vectors, and only
the fractions change. Values are computed in 32-bit floats.

*Source*: cubic convolution: Keys 1981, IEEE ASSP 29(6), eq. 15 (a = −1/2); Lanczos: Duchon 1979,
J. Appl. Meteorology 18(8), three lobes.
"""

from __future__ import annotations

import math
from typing import Any, Final, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

NEAREST: Final = 0
BILINEAR: Final = 1
CUBIC: Final = 2
LANCZOS: Final = 3
REACH: Final = (1, 1, 2, 3)
"""Pixels on either side of a place that each method looks at."""
Pixels: TypeAlias = NDArray[Any]
Float32Array: TypeAlias = NDArray[np.float32]

LANCZOS_STEPS: Final = 4096
_FAST: Final = {"contract", "arcp", "nsz", "reassoc"}
_PLAIN: Final[dict[str, Any]] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": _FAST,
    "_nrt": False,
}
_LEAST_WEIGHT: Final = 0.25
"""Where more of the kernel's weight is missing, what is left may cancel."""

_F0: Final = np.float32(0.0)
_F05: Final = np.float32(0.5)
_F1: Final = np.float32(1.0)
_F15: Final = np.float32(1.5)
_F2: Final = np.float32(2.0)
_F25: Final = np.float32(2.5)


def _lanczos_table() -> Float32Array:
    """Weights (steps + 1, 6) of the six pixels around each fraction, of unit sum."""
    t = np.linspace(0.0, 1.0, LANCZOS_STEPS + 1)[:, None] - np.arange(-2.0, 4.0)
    weights = np.sinc(t) * np.sinc(t / 3.0) * (np.abs(t) < 3.0)
    table: Float32Array = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    table.setflags(write=False)
    return table


LANCZOS_TABLE: Final = _lanczos_table()


@njit(**_PLAIN)
def cubic_weights(
    t: np.float32,
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Weights of the four pixels around the fraction `t`."""
    w0 = t * (-_F05 + t * (_F1 - _F05 * t))
    w1 = _F1 + t * t * (_F15 * t - _F25)
    w2 = t * (_F05 + t * (_F2 - _F15 * t))
    w3 = t * t * (_F05 * t - _F05)
    return w0, w1, w2, w3


@njit(**_PLAIN)
def run_nearest(image: Pixels, i: int, j: int, out: Pixels) -> None:
    """Values at (i, j + k)."""
    row = image[i, j : j + len(out)]
    for k in range(len(out)):
        out[k] = row[k]


@njit(**_PLAIN)
def run_bilinear(
    image: Pixels,
    i: int,
    j: int,
    start: tuple[np.float32, np.float32, np.float32, np.float32],
    limits: tuple[np.float32, np.float32, np.float32],
    out: Pixels,
) -> None:
    """Values at (i + y, j + k + x), y and x linear in k: `start` is y, its step, x, its step."""
    n = len(out)
    above, below = image[i, j : j + n + 1], image[i + 1, j : j + n + 1]
    y0, dy, x0, dx = start
    low, high, half = limits
    for k in range(n):
        t = np.float32(np.int32(k))
        x, y = x0 + t * dx, y0 + t * dy
        a, b = np.float32(above[k]), np.float32(above[k + 1])
        c, d = np.float32(below[k]), np.float32(below[k + 1])
        a += x * (b - a)
        c += x * (d - c)
        out[k] = min(max(a + y * (c - a), low), high) + half


@njit(**_PLAIN)
def run_cubic(
    image: Pixels,
    i: int,
    j: int,
    start: tuple[np.float32, np.float32, np.float32, np.float32],
    limits: tuple[np.float32, np.float32, np.float32],
    out: Pixels,
) -> None:
    """As `run_bilinear`."""
    n = len(out)
    r0, r1 = image[i - 1, j - 1 : j + n + 2], image[i, j - 1 : j + n + 2]
    r2, r3 = image[i + 1, j - 1 : j + n + 2], image[i + 2, j - 1 : j + n + 2]
    y0, dy, x0, dx = start
    low, high, half = limits
    for k in range(n):
        t = np.float32(np.int32(k))
        a, b, c, d = cubic_weights(x0 + t * dx)
        p, q, r, s = cubic_weights(y0 + t * dy)
        u0 = p * np.float32(r0[k]) + q * np.float32(r1[k])
        u0 += r * np.float32(r2[k]) + s * np.float32(r3[k])
        u1 = p * np.float32(r0[k + 1]) + q * np.float32(r1[k + 1])
        u1 += r * np.float32(r2[k + 1]) + s * np.float32(r3[k + 1])
        u2 = p * np.float32(r0[k + 2]) + q * np.float32(r1[k + 2])
        u2 += r * np.float32(r2[k + 2]) + s * np.float32(r3[k + 2])
        u3 = p * np.float32(r0[k + 3]) + q * np.float32(r1[k + 3])
        u3 += r * np.float32(r2[k + 3]) + s * np.float32(r3[k + 3])
        out[k] = min(max((a * u0 + b * u1) + (c * u2 + d * u3), low), high) + half


@njit(**_PLAIN)
def run_lanczos(
    image: Pixels,
    i: int,
    j: int,
    start: tuple[np.float32, np.float32, np.float32, np.float32],
    limits: tuple[np.float32, np.float32, np.float32],
    table: Float32Array,
    out: Pixels,
) -> None:
    """As `run_bilinear`, the weights from `table`."""
    y0, dy, x0, dx = start
    low, high, half = limits
    steps = np.float32(LANCZOS_STEPS)
    for k in range(len(out)):
        t = np.float32(np.int32(k))
        at_x = min(max(int((x0 + t * dx) * steps + _F05), 0), LANCZOS_STEPS)
        at_y = min(max(int((y0 + t * dy) * steps + _F05), 0), LANCZOS_STEPS)
        value = _F0
        for m in range(6):
            part = _F0
            for q in range(6):
                part += table[at_x, q] * np.float32(image[i + m - 2, j + k + q - 2])
            value += table[at_y, m] * part
        out[k] = min(max(value, low), high) + half


@njit(**_PLAIN)
def careful_value(
    image: Pixels,
    table: Float32Array,
    nodata: float,
    has_nodata: bool,
    method: int,
    line: float,
    sample: float,
) -> float:
    """Value where some of the pixels may be outside or missing; NaN where there is none."""
    rows, cols = image.shape
    if not (line >= -0.5 and line <= rows - 0.5 and sample >= -0.5 and sample <= cols - 0.5):
        return math.nan
    near_i = min(max(math.floor(line + 0.5), 0), rows - 1)
    near_j = min(max(math.floor(sample + 0.5), 0), cols - 1)
    nearest = np.float64(image[near_i, near_j])
    if nearest != nearest or (has_nodata and nearest == nodata):
        return math.nan
    if method == NEAREST:
        return nearest
    i, j = math.floor(line), math.floor(sample)
    y, x = line - i, sample - j
    across, down = cubic_weights(np.float32(x)), cubic_weights(np.float32(y))
    at_x, at_y = int(x * LANCZOS_STEPS + 0.5), int(y * LANCZOS_STEPS + 0.5)
    reach = 1 if method == BILINEAR else (2 if method == CUBIC else 3)
    total = 0.0
    value = 0.0
    for k in range(1 - reach, reach + 1):
        for m in range(1 - reach, reach + 1):
            if i + k < 0 or i + k >= rows or j + m < 0 or j + m >= cols:
                continue
            pixel = np.float64(image[i + k, j + m])
            if pixel != pixel or (has_nodata and pixel == nodata):
                continue
            if method == BILINEAR:
                weight = (y if k == 1 else 1.0 - y) * (x if m == 1 else 1.0 - x)
            elif method == CUBIC:
                weight = np.float64(down[k + 1]) * np.float64(across[m + 1])
            else:
                weight = np.float64(table[at_y, k + 2]) * np.float64(table[at_x, m + 2])
            total += weight
            value += weight * pixel
    return value / total if total > _LEAST_WEIGHT else nearest
