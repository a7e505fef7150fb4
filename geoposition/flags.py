"""What became of one point: the reasons an expected miss can have."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import FlagArray


class Flag(IntEnum):
    """Why a point has, or has not, a result; only `OK` and `OUTSIDE_IMAGE` carry numbers."""

    OK = 0
    OUTSIDE_IMAGE = 1
    """A result was found, but the pixel lies outside the image, within the model's margin."""
    OUTSIDE_MODEL = 2
    """Beyond the margin: ephemeris, attitude or camera do not reach there."""
    BAD_INPUT = 3
    """The given numbers are not finite, or no point on Earth."""
    NO_INTERSECTION = 4
    """The line of sight misses the surface."""
    NOT_CONVERGED = 5
    OUTSIDE_TERRAIN = 6
    """The line of sight meets no terrain data: outside the raster."""
    NODATA = 7
    """The terrain has a hole where the line of sight meets it."""
    WEAK_GEOMETRY = 8
    """Rays too nearly parallel for an intersection."""
    TOO_FEW_RAYS = 9
    BLUNDER = 10
    """The residual is far outside what the others have."""


_LABELS = np.array([flag.name.lower() for flag in Flag])


def flag_labels(flags: FlagArray) -> NDArray[np.str_]:
    """Lower-case names of `flags`, as tables print them: `ok`, `outside_image`, ..."""
    labels: NDArray[np.str_] = _LABELS[flags]
    return labels


def has_result(flags: FlagArray) -> NDArray[np.bool_]:
    """Tell where a number was found: flags `OK` and `OUTSIDE_IMAGE`."""
    return flags <= Flag.OUTSIDE_IMAGE
