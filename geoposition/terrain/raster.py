"""`RasterTerrain`: heights from rasters of any system and size, in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike, fspath
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.constants import WGS84_A_M
from geoposition.datum import Geoid
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.rays import Rays
from geoposition.terrain.grid import Grid
from geoposition.terrain.kernels import BAD, UNSETTLED, bracket_directions, crossings, heights
from geoposition.terrain.patch import normals
from geoposition.terrain.series import STRAIGHT, Bend
from geoposition.terrain.source import PLAUSIBLE_M, open_lattice
from geoposition.terrain.store import BLOCK, WIDEST_RAD, HeightStore, blocks, vertical_facts
from geoposition.terrain.surfaces import Crossings, TerrainHeights, bad_lon_lat, keep_flags, lon_lat
from geoposition.terrain.walk import CROSSED, HOLE, MISSED, OUTSIDE, PASSED
from geoposition.terrain.window import Box, box_around, span_of_box

EARTH_M: Final = (-600.0, 9000.0)
"""All dry land; where the raster goes lower, the search is repeated down to that."""
_SCAN_FACTOR: Final = 8
"""So many times the loaded nodes may be scanned for extremes, block by block."""
_DEEPEST: Final = 40

_FLAGS = np.full(7, Flag.NO_INTERSECTION, dtype=np.uint8)
_FLAGS[CROSSED], _FLAGS[HOLE], _FLAGS[OUTSIDE] = Flag.OK, Flag.NODATA, Flag.OUTSIDE_TERRAIN
_FLAGS[UNSETTLED], _FLAGS[BAD] = Flag.NOT_CONVERGED, Flag.BAD_INPUT


class RasterTerrain:
    """Terrain of one raster, or of tiles on one lattice; bilinear between pixel centres.

    Parameters
    ----------
    paths
        A raster GDAL reads (GeoTIFF, .hgt, VRT ...), or several on one lattice.
    geoid
        Undulations to add, where the heights are above a geoid; a file, or one read already.
        Without it the heights are taken as ellipsoidal; a raster that says they are not is
        refused.
    max_nodes
        Nodes held at a time (8 bytes each, two windows at most). A raster of no more is loaded
        whole, of a larger one the windows that the points need.

    Raises
    ------
    MissingFileError, ProductError, UnsupportedError
        See `open_lattice`; and heights whose vertical datum contradicts `geoid`.
    """

    __slots__ = ("_arguments", "_provenance", "_store")

    def __init__(
        self,
        paths: str | PathLike[str] | Sequence[str | PathLike[str]],
        geoid: Geoid | str | PathLike[str] | None = None,
        max_nodes: int = 16_000_000,
    ):
        if max_nodes < 4 * BLOCK * BLOCK:
            raise ArgumentError(f"terrain: max_nodes of at least {4 * BLOCK * BLOCK} expected")
        several = [paths] if isinstance(paths, str | PathLike) else list(paths)
        lattice = open_lattice(several)
        named = fspath(geoid) if isinstance(geoid, str | PathLike) else "the given geoid"
        self._provenance = vertical_facts(lattice, None if geoid is None else named)
        grid = Geoid.from_file(geoid) if isinstance(geoid, str | PathLike) else geoid
        self._store = HeightStore(lattice, grid, max_nodes)
        self._arguments = (several, geoid, max_nodes)

    def __reduce__(self) -> tuple[object, ...]:
        # other processes open the files anew
        return RasterTerrain, self._arguments

    @property
    def provenance(self) -> tuple[str, ...]:
        """The files, their system, and what was made of their vertical datum."""
        return self._provenance

    @property
    def name(self) -> str:
        """The first file's path, for messages."""
        return fspath(self._arguments[0][0])

    @property
    def spacing_m(self) -> float:
        """Spacing of the rows of nodes, in metres."""
        lattice = self._store.lattice
        step = float(np.hypot(*lattice.from_grid[:, 1]))
        return step * (math.radians(WGS84_A_M) if lattice.geographic else 1.0)

    # answers ---------------------------------------------------------------------------------

    def height_at(self, geodetic: ArrayLike) -> TerrainHeights:
        """Height at `geodetic` (..., 2 or 3): bilinear, as `rasterio` or GDAL would."""
        asked = lon_lat(geodetic)
        shape = asked.shape[:-1]
        flat = np.ascontiguousarray(asked).reshape(-1, 2)
        bad = bad_lon_lat(flat)
        height = np.full(len(flat), np.nan)
        flag = np.where(bad, Flag.BAD_INPUT, Flag.OUTSIDE_TERRAIN).astype(np.uint8)
        with self._store.lock:
            self._heights(flat, np.flatnonzero(~bad), height, flag, 0)
        return TerrainHeights(height.reshape(shape), flag.reshape(shape))

    def first_crossing(
        self, rays: Rays, hint_m: ArrayLike | None = None, bend: Bend = STRAIGHT
    ) -> Crossings:
        """First point of each ray on the surface, from above, to a few micrometres.

        With `bend` the point is on the bent ray, and its range that along the straight one.

        A hole is taken to be no higher than the block of 8 pixels around it, the ground beyond
        the raster's border no higher than the border: rays that clear these go on, others are
        `NODATA` and `OUTSIDE_TERRAIN`.
        """
        shape = rays.origin_ecef_m.shape[:-1]
        origin = np.ascontiguousarray(rays.origin_ecef_m, dtype=np.float64).reshape(-1, 3)
        direction = np.ascontiguousarray(rays.direction_ecef, dtype=np.float64).reshape(-1, 3)
        hint = np.zeros(0)
        if hint_m is not None:
            hint = np.ascontiguousarray(
                np.broadcast_to(np.asarray(hint_m, dtype=np.float64), shape)
            ).reshape(-1)
        search = _Search(origin, direction, hint, bend)
        with self._store.lock:
            whole = self._store.whole()
            if whole is not None:
                search.run(whole, None, whole.highest_m + 1.0, whole.lowest_m - 1.0)
            else:
                known = np.flatnonzero(np.isfinite(np.sum(origin * direction, axis=1)))
                self._cross(search, known, EARTH_M[1], EARTH_M[0], 0)
                deeper = np.flatnonzero(search.status == PASSED)
                self._cross(search, deeper, EARTH_M[0] + 1.0, PLAUSIBLE_M[0], 0)
        flag: FlagArray = _FLAGS[search.status]
        keep_flags(rays, flag)
        lost = flag != Flag.OK
        if lost.any():
            search.range_m[lost] = np.nan
            search.geodetic[lost] = np.nan
        return Crossings(
            search.range_m.reshape(shape), search.geodetic.reshape(*shape, 3), flag.reshape(shape)
        )

    def height_range_m(self, geodetic: ArrayLike) -> tuple[float, float]:
        """Lowest and highest node within a box around `geodetic` (..., 2 or 3).

        Read block by block, whatever the size. `GeometryError` where there is no height.
        """
        asked = lon_lat(geodetic).reshape(-1, 2)
        asked = asked[~bad_lon_lat(asked)]
        box = box_around(normals(asked[:, 0], asked[:, 1])) if len(asked) else None
        span = span_of_box(self._store.lattice, box) if box is not None else None
        lowest, highest = np.inf, -np.inf
        if span is not None:
            with self._store.lock:
                for part in blocks(span):
                    height = self._store.load(part)
                    if np.isfinite(height).any():
                        lowest = min(lowest, float(np.nanmin(height)))
                        highest = max(highest, float(np.nanmax(height)))
        if not lowest <= highest:
            raise GeometryError(f"{self._store.lattice.tiles[0].path}: no height within the region")
        return lowest, highest

    def grid_over(self, geodetic: ArrayLike) -> Grid | None:
        """Nodes over all of `geodetic` (..., 2 or 3) at once; none where there is no such grid."""
        asked = lon_lat(geodetic).reshape(-1, 2)
        with self._store.lock:
            grid = self._store.whole()
            if grid is not None or bad_lon_lat(asked).any():
                return grid
            box = box_around(normals(asked[:, 0], asked[:, 1]))
            span = span_of_box(self._store.lattice, box) if box is not None else None
            if span is None or span.nodes > self._store.max_nodes or _too_wide(box):
                return None
            return self._store.patch(span)

    # windows ---------------------------------------------------------------------------------

    def _heights(
        self, flat: FloatArray, index: IntArray, height: FloatArray, flag: FlagArray, depth: int
    ) -> None:
        if not index.size:
            return
        grid: Grid | None = self._store.whole()
        if grid is None:
            direction = normals(flat[index, 0], flat[index, 1])
            box = box_around(direction)
            span = span_of_box(self._store.lattice, box) if box is not None else None
            if box is not None and span is None:
                return
            if span is None or span.nodes > self._store.max_nodes or _too_wide(box):
                for part in _halves(direction):
                    if depth < _DEEPEST:
                        self._heights(flat, index[part], height, flag, depth + 1)
                return
            grid = self._store.patch(span)
            if grid is None:
                flag[index] = Flag.NODATA
                return
        values, inside = np.empty(len(index)), np.empty(len(index), np.uint8)
        heights(grid, np.ascontiguousarray(flat[index]), values, inside)
        height[index] = values
        found = np.where(np.isnan(values), Flag.NODATA, Flag.OK)
        flag[index] = np.where(inside > 0, found, Flag.OUTSIDE_TERRAIN)

    def _cross(
        self, search: _Search, index: IntArray, top_m: float, bottom_m: float, depth: int
    ) -> None:
        """Solve the rays `index` between two heights: tighten these, then split if need be."""
        if not index.size:
            return
        direction = search.bracket(index, top_m, bottom_m)
        seen = np.isfinite(direction[: len(index), 0])
        search.status[index[~seen]] = MISSED
        if not seen.all():
            index, direction = index[seen], direction[np.concatenate([seen, seen])]
            if not index.size:
                return
        span, tight, box = None, (bottom_m, top_m), None
        for _ in range(5):
            box = box_around(direction)
            span = span_of_box(self._store.lattice, box) if box is not None else None
            if box is not None and span is None:
                search.status[index] = OUTSIDE
                return
            if span is None or span.nodes > _SCAN_FACTOR * self._store.max_nodes:
                break
            lowest, highest = self._store.scan(span)
            if lowest > highest:
                search.status[index] = HOLE
                return
            new = max(tight[0], lowest - 1.0), min(tight[1], highest + 1.0)
            if new[0] >= new[1]:
                # the ground is all below or all above these heights
                search.status[index] = PASSED if lowest - 1.0 < tight[0] else MISSED
                return
            gain = (new[0] - tight[0]) + (tight[1] - new[1])
            small = gain < 0.1 * (tight[1] - tight[0])
            tight = new
            if small:
                break
            direction = search.bracket(index, tight[1], tight[0])
            if not np.all(np.isfinite(direction)):
                break
        if span is not None and span.nodes <= self._store.max_nodes and not _too_wide(box):
            grid = self._store.patch(span)
            if grid is None:
                search.status[index] = HOLE
            else:
                search.run(grid, index, tight[1], tight[0])
            return
        if depth >= _DEEPEST:
            search.status[index] = UNSETTLED
            return
        if len(index) > 1:
            middle = direction[: len(index)] + direction[len(index) :]
            for part in _halves(middle):
                self._cross(search, index[part], top_m, bottom_m, depth + 1)
            return
        middle_m = 0.5 * (tight[0] + tight[1])
        self._cross(search, index, tight[1], middle_m, depth + 1)
        if search.status[index[0]] == PASSED:
            self._cross(search, index, middle_m, tight[0], depth + 1)


