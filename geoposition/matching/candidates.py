"""Compiled comparison of feature descriptors, among the candidates that the geometry allows."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from geoposition.arrays import FloatArray, IntArray

_SAME_PLACE_PX = 1.5
_FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, error_model="numpy")
def _distance2(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> int:
    total = np.int32(0)
    for k in range(len(a)):
        d = np.int32(a[k]) - np.int32(b[k])
        total += d * d
    return int(total)


@njit(cache=True, error_model="numpy", fastmath=_FAST, inline="always")
def _allowed(
    dl: float,
    ds: float,
    al: float,
    asam: float,
    length: float,
    reach: float,
    low: float,
    high: float,
) -> bool:
    """Whether a point at (dl, ds) from a chord's low end lies in its band."""
    along = dl * al + ds * asam
    across = ds * al - dl * asam
    return -reach <= along <= length + reach and low <= across <= high


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def match_candidates(
    descriptors_a: NDArray[np.uint8],
    low_px: FloatArray,
    along: FloatArray,
    length_px: FloatArray,
    descriptors_b: NDArray[np.uint8],
    points_b: FloatArray,
    reach_px: float,
    across_low_px: float,
    across_high_px: float,
    ratio: float,
    best: IntArray,
    best2: IntArray,
) -> None:
    """Find for each feature of a the nearest of b within its band, if clearly the nearest.

    `best` is its index or −1, `best2` its squared distance. The second best is one at another
    place: one place may carry features of several orientations.
    """
    for i in prange(len(descriptors_a)):
        first, second, at = 1 << 30, 1 << 30, -1
        for j in range(len(points_b)):
            dl, ds = points_b[j, 0] - low_px[i, 0], points_b[j, 1] - low_px[i, 1]
            if not _allowed(
                dl, ds, along[i, 0], along[i, 1], length_px[i],
                reach_px, across_low_px, across_high_px,
            ):  # fmt: skip
                continue
            d2 = _distance2(descriptors_a[i], descriptors_b[j])
            if d2 >= second:
                continue
            near = at >= 0 and (
                abs(points_b[j, 0] - points_b[at, 0]) < _SAME_PLACE_PX
                and abs(points_b[j, 1] - points_b[at, 1]) < _SAME_PLACE_PX
            )
            if d2 < first:
                if not near:
                    second = first
                first, at = d2, j
            elif not near:
                second = d2
        clear = at >= 0 and first < ratio * ratio * second
        best[i] = at if clear else -1
        best2[i] = first


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def keep_mutual(
    descriptors_a: NDArray[np.uint8],
    low_px: FloatArray,
    along: FloatArray,
    length_px: FloatArray,
    points_a: FloatArray,
    descriptors_b: NDArray[np.uint8],
    points_b: FloatArray,
    reach_px: float,
    across_low_px: float,
    across_high_px: float,
    best: IntArray,
    best2: IntArray,
) -> None:
    """Set `best` to −1 where the feature of b has a nearer one in a, at another place."""
    rival = np.zeros(len(best), dtype=np.bool_)
    for i in prange(len(best)):
        j = best[i]
        if j < 0:
            continue
        for k in range(len(descriptors_a)):
            dl, ds = points_b[j, 0] - low_px[k, 0], points_b[j, 1] - low_px[k, 1]
            if not _allowed(
                dl, ds, along[k, 0], along[k, 1], length_px[k],
                reach_px, across_low_px, across_high_px,
            ):  # fmt: skip
                continue
            if (
                abs(points_a[k, 0] - points_a[i, 0]) < _SAME_PLACE_PX
                and abs(points_a[k, 1] - points_a[i, 1]) < _SAME_PLACE_PX
            ):
                continue
            if _distance2(descriptors_a[k], descriptors_b[j]) < best2[i]:
                rival[i] = True
                break
    for i in range(len(best)):
        if rival[i]:
            best[i] = -1
