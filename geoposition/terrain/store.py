"""Windows of ellipsoidal heights out of rasters of any size, held in bounded memory."""

from __future__ import annotations

import logging
from collections import OrderedDict
from threading import RLock
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.datum import Geoid
from geoposition.errors import ProductError, UnsupportedError
from geoposition.terrain.grid import Grid
from geoposition.terrain.patch import lon_lat_grid, normals, table_grid
from geoposition.terrain.source import Lattice
from geoposition.terrain.window import Span, box_around, is_wgs84_degrees, places, positions

logger = logging.getLogger(__name__)

BLOCK: Final = 512
WIDEST_RAD: Final = 0.5
"""No window of a projected raster is wider: its map is a table over one plane."""
_PATCHES: Final = 2


class HeightStore:
    """Grids and extremes of windows of a lattice; the last ones asked for are kept.

    `max_nodes` bounds a window; two are held. `lock` is to be held while a grid is looked for
    and used.
    """

    __slots__ = ("_extremes", "_geoid", "_patches", "_wgs84", "lattice", "lock", "max_nodes")

    def __init__(self, lattice: Lattice, geoid: Geoid | None, max_nodes: int):
        self.lattice = lattice
        self.max_nodes = max_nodes
        self.lock = RLock()
        self._geoid = geoid
        self._wgs84 = is_wgs84_degrees(lattice)
        self._patches: OrderedDict[Span, Grid | None] = OrderedDict()
        self._extremes: dict[tuple[int, int], tuple[float, float]] = {}

    def whole(self) -> Grid | None:
        """Grid of the whole raster, if it fits; one without any height is a `ProductError`."""
        row0, col0, row1, col1 = self.lattice.bounds
        span = Span(row0, col0, row1 - row0, col1 - col0)
        if span.nodes > self.max_nodes or self.lattice.closed:
            return None
        if not self._wgs84 and span not in self._patches:
            rows, cols = np.meshgrid([row0, row1 - 1.0], [col0, col1 - 1.0])
            box = box_around(normals(*places(self.lattice, rows, cols)).reshape(-1, 3))
            if box is None or box.extent_rad > WIDEST_RAD:
                return None
        grid = self._grid(span)
        if grid is None:
            raise ProductError(self.lattice.tiles[0].path, "band 1", "there is no height in it")
        return grid

    def patch(self, span: Span) -> Grid | None:
        """Grid that covers `span`; none where that has no height at all."""
        for held, grid in self._patches.items():
            if held.contains(span):
                self._patches.move_to_end(held)
                return grid
        # rounded up to blocks where that fits, so that the neighbours find it too
        row0, col0, row1, col1 = self.lattice.bounds
        first_row, first_col = span.row // BLOCK * BLOCK, span.col // BLOCK * BLOCK
        end_row = -(-(span.row + span.rows) // BLOCK) * BLOCK
        end_col = -(-(span.col + span.cols) // BLOCK) * BLOCK
        first_row, end_row = max(first_row, row0), min(end_row, row1)
        if not self.lattice.closed:
            first_col, end_col = max(first_col, col0), min(end_col, col1)
        wide = Span(first_row, first_col, end_row - first_row, end_col - first_col)
        return self._grid(wide if wide.nodes <= self.max_nodes else span)

    def _grid(self, span: Span) -> Grid | None:
        if span in self._patches:
            self._patches.move_to_end(span)
            return self._patches[span]
        while len(self._patches) >= _PATCHES:
            self._patches.popitem(last=False)
        grid = self._build(span)
        self._patches[span] = grid
        return grid

    def _build(self, span: Span) -> Grid | None:
        height = self.load(span)
        if not np.isfinite(height).any():
            return None
        lattice = self.lattice
        if self._wgs84:
            start = lattice.from_grid @ np.array([1.0, span.row, span.col])
            matrix = np.radians(np.column_stack([start, lattice.from_grid[:, 1:]]))
            return lon_lat_grid(height, matrix)
        return table_grid(
            height,
            lambda lon, lat: _shifted(positions(lattice, lon, lat), -span.row, -span.col),
            lambda row, col: places(lattice, row + span.row, col + span.col),
        )

    def load(self, span: Span) -> FloatArray:
        """Ellipsoidal heights (rows, cols) at the nodes."""
        height = self.lattice.read(span.row, span.col, span.rows, span.cols)
        if self._geoid is not None:
            for start in range(0, span.rows, 256):  # by strips, to bound the memory
                end = min(start + 256, span.rows)
                rows, cols = np.mgrid[span.row + start : span.row + end, 0 : span.cols]
                lon, lat = self._places(rows.astype(np.float64), cols + float(span.col))
                undulation = self._geoid.undulation_m(np.stack([lon, lat], axis=-1))
                height[start:end] += undulation
        return height

    def _places(self, row: FloatArray, col: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not self._wgs84:
            return places(self.lattice, row, col)
        f = np.radians(self.lattice.from_grid)
        return f[0, 0] + f[0, 1] * row + f[0, 2] * col, f[1, 0] + f[1, 1] * row + f[1, 2] * col

    def scan(self, span: Span) -> tuple[float, float]:
        """Extremes over the blocks that `span` touches; read once, remembered."""
        lowest, highest = np.inf, -np.inf
        for block in blocks(span):
            key = (block.row // BLOCK, block.col // BLOCK)
            if key not in self._extremes:
                whole = Span(key[0] * BLOCK, key[1] * BLOCK, BLOCK, BLOCK)
                height = self.load(whole)
                known = height[np.isfinite(height)]
                self._extremes[key] = (
                    (float(known.min()), float(known.max())) if known.size else (np.inf, -np.inf)
                )
            low, high = self._extremes[key]
            lowest, highest = min(lowest, low), max(highest, high)
        return lowest, highest


def _shifted(
    position: tuple[FloatArray, FloatArray], rows: float, cols: float
) -> tuple[FloatArray, FloatArray]:
    return position[0] + rows, position[1] + cols


def blocks(span: Span) -> list[Span]:
    """Parts of a window, each within one block of the lattice."""
    parts = []
    for block_row in range(span.row // BLOCK, (span.row + span.rows - 1) // BLOCK + 1):
        row0 = max(block_row * BLOCK, span.row)
        row1 = min((block_row + 1) * BLOCK, span.row + span.rows)
        for block_col in range(span.col // BLOCK, (span.col + span.cols - 1) // BLOCK + 1):
            col0 = max(block_col * BLOCK, span.col)
            col1 = min((block_col + 1) * BLOCK, span.col + span.cols)
            parts.append(Span(row0, col0, row1 - row0, col1 - col0))
    return parts


def vertical_facts(lattice: Lattice, geoid: str | None) -> tuple[str, ...]:
    """Say what the heights are taken to be, a fact a line; a contradiction is refused."""
    path = lattice.tiles[0].path
    more = len(lattice.tiles) - 1
    facts = [f"heights from {path}" + (f" and {more} more" if more else "")]
    if lattice.vertical == "ellipsoid":
        if geoid is not None:
            raise UnsupportedError(
                path, "vertical datum", "its heights are ellipsoidal: name no geoid"
            )
        facts.append("ellipsoidal heights, as the raster states")
    elif lattice.vertical:
        if geoid is None:
            raise UnsupportedError(
                path,
                "vertical datum",
                f"its heights are above {lattice.vertical!r}: name the geoid grid to add",
            )
        facts.append(f"heights above {lattice.vertical!r}, made ellipsoidal with {geoid}")
    elif geoid is not None:
        facts.append(f"heights taken as orthometric, made ellipsoidal with {geoid}")
    else:
        note = "the raster states no vertical datum: heights taken as ellipsoidal"
        if path.lower().endswith((".hgt", ".hgt.gz", ".hgt.zip")):
            note += "; SRTM tiles are orthometric (EGM96), so name that geoid"
        logger.warning("%s: %s", path, note)
        facts.append(note)
    return tuple(facts)
