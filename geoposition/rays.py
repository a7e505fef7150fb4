"""Lines of sight: half-lines in the Earth-fixed frame."""

from __future__ import annotations

from dataclasses import dataclass

from geoposition.arrays import FlagArray, FloatArray


@dataclass(frozen=True, slots=True)
class Rays:
    """Half-lines: `origin_ecef_m` (..., 3), unit `direction_ecef` (..., 3), `flag` (...).

    The directions point from the satellite to the ground. Where `flag` has no result the
    numbers are NaN.
    """

    origin_ecef_m: FloatArray
    direction_ecef: FloatArray
    flag: FlagArray

    def at(self, range_m: FloatArray) -> FloatArray:
        """Points at `range_m` (...), as (..., 3) ECEF metres."""
        return self.origin_ecef_m + range_m[..., None] * self.direction_ecef
