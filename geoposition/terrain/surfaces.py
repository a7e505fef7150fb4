"""`Terrain`: the ground's ellipsoidal height, and where lines of sight first meet it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, runtime_checkable

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, require_finite
from geoposition.ellipsoid import ecef_to_geodetic
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.rays import Rays
from geoposition.terrain.grid import FAST, foot_point
from geoposition.terrain.series import shell_ranges


@dataclass(frozen=True, slots=True)
class TerrainHeights:
    """Heights above the ellipsoid: `height_m` (...), `flag` (...); NaN where there is none."""

    height_m: FloatArray
    flag: FlagArray


@dataclass(frozen=True, slots=True)
class Crossings:
    """Where rays first meet the ground: `range_m` (...), `geodetic` (..., 3), `flag` (...).

    `range_m` counts along the ray from its origin, `geodetic` is (lon_rad, lat_rad, height_m);
    both are NaN where `flag` is not OK.
    """

    range_m: FloatArray
    geodetic: FloatArray
    flag: FlagArray


@runtime_checkable
class Terrain(Protocol):
    """A surface of ellipsoidal heights on WGS 84, one height per place.

    Per-point misses are flags: `OUTSIDE_TERRAIN`, `NODATA`, `NO_INTERSECTION` (the ray passes
    the Earth, or starts below the ground), `BAD_INPUT`.
    """

    @property
    def provenance(self) -> tuple[str, ...]:
        """What the heights are and where they come from, a fact a line."""
        ...

    def height_at(self, geodetic: ArrayLike) -> TerrainHeights:
        """Height at `geodetic` (..., 2 or 3) = (lon_rad, lat_rad[, ignored])."""
        ...

    def first_crossing(self, rays: Rays, hint_m: ArrayLike | None = None) -> Crossings:
        """First point of each ray on the surface, from above.

        `hint_m` (...) are heights near those expected; they save time and change nothing.
        """
        ...

    def height_range_m(self, geodetic: ArrayLike) -> tuple[float, float]:
        """Lowest and highest height within a box around `geodetic` (..., 2 or 3)."""
        ...


def lon_lat(geodetic: ArrayLike) -> FloatArray:
    """(..., 2) of `geodetic` (..., 2 or 3); another shape is an `ArgumentError`."""
    points = np.asarray(geodetic, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] not in (2, 3):
        raise ArgumentError(f"geodetic: shape (..., 2 or 3) expected, got {points.shape}")
    return points[..., :2]


def bad_lon_lat(places: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Tell which of `places` (..., 2) are no place on Earth."""
    return ~(np.isfinite(places[..., 0]) & (np.abs(places[..., 1]) <= 0.5 * np.pi + 1e-12))


_SHELL_OK: Final = np.uint8(Flag.OK)
_SHELL_BAD: Final = np.uint8(Flag.BAD_INPUT)
_SHELL_MISSED: Final = np.uint8(Flag.NO_INTERSECTION)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def _level_crossings(
    origin_ecef_m: FloatArray,
    direction_ecef: FloatArray,
    height_m: FloatArray,
    flag: FlagArray,
    range_m: FloatArray,
) -> None:
    for k in prange(flag.size):
        ox, oy, oz = origin_ecef_m[k, 0], origin_ecef_m[k, 1], origin_ecef_m[k, 2]
        dx, dy, dz = direction_ecef[k, 0], direction_ecef[k, 1], direction_ecef[k, 2]
        range_m[k] = math.nan
        flag[k] = _SHELL_BAD
        if not abs((ox + oy + oz) * (dx + dy + dz)) < math.inf:
            continue
        flag[k] = _SHELL_MISSED
        level = height_m[k] if height_m.size > 1 else height_m[0]
        t, _ = shell_ranges(ox, oy, oz, dx, dy, dz, level)
        for _step in range(20):
            x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
            cos_lat, sin_lat, p, h = foot_point(x, y, z)
            up = sin_lat * dz + (cos_lat * (x * dx + y * dy) / p if p > 0.0 else 0.0)
            step = (level - h) / up
            t += step
            if abs(step) < 1e-6:
                if t >= 0.0 and up < 0.0:
                    flag[k] = _SHELL_OK
                    range_m[k] = t
                break


