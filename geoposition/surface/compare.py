"""A surface, or points, against a reference: offset, scatter, tilt, shift, and where they differ.

Differences are surface − reference, the reference bilinear there; the shift is `coregister`'s.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.accuracy import NMAD_FACTOR, AxisStatistics, axis_statistics
from geoposition.arrays import BoolArray, FloatArray, as_components
from geoposition.datum import from_crs
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.surface.cells import (
    SurfaceCells,
    point_cells,
    reference_cover,
    reference_nodes,
    surface_cells,
)
from geoposition.surface.coregister import SIGMAS, Shift, coregistered, ground_slopes, sampled
from geoposition.terrain.raster import RasterTerrain

SLOPE_EDGES_DEG: Final = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 90.0)
SECTORS: Final = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")

FEWEST_COMPARED: Final = 30
"""Differences below this number say too little of slopes and shifts."""
_LEAST_SLOPE_DEG: Final = 5.0
_COARSER: Final = 2.0


@dataclass(frozen=True, slots=True)
class Part:
    """Differences of one kind of ground: how many, their median and NMAD (m)."""

    name: str
    count: int
    median_m: float
    nmad_m: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Differences of heights, as they are and after co-registration.

    `tilt_mm_per_m` is the slope of the plane through the differences and `tilt_azimuth_deg`
    where it rises to. `shift` is None where the ground is too flat, or too little, to tell;
    then `after` is None too. `by_slope` and `by_aspect` are of the reference's ground, the
    latter where it slopes by 5° or more.
    """

    before: AxisStatistics
    after: AxisStatistics | None
    shift: Shift | None
    tilt_mm_per_m: float
    tilt_azimuth_deg: float
    by_slope: tuple[Part, ...]
    by_aspect: tuple[Part, ...]

    def as_dict(self) -> dict[str, object]:
        """Return the numbers by name, fit for JSON."""
        shift = self.shift
        return {
            "difference_m": self.before.as_dict(),
            "coregistered_m": None if self.after is None else self.after.as_dict(),
            "shift_enu_m": None if shift is None else list(shift.enu_m),
            "shift_sigma_enu_m": None if shift is None else list(shift.sigma_enu_m),
            "tilt_mm_per_m": self.tilt_mm_per_m,
            "tilt_azimuth_deg": self.tilt_azimuth_deg,
            "by_slope_deg": [_facts(part) for part in self.by_slope],
            "by_aspect": [_facts(part) for part in self.by_aspect],
        }


@dataclass(frozen=True, slots=True)
class SurfaceComparison:
    """A gridded surface against a reference: its cells' `differences`, and how much it covers.

    `by_reference_cell`, of a reference more than twice as coarse, compares the surface's means
    over the reference's cells with these: like with like. `cover` is the share of the
    reference's cells within the surface's bounds where the surface has a height. `stride` says
    that every so many-th cell was compared.
    """

    differences: Comparison
    by_reference_cell: AxisStatistics | None
    cover: float
    stride: int

    def as_dict(self) -> dict[str, object]:
        """Return the numbers by name, fit for JSON."""
        coarse = self.by_reference_cell
        return self.differences.as_dict() | {
            "reference_cells_m": None if coarse is None else coarse.as_dict(),
            "reference_cover": self.cover,
            "stride": self.stride,
        }


def compare_surface(surface: str | PathLike[str], reference: RasterTerrain) -> SurfaceComparison:
    """Compare the first band of the raster `surface` with a raster of heights.

    Heights of `surface` are ellipsoidal and its system is a projected one in metres or one in
    degrees. A `GeometryError` where the two have no ground in common.
    """
    cells = surface_cells(surface)
    cover, spacing_m = reference_cover(surface, reference.name)
    slope_step_m = max(spacing_m, cells.spacing_m)
    return SurfaceComparison(
        _compared(cells, reference, spacing_m, slope_step_m),
        _by_reference_cell(reference.name, reference, cells, spacing_m),
        cover,
        cells.stride,
    )


def compare_points(geodetic: ArrayLike, reference: RasterTerrain) -> Comparison:
    """Compare ground points (n, 3) = (lon_rad, lat_rad, height_m) with a raster of heights.

    Points that are not numbers take no part. A `GeometryError` where the two have no ground in
    common.
    """
    points = as_components(geodetic, 3, "geodetic").reshape(-1, 3)
    cells = point_cells(points[np.isfinite(points).all(axis=1)])
    return _compared(cells, reference, reference.spacing_m, reference.spacing_m)


