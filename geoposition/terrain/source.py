"""Rasters of heights as GDAL gives them: one file, or tiles of one lattice, read by window.

A node is a pixel's centre; GDAL's transform already knows whether a file counts pixels as
areas or as points. Nothing is kept open and nothing is read but the asked window.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from rasterio.enums import ColorInterp
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, MissingFileError, ProductError, UnsupportedError

PLAUSIBLE_M: Final = (-12000.0, 10000.0)
"""Heights outside are holes: undeclared fill values, since the Earth has no such ground."""
_LATTICE_PX: Final = 0.01
_HEIGHT_BAND: Final = "height"
_METRE_NAMES: Final = {"", "m", "metre", "metres", "meter", "meters"}


@dataclass(frozen=True, slots=True)
class Tile:
    """One file on the lattice: its first node's (row, column) and its size."""

    path: str
    row: int
    col: int
    rows: int
    cols: int


@dataclass(frozen=True, slots=True)
class Lattice:
    """Files on one lattice of nodes.

    `from_grid` (2, 3) takes (1, row, col) to (x, y) in the units of `crs_wkt` (horizontal part
    only); rows and columns count from the first file's first node. `period` is the number of
    columns around the Earth, 0 where the lattice does not close. `vertical` is the stated
    vertical datum: "" if none, "ellipsoid", or the name of an orthometric one.
    """

    tiles: tuple[Tile, ...]
    crs_wkt: str
    geographic: bool
    vertical: str
    from_grid: FloatArray
    period: int

    @property
    def bounds(self) -> tuple[int, int, int, int]:
        """First row, first column, and the ones after the last."""
        return (
            min(tile.row for tile in self.tiles),
            min(tile.col for tile in self.tiles),
            max(tile.row + tile.rows for tile in self.tiles),
            max(tile.col + tile.cols for tile in self.tiles),
        )

    @property
    def closed(self) -> bool:
        """Whether the columns go all around the Earth."""
        _, first, _, end = self.bounds
        return self.period > 0 and end - first >= self.period

    def read(self, row: int, col: int, rows: int, cols: int) -> FloatArray:
        """Heights (rows, cols) as in the files, NaN in holes and where no file reaches.

        Where files overlap, the first that has a height there gives it.
        """
        out = np.full((rows, cols), np.nan)
        for tile in self.tiles:
            turns = (-1, 0, 1) if self.period else (0,)
            for turn in turns:
                at_col = tile.col + turn * self.period
                r0, r1 = max(row, tile.row), min(row + rows, tile.row + tile.rows)
                c0, c1 = max(col, at_col), min(col + cols, at_col + tile.cols)
                if r0 >= r1 or c0 >= c1:
                    continue
                target = out[r0 - row : r1 - row, c0 - col : c1 - col]
                part = _read(tile.path, r0 - tile.row, c0 - at_col, r1 - r0, c1 - c0)
                np.copyto(target, part, where=np.isnan(target))
        return out


def _read(path: str, row: int, col: int, rows: int, cols: int) -> FloatArray:
    try:
        with _open(path) as raster:
            band = raster.read(1, window=Window(col, row, cols, rows), masked=True)
            scale, offset = raster.scales[0], raster.offsets[0]
    except RasterioError as error:
        raise ProductError(path, "pixels", f"not readable ({_one_line(error)})") from None
    height: FloatArray = band.data.astype(np.float64)
    if scale != 1.0 or offset != 0.0:
        height = height * scale + offset
    with np.errstate(invalid="ignore"):
        hole = ~((height >= PLAUSIBLE_M[0]) & (height <= PLAUSIBLE_M[1]))
    height[hole | np.ma.getmaskarray(band)] = np.nan
    return height


def _open(path: str) -> rasterio.DatasetReader:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        return rasterio.open(path)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


@dataclass(frozen=True, slots=True)
class _Header:
    path: str
    affine: FloatArray
    """(2, 3): (1, row, col) of a node to (x, y)."""
    shape: tuple[int, int]
    crs_wkt: str
    geographic: bool
    vertical: str


