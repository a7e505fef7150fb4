"""Ground points of dense matches of two images: the fast way, for millions."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components
from geoposition.errors import ArgumentError
from geoposition.intersect import MIN_CONVERGENCE_RAD, PairIntersections, intersect_pairs
from geoposition.sensor_model import SensorModel
from geoposition.triangulate.solve import MORE_RAYS, RAY_TOLERANCE_M
from geoposition.triangulate.start import height_range_m, height_start

_CHUNK: Final = 1 << 15


def triangulate_pairs(
    first: SensorModel,
    second: SensorModel,
    first_px: ArrayLike,
    second_px: ArrayLike,
    min_convergence_rad: float = MIN_CONVERGENCE_RAD,
) -> PairIntersections:
    """Intersect dense matches of two images: row i of `first_px` (n, 2) with that of `second_px`.

    The fast way for millions: midpoints of the lines of sight, without image residuals and
    covariance. Lines of sight are exact within `RAY_TOLERANCE_M` of the point's height.
    """
    a = np.ascontiguousarray(as_components(first_px, 2, "image points")).reshape(-1, 2)
    b = np.ascontiguousarray(as_components(second_px, 2, "image points")).reshape(-1, 2)
    if len(a) != len(b):
        raise ArgumentError(f"a pair: as many points in both expected, got {len(a)}, {len(b)}")
    n = len(a)
    out = PairIntersections(np.empty((n, 3)), np.empty(n), np.empty(n, dtype=np.uint8))
    guess = height_start(first, second)
    middle = float(np.mean(height_range_m([first, second])))
    for begin in range(0, n, _CHUNK):
        end = min(begin + _CHUNK, n)
        part_a, part_b = a[begin:end], b[begin:end]
        height = np.full(end - begin, middle) if guess is None else guess.heights_m(part_a, part_b)
        found = _pairs(first, second, part_a, part_b, height, min_convergence_rad)
        out.geodetic[begin:end], out.miss_m[begin:end] = found.geodetic, found.miss_m
        out.flag[begin:end] = found.flag
        for _ in range(MORE_RAYS):
            moved = np.flatnonzero(np.abs(out.geodetic[begin:end, 2] - height) > RAY_TOLERANCE_M)
            if len(moved) == 0:
                break
            height[moved] = out.geodetic[begin + moved, 2]
            found = _pairs(
                first, second, part_a[moved], part_b[moved], height[moved], min_convergence_rad
            )
            out.geodetic[begin + moved], out.miss_m[begin + moved] = found.geodetic, found.miss_m
            out.flag[begin + moved] = found.flag
    return out


def _pairs(
    first: SensorModel,
    second: SensorModel,
    first_px: FloatArray,
    second_px: FloatArray,
    height_m: FloatArray,
    min_convergence_rad: float,
) -> PairIntersections:
    return intersect_pairs(
        first.rays(first_px, height_m),
        second.rays(second_px, height_m),
        min_convergence_rad=min_convergence_rad,
    )
