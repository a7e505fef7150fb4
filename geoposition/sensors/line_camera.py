"""The push-broom camera: line timing, one or more CCDs in a focal plane, mounting."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, read_only, require_finite
from geoposition.camera import Detector, LineTiming
from geoposition.errors import ArgumentError
from geoposition.sensors.directions import Directions


@dataclass(frozen=True, slots=True, eq=False)
class Ccd:
    """One CCD of a focal plane: `samples` pixels of the image row and their directions.

    `directions` counts from the image's sample 0, not the CCD's.
    """

    samples: int
    directions: Directions


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """How the camera sits in the body: its turn and its place.

    `lever_arm_body_m` is the perspective centre relative to the point the ephemeris gives, such
    as the GPS antenna, in the body frame (P 9: B_x, B_y, B_z).
    """

    R_body_camera: Rotation = field(default_factory=Rotation.identity)
    lever_arm_body_m: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        arm = require_finite(read_only(self.lever_arm_body_m), "lever arm")
        if arm.shape != (3,):
            raise ArgumentError(f"lever arm: 3 numbers expected, got shape {arm.shape}")
        object.__setattr__(self, "lever_arm_body_m", arm)


@dataclass(frozen=True, slots=True, eq=False)
class LineCamera:
    """Push-broom camera of `lines` lines; the CCDs stand side by side in the image row."""

    lines: int
    timing: LineTiming
    ccds: tuple[Ccd, ...]
    mounting: Mounting = field(default_factory=Mounting)

    def __post_init__(self) -> None:
        if self.lines < 1 or not self.ccds or any(ccd.samples < 1 for ccd in self.ccds):
            raise ArgumentError("camera: at least one line, one CCD and one sample expected")

    @classmethod
    def single(
        cls,
        shape: tuple[int, int],
        timing: LineTiming,
        directions: Directions,
        mounting: Mounting | None = None,
    ) -> LineCamera:
        """Camera with one CCD; `shape` is (lines, samples)."""
        return cls(shape[0], timing, (Ccd(shape[1], directions),), mounting or Mounting())

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (lines, samples)."""
        return self.lines, sum(ccd.samples for ccd in self.ccds)

    @property
    def detectors(self) -> tuple[Detector, ...]:
        """The CCDs by increasing sample."""
        result, first = [], 0
        for ccd in self.ccds:
            last = first + ccd.samples - 1
            result.append(Detector(float(first), float(last), ccd.directions.knots_sample))
            first = last + 1
        return tuple(result)

    def tangents(self, detector: int, sample: ArrayLike) -> FloatArray:
        """Apparent direction (..., 2) of `sample` (...) seen by CCD number `detector`."""
        return self.ccds[detector].directions.tangents(sample)

    @property
    def R_body_camera(self) -> Rotation:
        """Mounting rotation, camera frame to body frame."""
        return self.mounting.R_body_camera

    @property
    def lever_arm_body_m(self) -> FloatArray:
        """Perspective centre relative to the ephemeris's point, body frame (3,)."""
        return self.mounting.lever_arm_body_m

    @property
    def parameters(self) -> Mapping[str, float]:
        """Directions of each CCD as `ccd0.x0`, ..., small mounting turns `mounting_x_rad`, ....

        The turns are relative to the present mounting, so they read zero.
        """
        named = {
            f"ccd{i}.{name}": value
            for i, ccd in enumerate(self.ccds)
            for name, value in ccd.directions.parameters.items()
        }
        return named | {f"mounting_{axis}_rad": 0.0 for axis in "xyz"}

    def with_parameters(self, values: Mapping[str, float]) -> Self:
        """Camera with some parameters changed."""
        unknown = set(values) - set(self.parameters)
        if unknown:
            raise ArgumentError(f"camera: no parameter {sorted(unknown)}")
        if not np.all(np.isfinite(list(values.values()))):
            raise ArgumentError("camera: finite parameters expected")
        turn = [values.get(f"mounting_{axis}_rad", 0.0) for axis in "xyz"]
        mounting = replace(
            self.mounting,
            R_body_camera=self.mounting.R_body_camera * Rotation.from_rotvec(turn),
        )
        ccds = []
        for i, ccd in enumerate(self.ccds):
            own = {
                name.partition(".")[2]: value
                for name, value in values.items()
                if name.startswith(f"ccd{i}.")
            }
            directions = ccd.directions.with_parameters(own) if own else ccd.directions
            ccds.append(replace(ccd, directions=directions))
        return replace(self, ccds=tuple(ccds), mounting=mounting)
