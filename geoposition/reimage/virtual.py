"""Virtual cameras: part of an image, one CCD of several, or the ideal camera for all of them.

The ideal camera has one straight line of evenly spaced pixels without distortion, across the
whole field of the real one (P 2.2). Neighbouring CCDs may overlap on the ground, leave gaps or
stand in staggered rows: each is mapped by itself, and each column of the ideal image is taken
from the CCD that has it farthest inside. CCDs of other bands are mapped to the same camera,
which registers them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.camera import Camera, Detector, LineTiming
from geoposition.errors import ArgumentError
from geoposition.pushbroom import PushbroomModel
from geoposition.timescale import Epoch

_FIT_SAMPLES: Final = 201


@dataclass(frozen=True, slots=True, eq=False)
class ShiftedTiming:
    """Timing of an image whose line 0 is line `first_line` of `base`."""

    base: LineTiming
    first_line: float

    @property
    def epoch(self) -> Epoch:
        """Instant from which the seconds count."""
        return self.base.epoch

    @property
    def knots_line(self) -> FloatArray:
        """Lines at which the line rate jumps."""
        return self.base.knots_line - self.first_line

    def time_s(self, line: ArrayLike) -> FloatArray:
        """Seconds from `epoch` of `line` (...)."""
        return self.base.time_s(np.asarray(line, dtype=np.float64) + self.first_line)

    def line_at(self, time_s: ArrayLike) -> FloatArray:
        """Line (...) taken at `time_s` (...)."""
        return np.asarray(self.base.line_at(time_s) - self.first_line)


@dataclass(frozen=True, slots=True, eq=False)
class VirtualCamera:
    """Push-broom camera made from `base`, whose mounting it has.

    Its image of `shape` begins with line `first_line` and sample `first_sample` of the base's.
    It has the CCDs `numbers` of `base`; or, with `line` (2, 2), one ideal array: sample s looks
    along x = line[0, 0] + line[0, 1] s, and y likewise.
    """

    base: Camera
    shape: tuple[int, int]
    first_line: int = 0
    first_sample: float = 0.0
    numbers: tuple[int, ...] = (0,)
    line: FloatArray | None = None

    @property
    def timing(self) -> LineTiming:
        """Line to time."""
        timing = self.base.timing
        return ShiftedTiming(timing, self.first_line) if self.first_line else timing

    @property
    def detectors(self) -> tuple[Detector, ...]:
        """The CCDs, cut to the image."""
        last = self.shape[1] - 1.0
        if self.line is not None:
            return (Detector(0.0, last, np.empty(0)),)
        found = []
        for number in self.numbers:
            whole = self.base.detectors[number]
            ends = np.array([whole.first_sample, whole.last_sample]) - self.first_sample
            low, high = np.clip(ends, 0.0, last)
            found.append(Detector(low, high, whole.knots_sample - self.first_sample))
        return tuple(found)

    def tangents(self, detector: int, sample: ArrayLike) -> FloatArray:
        """Apparent direction (..., 2) of `sample` (...) seen by CCD number `detector`."""
        at = np.asarray(sample, dtype=np.float64)
        if self.line is None:
            return self.base.tangents(self.numbers[detector], at + self.first_sample)
        return np.asarray(self.line[:, 0] + self.line[:, 1] * at[..., None])

    @property
    def R_body_camera(self) -> Rotation:
        """Mounting rotation of `base`."""
        return self.base.R_body_camera

    @property
    def lever_arm_body_m(self) -> FloatArray:
        """Lever arm of `base`."""
        return self.base.lever_arm_body_m

    @property
    def parameters(self) -> Mapping[str, float]:
        """None: a virtual camera is not estimated."""
        return {}

    def with_parameters(self, values: Mapping[str, float]) -> VirtualCamera:
        """Return the camera itself; any parameter is unknown."""
        if values:
            raise ArgumentError(f"virtual camera: no parameter {sorted(values)}")
        return self


@dataclass(frozen=True, slots=True)
class Segment:
    """Columns `first_col` ... `end_col` − 1 of an ideal image, seen best by CCD `number`."""

    number: int
    first_col: int
    end_col: int


def single_ccd(model: PushbroomModel, number: int) -> PushbroomModel:
    """Model of one CCD of `model`: its image begins with that CCD's first pixel."""
    camera = model.camera
    if not 0 <= number < len(camera.detectors):
        raise ArgumentError(f"CCD: 0 to {len(camera.detectors) - 1} expected, got {number}")
    detector = camera.detectors[number]
    shape = camera.shape[0], round(detector.last_sample - detector.first_sample) + 1
    one = VirtualCamera(camera, shape, 0, detector.first_sample, (number,))
    return replace(model, camera=one)


def cropped_model(
    model: PushbroomModel, first_line: int, first_sample: int, shape: tuple[int, int]
) -> PushbroomModel:
    """Model of a part of the image, of `shape`, that begins at (`first_line`, `first_sample`)."""
    lines, samples = model.shape
    if (first_line, first_sample, *shape) == (0, 0, lines, samples):
        return model
    end_line, end_sample = first_line + shape[0], first_sample + shape[1]
    if min(first_line, first_sample) < 0 or end_line > lines or end_sample > samples:
        raise ArgumentError(
            f"crop: lines {first_line} .. {end_line - 1} and samples {first_sample} .. "
            f"{end_sample - 1} are not all within an image of {lines} x {samples}"
        )
    inside = tuple(
        number
        for number, ccd in enumerate(model.camera.detectors)
        if ccd.last_sample >= first_sample and ccd.first_sample <= end_sample - 1
    )
    camera = VirtualCamera(model.camera, shape, first_line, float(first_sample), inside)
    return replace(model, camera=camera)


def ideal_camera(camera: Camera) -> tuple[VirtualCamera, tuple[Segment, ...]]:
    """Straight camera across the field of `camera`, and which CCD serves which columns.

    The line is the least-squares one through all pixels, their mean distance its own.
    """
    places, steps = [], []
    for number, detector in enumerate(camera.detectors):
        sample = np.linspace(detector.first_sample, detector.last_sample, _FIT_SAMPLES)
        places.append(camera.tangents(number, sample))
        steps.append((places[-1][-1] - places[-1][0]) / max(sample[-1] - sample[0], 1.0))
    points = np.concatenate(places)
    centre = points.mean(axis=0)
    direction = np.linalg.svd(points - centre, full_matrices=False)[2][0]
    along = direction * np.sign(direction @ np.mean(steps, axis=0))
    pitch = float(np.mean(np.linalg.norm(steps, axis=1)))
    spans = np.array([np.sort([(part[k] - centre) @ along for k in (0, -1)]) for part in places])
    start = float(spans.min())
    samples = int(np.floor((spans.max() - start) / pitch + 1e-6)) + 1
    line = np.stack([centre + start * along, pitch * along], axis=1)
    line.setflags(write=False)
    ideal = VirtualCamera(camera, (camera.shape[0], samples), line=line)
    return ideal, _segments((spans - start) / pitch, samples)


def _segments(spans: FloatArray, samples: int) -> tuple[Segment, ...]:
    """Give each column to the CCD of which it is farthest inside; the nearest one in gaps."""
    col = np.arange(samples)[:, None]
    best = np.argmax(np.minimum(col - spans[:, 0], spans[:, 1] - col), axis=1)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(best)) + 1, [samples]])
    return tuple(Segment(int(best[a]), int(a), int(b)) for a, b in pairwise(edges))