def _too_wide(box: Box | None) -> bool:
    return box is None or box.extent_rad > WIDEST_RAD


class _Search:
    """Rays, and what became of each."""

    __slots__ = ("bend", "direction", "geodetic", "hint", "origin", "range_m", "status")

    def __init__(self, origin: FloatArray, direction: FloatArray, hint: FloatArray, bend: Bend):
        n = len(origin)
        self.origin, self.direction, self.hint, self.bend = origin, direction, hint, bend
        self.status: FlagArray = np.full(n, BAD, dtype=np.uint8)
        self.range_m = np.empty(n)
        self.geodetic = np.empty((n, 3))

    def run(self, grid: Grid, index: IntArray | None, top_m: float, bottom_m: float) -> None:
        """Cross the rays `index` (all, if none is given) with a grid."""
        if index is None or len(index) == len(self.origin):
            crossings(
                grid,
                self.bend,
                self.origin,
                self.direction,
                top_m,
                bottom_m,
                self.hint,
                self.status,
                self.range_m,
                self.geodetic,
            )
            return
        n = len(index)
        status, range_m, geodetic = np.empty(n, np.uint8), np.empty(n), np.empty((n, 3))
        hint = self.hint[index] if self.hint.size else self.hint
        bend = self.bend
        if len(bend.image_px):
            bend = bend._replace(image_px=bend.image_px[index])
        crossings(
            grid,
            bend,
            self.origin[index],
            self.direction[index],
            top_m,
            bottom_m,
            hint,
            status,
            range_m,
            geodetic,
        )
        self.status[index], self.range_m[index], self.geodetic[index] = status, range_m, geodetic

    def bracket(self, index: IntArray, top_m: float, bottom_m: float) -> FloatArray:
        """Directions (2 n, 3) of the normals where the rays have the two heights."""
        out = np.empty((2 * len(index), 3))
        bracket_directions(self.origin[index], self.direction[index], top_m, bottom_m, out)
        return out


def _halves(direction: FloatArray) -> tuple[IntArray, IntArray]:
    """Split points at the median of the widest of their three coordinates."""
    axis = int(np.argmax(np.ptp(direction, axis=0)))
    order = np.argsort(direction[:, axis], kind="stable")
    half = (len(order) + 1) // 2
    return np.sort(order[:half]), np.sort(order[half:])
