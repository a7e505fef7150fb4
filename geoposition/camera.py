"""The `Camera` protocol: pixel to time and direction; the satellite's side implements it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, Self

from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.timescale import Epoch


class LineTiming(Protocol):
    """When each line was taken: strictly monotonic in the line, up or down (reverse scans)."""

    @property
    def epoch(self) -> Epoch:
        """Instant from which the seconds count."""
        ...

    @property
    def knots_line(self) -> FloatArray:
        """Lines (m,) at which the line rate jumps; empty for a constant rate."""
        ...

    def time_s(self, line: ArrayLike) -> FloatArray:
        """Seconds from `epoch` at which `line` (...) was taken; linear beyond the ends."""
        ...

    def line_at(self, time_s: ArrayLike) -> FloatArray:
        """Line (...) that was taken at `time_s` (...); the inverse of `time_s`."""
        ...


@dataclass(frozen=True, slots=True)
class Detector:
    """One CCD: the samples it fills, first and last, and the knots of its direction curve."""

    first_sample: float
    last_sample: float
    knots_sample: FloatArray


class Camera(Protocol):
    """Push-broom camera: all samples of a line at one time, each sample its own direction."""

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (lines, samples)."""
        ...

    @property
    def timing(self) -> LineTiming:
        """Line to time."""
        ...

    @property
    def detectors(self) -> tuple[Detector, ...]:
        """The CCDs by increasing sample; one for a single array."""
        ...

    def tangents(self, detector: int, sample: ArrayLike) -> FloatArray:
        """Apparent direction of `sample` (...) as (..., 2): d_camera is along (x, y, 1).

        Must be defined some samples beyond the detector's ends, as its smooth continuation.
        """
        ...

    @property
    def R_body_camera(self) -> Rotation:
        """Mounting: camera frame to body frame."""
        ...

    @property
    def lever_arm_body_m(self) -> FloatArray:
        """Perspective centre relative to the ephemeris's point, body frame (3,)."""
        ...

    @property
    def parameters(self) -> Mapping[str, float]:
        """Estimable parameters by name, with their present values."""
        ...

    def with_parameters(self, values: Mapping[str, float]) -> Self:
        """Camera with some parameters changed; an unknown name is an `ArgumentError`."""
        ...
