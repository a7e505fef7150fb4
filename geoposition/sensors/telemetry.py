"""What the attitude instruments sent down, and how they are mounted: the input of determination.

Times are seconds from an epoch that the caller keeps; all series of one run share it. A star
head's quaternion is `R_inertial_sensor`, its boresight the sensor's +z. Gyro values are in the
body frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    as_components,
    read_only,
    require_finite,
    require_increasing,
)
from geoposition.errors import ArgumentError

GyroKind: TypeAlias = Literal["rate", "mean-rate", "increment"]
"""What a gyro sample says: the rate at its time, the mean rate since the sample before it, or the
angle turned since the sample before it."""

_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class StarSeries:
    """Quaternions of one or several star heads, in the order of time.

    `times_s` (n,) never go back (heads may share one); `head` (n,) indexes `heads`;
    `quat_xyzw` (n, 4) is R_inertial_sensor, unit, scalar last, sign free. The noise of a sample
    about the sensor's axes is (`sigma_cross_rad`, `sigma_cross_rad`, `sigma_bore_rad`), each (n,).
    """

    times_s: FloatArray
    head: IntArray
    quat_xyzw: FloatArray
    sigma_cross_rad: FloatArray
    sigma_bore_rad: FloatArray
    heads: tuple[str, ...]

    @classmethod
    def of(
        cls,
        times_s: ArrayLike,
        quat_xyzw: ArrayLike,
        sigma_cross_rad: ArrayLike,
        sigma_bore_rad: ArrayLike | None = None,
        head: ArrayLike = 0,
        heads: tuple[str, ...] = ("star",),
    ) -> StarSeries:
        """Check and freeze a series; the boresight's noise is the cross-axis one if not given."""
        times = np.asarray(times_s, dtype=np.float64)
        n = len(times) if times.ndim == 1 else 0
        if n == 0:
            raise ArgumentError("star series: a non-empty list of times expected")
        require_finite(times, "star times")
        if np.any(np.diff(times) < 0.0):
            bad = int(np.argmax(np.diff(times) < 0.0)) + 1
            raise ArgumentError(f"star times: entry {bad} goes back")
        quat = require_finite(as_components(quat_xyzw, 4, "star quaternions"), "star quaternions")
        if quat.shape != (n, 4):
            raise ArgumentError(f"star quaternions: shape ({n}, 4) expected, got {quat.shape}")
        norm = np.linalg.norm(quat, axis=1)
        if np.any(np.abs(norm - 1.0) > _UNIT_TOLERANCE):
            bad = int(np.argmax(np.abs(norm - 1.0)))
            raise ArgumentError(f"star quaternions: entry {bad} has norm {norm[bad]:.6g}, not 1")
        sigma = [
            np.broadcast_to(np.asarray(s, dtype=np.float64), (n,))
            for s in (
                sigma_cross_rad,
                sigma_cross_rad if sigma_bore_rad is None else sigma_bore_rad,
            )
        ]
        if not all(np.all(np.isfinite(s)) and np.all(s > 0.0) for s in sigma):
            raise ArgumentError("star series: positive finite noise expected")
        index = np.broadcast_to(np.asarray(head, dtype=np.int64), (n,)).copy()
        if index.min() < 0 or index.max() >= len(heads):
            raise ArgumentError(f"star series: head indices 0 .. {len(heads) - 1} expected")
        index.setflags(write=False)
        return cls(
            read_only(times),
            index,
            read_only(quat / norm[:, None]),
            read_only(sigma[0]),
            read_only(sigma[1]),
            tuple(heads),
        )

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def R_inertial_sensor(self) -> Rotation:
        """The samples as rotations (n,)."""
        return Rotation.from_quat(np.array(self.quat_xyzw))

    def where(self, keep: BoolArray) -> StarSeries:
        """Return the samples at which `keep` (n,) is true; heads keep their indices."""
        index = self.head[keep]
        index.setflags(write=False)
        return StarSeries(
            read_only(self.times_s[keep]),
            index,
            read_only(self.quat_xyzw[keep]),
            read_only(self.sigma_cross_rad[keep]),
            read_only(self.sigma_bore_rad[keep]),
            self.heads,
        )