def _compared(
    cells: SurfaceCells, terrain: RasterTerrain, spacing_m: float, slope_step_m: float
) -> Comparison:
    found = sampled(terrain, cells, np.zeros(2))
    known = np.isfinite(found)
    if known.sum() < FEWEST_COMPARED:
        raise GeometryError(f"{terrain.name}: the reference has no heights where the surface is")
    cells, found = cells.where(known), found[known]
    slopes = ground_slopes(terrain, cells, np.zeros(2), slope_step_m)
    difference = cells.height_m - found
    share = min(1.0, (cells.spacing_m / max(spacing_m, cells.spacing_m)) ** 2)
    shift, moved = coregistered(terrain, cells, slopes, difference, share, spacing_m)
    tilt, azimuth = _tilt(cells, difference)
    return Comparison(
        before=axis_statistics(difference),
        after=None if moved is None else axis_statistics(moved),
        shift=shift,
        tilt_mm_per_m=tilt,
        tilt_azimuth_deg=azimuth,
        by_slope=_by_slope(slopes, difference),
        by_aspect=_by_aspect(slopes, difference),
    )


def _by_reference_cell(
    path: str | PathLike[str], terrain: RasterTerrain, cells: SurfaceCells, spacing_m: float
) -> AxisStatistics | None:
    """Statistics of the surface's means over the reference's cells, where these are coarser.

    Cells that the surface covers by less than half of what it covers of the fullest do not count.
    """
    if spacing_m < _COARSER * cells.spacing_m:
        return None
    place = np.column_stack([cells.xy, cells.height_m])
    cell, node = reference_nodes(path, from_crs(cells.crs, place))
    _, first, inverse, count = np.unique(
        cell, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    mean = np.bincount(inverse.reshape(-1), weights=cells.height_m) / count
    heights = terrain.height_at(node[first])
    full = (2 * count >= count.max()) & has_result(heights.flag)
    return axis_statistics((mean - heights.height_m)[full]) if full.any() else None


def _tilt(cells: SurfaceCells, difference: FloatArray) -> tuple[float, float]:
    """Slope (mm/m) of the plane through the differences, and the azimuth it rises to (deg)."""
    place = cells.xy / cells.unit_per_m
    place = place - place.mean(axis=0)
    scale = max(float(np.abs(place).max()), 1.0)
    rows = np.column_stack([place / scale, np.ones(len(place))])
    keep = np.ones(len(place), dtype=np.bool_)
    plane = np.zeros(3)
    for _ in range(3):
        plane = np.linalg.lstsq(rows[keep], difference[keep], rcond=None)[0]
        rest = np.abs(difference - rows @ plane)
        keep = rest <= SIGMAS * NMAD_FACTOR * float(np.median(rest)) + 1e-9
    east, north = plane[:2] / scale * 1e3
    return float(np.hypot(east, north)), float(np.degrees(np.arctan2(east, north)) % 360.0)


def _by_slope(slopes: FloatArray, difference: FloatArray) -> tuple[Part, ...]:
    steep = np.degrees(np.arctan(np.hypot(slopes[:, 0], slopes[:, 1])))
    return tuple(
        _part(f"{low:g}-{high:g}", difference, (steep >= low) & (steep < high))
        for low, high in pairwise(SLOPE_EDGES_DEG)
    )


def _by_aspect(slopes: FloatArray, difference: FloatArray) -> tuple[Part, ...]:
    """By where the ground falls to."""
    steep = np.degrees(np.arctan(np.hypot(slopes[:, 0], slopes[:, 1])))
    falls = np.degrees(np.arctan2(-slopes[:, 0], -slopes[:, 1])) % 360.0
    width = 360.0 / len(SECTORS)
    with np.errstate(invalid="ignore"):
        sector = np.rint(falls / width) % len(SECTORS)
    return tuple(
        _part(name, difference, (sector == k) & (steep >= _LEAST_SLOPE_DEG))
        for k, name in enumerate(SECTORS)
    )


def _part(name: str, difference: FloatArray, mine: BoolArray) -> Part:
    if not mine.any():
        return Part(name, 0, float("nan"), float("nan"))
    found = axis_statistics(difference[mine])
    return Part(name, found.count, found.median, found.nmad)


def _facts(part: Part) -> dict[str, object]:
    return {
        "class": part.name,
        "count": part.count,
        "median_m": part.median_m,
        "nmad_m": part.nmad_m,
    }
