"""Where two images' lines of sight meet, over one tile: cubics of the match's place.

Over a tile the ground point is a smooth function of the pixel (line, sample) and of how far
along the epipolar lines t its match lies: t = along · second − plane · (1, line, sample). Cubics
in these three are fitted to exact intersections at nodes and checked at others, between them;
where they miss one by more than `TOLERANCE_M`, every point is intersected exactly instead. What
a match lies beside the epipolar line, a bounded part of a pixel, moves the point by half that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FloatArray
from geoposition.constants import WGS84_A_M
from geoposition.dense.epipolar import EpipolarTile
from geoposition.flags import has_result
from geoposition.pushbroom.model import cubic_terms
from geoposition.sensor_model import SensorModel
from geoposition.triangulate import triangulate_pairs

TOLERANCE_M: Final = 0.005

_NODES: Final = 6
_CHECKS: Final = 5
_FAST = {"contract", "arcp", "nsz", "reassoc"}


@dataclass(frozen=True, slots=True, eq=False)
class GroundFit:
    """Cubics (20, 3) of longitude, latitude and height, less `base` (3,).

    `centre`, `extent` (3,) normalise line, sample and t; `error_m` is the largest misfit found.
    """

    along: FloatArray
    plane: FloatArray
    centre: FloatArray
    extent: FloatArray
    base: FloatArray
    coefficients: FloatArray
    error_m: float

    def at(self, first_px: FloatArray, second_px: FloatArray) -> FloatArray:
        """Ground points (n, 3) of matches (n, 2) and (n, 2), NaN where a match is."""
        out = np.empty((len(first_px), 3))
        _ground(
            np.ascontiguousarray(first_px),
            np.ascontiguousarray(second_px),
            np.concatenate([self.along, self.plane]),
            np.concatenate([self.centre, 1.0 / self.extent]),
            self.base,
            self.coefficients,
            out,
        )
        return out


def ground_fit(tile: EpipolarTile, first: SensorModel, second: SensorModel) -> GroundFit | None:
    """Fit the cubics over the core of `tile`; None where the models' ground is not so smooth."""
    core, (low, high) = tile.core, tile.disparities_px
    size = np.array([core.lines, core.samples])
    corner = np.array([core.line, core.sample]) - 0.5
    heights = tile.field.over(core)[:2]
    deep = sorted((low / tile.px_per_m, high / tile.px_per_m))
    span = (heights[0] + deep[0], heights[1] + deep[1])
    nodes = _matches(tile, corner, size, span, np.linspace(0.0, 1.0, _NODES))
    checks = _matches(tile, corner, size, span, (np.arange(_CHECKS) + 0.5) / _CHECKS)
    exact, exact_checks = (triangulate_pairs(first, second, *m) for m in (nodes, checks))
    if not (has_result(exact.flag).all() and has_result(exact_checks.flag).all()):
        return None
    step = tile.chart.at(nodes[0], span[1]) - tile.chart.at(nodes[0], span[0])
    along = step.mean(axis=0) / float(np.hypot(*step.mean(axis=0)))
    position = nodes[1] @ along
    flat = np.column_stack([np.ones(len(position)), nodes[0]])
    plane = np.asarray(np.linalg.lstsq(flat, position, rcond=None)[0], dtype=np.float64)
    place = np.column_stack([nodes[0], position - flat @ plane])
    centre = 0.5 * (place.max(axis=0) + place.min(axis=0))
    extent = np.maximum(0.5 * np.ptp(place, axis=0), 1e-6)
    base = exact.geodetic.mean(axis=0)
    terms = cubic_terms((place - centre) / extent)
    solution = np.linalg.lstsq(terms, exact.geodetic - base, rcond=1e-12)[0]
    fit = GroundFit(along, plane, centre, extent, base, np.ascontiguousarray(solution), 0.0)
    scale = np.array([WGS84_A_M * np.cos(base[1]), WGS84_A_M, 1.0])
    error = max(
        float(np.max(np.abs((fit.at(*match) - truth.geodetic) * scale)))
        for match, truth in ((nodes, exact), (checks, exact_checks))
    )
    if not error <= TOLERANCE_M:
        return None
    return GroundFit(along, plane, centre, extent, base, fit.coefficients, error)


def _matches(
    tile: EpipolarTile,
    corner: FloatArray,
    size: FloatArray,
    heights_m: tuple[float, float],
    at: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Pixels of the core and their matches, at heights over the range."""
    mesh = np.meshgrid(
        corner[0] + at * size[0],
        corner[1] + at * size[1],
        heights_m[0] + at * (heights_m[1] - heights_m[0]),
        indexing="ij",
    )
    place = np.stack(mesh, axis=-1).reshape(-1, 3)
    first = np.ascontiguousarray(place[:, :2])
    return first, tile.chart.at(first, place[:, 2])


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _ground(
    first_px: FloatArray,
    second_px: FloatArray,
    way: FloatArray,
    normal: FloatArray,
    base: FloatArray,
    c: FloatArray,
    out: FloatArray,
) -> None:
    for i in prange(len(out)):
        line, sample = first_px[i, 0], first_px[i, 1]
        t = second_px[i, 0] * way[0] + second_px[i, 1] * way[1]
        t -= way[2] + way[3] * line + way[4] * sample
        e = (line - normal[0]) * normal[3]
        n = (sample - normal[1]) * normal[4]
        u = (t - normal[2]) * normal[5]
        # The order of the terms is that of `pushbroom.cubic_terms`.
        for k in range(3):
            out[i, k] = (
                base[k]
                + c[0, k]
                + e * (c[1, k] + e * (c[4, k] + e * c[10, k] + n * c[11, k] + u * c[12, k]))
                + n * (c[2, k] + n * (c[5, k] + n * c[13, k] + e * c[14, k] + u * c[15, k]))
                + u * (c[3, k] + u * (c[6, k] + u * c[16, k] + e * c[17, k] + n * c[18, k]))
                + e * n * (c[7, k] + u * c[19, k])
                + e * u * c[8, k]
                + n * u * c[9, k]
            )
