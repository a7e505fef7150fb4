"""Forward intersection of lines of sight (T 2.3–2.6): where rays of several images meet.

Everything here is in space and metres: a ray's error is its perpendicular distance, with one
standard deviation across it. Image points, pixels and models are `triangulate`'s.

T (2.4) writes a ray as two equations, scaled by the components of its direction; its solution
weighs the rays by how they happen to point. Here a ray's misfit is the distance itself, which
does not depend on the axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition import intersect_kernels as kernels
from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.rays import Rays

MIN_CONVERGENCE_RAD: Final = 1e-3
"""Rays that converge by less are `WEAK_GEOMETRY`: errors along them grow a thousandfold."""


@dataclass(frozen=True, slots=True, eq=False)
class PairIntersections:
    """Where pairs of rays pass each other.

    `geodetic` (n, 3) = (lon_rad, lat_rad, height_m); `miss_m` (n,) is the distance between the
    two rays there; NaN where `flag` (n,) has no result.
    """

    geodetic: FloatArray
    miss_m: FloatArray
    flag: FlagArray


@dataclass(frozen=True, slots=True, eq=False)
class RayIntersections:
    """Least-squares points of bundles of rays.

    `geodetic` (n, 3); `covariance_enu_m2` (n, 3, 3) east, north, up, from the stated standard
    deviations; `residual_m` (observations,) each ray's distance from its point; `rays` (n,) how
    many took part; `convergence_rad` (n,) the largest angle between two of them. NaN where
    `flag` (n,) has no result.
    """

    geodetic: FloatArray
    covariance_enu_m2: FloatArray
    residual_m: FloatArray
    rays: IntArray
    convergence_rad: FloatArray
    flag: FlagArray

    @property
    def sigma_enu_m(self) -> FloatArray:
        """Standard deviations east, north, up (n, 3)."""
        return np.sqrt(np.diagonal(self.covariance_enu_m2, axis1=1, axis2=2))


def intersect_pairs(
    a: Rays,
    b: Rays,
    sigma_a_m: float = 1.0,
    sigma_b_m: float = 1.0,
    min_convergence_rad: float = MIN_CONVERGENCE_RAD,
) -> PairIntersections:
    """Intersect ray i of `a` (n) with ray i of `b` (n), in closed form.

    The point divides the rays' common perpendicular by their variances: with equal standard
    deviations it is the midpoint. Flags: those of the rays; `WEAK_GEOMETRY` for rays that
    converge by less than `min_convergence_rad`; `NO_INTERSECTION` for a point that is not in
    front of both origins. *Source*: T (2.3)–(2.6).
    """
    if a.direction_ecef.ndim != 2 or a.direction_ecef.shape != b.direction_ecef.shape:
        raise ArgumentError(
            f"rays: two lists of equal length expected, got {a.flag.shape} and {b.flag.shape}"
        )
    if not (sigma_a_m > 0.0 and sigma_b_m > 0.0):
        raise ArgumentError(f"rays: positive sigmas expected, got {sigma_a_m}, {sigma_b_m}")
    n = len(a.flag)
    geodetic, miss = np.empty((n, 3)), np.empty(n)
    flags: FlagArray = np.empty(n, dtype=np.uint8)
    kernels.intersect_two(
        np.ascontiguousarray(a.origin_ecef_m),
        np.ascontiguousarray(a.direction_ecef),
        a.flag,
        np.ascontiguousarray(b.origin_ecef_m),
        np.ascontiguousarray(b.direction_ecef),
        b.flag,
        sigma_a_m**2 / (sigma_a_m**2 + sigma_b_m**2),
        float(np.sin(min_convergence_rad)),
        geodetic,
        miss,
        flags,
    )
    return PairIntersections(geodetic, miss, flags)


def intersect_rays(
    rays: Rays,
    start: ArrayLike,
    sigma_m: ArrayLike = 1.0,
    min_convergence_rad: float = MIN_CONVERGENCE_RAD,
) -> RayIntersections:
    """Intersect bundles of rays: those of point i are `rays[start[i]:start[i + 1]]`.

    `sigma_m`, one or per ray, is the standard deviation of a ray across itself at the point.
    A ray without a result is left out. Flags: `TOO_FEW_RAYS` with one ray; the lost ray's own
    flag where only its loss left fewer than two; `WEAK_GEOMETRY` and `NO_INTERSECTION` as in
    `intersect_pairs`; `OUTSIDE_IMAGE`, with numbers, where a ray has it.
    *Source*: the normal equations are the module's; T (2.6) for any number of rays.
    """
    direction = np.ascontiguousarray(rays.direction_ecef).reshape(-1, 3)
    first = np.ascontiguousarray(np.asarray(start, dtype=np.int64))
    total = len(direction)
    if (
        first.ndim != 1
        or len(first) < 1
        or first[0] != 0
        or first[-1] != total
        or np.any(np.diff(first) < 0)
    ):
        raise ArgumentError(f"start: increasing row numbers from 0 to {total} expected")
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (total,))
    if not np.all((sigma > 0.0) & np.isfinite(sigma)):
        raise ArgumentError("sigma_m: positive metres expected")
    n = len(first) - 1
    result = RayIntersections(
        geodetic=np.full((n, 3), np.nan),
        covariance_enu_m2=np.full((n, 3, 3), np.nan),
        residual_m=np.full(total, np.nan),
        rays=np.empty(n, dtype=np.int64),
        convergence_rad=np.full(n, np.nan),
        flag=np.empty(n, dtype=np.uint8),
    )
    kernels.intersect_many(
        first,
        np.ascontiguousarray(rays.origin_ecef_m).reshape(-1, 3),
        direction,
        np.ascontiguousarray(rays.flag).reshape(-1),
        1.0 / sigma**2,
        min_convergence_rad,
        result.geodetic,
        result.covariance_enu_m2,
        result.residual_m,
        result.rays,
        result.convergence_rad,
        result.flag,
    )
    return result
