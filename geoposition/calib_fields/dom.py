"""A reference orthophoto: rasters on one lattice, read window by window."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.transform import Affine
from rasterio.vrt import WarpedVRT
from rasterio.warp import calculate_default_transform
from rasterio.windows import Window

from geoposition.arrays import FloatArray
from geoposition.datum import utm_epsg
from geoposition.errors import ArgumentError, MissingFileError, ProductError
from geoposition.reimage.ortho import OrthoGrid
from geoposition.terrain.source import split_vertical

_SQUARE: Final = 1e-6
_ALIGNED: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Dom:
    """A reference orthophoto: one raster, or tiles on one lattice, read by window.

    `grid` spans all tiles at their own resolution. Several bands are averaged to one grey value,
    unless `band` (from 1) names one.
    """

    paths: tuple[Path, ...]
    grid: OrthoGrid
    band: int | None = None

    @classmethod
    def open(
        cls, paths: str | PathLike[str] | Sequence[str | PathLike[str]], band: int | None = None
    ) -> Dom:
        """Look at the files: GeoTIFF, COG, VRT, whatever GDAL reads.

        `ProductError` where one is no raster or states no coordinate system, or where tiles are
        not in one system and on one lattice.
        """
        several = [paths] if isinstance(paths, str | PathLike) else list(paths)
        if not several:
            raise ArgumentError("DOM: at least one file expected")
        files = tuple(Path(path) for path in several)
        grids = [_lattice(path, band) for path in files]
        first = grids[0]
        for path, grid in zip(files[1:], grids[1:], strict=True):
            away = (
                (grid.left - first.left) / first.resolution,
                (first.top - grid.top) / first.resolution,
            )
            off = max(abs(value - round(value)) for value in away)
            same = abs(grid.resolution / first.resolution - 1.0) * max(grid.shape) < _ALIGNED
            if grid.crs != first.crs or not same or off > _ALIGNED:
                raise ProductError(
                    path, "geotransform", f"pixels in line with those of {files[0]} expected"
                )
        res = first.resolution
        left, top = min(grid.left for grid in grids), max(grid.top for grid in grids)
        right = max(grid.left + grid.shape[1] * res for grid in grids)
        bottom = min(grid.top - grid.shape[0] * res for grid in grids)
        shape = round((top - bottom) / res), round((right - left) / res)
        return cls(files, OrthoGrid(first.crs, left, top, res, shape), band)

    def coarser(self, factor: int) -> OrthoGrid:
        """Return the lattice with pixels of `factor` × `factor`; what does not fill one is cut."""
        rows, cols = (max(n // factor, 1) for n in self.grid.shape)
        grid = self.grid
        return OrthoGrid(grid.crs, grid.left, grid.top, grid.resolution * factor, (rows, cols))

    def read(self, window: OrthoGrid) -> FloatArray:
        """Grey values (rows, cols) of a window of a `coarser` lattice; NaN where there are none.

        A coarse pixel that lies across the seam of two tiles is left out.
        """
        res = self.grid.resolution
        factor = round(window.resolution / res)
        out = np.full(window.shape, np.nan)
        for path in self.paths:
            with opened(path) as file:
                view, left, top = _view(file, self.grid)
                with view as source:
                    part = _read_part(source, window, factor, left, top, res, self.band, path)
            if part is not None:
                rows, cols, values = part
                target = out[rows, cols]
                np.copyto(target, values, where=np.isnan(target))
        return out


def _lattice(path: Path, band: int | None) -> OrthoGrid:
    if "://" not in str(path) and not str(path).startswith("/vsi") and not path.exists():
        raise MissingFileError(path, "", "a reference orthophoto expected, there is no such file")
    try:
        with opened(path) as file:
            if not file.crs:
                raise ProductError(path, "coordinate system", "the orthophoto states none")
            if band is not None and not 1 <= band <= file.count:
                raise ProductError(path, "", f"band {band} expected, it has {file.count}")
            if file.transform.is_identity:
                raise ProductError(path, "geotransform", "an orthophoto expected, it has none")
            wkt, _ = split_vertical(file.crs.to_wkt(), str(path))
            t = file.transform
            if _regular(t):
                return OrthoGrid(wkt, t.c, t.f, t.a, file.shape)
            target, (t, cols, rows) = _upright(file)
            return OrthoGrid(target, t.c, t.f, t.a, (rows, cols))
    except (RasterioError, CRSError) as error:
        line = " ".join(str(error).split())
        raise ProductError(path, "", f"a raster GDAL can read expected: {line}") from None


def _regular(t: Affine) -> bool:
    """Whether the pixels are square and north is up."""
    return bool(
        abs(t.b) + abs(t.d) < _SQUARE * abs(t.a) and t.a > 0.0 and abs(t.e / t.a + 1.0) < _SQUARE
    )


def _upright(file: Any) -> tuple[str, tuple[Affine, int, int]]:
    """Return the UTM zone, and the transform and size of the raster in it, pixels square."""
    longitude, latitude = file.lnglat()
    crs = f"EPSG:{utm_epsg(np.radians(longitude), np.radians(latitude))}"
    return crs, calculate_default_transform(file.crs, crs, file.width, file.height, *file.bounds)


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a raster, whether or not it is anywhere on Earth."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as file:
            yield file


def _view(file: Any, grid: OrthoGrid) -> tuple[Any, float, float]:
    """Return the raster as it is, or warped to be upright; and its left and top."""
    if _regular(file.transform):
        return _kept_open(file), file.transform.c, file.transform.f
    crs, (transform, cols, rows) = _upright(file)
    view = WarpedVRT(
        file, crs=crs, transform=transform, width=cols, height=rows, resampling=Resampling.cubic
    )
    return view, transform.c, transform.f


@contextmanager
def _kept_open(file: Any) -> Iterator[Any]:
    yield file


def _read_part(
    source: Any,
    window: OrthoGrid,
    factor: int,
    left: float,
    top: float,
    res: float,
    band: int | None,
    path: Path,
) -> tuple[slice, slice, FloatArray] | None:
    """Rows and columns of `window` that `source` fills, and its values there."""
    row = round((top - window.top) / res)
    col = round((window.left - left) / res)
    # whole coarse pixels within the raster
    first = [max(0, -(n // factor)) for n in (row, col)]
    size = source.shape
    last = [
        min(count, (limit - n) // factor)
        for count, limit, n in zip(window.shape, size, (row, col), strict=True)
    ]
    if last[0] <= first[0] or last[1] <= first[1]:
        return None
    shape = last[0] - first[0], last[1] - first[1]
    asked = Window(
        col + first[1] * factor, row + first[0] * factor, shape[1] * factor, shape[0] * factor
    )
    bands = _grey_bands(source) if band is None else [band]
    try:
        values = source.read(
            bands,
            window=asked,
            out_shape=(len(bands), *shape),
            resampling=Resampling.average if factor > 1 else Resampling.nearest,
            masked=True,
            out_dtype="float64",
        )
    except RasterioError as error:
        raise ProductError(path, "pixels", f"cannot be read ({error})") from None
    grey = np.ma.mean(values, axis=0).astype(np.float64).filled(np.nan)
    grey[np.ma.getmaskarray(values).any(axis=0)] = np.nan
    return slice(first[0], last[0]), slice(first[1], last[1]), grey


def _grey_bands(source: Any) -> list[int]:
    kinds = source.colorinterp
    bands = [k + 1 for k in range(source.count) if kinds[k] != ColorInterp.alpha]
    return bands or [1]
