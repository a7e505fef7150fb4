"""Cells of rasters of heights, as points: for comparing one surface with another."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor
from os import PathLike
from typing import Final

import numpy as np
import rasterio
from rasterio.errors import RasterioError
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window, from_bounds

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.constants import WGS84_A_M
from geoposition.datum import from_crs, to_crs, utm_epsg
from geoposition.errors import ProductError
from geoposition.longitudes import middle_of

_MOST: Final = 1_000_000
_BLOCK: Final = 1024
_MOST_COVER: Final = 25_000_000


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCells:
    """Cells with a height: `xy` (n, 2) in `crs`, `height_m` (n,).

    `unit_per_m` (2,) are units of `crs` per metre east and north, `spacing_m` between compared
    cells, of which every `stride`-th of the raster's rows and columns is one.
    """

    crs: str
    xy: FloatArray
    height_m: FloatArray
    unit_per_m: FloatArray
    spacing_m: float
    stride: int

    def where(self, keep: BoolArray) -> SurfaceCells:
        """Return the cells of the mask `keep`."""
        return SurfaceCells(
            self.crs,
            self.xy[keep],
            self.height_m[keep],
            self.unit_per_m,
            self.spacing_m,
            self.stride,
        )


def surface_cells(path: str | PathLike[str], most: int = _MOST) -> SurfaceCells:
    """Read at most about `most` cells of the first band of `path`, evenly spread."""
    try:
        with rasterio.open(path) as raster:
            stride = max(1, int(np.ceil(np.sqrt(raster.width * raster.height / most))))
            xy, heights = [], []
            for top in range(0, raster.height, _BLOCK * stride):
                lines = min(_BLOCK * stride, raster.height - top)
                band = raster.read(1, window=Window(0, top, raster.width, lines), masked=True)
                part = band.astype(np.float64).filled(np.nan)[::stride, ::stride]
                row, column = np.nonzero(np.isfinite(part))
                x, y = raster.transform * (column * stride + 0.5, top + row * stride + 0.5)
                xy.append(np.column_stack([x, y]))
                heights.append(part[row, column])
            crs, transform = raster.crs, raster.transform
    except RasterioError:
        raise ProductError(path, "", "a raster of heights expected") from None
    if crs is None:
        raise ProductError(path, "coordinate system", "the raster states none")
    place = np.concatenate(xy)
    unit = np.ones(2)
    if crs.is_geographic:
        latitude = np.radians(float(place[:, 1].mean())) if len(place) else 0.0
        unit = np.degrees(1.0 / WGS84_A_M) / np.array([np.cos(latitude), 1.0])
    spacing = stride * abs(float(transform.e)) / float(unit[1])
    return SurfaceCells(crs.to_wkt(), place, np.concatenate(heights), unit, spacing, stride)


def point_cells(geodetic: FloatArray) -> SurfaceCells:
    """Ground points (n, 3) as cells, in the UTM zone of their middle; each stands for itself."""
    if not len(geodetic):
        return SurfaceCells("EPSG:4326", np.empty((0, 2)), np.empty(0), np.ones(2), 1.0, 1)
    middle = middle_of(geodetic)
    crs = f"EPSG:{utm_epsg(float(middle[0]), float(middle[1]))}"
    place = to_crs(crs, geodetic)
    extent = np.ptp(place[:, :2], axis=0)
    spacing = max(float(np.sqrt(np.prod(extent) / len(place))), 1e-3)
    return SurfaceCells(crs, place[:, :2], place[:, 2], np.ones(2), spacing, 1)


def reference_nodes(
    reference: str | PathLike[str], geodetic: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Cell (row, column) of `reference` that each ground point (n, 3) lies in, and its centre.

    Centres (n, 2) are (lon_rad, lat_rad).
    """
    with rasterio.open(reference) as raster:
        crs, transform = raster.crs.to_wkt(), raster.transform
    place = to_crs(crs, geodetic)
    column, row = ~transform * (place[:, 0], place[:, 1])
    cell = np.floor(np.column_stack([row, column])).astype(np.int64)
    x, y = transform * (cell[:, 1] + 0.5, cell[:, 0] + 0.5)
    centre = from_crs(crs, np.column_stack([x, y, geodetic[:, 2]]))
    return cell, centre[:, :2]


def reference_cover(
    surface: str | PathLike[str], reference: str | PathLike[str]
) -> tuple[float, float]:
    """Share of the cells of `reference` within the bounds of `surface` that have a height there.

    And the spacing of the reference's cells, in metres. NaN for the share where it has none.
    """
    with rasterio.open(reference) as ref, rasterio.open(surface) as own:
        degrees = bool(ref.crs and ref.crs.is_geographic)
        spacing = abs(float(ref.transform.e)) * (np.radians(WGS84_A_M) if degrees else 1.0)
        with WarpedVRT(own, crs=ref.crs) as warped:
            bounds = warped.bounds
        inside = from_bounds(*bounds, transform=ref.transform)
        left, top = max(0, ceil(inside.col_off)), max(0, ceil(inside.row_off))
        right = min(ref.width, floor(inside.col_off + inside.width))
        bottom = min(ref.height, floor(inside.row_off + inside.height))
        if left >= right or top >= bottom or (right - left) * (bottom - top) > _MOST_COVER:
            return float("nan"), spacing
        window = Window(left, top, right - left, bottom - top)
        wanted = np.isfinite(ref.read(1, window=window, masked=True).astype(float).filled(np.nan))
        with WarpedVRT(
            own,
            crs=ref.crs,
            transform=ref.window_transform(window),
            width=right - left,
            height=bottom - top,
        ) as warped:
            have = np.isfinite(warped.read(1, masked=True).astype(float).filled(np.nan))
    total = int(wanted.sum())
    return (float((wanted & have).sum() / total) if total else float("nan")), spacing
