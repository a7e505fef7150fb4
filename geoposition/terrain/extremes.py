"""Compiled: the least and the greatest of numbers of which some are missing."""

from __future__ import annotations

import math

from numba import njit

from geoposition.arrays import FloatArray


@njit(cache=True, error_model="numpy")
def finite_extremes(values: FloatArray) -> tuple[int, int, int]:
    """Return where `values` (n,) are least and greatest, and how many are finite; else zeros.

    One pass without temporaries, strided or not, where NumPy takes several.
    """
    low = high = count = 0
    lowest, highest = math.inf, -math.inf
    for i in range(len(values)):
        value = values[i]
        if abs(value) < math.inf:
            count += 1
            if value < lowest:
                low, lowest = i, value
            if value > highest:
                high, highest = i, value
    return low, high, count
