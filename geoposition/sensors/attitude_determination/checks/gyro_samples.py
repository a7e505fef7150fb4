"""Gyro samples that cannot be true by themselves: spikes, and values that are stuck."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FlagArray, FloatArray
from geoposition.sensors.telemetry import GyroSeries

_SPIKE_SIGMA: Final = 10.0
_SMALLEST_RAD_S: Final = 1e-11
_STUCK_SAMPLES: Final = 5
_QUANTISED: Final = 0.1
"""Where more than this part of the samples repeats the one before, repeating is no fault."""


class GyroFlag(IntEnum):
    """What is suspicious about one gyro sample."""

    OK = 0
    SPIKE = 1
    """Far from the mean of its neighbours, beside what is usual in the series."""
    STUCK = 2
    """One of five or more equal samples in a series that does not repeat otherwise."""
    DISAGREES = 3
    """In an interval whose turn is not the star sensor's."""


def suspicious_samples(gyro: GyroSeries) -> FlagArray:
    """`GyroFlag` of each sample (n,), from the gyro alone."""
    flags = np.zeros(len(gyro), dtype=np.uint8)
    values = _rates(gyro)
    flags[_spikes(_beside_neighbours(gyro.times_s, values))] = GyroFlag.SPIKE
    flags[_stuck(values)] = GyroFlag.STUCK
    return flags


def excess_turn_rad(gyro: GyroSeries) -> FloatArray:
    """Angle (n, 3) by which each sample turns the body more than its neighbours let expect."""
    excess = np.zeros_like(gyro.values)
    span = 0.5 * (gyro.times_s[2:] - gyro.times_s[:-2])
    excess[1:-1] = _beside_neighbours(gyro.times_s, _rates(gyro)) * span[:, None]
    return excess


def _beside_neighbours(times: FloatArray, values: FloatArray) -> FloatArray:
    """Differences (n − 2, 3) of the inner samples from the line through their neighbours."""
    part = ((times[1:-1] - times[:-2]) / (times[2:] - times[:-2]))[:, None]
    return np.asarray(values[1:-1] - (1.0 - part) * values[:-2] - part * values[2:])


def _rates(gyro: GyroSeries) -> FloatArray:
    values = np.array(gyro.values)
    if gyro.kind == "increment":
        values[1:] /= np.diff(gyro.times_s)[:, None]
        values[0] = values[1]
    return values


def _spikes(off: FloatArray) -> BoolArray:
    spikes = np.zeros(len(off) + 2, dtype=bool)
    if len(off) < 6:
        return spikes
    usual = 1.4826 * np.median(np.abs(off), axis=0)
    size = np.max(np.abs(off) / np.maximum(usual, _SMALLEST_RAD_S), axis=1)
    # A spike lifts its neighbours' differences to half of its own: only the top counts.
    padded = np.concatenate([[0.0], size, [0.0]])
    spikes[1:-1] = (size > _SPIKE_SIGMA) & (size >= padded[:-2]) & (size >= padded[2:])
    return spikes


def _stuck(values: FloatArray) -> BoolArray:
    same = np.concatenate([[False], np.all(values[1:] == values[:-1], axis=1)])
    stuck = np.zeros(len(values), dtype=bool)
    if np.mean(same) > _QUANTISED:
        return stuck
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        if end - start + 1 >= _STUCK_SAMPLES:
            stuck[start - 1 : end] = True
    return stuck
