"""Co-registration of a surface with a reference: the shift at which their differences vanish.

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
from typing import Final

import numpy as np

from geoposition.accuracy import NMAD_FACTOR
from geoposition.arrays import FloatArray
from geoposition.datum import from_crs
from geoposition.flags import has_result
from geoposition.surface.cells import SurfaceCells
from geoposition.terrain.raster import RasterTerrain

SIGMAS: Final = 3.0
"""Differences further out than this many NMAD take no part in a fit."""
_TURNS: Final = 8
_STILL: Final = 0.005
"""A step below this part of a cell ends the iteration."""
_LEAST_RELIEF: Final = 0.02
"""Slopes must scatter by this much in every direction for a shift to show."""
_FEWEST_REFERENCE_CELLS: Final = 50


@dataclass(frozen=True, slots=True)
class Shift:
    """By how much the surface lies east, north and above of the reference, and sigmas (m).

    The sigmas count one independent difference per cell of the coarser of the two.
    """

    enu_m: tuple[float, float, float]
    sigma_enu_m: tuple[float, float, float]


def sampled(terrain: RasterTerrain, cells: SurfaceCells, shift_m: FloatArray) -> FloatArray:
    """Heights (n,) of the reference at the cells, moved back by a shift; NaN where none."""
    place = np.column_stack([cells.xy - shift_m * cells.unit_per_m, cells.height_m])
    heights = terrain.height_at(from_crs(cells.crs, place))
    return np.where(has_result(heights.flag), heights.height_m, np.nan)


def ground_slopes(
    terrain: RasterTerrain, cells: SurfaceCells, shift_m: FloatArray, step_m: float
) -> FloatArray:
    """Slopes (n, 2) east and north of the reference, over two of its cells; NaN at its edge."""
    out = np.empty((len(cells.height_m), 2))
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = step_m
        ahead, behind = (sampled(terrain, cells, shift_m - s * step) for s in (1.0, -1.0))
        out[:, axis] = (ahead - behind) / (2.0 * step_m)
    return out


def coregistered(
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
        near = np.abs(off) <= SIGMAS * NMAD_FACTOR * float(np.median(np.abs(off))) + 1e-9
        rows = np.column_stack([-slopes[known][near], np.ones(int(near.sum()))])
        normal = rows.T @ rows
        step = np.linalg.solve(normal, rows.T @ moved[known][near])
        rest = moved[known][near] - rows @ step
        inverse = np.linalg.inv(normal) / share
        spread = NMAD_FACTOR * float(np.median(np.abs(rest)))
        place += step
        moved = cells.height_m - sampled(terrain, cells, place[:2]) - place[2]
        if float(np.hypot(*step[:2])) < _STILL * max(spacing_m, cells.spacing_m):
            break
    sigma = spread * np.sqrt(np.diag(inverse))
    east, north, up = (float(value) for value in place)
    return Shift((east, north, up), (float(sigma[0]), float(sigma[1]), float(sigma[2]))), moved
