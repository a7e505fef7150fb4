"""The noise under the lines of a periodogram, and how likely noise alone looks like a line."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray

_BLOCK: Final = 96
"""Bins whose median is the noise floor: many enough for a steady median, few enough to follow."""
SMALLEST_BLOCK: Final = 24
_MEDIAN_EFFICIENCY: Final = float(np.log(2.0)) ** 2
"""Exponentials averaged that are as good as one exponential in a median."""
_TRIES: Final = 2.0
"""Independent chances per bin: a peak between two bins also counts."""


def noise_floor(
    frequency_hz: FloatArray, power: FloatArray, oversampling: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Noise power (m,) under the lines, and how many exponentials (m,) it is worth.

    Medians over blocks that grow with frequency (noise is steep at its low end), joined by lines
    in double logarithm; a second pass levels what the first left tilted within its blocks.
    """
    edges = _block_edges(len(power), oversampling)
    level = np.ones(len(power))
    log_f = np.log(frequency_hz)
    counts = np.diff(edges) / oversampling
    centre = np.array([np.mean(log_f[a:b]) for a, b in pairwise(edges)])
    for _ in range(3):
        whitened = power / level
        medians = np.array([np.median(whitened[a:b]) for a, b in pairwise(edges)])
        steps = np.log(np.maximum(medians, np.finfo(float).tiny) / np.log(2.0))
        level = level * np.exp(_interpolate_straight(log_f, centre, steps))
    worth = np.interp(log_f, centre, counts * _MEDIAN_EFFICIENCY)
    return np.maximum(level, np.finfo(float).tiny), worth


def _block_edges(n: int, oversampling: float) -> list[int]:
    edges, size = [0], SMALLEST_BLOCK * oversampling
    while edges[-1] < n:
        edges.append(min(n, edges[-1] + round(size)))
        size = min(max(size, 0.5 * edges[-1]), max(_BLOCK * oversampling, n / 64))
    if len(edges) > 2 and edges[-1] - edges[-2] < 0.5 * (edges[-2] - edges[-3]):
        del edges[-2]
    return edges


def _interpolate_straight(x: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    if len(knots) == 1:
        return np.full(len(x), values[0])
    result = np.interp(x, knots, values)
    below = x < knots[0]
    slope = (values[1] - values[0]) / (knots[1] - knots[0])
    # Noise only rises towards zero frequency; a falling line there would make false lines.
    result[below] = values[0] + min(slope, 0.0) * (x[below] - knots[0])
    return np.asarray(result)


def false_alarm_probability(ratio: FloatArray, worth: FloatArray, bins: float) -> FloatArray:
    """Probability (m,) that noise alone lifts any of `bins` bins to `ratio` times its floor.

    The floor is itself an estimate, a mean of `worth` exponentials: the ratio is Pareto.
    """
    single = np.exp(-worth * np.log1p(ratio / worth))
    tries = _TRIES * bins
    return np.asarray(-np.expm1(tries * np.log1p(-np.minimum(single, 1.0 - 1e-16))))