@njit(cache=True, error_model="numpy")
def _leave_ranges(
    origin_ecef_m: FloatArray, direction_ecef: FloatArray, height_m: float
) -> FloatArray:
    """Range (n,) where each ray leaves the height upwards; NaN if it never had less."""
    out = np.empty(origin_ecef_m.shape[0])
    for k in range(out.size):
        ox, oy, oz = origin_ecef_m[k, 0], origin_ecef_m[k, 1], origin_ecef_m[k, 2]
        dx, dy, dz = direction_ecef[k, 0], direction_ecef[k, 1], direction_ecef[k, 2]
        _, out[k] = shell_ranges(ox, oy, oz, dx, dy, dz, height_m)
    return out


@dataclass(frozen=True, slots=True)
class ConstantTerrain:
    """The surface of one ellipsoidal height, `height_m`."""

    height_m: float = 0.0

    def __post_init__(self) -> None:
        if not -12e3 <= self.height_m <= 100e3:
            raise ArgumentError(f"height: metres above the ellipsoid expected, got {self.height_m}")

    @property
    def provenance(self) -> tuple[str, ...]:
        """The height, in words."""
        return (f"constant ellipsoidal height {self.height_m:g} m",)

    def height_at(self, geodetic: ArrayLike) -> TerrainHeights:
        """`height_m` everywhere; NaN where the place is no place."""
        bad = bad_lon_lat(lon_lat(geodetic))
        flag = np.where(bad, Flag.BAD_INPUT, Flag.OK).astype(np.uint8)
        return TerrainHeights(np.where(bad, np.nan, self.height_m), flag)

    def first_crossing(self, rays: Rays, hint_m: ArrayLike | None = None) -> Crossings:
        """Where each ray comes down to the height, to a micrometre; `hint_m` is ignored."""
        return level_crossings(rays, self.height_m)

    def height_range_m(self, geodetic: ArrayLike) -> tuple[float, float]:
        """Return the height, twice."""
        return self.height_m, self.height_m


def level_crossings(rays: Rays, height_m: ArrayLike) -> Crossings:
    """Where each ray comes down to its ellipsoidal height `height_m` (...), to a micrometre."""
    shape = rays.origin_ecef_m.shape[:-1]
    origin = np.ascontiguousarray(rays.origin_ecef_m, dtype=np.float64).reshape(-1, 3)
    direction = np.ascontiguousarray(rays.direction_ecef, dtype=np.float64).reshape(-1, 3)
    height = np.asarray(height_m, dtype=np.float64)
    if height.ndim:
        height = np.broadcast_to(height, shape)
    range_m = np.empty(len(origin))
    flag = np.empty(len(origin), np.uint8)
    if len(origin):
        levels = np.ascontiguousarray(height.reshape(-1))
        _level_crossings(origin, direction, levels, flag, range_m)
    geodetic = ecef_to_geodetic(origin + range_m[:, None] * direction)
    keep_flags(rays, flag)
    return Crossings(range_m.reshape(shape), geodetic.reshape(*shape, 3), flag.reshape(shape))


def keep_flags(rays: Rays, flag: FlagArray) -> None:
    """Put the rays' own reason, where they have no line of sight, before the terrain's."""
    own = np.broadcast_to(rays.flag, rays.origin_ecef_m.shape[:-1]).reshape(-1)
    lost = own > Flag.OUTSIDE_IMAGE
    if lost.any():
        flag[lost] = own[lost]


