"""Parallax between two rows of detectors that see the same ground a moment apart.

One image is brought to the other's geometry by models without jitter; what is left between them
is the difference of the jitter at two times. It is measured in narrow blocks of lines by least
squares on the grey values: iterated, since the shifts may be larger than what is linear.

*Source*: Lucas & Kanade 1981, IJCAI; parallax as a jitter sensor: T's references, Teshima &
Iwasaki 2008, IEEE TGRS 46(1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ArgumentError, GeometryError
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.mapping import RowMap, map_models
from geoposition.reimage.resample import Resampler
from geoposition.terrain import Terrain

_ITERATIONS: Final = 15
_SETTLED_PX: Final = 1e-3
_SMOOTH_PX: Final = (0.6, 1.0)
_EDGE: Final = 4
_LEAST_PIXELS: Final = 64
_LEAST_SLOPE: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Parallax:
    """Shifts `shift_px` (n, 2), (line, sample), of the second image against the first.

    `times_s` (n,) are when the first image's blocks were taken, evenly; `lag_s` later the second
    one sees the same ground. `sigma_px` (n, 2) follows from the grey values' misfit; NaN where
    nothing could be measured. `block_s` is how long a block takes.
    """

    times_s: FloatArray
    shift_px: FloatArray
    sigma_px: FloatArray
    lag_s: float
    block_s: float


def measure_parallax(
    first_model: PushbroomModel,
    second_model: PushbroomModel,
    first: NDArray[Any],
    second: NDArray[Any],
    terrain: Terrain | float,
    block_rows: int = 4,
) -> Parallax:
    """Parallax of `first` and `second` (lines, samples), images of two models without jitter.

    `block_rows` lines at a time: more give smaller errors, and cannot follow high frequencies.
    """
    if first.shape != first_model.shape or second.shape != second_model.shape:
        raise ArgumentError("parallax: images of their models' sizes expected")
    rows, cols = first.shape
    if block_rows < 1 or rows < 4 * block_rows:
        raise ArgumentError(f"parallax: at least {4 * block_rows} lines expected, got {rows}")
    places = map_models(first_model, second_model, terrain).rows(0, rows)
    lag_s = _lag_s(first_model, second_model, places, cols)
    # interpolation is worst at the finest texture, and biases shifts by some hundredths there
    grey = np.ascontiguousarray(_smooth(second), dtype=np.float32)[None]
    count = rows // block_rows
    shift = np.zeros((count, 2))
    sigma = np.full((count, 2), np.nan)
    centre = block_rows * np.arange(count, dtype=np.float64) + 0.5 * (block_rows - 1)
    known = np.zeros(count, dtype=np.bool_)
    target = _smooth(first)
    for _ in range(_ITERATIONS):
        moved = _shifted(places, centre, shift)
        brought, valid = Resampler("lanczos").rows(grey, moved, cols)
        seen = (valid != 0) & np.isfinite(target)
        there = np.where(seen, brought[0], 0.0)
        step, sigma, known = _steps(np.where(seen, target, 0.0), there, seen, block_rows)
        shift[known] += step[known]
        if known.any() and np.sqrt(np.mean(step[known] ** 2)) < _SETTLED_PX:
            break
    if known.sum() < 4:
        raise GeometryError("parallax: the two images have too little in common to be compared")
    shift[~known] = np.nan
    timing = first_model.camera.timing
    times = timing.time_s(centre)
    block_s = abs(float(times[1] - times[0]))
    return Parallax(read_only(times), read_only(shift), read_only(sigma), lag_s, block_s)


def _lag_s(first: PushbroomModel, second: PushbroomModel, places: RowMap, cols: int) -> float:
    """Mean time from when the first sees a place to when the second does."""
    lines = places.displacement_px(np.linspace(0.0, cols - 1.0, 5))[..., 0]
    own = np.arange(len(lines), dtype=np.float64)
    seen = np.isfinite(lines)
    if not seen.any():
        raise GeometryError("parallax: the second image sees nothing of the first one's ground")
    theirs = (own[:, None] + lines)[seen]
    mine = np.broadcast_to(own[:, None], lines.shape)[seen]
    a, b = first.camera.timing, second.camera.timing
    later = b.time_s(theirs) + (b.epoch - a.epoch) - a.time_s(mine)
    return float(np.mean(later))


def _shifted(places: RowMap, centre: FloatArray, shift: FloatArray) -> RowMap:
    rows = np.arange(len(places.places), dtype=np.float64)
    each = np.stack([np.interp(rows, centre, shift[:, k]) for k in range(2)], axis=-1)
    return RowMap(0, places.node_step, places.places + each[:, None], places.error_px)


def _smooth(grey: NDArray[Any]) -> FloatArray:
    smooth: FloatArray = ndimage.gaussian_filter(
        grey.astype(np.float64), _SMOOTH_PX, mode="nearest"
    )
    return smooth


def _slope(grey: FloatArray, axis: int) -> FloatArray:
    """First differences of fourth order: simple ones are too flat for fine texture."""
    near = np.roll(grey, -1, axis) - np.roll(grey, 1, axis)
    far = np.roll(grey, -2, axis) - np.roll(grey, 2, axis)
    return np.asarray((8.0 * near - far) / 12.0)


def _steps(
    first: FloatArray, second: FloatArray, valid: NDArray[np.bool_], block_rows: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """One least-squares step of each block: shift (n, 2), sigma (n, 2), and whether there is."""
    mean = 0.5 * (first + second)
    by_line, by_sample = (_slope(mean, axis) for axis in (0, 1))
    # the second image's contrast and level may differ: a gain and an offset are solved along
    inside = valid.copy()
    for axis in (0, 1):
        for step in (-2, -1, 1, 2):
            inside &= np.roll(valid, step, axis=axis)
    inside[:, :_EDGE] = inside[:, -_EDGE:] = False
    inside[:2] = inside[-2:] = False
    terms = np.stack([by_line, by_sample, second, np.ones_like(second)], axis=-1)
    count = first.shape[0] // block_rows
    size = block_rows * first.shape[1]
    terms = terms[: count * block_rows].reshape(count, size, 4)
    weight = inside[: count * block_rows].reshape(count, size).astype(np.float64)
    value = first[: count * block_rows].reshape(count, size)
    weighted = terms * weight[..., None]
    normal = np.einsum("nsi,nsj->nij", weighted, terms)
    right = np.einsum("nsi,ns->ni", weighted, value)
    pixels = weight.sum(axis=1)
    known = (pixels >= _LEAST_PIXELS) & (normal[:, 0, 0] > _LEAST_SLOPE * pixels)
    known &= normal[:, 1, 1] > _LEAST_SLOPE * pixels
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
    scaled = normal / (scale[:, :, None] * scale[:, None, :])
    known &= np.linalg.cond(scaled) < 1e10
    inverse = np.zeros_like(normal)
    inverse[known] = np.linalg.inv(scaled[known])
    inverse /= scale[:, :, None] * scale[:, None, :]
    solution = np.einsum("nij,nj->ni", inverse, right)
    left = value - np.einsum("nsi,ni->ns", terms, solution)
    variance = np.sum(weight * left**2, axis=1) / np.maximum(pixels - 4, 1)
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", inverse)[:, :2] * variance[:, None], 0.0))
    # first = second(x + step) = second + step . gradient
    return np.where(known[:, None], solution[:, :2], 0.0), sigma, known
