"""Back from the solved ends of segments to the knots inside: values, covariances."""

from __future__ import annotations

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray, IntArray
from geoposition.sensors.attitude_determination.graph.chain import Eliminated
from geoposition.sensors.attitude_determination.threads import in_chunks


def interior_means(done: Eliminated, means: FloatArray, constants: FloatArray) -> FloatArray:
    """All knots (k, 6), from those at the bounds (s + 1, 6) and the constants (p,)."""
    knots = np.zeros_like(done.offset)
    knots[done.bounds] = means
    _interior_means(done.bounds, done.gain, done.offset, constants, knots)
    return knots


def pair_covariances(done: Eliminated, joint: FloatArray) -> FloatArray:
    """Covariance (k − 1, n, n) of (x_i, x_{i+1}, c), from `joint` (s, n, n) of (x_b, x_a, c)."""
    n = joint.shape[1]
    pairs = np.empty((len(done.offset) - 1, n, n))
    in_chunks(
        _pair_covariances,
        len(joint),
        done.bounds,
        done.gain,
        done.covariance,
        joint,
        pairs,
    )
    return pairs


@njit(cache=True, error_model="numpy")
def _interior_means(
    bounds: IntArray,
    gain: FloatArray,
    offset: FloatArray,
    constants: FloatArray,
    knots: FloatArray,
) -> None:
    for segment in range(len(bounds) - 1):
        a = bounds[segment]
        for i in range(bounds[segment + 1] - 1, a, -1):
            for r in range(6):
                s = offset[i, r]
                for c in range(6):
                    s -= gain[i, r, c] * knots[i + 1, c] + gain[i, r, 6 + c] * knots[a, c]
                for c in range(len(constants)):
                    s -= gain[i, r, 12 + c] * constants[c]
                knots[i, r] = s


@njit(cache=True, error_model="numpy")
def _pair_segment(
    segment: int,
    bounds: IntArray,
    gain: FloatArray,
    covariance: FloatArray,
    joint: FloatArray,
    pairs: FloatArray,
) -> None:
    """Covariances of neighbours within one segment, from its right end to its left."""
    n = joint.shape[1]
    # `known` is the covariance of (x_{i+1}, x_a, c), `cross` that of x_i with these.
    known, cross = joint[segment].copy(), np.zeros((6, n))
    for i in range(bounds[segment + 1] - 1, bounds[segment], -1):
        K, pair = gain[i], pairs[i]
        for r in range(6):
            for c in range(n):
                s = 0.0
                for k in range(n):
                    s -= K[r, k] * known[k, c]
                cross[r, c] = s
        # Loops, not slices: those compile ten times as long.
        for r in range(n):
            at = r + 6 if r < 6 else r
            for c in range(n):
                to = c + 6 if c < 6 else c
                if not (6 <= r < 12 or 6 <= c < 12):
                    pair[at, to] = known[r, c]
        for r in range(6):
            for c in range(6):
                pair[r, 6 + c] = cross[r, c]
                pair[6 + c, r] = cross[r, c]
            for c in range(12, n):
                pair[r, c] = cross[r, c]
                pair[c, r] = cross[r, c]
        for r in range(6):
            for c in range(r + 1):
                s = covariance[i, r, c]
                for k in range(n):
                    s -= cross[r, k] * K[c, k]
                pair[r, c] = s
                pair[c, r] = s
        for r in range(6):
            for c in range(n):
                value = pair[r, c] if c < 6 else cross[r, c]
                known[r, c] = value
                known[c, r] = value
    pair = pairs[bounds[segment]]
    for r in range(n):
        at = 6 + r if r < 6 else (r - 6 if r < 12 else r)
        for c in range(n):
            pair[at, 6 + c if c < 6 else (c - 6 if c < 12 else c)] = known[r, c]


@njit(cache=True, error_model="numpy", nogil=True)
def _pair_covariances(
    low: int,
    high: int,
    bounds: IntArray,
    gain: FloatArray,
    covariance: FloatArray,
    joint: FloatArray,
    pairs: FloatArray,
) -> None:
    for segment in range(low, high):
        _pair_segment(
            segment,
            bounds,
            gain,
            covariance,
            joint,
            pairs,
        )
