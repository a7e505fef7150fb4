"""Array types and the checks every door makes: shape, finiteness, read-only."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geoposition.errors import ArgumentError

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]
FlagArray: TypeAlias = NDArray[np.uint8]


def read_only(values: ArrayLike) -> FloatArray:
    """Return a contiguous float64 copy that cannot be written to."""
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


def as_components(values: ArrayLike, n: int, name: str) -> FloatArray:
    """Return `values` as float64 (..., n); anything else is an `ArgumentError`."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name}: numbers of shape (..., {n}) expected") from None
    if array.ndim == 0 or array.shape[-1] != n:
        raise ArgumentError(f"{name}: shape (..., {n}) expected, got {array.shape}")
    return array


def require_finite(values: FloatArray, name: str) -> FloatArray:
    """Return `values` unchanged; NaN or infinity in it is an `ArgumentError`."""
    if not np.all(np.isfinite(values)):
        rows = np.isfinite(values).reshape(len(values) if values.ndim else 1, -1)
        bad = int(np.argmax(~rows.all(axis=1)))
        raise ArgumentError(f"{name}: finite numbers expected, entry {bad} is not")
    return values


def require_increasing(times_s: FloatArray, name: str) -> FloatArray:
    """Return `times_s` (n,) unchanged; it must increase strictly."""
    if times_s.ndim != 1 or len(times_s) == 0:
        raise ArgumentError(f"{name}: a non-empty list of times expected")
    require_finite(times_s, name)
    steps = np.diff(times_s)
    if np.any(steps <= 0):
        bad = int(np.argmax(steps <= 0)) + 1
        raise ArgumentError(f"{name}: strictly increasing times expected, entry {bad} does not")
    return times_s
