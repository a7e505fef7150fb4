"""Raw gyro pulses to body angles: scale per pulse, sensing axes of any number and direction.

Each sensing axis counts pulses for the angle turned about it. Three axes or more, orthogonal,
skewed or redundant, give the body's angle by least squares; more than three leave a residual
that tells a failing one. *Source*: T 2.3.2; Markley & Crassidis 2014, section 4.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import (
    FlagArray,
    FloatArray,
    as_components,
    read_only,
    require_finite,
    require_increasing,
)
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.sensors.telemetry import GyroSeries

_LEAST_SPREAD: Final = 1e-3
"""Axes whose smallest singular value is below this do not see all three directions."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroAxes:
    """Sensing axes: unit `axis_body` (m, 3), m >= 3, and signed `rad_per_pulse` (m,).

    `sigma_rad` (m,), where axes differ, is the noise of one sample of each; only ratios matter.
    """

    axis_body: FloatArray
    rad_per_pulse: FloatArray
    sigma_rad: FloatArray

    @classmethod
    def of(
        cls, axis_body: ArrayLike, rad_per_pulse: ArrayLike, sigma_rad: ArrayLike = 1.0
    ) -> GyroAxes:
        """Check and freeze; one scale or sigma stands for all axes."""
        axes = require_finite(as_components(axis_body, 3, "gyro axes"), "gyro axes")
        if axes.ndim != 2 or len(axes) < 3:
            raise ArgumentError("gyro axes: at least three (m, 3) expected")
        length = np.linalg.norm(axes, axis=1)
        if np.any(length == 0.0):
            raise ArgumentError(f"gyro axes: entry {int(np.argmin(length))} is zero")
        axes = axes / length[:, None]
        if np.linalg.svd(axes, compute_uv=False)[-1] < _LEAST_SPREAD:
            raise GeometryError("gyro axes: they lie in one plane and do not see a turn across it")
        scale = np.broadcast_to(np.asarray(rad_per_pulse, dtype=np.float64), (len(axes),))
        sigma = np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), (len(axes),))
        if not (np.all(np.isfinite(scale)) and np.all(scale != 0.0)):
            raise ArgumentError("gyro axes: a finite angle per pulse, not zero, expected")
        if not (np.all(np.isfinite(sigma)) and np.all(sigma > 0.0)):
            raise ArgumentError("gyro axes: positive noise expected")
        return cls(read_only(axes), read_only(scale), read_only(sigma))


@dataclass(frozen=True, slots=True, eq=False)
class BodyAngles:
    """Angles about the body's axes since the sample before, `increments_rad` (n, 3).

    `residual_rad` (n, m) is what each sensing axis measured beyond them: zeros to rounding for
    three axes. NaN where `flag` (n,) is `TOO_FEW_RAYS`, the axes left not seeing every turn; the
    first sample says nothing.
    """

    times_s: FloatArray
    increments_rad: FloatArray
    residual_rad: FloatArray
    flag: FlagArray

    def series(self) -> GyroSeries:
        """Return the angles as telemetry of the body; all samples must be OK."""
        if np.any(self.flag != Flag.OK):
            bad = int(np.argmax(self.flag != Flag.OK))
            raise GeometryError(f"gyro pulses: sample {bad} has too few axes, split the span there")
        return GyroSeries.of(self.times_s, self.increments_rad, "increment")

    def rates_rad_s(self) -> FloatArray:
        """Mean rates (n, 3) since the sample before; the first repeats the second."""
        step = np.diff(self.times_s)
        rate: FloatArray = self.increments_rad / np.concatenate([step[:1], step])[:, None]
        return rate


def body_angles(times_s: ArrayLike, pulses: ArrayLike, axes: GyroAxes) -> BodyAngles:
    """Angles from `pulses` (n, m), counted since the sample before; NaN where an axis is off."""
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "gyro times")
    counts = as_components(pulses, len(axes.axis_body), "gyro pulses")
    if counts.shape != (len(times), len(axes.axis_body)) or len(times) < 2:
        raise ArgumentError(f"gyro pulses: shape ({len(times)}, {len(axes.axis_body)}) expected")
    alive = np.isfinite(counts)
    angle = np.where(alive, counts, 0.0) * axes.rad_per_pulse
    # Samples share few patterns of living axes: one inverse for each.
    patterns, which = np.unique(alive, axis=0, return_inverse=True)
    increments = np.full((len(times), 3), np.nan)
    flag = np.full(len(times), Flag.TOO_FEW_RAYS, dtype=np.uint8)
    for index, on in enumerate(patterns):
        if on.sum() < 3 or np.linalg.svd(axes.axis_body[on], compute_uv=False)[-1] < _LEAST_SPREAD:
            continue
        rows = which.ravel() == index
        weight = 1.0 / axes.sigma_rad[on]
        inverse = np.linalg.pinv(axes.axis_body[on] * weight[:, None])
        increments[rows] = (angle[rows][:, on] * weight) @ inverse.T
        flag[rows] = Flag.OK
    residual = np.where(alive, angle - increments @ axes.axis_body.T, np.nan)
    return BodyAngles(read_only(times), read_only(increments), read_only(residual), flag)


def pulses_of_counter(counter: ArrayLike, bits: int) -> FloatArray:
    """Pulses (n, m) since the sample before, of up-down counters (n, m) that wrap at 2^bits.

    Turns of less than half the counter's range per sample come out right. The first row repeats
    the second.
    """
    if not 2 <= bits <= 53:
        raise ArgumentError("gyro counter: 2 to 53 bits expected")
    counts = np.asarray(counter, dtype=np.float64)
    if counts.ndim != 2 or len(counts) < 2:
        raise ArgumentError("gyro counter: shape (n, m) of at least 2 samples expected")
    span = 2.0**bits
    step = np.mod(np.diff(counts, axis=0) + 0.5 * span, span) - 0.5 * span
    return np.concatenate([step[:1], step])


def simulate_pulses(increments_rad: ArrayLike, axes: GyroAxes) -> FloatArray:
    """Whole pulses (n, m) of measured body angles (n, 3): what is not yet a pulse is kept.

    The first sample's angle counts from zero.
    """
    angle = np.cumsum(
        as_components(increments_rad, 3, "gyro increments") @ axes.axis_body.T, axis=0
    )
    counted = np.floor(angle / axes.rad_per_pulse)
    return np.diff(counted, axis=0, prepend=np.zeros((1, counted.shape[1])))