@dataclass(frozen=True, slots=True, eq=False)
class GyroSeries:
    """Gyro or angular-displacement samples in the body frame, at strictly increasing `times_s`.

    `values` (n, 3): rad/s for the kinds "rate" and "mean-rate", rad for "increment". The first
    sample of a mean or an increment says nothing about the span and is not used.
    """

    times_s: FloatArray
    values: FloatArray
    kind: GyroKind = "rate"

    @classmethod
    def of(cls, times_s: ArrayLike, values: ArrayLike, kind: GyroKind = "rate") -> GyroSeries:
        """Check and freeze a series of at least two samples."""
        times = require_increasing(np.asarray(times_s, dtype=np.float64), "gyro times")
        samples = require_finite(as_components(values, 3, "gyro values"), "gyro values")
        if samples.shape != (len(times), 3):
            raise ArgumentError(f"gyro values: shape ({len(times)}, 3) expected")
        if len(times) < 2:
            raise ArgumentError("gyro series: at least 2 samples expected")
        if kind not in ("rate", "mean-rate", "increment"):
            raise ArgumentError(f"gyro kind: rate, mean-rate or increment expected, got {kind!r}")
        return cls(read_only(times), read_only(samples), kind)

    def __len__(self) -> int:
        return len(self.times_s)

    def increments_rad(self) -> FloatArray:
        """Measured angle (n − 1, 3) turned from each sample to the next.

        Sampled rates are taken as linear between the samples (trapezoid).
        """
        step = np.diff(self.times_s)[:, None]
        if self.kind == "increment":
            return read_only(self.values[1:])
        if self.kind == "mean-rate":
            return read_only(self.values[1:] * step)
        return read_only(0.5 * (self.values[1:] + self.values[:-1]) * step)


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """How sensors are built in: `R_body_sensor` by the sensor's name; not named, not turned."""

    R_body_sensor: Mapping[str, Rotation] = field(default_factory=dict)

    def rotation(self, sensor: str) -> Rotation:
        """R_body_sensor of one sensor."""
        return self.R_body_sensor.get(sensor, Rotation.identity())


@dataclass(frozen=True, slots=True)
class GyroNoise:
    """White noise of the rate and random walk of the bias, alike on all axes.

    `angle_random_walk` sigma_v in rad/s^0.5, `rate_random_walk` sigma_u in rad/s^1.5.
    *Source*: T (2.24)–(2.25); Farrenkopf 1978.
    """

    angle_random_walk: float
    rate_random_walk: float


@dataclass(frozen=True, slots=True, eq=False)
class GyroParameters:
    """Errors of a gyro: measured = (I + S) true + bias, S of scale and misalignment.

    `bias_rad_s`, `scale`, `upper` (U1 U2 U3 at 12, 13, 23) and `lower` (L1 L2 L3 at 21, 31, 32),
    each (3,). *Source*: T (2.26)–(2.27).
    """

    bias_rad_s: FloatArray
    scale: FloatArray
    upper: FloatArray
    lower: FloatArray

    @classmethod
    def of(
        cls,
        bias_rad_s: ArrayLike = (0.0, 0.0, 0.0),
        scale: ArrayLike = (0.0, 0.0, 0.0),
        upper: ArrayLike = (0.0, 0.0, 0.0),
        lower: ArrayLike = (0.0, 0.0, 0.0),
    ) -> GyroParameters:
        """Check and freeze; what is not given is zero."""
        parts = [
            as_components(part, 3, "gyro parameters") for part in (bias_rad_s, scale, upper, lower)
        ]
        return cls(*(read_only(require_finite(part, "gyro parameters")) for part in parts))

    @property
    def matrix(self) -> FloatArray:
        """S (..., 3, 3)."""
        s, u, k = np.broadcast_arrays(self.scale, self.upper, self.lower)
        matrix = np.zeros((*s.shape, 3))
        matrix[..., range(3), range(3)] = s
        matrix[..., (0, 0, 1), (1, 2, 2)] = u
        matrix[..., (1, 2, 2), (0, 0, 1)] = k
        return matrix
