"""Lines of sight: half-lines in the Earth-fixed frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Half-lines: `origin_ecef_m` (..., 3), unit `direction_ecef` (..., 3), `flag` (...).

    The directions point from the satellite to the ground. Where `flag` has no result the
    numbers are NaN.
    """

    origin_ecef_m: FloatArray
    direction_ecef: FloatArray
    flag: FlagArray

    def at(self, range_m: ArrayLike) -> FloatArray:
        """Points at `range_m` (...), as (..., 3) ECEF metres."""
        distance = np.asarray(range_m, dtype=np.float64)[..., None]
        result: FloatArray = self.origin_ecef_m + distance * self.direction_ecef
        return result
