"""Which rows of telemetry go forward in time, and which repeat or contradict the others."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray

_SAME_TIME_S: Final = 1e-6


def forward_rows(times_s: FloatArray, usable: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Rows (n,) of a series to keep, and those dropped as repetitions.

    Of several rows of one time (to a microsecond) the first `usable` one stays. Of the rest the
    largest set whose times increase is kept, so a wrong time costs its own row and not all rows
    that follow. Times that are no numbers are neither.
    """
    n = len(times_s)
    forward, duplicate = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    finite = np.flatnonzero(np.isfinite(times_s))
    # By time, usable ones first, then in the order they came.
    order = finite[np.lexsort((finite, ~usable[finite], times_s[finite]))]
    again = np.concatenate([[False], np.diff(times_s[order]) <= _SAME_TIME_S])[: len(order)]
    # Rows nearly a microsecond apart must not chain into one: only the same cluster's start.
    duplicate[order[again]] = True
    single = np.flatnonzero(np.isfinite(times_s) & ~duplicate)
    forward[single[_longest_increasing(times_s[single])]] = True
    return forward, duplicate


def _longest_increasing(values: FloatArray) -> IntArray:
    if np.all(np.diff(values) > 0.0):
        return np.arange(len(values))
    return _longest_increasing_kernel(np.ascontiguousarray(values))


@njit(cache=True, error_model="numpy")
def _longest_increasing_kernel(values: FloatArray) -> IntArray:
    """Find the indices of a longest strictly increasing subsequence (patience sorting)."""
    n = len(values)
    tails = np.empty(n, dtype=np.int64)
    before = np.empty(n, dtype=np.int64)
    length = 0
    for i in range(n):
        low, high = 0, length
        while low < high:
            middle = (low + high) // 2
            if values[tails[middle]] < values[i]:
                low = middle + 1
            else:
                high = middle
        before[i] = tails[low - 1] if low > 0 else -1
        tails[low] = i
        length = max(length, low + 1)
    result = np.empty(length, dtype=np.int64)
    at = tails[length - 1]
    for k in range(length - 1, -1, -1):
        result[k] = at
        at = before[at]
    return result
