"""A surface against a reference: offset, scatter, tilt, horizontal shift, and where they differ.

dh = surface − reference at the surface's cells, the reference bilinear there. A surface that is
the reference moved by (e, n, u) has, with the reference's slopes g,
    dh = u − e g_e − n g_n ,
which is the cosine of aspect that Nuth and Kääb fit, times the slope: solved here by least
squares without dividing by the slope, so that flat ground does no harm, and repeated at the
shift found. Cells more than three NMAD off take no part.

*Source*: Nuth and Kääb 2011, The Cryosphere 5, (2)–(3).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from typing import Final

import numpy as np

from geoposition.accuracy import NMAD_FACTOR, AxisStatistics, axis_statistics
from geoposition.arrays import BoolArray, FloatArray
from geoposition.datum import from_crs
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.surface.cells import (
    SurfaceCells,
    reference_cover,
    reference_nodes,
    surface_cells,
)
from geoposition.terrain.raster import RasterTerrain

SLOPE_EDGES_DEG: Final = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 90.0)
SECTORS: Final = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")

_FEWEST: Final = 30
_TURNS: Final = 8
_STILL: Final = 0.005
"""A step below this part of a cell ends the iteration."""
_SIGMAS: Final = 3.0
_LEAST_RELIEF: Final = 0.02
"""Slopes must scatter by this much in every direction for a shift to show."""
_FEWEST_REFERENCE_CELLS: Final = 50
_LEAST_SLOPE_DEG: Final = 5.0
_COARSER: Final = 2.0


@dataclass(frozen=True, slots=True)
class Shift:
    """By how much the surface lies east, north and above of the reference, and sigmas (m).

    The sigmas count one independent difference per cell of the coarser of the two.
    """

    enu_m: tuple[float, float, float]
    sigma_enu_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Part:
    """Differences of one kind of ground: how many, their median and NMAD (m)."""

    name: str
    count: int
    median_m: float
    nmad_m: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Differences surface − reference, as they are and after co-registration.

    `tilt_mm_per_m` is the slope of the plane through the differences and `tilt_azimuth_deg`
    where it rises to. `shift` is None where the ground is too flat, or too little, to tell;
    then `after` is None too. `by_slope` and `by_aspect` are of the reference's ground, the
    latter where it slopes by 5° or more. `by_reference_cell`, of a reference more than twice as
    coarse, compares the surface's means over the reference's cells with these: like with like.
    `cover` is the share of the reference's cells within
    the surface's bounds where the surface has a height. `stride` says that every so many-th
    cell was compared.
    """

    before: AxisStatistics
    after: AxisStatistics | None
    shift: Shift | None
    tilt_mm_per_m: float
    tilt_azimuth_deg: float
    by_slope: tuple[Part, ...]
    by_aspect: tuple[Part, ...]
    by_reference_cell: AxisStatistics | None
    cover: float
    stride: int

    def as_dict(self) -> dict[str, object]:
        """Return the numbers by name, fit for JSON."""
        shift = self.shift
        return {
            "difference_m": self.before.as_dict(),
            "coregistered_m": None if self.after is None else self.after.as_dict(),
            "shift_enu_m": None if shift is None else list(shift.enu_m),
            "shift_sigma_enu_m": None if shift is None else list(shift.sigma_enu_m),
            "reference_cells_m": None
            if self.by_reference_cell is None
            else self.by_reference_cell.as_dict(),
            "tilt_mm_per_m": self.tilt_mm_per_m,
            "tilt_azimuth_deg": self.tilt_azimuth_deg,
            "by_slope_deg": [_facts(part) for part in self.by_slope],
            "by_aspect": [_facts(part) for part in self.by_aspect],
            "reference_cover": self.cover,
            "stride": self.stride,
        }


