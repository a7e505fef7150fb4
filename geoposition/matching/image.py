"""An image file in its model's frame: windows of it as 8-bit grey, ready for feature detection."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window as RasterWindow

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, MissingFileError, ProductError

_CLIP_PERCENT: Final = 0.5
_LEVELS: Final = 255.0


@dataclass(frozen=True, slots=True)
class Window:
    """Lines `line` .. `line + lines` and samples `sample` .. of an image, in the model's frame."""

    line: int
    sample: int
    lines: int
    samples: int

    def within(self, other: Window) -> Window | None:
        """Return the part of it that lies in `other`, or None."""
        line, sample = max(self.line, other.line), max(self.sample, other.sample)
        lines = min(self.line + self.lines, other.line + other.lines) - line
        samples = min(self.sample + self.samples, other.sample + other.samples) - sample
        return Window(line, sample, lines, samples) if lines > 0 and samples > 0 else None


@dataclass(frozen=True, slots=True)
class ImageSource:
    """A raster `path` whose first pixel is (`first_line`, `first_sample`) in the model's frame.

    `shape` is the file's (lines, samples); `band` counts from 1.
    """

    path: Path
    shape: tuple[int, int]
    first_line: int = 0
    first_sample: int = 0
    band: int = 1

    @property
    def extent(self) -> Window:
        """The pixels that the file holds."""
        return Window(self.first_line, self.first_sample, *self.shape)

    def read(self, window: Window) -> FloatArray:
        """Grey values (lines, samples) of `window`, which must lie in `extent`; NaN for nodata."""
        inside = window.within(self.extent)
        if inside != window:
            raise ArgumentError(f"{self.path}: window {window} reaches outside the image")
        try:
            with _opened(self.path) as raster:
                grey = raster.read(
                    self.band,
                    window=RasterWindow(
                        window.sample - self.first_sample,
                        window.line - self.first_line,
                        window.samples,
                        window.lines,
                    ),
                    masked=True,
                )
        except RasterioError as error:
            raise ProductError(self.path, "pixels", f"cannot be read ({error})") from None
        values: FloatArray = grey.astype(np.float64).filled(np.nan)
        return values


def open_image(
    path: str | PathLike[str], band: int = 1, first_pixel: tuple[int, int] | None = None
) -> ImageSource:
    """Look at the raster `path`; its pixels are read window by window later.

    `first_pixel` (line, sample) says where its first pixel lies in the model's frame. Without
    it a raster in no coordinate system, with a geotransform of unit pixels, is taken for a crop
    whose origin is that place; any other begins at (0, 0).
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFileError(path, "", "an image expected, there is no such file")
    try:
        with _opened(path) as raster:
            count, shape, transform, crs = raster.count, raster.shape, raster.transform, raster.crs
    except RasterioError:
        raise ProductError(path, "", "an image expected, not readable as a raster") from None
    if not 1 <= band <= count:
        raise ProductError(path, "", f"band {band} expected, it has {count}")
    if first_pixel is None:
        unit = (transform.a, transform.b, transform.d, abs(transform.e)) == (1.0, 0.0, 0.0, 1.0)
        mapped = crs is not None and (crs.is_geographic or crs.is_projected)
        crop = unit and not mapped and transform.f >= 0.0 and transform.c >= 0.0
        first_pixel = (round(transform.f), round(transform.c)) if crop else (0, 0)
    return ImageSource(path, (int(shape[0]), int(shape[1])), *first_pixel, band)


def stretched(grey: FloatArray) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Grey values as 8 bits, clipped at the extreme half per cents; and a mask, 255 where valid."""
    valid = np.isfinite(grey)
    mask = np.where(valid, np.uint8(255), np.uint8(0))
    if not valid.any():
        return np.zeros(grey.shape, dtype=np.uint8), mask
    low, high = np.percentile(grey[valid], [_CLIP_PERCENT, 100.0 - _CLIP_PERCENT])
    scale = _LEVELS / (high - low) if high > low else 0.0
    level = np.where(valid, (grey - low) * scale, 0.5 * _LEVELS)
    return np.clip(np.rint(level), 0.0, _LEVELS).astype(np.uint8), mask


@contextmanager
def _opened(path: Path) -> Iterator[rasterio.io.DatasetReader]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as raster:
            yield raster
