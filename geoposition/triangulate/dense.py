"""Ground points of dense matches of two images: the fast way, for millions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, as_components
from geoposition.error_budget.model_error import ModelError
from geoposition.errors import ArgumentError
from geoposition.intersect import MIN_CONVERGENCE_RAD, PairIntersections, intersect_pairs
from geoposition.rays import Rays
from geoposition.sensor_model import SensorModel
from geoposition.triangulate.pair_kernel import weigh_pairs
from geoposition.triangulate.part import error_fields
from geoposition.triangulate.scale import TERMS, image_scale
from geoposition.triangulate.solve import MORE_RAYS, RAY_TOLERANCE_M
from geoposition.triangulate.start import height_range_m, height_start

_CHUNK: Final = 1 << 15


@dataclass(frozen=True, slots=True, eq=False)
class WeightedPairs:
    """Points intersected from pairs, weighted, with their covariance.

    `geodetic` (n, 3) = (lon_rad, lat_rad, height_m); `covariance_enu_m2` (n, 3, 3) east, north,
    up; `miss_m` (n,) the distance between the two lines of sight; NaN where `flag` (n,) has no
    result.
    """

    geodetic: FloatArray
    covariance_enu_m2: FloatArray
    miss_m: FloatArray
    flag: FlagArray

    @property
    def sigma_enu_m(self) -> FloatArray:
        """Standard deviations east, north, up (n, 3)."""
        return np.sqrt(np.diagonal(self.covariance_enu_m2, axis1=1, axis2=2))


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
    pixels = _pairs_of(first_px, second_px)
    n = len(pixels[0])
    out = PairIntersections(np.empty((n, 3)), np.empty(n), np.empty(n, dtype=np.uint8))
    for at, found, _ in _chunks((first, second), pixels, min_convergence_rad):
        out.geodetic[at], out.miss_m[at], out.flag[at] = found.geodetic, found.miss_m, found.flag
    return out


def triangulate_pairs_weighted(
    first: SensorModel,
    second: SensorModel,
    first_px: ArrayLike,
    second_px: ArrayLike,
    sigma_px: ArrayLike = 0.5,
    errors: tuple[ModelError | None, ModelError | None] = (None, None),
    min_convergence_rad: float = MIN_CONVERGENCE_RAD,
) -> WeightedPairs:
    """Intersect dense matches as `triangulate_pairs` does, weighted, with covariances.

    `sigma_px`, one number or (line, sample), is the standard deviation of the image points of
    both images; `errors` are the models' own. The covariance holds both, as `triangulate`'s
    does, with which points and covariances agree as closely as lines of sight are straight.
    """
    pixels = _pairs_of(first_px, second_px)
    n = len(pixels[0])
    sigma = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), (2,))
    if not np.all((sigma > 0.0) & np.isfinite(sigma)):
        raise ArgumentError(f"sigma_px: positive pixels expected, got {sigma}")
    models = (first, second)
    fields = np.stack([image_scale(model) for model in models])
    own = error_fields(models, errors, fields)
    own = np.zeros((2, TERMS, 3)) if own is None else own
    noise = np.tile([sigma[0] ** 2, 0.0, sigma[1] ** 2], (2, 1))
    out = WeightedPairs(
        np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(n), np.empty(n, dtype=np.uint8)
    )
    for at, found, rays in _chunks(models, pixels, min_convergence_rad):
        weigh_pairs(
            pixels[0][at],
            pixels[1][at],
            rays[0].origin_ecef_m,
            rays[0].direction_ecef,
            rays[1].origin_ecef_m,
            rays[1].direction_ecef,
            fields,
            own,
            noise,
            found.geodetic,
            out.covariance_enu_m2[at],
            found.flag,
        )
        out.geodetic[at], out.miss_m[at], out.flag[at] = found.geodetic, found.miss_m, found.flag
    return out


def _pairs_of(first_px: ArrayLike, second_px: ArrayLike) -> tuple[FloatArray, FloatArray]:
    a = np.ascontiguousarray(as_components(first_px, 2, "image points")).reshape(-1, 2)
    b = np.ascontiguousarray(as_components(second_px, 2, "image points")).reshape(-1, 2)
    if len(a) != len(b):
        raise ArgumentError(f"a pair: as many points in both expected, got {len(a)}, {len(b)}")
    return a, b


def _chunks(
    models: tuple[SensorModel, SensorModel],
    pixels: tuple[FloatArray, FloatArray],
    min_convergence_rad: float,
) -> Iterator[tuple[slice, PairIntersections, tuple[Rays, Rays]]]:
    """Midpoints of some points at a time, with the lines of sight they come from."""
    guess = height_start(*models)
    middle = float(np.mean(height_range_m(list(models))))
    for begin in range(0, len(pixels[0]), _CHUNK):
        at = slice(begin, min(begin + _CHUNK, len(pixels[0])))
        a, b = pixels[0][at], pixels[1][at]
        height = np.full(len(a), middle) if guess is None else guess.heights_m(a, b)
        rays = models[0].rays(a, height), models[1].rays(b, height)
        found = intersect_pairs(*rays, min_convergence_rad=min_convergence_rad)
        for _ in range(MORE_RAYS):
            moved = np.flatnonzero(np.abs(found.geodetic[:, 2] - height) > RAY_TOLERANCE_M)
            if len(moved) == 0:
                break
            height[moved] = found.geodetic[moved, 2]
            anew = models[0].rays(a[moved], height[moved]), models[1].rays(b[moved], height[moved])
            part = intersect_pairs(*anew, min_convergence_rad=min_convergence_rad)
            found.geodetic[moved], found.miss_m[moved] = part.geodetic, part.miss_m
            found.flag[moved] = part.flag
            for old, new in zip(rays, anew, strict=True):
                old.origin_ecef_m[moved] = new.origin_ecef_m
                old.direction_ecef[moved] = new.direction_ecef
        yield at, found, rays
