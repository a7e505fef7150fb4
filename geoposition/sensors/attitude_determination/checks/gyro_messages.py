"""What a gyro check found wrong, in words."""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import FlagArray, FloatArray
from geoposition.sensors.attitude_determination.checks.convention_check import ConventionCheck
from geoposition.sensors.attitude_determination.checks.gyro_samples import GyroFlag
from geoposition.sensors.telemetry import GyroSeries

_SCALE: Final = 0.02
_SURE: Final = 4.0
_NEAR: Final = 0.15
_FAULTS: Final = {
    GyroFlag.SPIKE: "are spikes",
    GyroFlag.STUCK: "are stuck",
    GyroFlag.DISAGREES: "lie in intervals that disagree with the star sensor",
}


def messages(
    gyro: GyroSeries,
    conventions: ConventionCheck,
    value: FloatArray,
    sigma: FloatArray,
    flags: FlagArray,
    star_suspects: int,
) -> tuple[str, ...]:
    """Sentences, empty if nothing is wrong; `value` and `sigma` (16,) as in `gyro_intervals`."""
    said = []
    kind = _kind(gyro, value, sigma)
    if kind:
        said.append(kind)
    elif conventions.message:
        said.append(conventions.message)
    else:
        said += _scale(value, sigma)
        said += _lag(gyro, float(value[15]), float(sigma[15]))
    for flag, words in _FAULTS.items():
        count = int(np.sum(flags == flag))
        if count:
            said.append(f"{count} gyro samples {words}")
    if star_suspects:
        said.append(f"{star_suspects} star samples disagree with the gyro before and after them")
    return tuple(said)


def _kind(gyro: GyroSeries, value: FloatArray, sigma: FloatArray) -> str:
    """Increments taken for rates or the reverse: all axes are off by the step, or its inverse."""
    factor = 1.0 + value[[6, 10, 14]]
    step = float(np.median(np.diff(gyro.times_s)))
    known = np.isfinite(factor) & (sigma[[6, 10, 14]] < _NEAR * np.abs(factor))
    if not np.any(known) or abs(np.log(step)) < 0.5:
        return ""
    factor = factor[known]
    if gyro.kind == "increment" and np.all(np.abs(factor * step - 1.0) < _NEAR):
        return "the increments are rates: each is 1 / step times too large"
    if gyro.kind != "increment" and np.all(np.abs(factor / step - 1.0) < _NEAR):
        return "the rates are increments: each is one step times too small"
    return ""


def _scale(value: FloatArray, sigma: FloatArray) -> list[str]:
    said = []
    for axis, at in zip("xyz", (6, 10, 14), strict=True):
        if abs(value[at]) > _SCALE and abs(value[at]) > _SURE * sigma[at]:
            said.append(f"scale of axis {axis} is off by {100.0 * value[at]:.1f} %")
    return said


def _lag(gyro: GyroSeries, lag_s: float, sigma_s: float) -> list[str]:
    step = float(np.median(np.diff(gyro.times_s)))
    if not abs(lag_s) > _SURE * sigma_s or abs(lag_s) < 0.1 * step:
        return []
    if sigma_s < _NEAR * step and gyro.kind == "rate" and abs(lag_s + 0.5 * step) < _NEAR * step:
        return ["the rates look like means since the sample before, not instantaneous"]
    if sigma_s < _NEAR * step and gyro.kind != "rate" and abs(lag_s - 0.5 * step) < _NEAR * step:
        return ["the rates look instantaneous, not like means since the sample before"]
    late, other = ("star", "gyro") if lag_s > 0.0 else ("gyro", "star")
    return [f"the {late} epochs are late by {abs(lag_s):.4g} s against the {other}'s"]