def compare_surface(
    surface: str | PathLike[str],
    reference: str | PathLike[str],
    geoid: str | PathLike[str] | None = None,
) -> Comparison:
    """Compare the first band of the raster `surface` with the raster of heights `reference`.

    Heights of `surface` are ellipsoidal and its system is a projected one in metres or one in
    degrees; those of `reference` become ellipsoidal with `geoid`, if one is named. A
    `GeometryError` where the two have no ground in common.
    """
    terrain = RasterTerrain(reference, geoid)
    cells = surface_cells(surface)
    found = _sampled(terrain, cells, np.zeros(2))
    known = np.isfinite(found)
    if known.sum() < _FEWEST:
        raise GeometryError(f"{reference}: the reference has no heights where the surface is")
    whole = cells
    cells, found = cells.where(known), found[known]
    cover, spacing_m = reference_cover(surface, reference)
    slopes = _slopes(terrain, cells, np.zeros(2), max(spacing_m, cells.spacing_m))
    difference = cells.height_m - found
    share = min(1.0, (cells.spacing_m / max(spacing_m, cells.spacing_m)) ** 2)
    shift, moved = _coregistered(terrain, cells, slopes, difference, share, spacing_m)
    tilt, azimuth = _tilt(cells, difference)
    return Comparison(
        before=axis_statistics(difference),
        after=None if moved is None else axis_statistics(moved),
        shift=shift,
        tilt_mm_per_m=tilt,
        tilt_azimuth_deg=azimuth,
        by_slope=_by_slope(slopes, difference),
        by_aspect=_by_aspect(slopes, difference),
        by_reference_cell=_by_reference_cell(reference, terrain, whole, spacing_m),
        cover=cover,
        stride=cells.stride,
    )


def _sampled(terrain: RasterTerrain, cells: SurfaceCells, shift_m: FloatArray) -> FloatArray:
    """Heights (n,) of the reference at the cells, moved back by a shift; NaN where none."""
    place = np.column_stack([cells.xy - shift_m * cells.unit_per_m, cells.height_m])
    heights = terrain.height_at(from_crs(cells.crs, place))
    return np.where(has_result(heights.flag), heights.height_m, np.nan)


def _slopes(
    terrain: RasterTerrain, cells: SurfaceCells, shift_m: FloatArray, step_m: float
) -> FloatArray:
    """Slopes (n, 2) east and north of the reference, over two of its cells; NaN at its edge."""
    out = np.empty((len(cells.height_m), 2))
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = step_m
        ahead, behind = (_sampled(terrain, cells, shift_m - s * step) for s in (1.0, -1.0))
        out[:, axis] = (ahead - behind) / (2.0 * step_m)
    return out


def _coregistered(
    terrain: RasterTerrain,
    cells: SurfaceCells,
    slopes: FloatArray,
    difference: FloatArray,
    share: float,
    spacing_m: float,
) -> tuple[Shift | None, FloatArray | None]:
    """Shift of the surface, and the differences without it; None where it does not show."""
    good = np.isfinite(slopes).all(axis=1)
    independent = share * float(good.sum())
    if independent < _FEWEST_REFERENCE_CELLS:
        return None, None
    scatter = np.linalg.eigvalsh(np.cov(slopes[good].T))
    if not np.sqrt(max(float(scatter[0]), 0.0)) >= _LEAST_RELIEF:
        return None, None
    place, moved = np.zeros(3), difference
    inverse, spread = np.eye(3), float("nan")
    for _ in range(_TURNS):
        known = good & np.isfinite(moved)
        off = moved[known] - np.median(moved[known])
        near = np.abs(off) <= _SIGMAS * NMAD_FACTOR * float(np.median(np.abs(off))) + 1e-9
        rows = np.column_stack([-slopes[known][near], np.ones(int(near.sum()))])
        normal = rows.T @ rows
        step = np.linalg.solve(normal, rows.T @ moved[known][near])
        rest = moved[known][near] - rows @ step
        inverse = np.linalg.inv(normal) / share
        spread = NMAD_FACTOR * float(np.median(np.abs(rest)))
        place += step
        moved = cells.height_m - _sampled(terrain, cells, place[:2]) - place[2]
        if float(np.hypot(*step[:2])) < _STILL * max(spacing_m, cells.spacing_m):
            break
    sigma = spread * np.sqrt(np.diag(inverse))
    east, north, up = (float(value) for value in place)
    return Shift((east, north, up), (float(sigma[0]), float(sigma[1]), float(sigma[2]))), moved


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
        keep = rest <= _SIGMAS * NMAD_FACTOR * float(np.median(rest)) + 1e-9
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