def open_lattice(paths: Sequence[str | PathLike[str]]) -> Lattice:
    """Check the files and put them on one lattice; nothing but headers is read.

    Raises
    ------
    MissingFileError, ProductError, UnsupportedError
        A file is absent, no raster of heights in metres, not georeferenced, of several bands,
        or not on the lattice of the first.
    """
    if not paths:
        raise ArgumentError("terrain: at least one raster expected")
    headers = [_header(str(path)) for path in paths]
    for header in headers:
        if not np.all(np.isfinite(header.affine)):
            raise ProductError(header.path, "geotransform", "finite numbers expected")
    first = headers[0]
    linear = first.affine[:, 1:]
    period = 0
    if first.geographic and linear[0, 0] == 0.0 and linear[1, 1] == 0.0:
        columns = 360.0 / abs(linear[0, 1])
        if abs(columns - round(columns)) < _LATTICE_PX:
            period = round(columns)
    tiles = []
    for header in headers:
        if (header.crs_wkt, header.vertical) != (first.crs_wkt, first.vertical):
            raise UnsupportedError(
                header.path,
                "coordinate system",
                f"that of {first.path} expected: bring all tiles to one system, or build a VRT",
            )
        drift = np.linalg.solve(linear, header.affine[:, 1:]) - np.eye(2)
        origin = np.linalg.solve(linear, header.affine[:, 0] - first.affine[:, 0])
        row, col = (round(float(value)) for value in origin)
        off = np.max(np.abs(drift) @ np.array(header.shape)) + np.max(np.abs(origin - (row, col)))
        if not off < _LATTICE_PX:
            raise UnsupportedError(
                header.path,
                "geotransform",
                f"pixels in line with those of {first.path} "
                "expected: build a VRT, which resamples them",
            )
        if period:
            col = (col + period // 2) % period - period // 2
        tiles.append(Tile(header.path, row, col, *header.shape))
    return Lattice(
        tuple(tiles), first.crs_wkt, first.geographic, first.vertical, first.affine, period
    )


def _header(path: str) -> _Header:
    if "://" not in path and not path.startswith("/vsi") and not Path(path).exists():
        raise MissingFileError(path, "", "a raster of heights expected, there is no such file")
    try:
        with _open(path) as raster:
            bands = sum(kind != ColorInterp.alpha for kind in raster.colorinterp)
            named = (raster.descriptions[0] or "").strip().lower() == _HEIGHT_BAND
            dtype, unit, crs = raster.dtypes[0], raster.units[0] or "", raster.crs
            transform, shape = raster.transform, raster.shape
            wkt = crs.to_wkt() if crs else ""
            geographic = bool(crs and crs.is_geographic)
            gcps = bool(raster.gcps[0])
    except (RasterioError, CRSError) as error:
        raise ProductError(
            path, "", f"a raster GDAL can read expected: {_one_line(error)}"
        ) from None
    # A surface of ours has layers of counts and errors beside its heights, and says which is which.
    if bands != 1 and not named:
        raise UnsupportedError(path, "bands", f"one band of heights expected, it has {bands}")
    if dtype.startswith("complex"):
        raise UnsupportedError(path, "band 1", "heights expected, it holds complex numbers")
    if unit.strip().lower() not in _METRE_NAMES:
        raise UnsupportedError(path, "band 1", f"heights in metres expected, its unit is {unit!r}")
    if not wkt:
        raise ProductError(path, "coordinate system", "the raster states none")
    determinant = transform.a * transform.e - transform.b * transform.d
    if transform.is_identity or not (math.isfinite(determinant) and determinant != 0.0):
        wanted = "a geotransform expected" + (", it has control points only" if gcps else "")
        raise ProductError(path, "geotransform", wanted)
    if min(shape) < 2:
        raise ProductError(path, "size", f"at least 2 x 2 pixels expected, it has {shape}")
    horizontal, vertical = split_vertical(wkt, path)
    affine = np.array(
        [
            [transform.c + 0.5 * (transform.a + transform.b), transform.b, transform.a],
            [transform.f + 0.5 * (transform.d + transform.e), transform.e, transform.d],
        ]
    )
    return _Header(path, affine, shape, horizontal, geographic, vertical)


def split_vertical(wkt: str, path: str) -> tuple[str, str]:
    """Horizontal part of a system in WKT 1 or 2, and its vertical datum as `Lattice` names it."""
    if not wkt.startswith(("COMPD_CS[", "COMPOUNDCRS[")):
        three = "CS[ellipsoidal,3" in wkt or "CS[Cartesian,3" in wkt
        return wkt, "ellipsoid" if three else ""
    parts = _members(wkt)
    vertical = next((part for part in parts if part.startswith(("VERT_CS[", "VERTCRS["))), "")
    name = vertical.split('"')[1] if '"' in vertical else "unknown"
    for part in _members(vertical):
        if part.startswith(("UNIT[", "LENGTHUNIT[")) and float(_members(part)[1]) != 1.0:
            raise UnsupportedError(path, "vertical datum", f"metres expected in {name!r}")
        if part.startswith("VERT_DATUM[") and _members(part)[1] == "2002":
            name = "ellipsoid"
    return parts[1], name


def _members(wkt: str) -> list[str]:
    """Members of a WKT node, its name first."""
    parts, depth, quoted, start = [], 0, False, wkt.find("[") + 1
    for at in range(start, len(wkt)):
        letter = wkt[at]
        if letter == '"':
            quoted = not quoted
        elif not quoted and letter in "[(":
            depth += 1
        elif not quoted and (letter in "])" or letter == ","):
            if depth == 0:
                parts.append(wkt[start:at].strip())
                start = at + 1
            if letter in "])":
                depth -= 1
                if depth < 0:
                    break
    return parts
