"""The image files of re-imaging: sources read by lines, results written by windows, then as COG."""

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
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from geoposition.errors import MissingFileError, ProductError, UnsupportedError
from geoposition.reimage.resample import PIXEL_TYPES

TILE: Final = 512
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
                threading.Lock(),
            )


def _first_pixel(raster: Any) -> tuple[int, int]:
    t, crs = raster.transform, raster.crs
    unit = (t.a, t.b, t.d, abs(t.e)) == (1.0, 0.0, 0.0, 1.0)
    mapped = crs is not None and (crs.is_geographic or crs.is_projected)
    if unit and not mapped and t.f >= 0.0 and t.c >= 0.0:
        return round(t.f), round(t.c)
    return 0, 0


@dataclass(frozen=True, slots=True)
class Layout:
    """What a raster to be written is like; `transform` are GDAL's six numbers, if any."""

    shape: tuple[int, int]
    bands: int
    dtype: str
    nodata: float | None = None
    crs: str | None = None
    transform: tuple[float, ...] | None = None


@contextmanager
def written_raster(path: Path, layout: Layout) -> Iterator[Any]:
    """Open a tiled GeoTIFF to write into by windows; not compressed, so that any order is fast."""
    extra: dict[str, Any] = {}
    if layout.crs is not None:
        extra["crs"] = layout.crs
    if layout.transform is not None:
        extra["transform"] = rasterio.Affine.from_gdal(*layout.transform)
    with warnings.catch_warnings(), rasterio.Env(GDAL_CACHEMAX=_CACHE_MB):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        if layout.shape[1] >= TILE:
            extra |= {"tiled": True, "blockxsize": TILE, "blockysize": TILE}
        try:
            with rasterio.open(
                path, "w", driver="GTiff", width=layout.shape[1], height=layout.shape[0],
                count=layout.bands, dtype=layout.dtype, nodata=layout.nodata,
                bigtiff="IF_SAFER", **extra,
            ) as raster:  # fmt: skip
                yield raster
        except RasterioError as error:
            raise ProductError(path, "", f"a writable place expected ({_line(error)})") from None


def write_rows(raster: Any, first_row: int, pixels: NDArray[Any]) -> None:
    """Write `pixels` (bands, rows, cols) as the rows from `first_row` on."""
    _, rows, cols = pixels.shape
    raster.write(pixels, window=Window(0, first_row, cols, rows))


def to_cog(source: Path, target: Path, compress: str, overviews: str = "average") -> None:
    """Copy `source` to a cloud-optimised GeoTIFF; tags and RPC go along.

    `overviews` are "average", "nearest" (of codes), or "none".
    """
    options: dict[str, Any] = {
        "COMPRESS": compress.upper(),
        "BLOCKSIZE": TILE,
        "NUM_THREADS": "ALL_CPUS",
        "BIGTIFF": "IF_SAFER",
    }
    if overviews == "none":
        options["OVERVIEWS"] = "NONE"
    else:
        options["RESAMPLING"] = overviews.upper()
    if compress in ("deflate", "zstd"):
        options["LEVEL"] = 1
    if compress != "none":
        options["PREDICTOR"] = "YES"
    with warnings.catch_warnings(), rasterio.Env(GDAL_CACHEMAX=_CACHE_MB):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            rasterio.shutil.copy(source, target, driver="COG", **options)
        except RasterioError as error:
            raise ProductError(target, "", f"a writable place expected ({_line(error)})") from None


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
