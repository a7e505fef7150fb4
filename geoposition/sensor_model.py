"""The `SensorModel` protocol: what the rigorous model and the RPC model have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray
from geoposition.rays import Rays


@dataclass(frozen=True, slots=True, eq=False)
class GroundPoints:
    """Located points: `geodetic` (..., 3) as (lon_rad, lat_rad, height_m), `flag` (...).

    WGS 84, heights above the ellipsoid. NaN where `flag` has no result.
    """

    geodetic: FloatArray
    flag: FlagArray


@dataclass(frozen=True, slots=True, eq=False)
class ImagePoints:
    """Projected points: `image_px` (..., 2) as (line, sample), `flag` (...).

    The centre of the first pixel is (0, 0). NaN where `flag` has no result.
    """

    image_px: FloatArray
    flag: FlagArray


@runtime_checkable
class SensorModel(Protocol):
    """Image geometry in both directions; image points are (line, sample), 0-based centres."""

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (lines, samples)."""
        ...

    @property
    def height_range_m(self) -> tuple[float, float]:
        """Ellipsoidal heights the model is meant for, lowest and highest."""
        ...

    def image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> GroundPoints:
        """Locate `image_px` (..., 2) on the surface of ellipsoidal height `height_m` (...)."""
        ...

    def ground_to_image(self, geodetic: ArrayLike) -> ImagePoints:
        """Project `geodetic` (..., 3) = (lon_rad, lat_rad, height_m) into the image."""
        ...

    def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
        """Lines of sight of `image_px` (..., 2).

        A line of sight is very slightly bent (refraction) and, seen from the rotating Earth,
        depends on the travel time of light: the ray returned is the straight one through the
        point of height `height_m` (...), exact there.
        """
        ...
