"""The images that new ones are made of, read by lines or windows."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from geoposition.errors import MissingFileError, ProductError, UnsupportedError
from geoposition.reimage.resample import PIXEL_TYPES

_CACHE_MB: Final = 192


@dataclass(frozen=True, slots=True, eq=False)
class ImageFile:
    """An open raster: `shape` (lines, samples), `bands`, `dtype`, `nodata`.

    Its first pixel is (`first_line`, `first_sample`) of the model's image: other than zero for
    a crop, a raster in no map system whose geotransform is a whole-pixel shift.
    """

    path: Path
    raster: Any
    shape: tuple[int, int]
    bands: int
    dtype: np.dtype[Any]
    nodata: float | None
    first_line: int
    first_sample: int
    band_names: tuple[str, ...]
    lock: Any

    def lines(self, first: int, end: int) -> NDArray[Any]:
        """Lines `first` ... `end` − 1 of the file, (bands, lines, samples)."""
        return self.window(first, 0, end - first, self.shape[1])

    def window(self, line: int, sample: int, lines: int, samples: int) -> NDArray[Any]:
        """Pixels of a window of the file, (bands, lines, samples)."""
        try:
            with self.lock:
                pixels: NDArray[Any] = self.raster.read(window=Window(sample, line, samples, lines))
        except RasterioError as error:
            raise ProductError(self.path, "pixels", f"cannot be read ({_line(error)})") from None
        return np.ascontiguousarray(pixels)


@contextmanager
def opened_image(path: str | PathLike[str], crop: bool = True) -> Iterator[ImageFile]:
    """Open the image `path`; with `crop` its geotransform may say that it is part of an image."""
    path = Path(path)
    if not path.is_file():
        raise MissingFileError(path, "", "an image expected, there is no such file")
    with warnings.catch_warnings(), rasterio.Env(GDAL_CACHEMAX=_CACHE_MB):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            raster = rasterio.open(path)
            if raster.compression is not None and raster.driver == "GTiff":
                raster.close()
                raster = rasterio.open(path, num_threads="all_cpus")
        except RasterioError:
            raise ProductError(path, "", "an image expected, not readable as a raster") from None
        with raster:
            types = set(raster.dtypes)
            if len(types) != 1 or not types <= set(PIXEL_TYPES):
                raise UnsupportedError(
                    path, "pixels", f"{', '.join(PIXEL_TYPES)} expected, got {sorted(types)}"
                )
            nodata = raster.nodata
            if nodata is not None and np.isnan(nodata):
                nodata = None
            first = _first_pixel(raster) if crop else (0, 0)
            yield ImageFile(
                path,
                raster,
                (raster.height, raster.width),
                raster.count,
                np.dtype(raster.dtypes[0]),
                nodata,
                *first,
                tuple(name or "" for name in raster.descriptions),
                threading.Lock(),
            )


def _first_pixel(raster: Any) -> tuple[int, int]:
    t, crs = raster.transform, raster.crs
    unit = (t.a, t.b, t.d, abs(t.e)) == (1.0, 0.0, 0.0, 1.0)
    mapped = crs is not None and (crs.is_geographic or crs.is_projected)
    if unit and not mapped and t.f >= 0.0 and t.c >= 0.0:
        return round(t.f), round(t.c)
    return 0, 0


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
