"""Compiled resampling of image windows into epipolar tiles, and of disparities back."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from geoposition.arrays import FloatArray
from geoposition.dense.height_field import Grid32, height_scalar
from geoposition.matching.image import ImageSource, Window

Grey: TypeAlias = NDArray[np.float32]

_FAST = {"contract", "arcp", "nsz", "reassoc"}
_STRIP_PX: Final = 1 << 23
_JUMP_PX: Final = 1.0


def pixel_of(window: Window, reduction: int) -> FloatArray:
    """Return first line, first sample, and twice 1 / f: image place to reduced pixels."""
    middle = 0.5 * (reduction - 1.0)
    scale = 1.0 / reduction
    return np.array([window.line + middle, window.sample + middle, scale, scale])


def read_reduced(source: ImageSource, window: Window, reduction: int) -> tuple[Grey, Window] | None:
    """Read the part of `window` that the image holds, as means of f × f pixels; NaN for nodata.

    Only whole blocks count: returned is the window that they cover, or None if there are none.
    Read by strips: of a reduced image no more than one strip is held in full.
    """
    inside = window.within(source.extent)
    if inside is None:
        return None
    f = reduction
    line = inside.line + (-(inside.line - window.line)) % f
    sample = inside.sample + (-(inside.sample - window.sample)) % f
    rows = (inside.line + inside.lines - line) // f
    columns = (inside.sample + inside.samples - sample) // f
    if rows < 1 or columns < 1:
        return None
    out = np.empty((rows, columns), dtype=np.float32)
    strip = max(1, _STRIP_PX // (f * f * columns))
    for row in range(0, rows, strip):
        n = min(strip, rows - row)
        grey = source.read(Window(line + row * f, sample, n * f, columns * f))
        if f > 1:
            grey = grey.reshape(n, f, columns, f).mean(axis=(1, 3))
        out[row : row + n] = grey
    return out, Window(line, sample, rows * f, columns * f)


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _cubic(grey: Grey, line: float, sample: float) -> float:
    """Cubic convolution (a = −1/2) at one place; NaN outside, or next to NaN."""
    i, j = math.floor(line), math.floor(sample)
    if not (1 <= i < grey.shape[0] - 2 and 1 <= j < grey.shape[1] - 2):
        return math.nan
    t = line - i
    a0 = t * (-0.5 + t * (1.0 - 0.5 * t))
    a1 = 1.0 + t * t * (1.5 * t - 2.5)
    a3 = t * t * (0.5 * t - 0.5)
    a2 = 1.0 - a0 - a1 - a3
    t = sample - j
    b0 = t * (-0.5 + t * (1.0 - 0.5 * t))
    b1 = 1.0 + t * t * (1.5 * t - 2.5)
    b3 = t * t * (0.5 * t - 0.5)
    b2 = 1.0 - b0 - b1 - b3
    i -= 1
    j -= 1
    r0 = b0 * grey[i, j] + b1 * grey[i, j + 1] + b2 * grey[i, j + 2] + b3 * grey[i, j + 3]
    i += 1
    r1 = b0 * grey[i, j] + b1 * grey[i, j + 1] + b2 * grey[i, j + 2] + b3 * grey[i, j + 3]
    i += 1
    r2 = b0 * grey[i, j] + b1 * grey[i, j + 1] + b2 * grey[i, j + 2] + b3 * grey[i, j + 3]
    i += 1
    r3 = b0 * grey[i, j] + b1 * grey[i, j + 1] + b2 * grey[i, j + 2] + b3 * grey[i, j + 3]
    value: float = a0 * r0 + a1 * r1 + a2 * r2 + a3 * r3
    return value


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def view_first(grey: Grey, affine: FloatArray, out: Grey) -> None:
    """Resample `grey` by `affine` (2, 3), (1, v, u) to its pixels."""
    for v in prange(out.shape[0]):
        l0, s0 = affine[0, 0] + v * affine[0, 1], affine[1, 0] + v * affine[1, 1]
        dl, ds = affine[0, 2], affine[1, 2]
        for u in range(out.shape[1]):
            out[v, u] = _cubic(grey, l0 + u * dl, s0 + u * ds)


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _guided(c: FloatArray, n: FloatArray, line: float, sample: float, height: float):  # type: ignore[no-untyped-def]
    """Line and sample of the second image: the quadratic of `matching.guide`."""
    x, y, z = (line - n[0]) * n[3], (sample - n[1]) * n[4], (height - n[2]) * n[5]
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    out_line = (
        c[0, 0] + x * c[1, 0] + y * c[2, 0] + z * c[3, 0] + xx * c[4, 0]
        + yy * c[5, 0] + zz * c[6, 0] + xy * c[7, 0] + xz * c[8, 0] + yz * c[9, 0]
    )  # fmt: skip
    out_sample = (
        c[0, 1] + x * c[1, 1] + y * c[2, 1] + z * c[3, 1] + xx * c[4, 1]
        + yy * c[5, 1] + zz * c[6, 1] + xy * c[7, 1] + xz * c[8, 1] + yz * c[9, 1]
    )  # fmt: skip
    return out_line, out_sample


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def view_second(
    grey: Grey,
    affine: FloatArray,
    nodes: Grid32,
    place: FloatArray,
    coefficients: FloatArray,
    normal: FloatArray,
    pixel: FloatArray,
    out: Grey,
) -> None:
    """Resample `grey` of the second image where the guide puts the surface of `nodes`.

    `affine` takes (1, v, u) to the first image, `pixel` is `pixel_of` of `grey`'s window.
    """
    for v in prange(out.shape[0]):
        l0, s0 = affine[0, 0] + v * affine[0, 1], affine[1, 0] + v * affine[1, 1]
        dl, ds = affine[0, 2], affine[1, 2]
        for u in range(out.shape[1]):
            line, sample = l0 + u * dl, s0 + u * ds
            height = height_scalar(nodes, place, line, sample)
            line, sample = _guided(coefficients, normal, line, sample, height)
            out[v, u] = _cubic(grey, (line - pixel[0]) * pixel[2], (sample - pixel[1]) * pixel[3])


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def to_second(
    disparity: Grey,
    sigma: Grey,
    row0: FloatArray,
    major: int,
    first_px: FloatArray,
    e_u: FloatArray,
    reduction: float,
    nodes: Grid32,
    place: FloatArray,
    coefficients: FloatArray,
    normal: FloatArray,
    second_px: FloatArray,
    sigma_px: Grey,
) -> None:
    """Places in the second image (n, m, 2) of the pixels of a core, NaN without a disparity.

    Pixel (0, 0) of the core has row `row0[0]` and column `row0[1]`, and lies at `first_px`;
    `major` is the image axis of the columns. Disparities are linear between two rows that agree,
    else the nearer row's.
    """
    lean = e_u[1 - major]
    for i in prange(second_px.shape[0]):
        for j in range(second_px.shape[1]):
            # The counters of a parallel loop are unsigned.
            line_of, sample_of = np.int64(i), np.int64(j)
            along, aside = (line_of, sample_of) if major == 0 else (sample_of, line_of)
            u = np.int64(row0[1]) + along
            y = row0[0] + aside - lean * along
            v = np.int64(math.floor(y))
            second_px[i, j, 0] = math.nan
            second_px[i, j, 1] = math.nan
            sigma_px[i, j] = math.nan
            if not (0 <= v < disparity.shape[0] - 1 and 0 <= u < disparity.shape[1]):
                continue
            t = y - v
            near, far = (v, v + 1) if t <= 0.5 else (v + 1, v)
            d = float(disparity[near, u])
            other = float(disparity[far, u])
            if d != d:
                continue
            w = t if t <= 0.5 else 1.0 - t
            if abs(other - d) < _JUMP_PX:
                d += w * (other - d)
            line = first_px[0] + reduction * (i - d * e_u[0])
            sample = first_px[1] + reduction * (j - d * e_u[1])
            height = height_scalar(nodes, place, line, sample)
            line, sample = _guided(coefficients, normal, line, sample, height)
            second_px[i, j, 0] = line
            second_px[i, j, 1] = sample
            sigma_px[i, j] = sigma[near, u]
