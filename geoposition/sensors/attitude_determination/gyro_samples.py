"""Gyro samples that cannot be true by themselves: spikes, and values that are stuck."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FlagArray, FloatArray
from geoposition.sensors.telemetry import GyroSeries

_SPIKE_SIGMA: Final = 8.0
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
    flags[_spikes(values)] = GyroFlag.SPIKE
    flags[_stuck(values)] = GyroFlag.STUCK
    return flags


def excess_turn_rad(gyro: GyroSeries) -> FloatArray:
    """Angle (n, 3) by which each sample turns the body more than the mean of its neighbours."""
    values = _rates(gyro)
    excess = np.zeros_like(values)
    span = 0.5 * (gyro.times_s[2:] - gyro.times_s[:-2])
    excess[1:-1] = (values[1:-1] - 0.5 * (values[:-2] + values[2:])) * span[:, None]
    return excess


def _rates(gyro: GyroSeries) -> FloatArray:
    values = np.array(gyro.values)
    if gyro.kind == "increment":
        values[1:] /= np.diff(gyro.times_s)[:, None]
        values[0] = values[1]
    return values


def _spikes(values: FloatArray) -> BoolArray:
    spikes = np.zeros(len(values), dtype=bool)
    if len(values) < 8:
        return spikes
    off = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    usual = 1.4826 * np.median(np.abs(off), axis=0)
    size = np.max(np.abs(off) / np.maximum(usual, 1e-15 + 1e-9 * np.abs(values).max()), axis=1)
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
