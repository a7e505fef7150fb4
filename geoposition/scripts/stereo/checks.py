"""Intersected points against what is known of the ground: check points, reference heights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.accuracy import (
    AxisStatistics,
    PointStatistics,
    axis_statistics,
    point_statistics,
)
from geoposition.arrays import FloatArray, IntArray
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.scripts.tie_tables import Checks, common
from geoposition.surface import FEWEST_COMPARED, Comparison, compare_points
from geoposition.terrain.raster import RasterTerrain
from geoposition.triangulate import IntersectedPoints

_GROSS_M: Final = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class PointChecks:
    """Points of known position: `rows` (n,) of the intersected ones, `true` (n, 3), statistics."""

    rows: IntArray
    true: FloatArray
    statistics: PointStatistics

    def as_dict(self) -> dict[str, object]:
        """Return the facts by name, fit for JSON."""
        axes = self.statistics.axes
        return {
            "checked": len(self.rows),
            "rmse_m": {name: axis.rmse for name, axis in axes.items()},
            "check": self.statistics.as_dict(),
        }


@dataclass(frozen=True, slots=True, eq=False)
class HeightDifferences:
    """Heights found less a reference's: `difference_m` (points,), NaN where there is none.

    `comparison` says where they differ and by which shift; None of too few points.
    """

    reference: Path
    provenance: tuple[str, ...]
    difference_m: FloatArray
    statistics: AxisStatistics
    comparison: Comparison | None

    def as_dict(self) -> dict[str, object]:
        """Return the facts by name, fit for JSON."""
        more = {} if self.comparison is None else self.comparison.as_dict()
        known = self.difference_m[np.isfinite(self.difference_m)]
        off = np.abs(known - self.statistics.median)
        return more | {
            "path": str(self.reference),
            "points": self.statistics.count,
            "difference_m": self.statistics.as_dict(),
            "share_beyond_5_m": float(np.mean(off > _GROSS_M)),
        }


def check_points(points: IntersectedPoints, checks: Checks) -> PointChecks:
    """Compare the points that have an id in `checks`; none in common is a `GeometryError`."""
    rows, check_rows = common(points.ids, checks)
    used = has_result(points.flag[rows])
    rows, check_rows = rows[used], check_rows[used]
    if not len(rows):
        raise GeometryError("--gcps: none of its points is among the intersected ones (by id)")
    true = checks.geodetic[check_rows]
    return PointChecks(rows, true, point_statistics(points.geodetic[rows], true))


def compare_heights(
    points: IntersectedPoints, reference: Path, geoid: Path | None
) -> HeightDifferences:
    """Compare heights with a raster's, ellipsoidal by `geoid` if one is named.

    A `GeometryError` where the raster has no height at any of the points.
    """
    terrain = RasterTerrain(reference, geoid)
    difference = np.full(len(points.ids), np.nan)
    found = np.flatnonzero(has_result(points.flag))
    heights = terrain.height_at(points.geodetic[found])
    known = has_result(heights.flag)
    if not known.any():
        raise GeometryError(f"{reference}: the reference has no height at any of the points")
    difference[found[known]] = points.geodetic[found[known], 2] - heights.height_m[known]
    comparison = None
    if known.sum() >= FEWEST_COMPARED:
        comparison = compare_points(points.geodetic[found[known]], terrain)
    return HeightDifferences(
        reference, terrain.provenance, difference, axis_statistics(difference), comparison
    )
