"""Samples that follow smoothly from their neighbours, whatever polynomial they miss."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, IntArray

_STRICTER: Final = 0.8
"""Neighbours must agree better than a window: else small blunders would come back."""


def runs(marked: BoolArray) -> tuple[IntArray, IntArray]:
    """First and one past the last of each run of marked samples (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(np.int8), [0]])))
    return edges[::2], edges[1::2]


def smooth_runs(
    times_s: FloatArray,
    quat_xyzw: FloatArray,
    suspect: BoolArray,
    noise_rad: FloatArray,
    threshold_sigma: float,
) -> BoolArray:
    """Mark the runs of suspects (n,) in which every sample is where its neighbours say.

    The neighbours are the nearest two on both sides, suspects or not, joined by a cubic: motion
    too lively for a window passes, blunders do not, and of a burst the ends do not. `noise_rad`
    (3,) is about the sensor's axes.
    """
    smooth = np.zeros(len(times_s), dtype=bool)
    index = np.flatnonzero(suspect)
    if len(times_s) < 5 or len(index) == 0:
        return smooth
    first = np.clip(index - 2, 0, len(times_s) - 5)
    near = first[:, None] + np.arange(5)
    near = near[near != index[:, None]].reshape(-1, 4)
    weights = np.ones((len(index), 4))
    for k in range(4):
        for other in range(4):
            if other != k:
                span = times_s[near[:, k]] - times_s[near[:, other]]
                weights[:, k] *= (times_s[index] - times_s[near[:, other]]) / span
    base = Rotation.from_quat(quat_xyzw[index])
    off = np.zeros((len(index), 3))
    for k in range(4):
        there = Rotation.from_quat(quat_xyzw[near[:, k]])
        off += weights[:, k, None] * (base.inv() * there).as_rotvec()
    allowed = _STRICTER * threshold_sigma * np.sqrt(1.0 + np.sum(weights**2, axis=1))
    smooth[index] = np.linalg.norm(off / noise_rad, axis=1) < allowed
    for start, end in zip(*runs(suspect), strict=True):
        smooth[start:end] = np.all(smooth[start:end])
    return smooth
