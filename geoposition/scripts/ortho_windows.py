"""The pixels of an orthoimage, in rows of windows: places, values, flags."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import FlagArray
from geoposition.flags import Flag
from geoposition.reimage.ortho import OrthoPlaces, OrthoTask, block_means, ortho_window
from geoposition.reimage.ortho_grid import OrthoGrid
from geoposition.reimage.raster_files import ImageFile
from geoposition.reimage.resample import Resampler

OrthoMethod = Literal["nearest", "bilinear", "cubic", "lanczos", "area"]

ROWS: Final = 512
"""Rows made at a time: those of a tile of the file."""

_COLS: Final = 8192
_MOST_FACTOR: Final = 16


@dataclass(slots=True)
class Tally:
    """What the windows add up to; one for each run."""

    error_px: float = 0.0
    flags: Any = None

    def add(self, error_px: float, flag: FlagArray) -> None:
        """Count in a window."""
        self.error_px = max(self.error_px, error_px)
        counts = np.array([np.count_nonzero(flag == value) for value in range(max(Flag) + 1)])
        self.flags = counts if self.flags is None else self.flags + counts


@dataclass(frozen=True, slots=True)
class OrthoMaker:
    """Makes pixels by `method` from the `image`; `fill` stands for what is not seen."""

    task: OrthoTask
    image: ImageFile
    method: OrthoMethod
    fill: float | None

    def rows(self, grid: OrthoGrid, first: int, tally: Tally) -> tuple[NDArray[Any], FlagArray]:
        """Pixels (bands, rows, cols) and flags (rows, cols) of rows `first` ... of `grid`."""
        rows, cols = min(ROWS, grid.shape[0] - first), grid.shape[1]
        pixels = np.empty((self.image.bands, rows, cols), self.image.dtype)
        flags = np.empty((rows, cols), np.uint8)
        for col in range(0, cols, _COLS):
            here = slice(col, min(col + _COLS, cols))
            part = grid.window(first, col, rows, here.stop - col)
            pixels[:, :, here], flags[:, here], places = self.window(part)
            tally.add(places.error_px, flags[:, here])
        return pixels, flags

    def window(self, grid: OrthoGrid) -> tuple[NDArray[Any], FlagArray, OrthoPlaces]:
        """Pixels (bands, rows, cols) and flags (rows, cols) of `grid`, and their places."""
        if self.method == "area":
            return self._means(grid)
        places = ortho_window(self.task, grid)
        resampler = Resampler(self.method, self.fill)
        pixels, valid = self._values(resampler, places)
        places.flag[(places.flag == Flag.OK) & (valid == 0)] = Flag.OUTSIDE_MODEL
        return pixels, places.flag, places

    def _means(self, grid: OrthoGrid) -> tuple[NDArray[Any], FlagArray, OrthoPlaces]:
        """Mean of so many values within each pixel that none of the image's is passed over."""
        rough = ortho_window(self.task, grid)
        factor = _stretch(rough)
        if factor == 1:
            return replace(self, method="bilinear").window(grid)
        fine = ortho_window(self.task, grid.finer(factor))
        values, valid = self._values(Resampler("bilinear", self.fill), fine)
        mean, seen = block_means(values, valid, factor)
        whole = self.image.dtype.kind != "f"
        pixels = np.where(seen != 0, np.rint(mean) if whole else mean, _number(self.fill))
        flag = np.where((rough.flag == Flag.OK) & (seen == 0), Flag.OUTSIDE_MODEL, rough.flag)
        flag[seen != 0] = Flag.OK
        return pixels.astype(self.image.dtype), flag.astype(np.uint8), fine

    def _values(self, resampler: Resampler, places: OrthoPlaces) -> tuple[NDArray[Any], FlagArray]:
        first = np.array([self.image.first_line, self.image.first_sample])
        size = np.array(self.image.shape)
        bounds = places.bounds_px
        if bounds is not None:
            start = np.clip(np.floor(bounds[0] - first).astype(int) - resampler.reach, 0, size)
            end = np.clip(np.ceil(bounds[1] - first).astype(int) + resampler.reach + 1, 0, size)
            if np.all(end > start):
                pixels = self.image.window(*start.tolist(), *(end - start).tolist())
                origin = (int(start[0] + first[0]), int(start[1] + first[1]))
                return resampler.at(pixels, places.line, places.sample, origin)
        empty = np.zeros(places.line.shape, dtype=np.uint8)
        shape = (self.image.bands, *places.line.shape)
        return np.full(shape, _number(self.fill)).astype(self.image.dtype), empty


def _number(fill: float | None) -> float:
    return float("nan") if fill is None else fill


def _stretch(places: OrthoPlaces) -> int:
    """Image pixels that a new pixel spans, in its longer direction, rounded up."""
    longest = 1.0
    for values in (places.line, places.sample):
        for axis in (0, 1):
            steps = np.abs(np.diff(values, axis=axis))
            steps = steps[np.isfinite(steps)]
            if steps.size:
                longest = max(longest, float(np.median(steps)))
    return int(min(np.ceil(longest - 0.05), _MOST_FACTOR))