@dataclass(frozen=True, slots=True)
class AnalyticTerrain:
    """Heights as a function of (lon_rad, lat_rad) arrays, between two given extremes.

    For tests and simulated scenes. Rays are followed in steps of `step_m` along them and the
    crossing is bisected, so a feature that a ray is below of for less than a step may be
    missed. The function returns metres, NaN where it has no height.
    """

    height_function: Callable[[FloatArray, FloatArray], FloatArray]
    lowest_m: float
    highest_m: float
    step_m: float = 5.0

    def __post_init__(self) -> None:
        require_finite(np.array([self.lowest_m, self.highest_m, self.step_m]), "terrain limits")
        if not (self.lowest_m <= self.highest_m and self.step_m > 0.0):
            raise ArgumentError("analytic terrain: lowest <= highest and a positive step expected")

    @property
    def provenance(self) -> tuple[str, ...]:
        """That it is made up."""
        return (f"analytic heights between {self.lowest_m:g} and {self.highest_m:g} m",)

    def height_at(self, geodetic: ArrayLike) -> TerrainHeights:
        """Evaluate the function."""
        places = lon_lat(geodetic)
        bad = bad_lon_lat(places)
        height = np.where(bad, np.nan, self._height(places[..., 0], places[..., 1]))
        flag = np.where(bad, Flag.BAD_INPUT, np.where(np.isnan(height), Flag.NODATA, Flag.OK))
        return TerrainHeights(height, flag.astype(np.uint8))

    def height_range_m(self, geodetic: ArrayLike) -> tuple[float, float]:
        """Return the given extremes."""
        return self.lowest_m, self.highest_m

    def _height(self, lon_rad: FloatArray, lat_rad: FloatArray) -> FloatArray:
        return np.asarray(self.height_function(lon_rad, lat_rad), dtype=np.float64)

    def _above(self, points_ecef_m: FloatArray) -> FloatArray:
        geodetic = ecef_to_geodetic(points_ecef_m)
        above: FloatArray = geodetic[..., 2] - self._height(geodetic[..., 0], geodetic[..., 1])
        return above

    def first_crossing(self, rays: Rays, hint_m: ArrayLike | None = None) -> Crossings:
        """Step along the rays, then bisect to a micrometre; `hint_m` is ignored."""
        shape = rays.origin_ecef_m.shape[:-1]
        origin = np.asarray(rays.origin_ecef_m, dtype=np.float64).reshape(-1, 3)
        direction = np.asarray(rays.direction_ecef, dtype=np.float64).reshape(-1, 3)
        flat = Rays(origin, direction, np.zeros(len(origin), np.uint8))
        top = ConstantTerrain(self.highest_m + 1.0).first_crossing(flat)
        bottom = ConstantTerrain(self.lowest_m - 1.0).first_crossing(flat)
        # a ray that starts between the two levels starts at its origin, one that never gets
        # down to the lower one ends where it rises above the upper one again
        start = np.where(top.flag == Flag.OK, top.range_m, 0.0)
        leave = _leave_ranges(origin, direction, self.highest_m + 1.0)
        end = np.where(bottom.flag == Flag.OK, bottom.range_m, leave)
        flag = np.where(bottom.flag == Flag.BAD_INPUT, Flag.BAD_INPUT, Flag.NO_INTERSECTION)
        flag[end > start] = Flag.OK
        flag = flag.astype(np.uint8)
        low, high = start.copy(), np.full(len(start), np.nan)
        active = np.flatnonzero(flag == Flag.OK)
        above = self._above(origin[active] + start[active, None] * direction[active])
        for miss, reason in ((above <= 0.0, Flag.NO_INTERSECTION), (np.isnan(above), Flag.NODATA)):
            flag[active[miss]] = reason
        active = active[above > 0.0]
        while active.size:
            ahead = np.minimum(low[active] + self.step_m, end[active])
            above = self._above(origin[active] + ahead[:, None] * direction[active])
            met = above <= 0.0
            high[active[met]] = ahead[met]
            flag[active[np.isnan(above)]] = Flag.NODATA
            going = above > 0.0
            low[active[going]] = ahead[going]
            active = active[going & (ahead < end[active])]
        found = np.flatnonzero((flag == Flag.OK) & np.isfinite(high))
        flag[(flag == Flag.OK) & ~np.isfinite(high)] = Flag.NO_INTERSECTION
        for _ in range(max(1, math.ceil(math.log2(self.step_m / 1e-7)))):
            middle = 0.5 * (low[found] + high[found])
            over = self._above(origin[found] + middle[:, None] * direction[found]) > 0.0
            low[found[over]] = middle[over]
            high[found[~over]] = middle[~over]
        range_m = np.full(len(start), np.nan)
        range_m[found] = high[found]
        keep_flags(rays, flag)
        range_m[flag != Flag.OK] = np.nan
        geodetic = ecef_to_geodetic(origin + range_m[:, None] * direction)
        return Crossings(range_m.reshape(shape), geodetic.reshape(*shape, 3), flag.reshape(shape))
