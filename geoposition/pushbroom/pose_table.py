"""Exterior and interior orientation as tables over lines and samples, for the kernels.

The pose of the camera (position, velocity, rotation) is a function of the line alone and the
direction in the camera frame one of the sample alone: both are tabulated as piecewise cubics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.attitude import Attitude
from geoposition.camera import Camera
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, GeometryError
from geoposition.pushbroom.piecewise import PiecewiseCubic, merge_knots, tabulate

POSITION_TOLERANCE_M = 1e-6
ROTATION_TOLERANCE = 5e-13
"""On quaternion components, half an angle: 1e-12 rad, below 1 µm from 800 km."""
TANGENT_TOLERANCE = 1e-13

LEAST_MARGIN_PX = 100.0
MARGIN_PART = 0.05
_LEAST_KNOT_STEP = 1e-6


class PoseTable(NamedTuple):
    """Pose over lines. Components of `cubic`: position ECEF (3), quaternion xyzw (4).

    R_ecef_camera, not normalised. `seconds` (n,) is the time each segment takes, negative in
    reverse scans; `first_line`, `last_line` bound what ephemeris and attitude cover.
    """

    cubic: PiecewiseCubic
    seconds: FloatArray
    first_line: float
    last_line: float


class DirectionTable(NamedTuple):
    """Camera-frame tangents (2) over the samples of m CCDs, one after the other.

    CCD i fills `first_sample[i]` .. `last_sample[i]` of the image row; its cubics are entries
    `start[i]` .. `start[i + 1]` of `coefficients` (n, 4, 2), its knots begin at
    `start[i] + i` of `knots` and its bins at `bin_start[i]`, as in `PiecewiseCubic`.
    """

    first_sample: FloatArray
    last_sample: FloatArray
    start: IntArray
    knots: FloatArray
    coefficients: FloatArray
    bins: IntArray
    bin_start: IntArray
    bin_origin: FloatArray
    bin_scale: FloatArray


def margin_px(size: int) -> float:
    """Pixels around an image of `size` lines or samples within which the model still answers."""
    return max(LEAST_MARGIN_PX, MARGIN_PART * size)


def pose_table(camera: Camera, ephemeris: Ephemeris, attitude: Attitude) -> PoseTable:
    """Tabulate the pose for all lines and a margin, as far as the spans reach."""
    if ephemeris.frame != "itrs" or attitude.frame != "itrs":
        raise ArgumentError("rigorous model: Earth-fixed (itrs) ephemeris and attitude expected")
    timing = camera.timing
    shift_ephemeris = timing.epoch - ephemeris.epoch
    shift_attitude = timing.epoch - attitude.epoch
    low_s = max(ephemeris.span_s[0] - shift_ephemeris, attitude.span_s[0] - shift_attitude)
    high_s = min(ephemeris.span_s[1] - shift_ephemeris, attitude.span_s[1] - shift_attitude)
    lines = camera.shape[0]
    reach = np.sort(timing.line_at(np.array([low_s, high_s])))
    low = max(-margin_px(lines), float(reach[0]))
    high = min(lines - 1 + margin_px(lines), float(reach[1]))
    if low_s >= high_s or low > lines - 1 or high < 0 or high - low < _LEAST_KNOT_STEP:
        raise GeometryError(
            f"rigorous model: ephemeris and attitude cover lines {reach[0]:.1f} .. {reach[1]:.1f}, "
            f"none of the image's 0 .. {lines - 1}"
        )
    knots = merge_knots(
        np.concatenate(
            [
                timing.knots_line,
                timing.line_at(ephemeris.curve.knots_s - shift_ephemeris),
                timing.line_at(attitude.curve.knots_s - shift_attitude),
            ]
        ),
        low,
        high,
        _LEAST_KNOT_STEP,
    )

    def evaluate(line: FloatArray) -> FloatArray:
        # The ends may leave the span by rounding only.
        time = np.clip(timing.time_s(line), low_s, high_s).ravel()
        position = ephemeris.position_m(np.clip(time + shift_ephemeris, *ephemeris.span_s))
        R_ecef_body = attitude.rotation(np.clip(time + shift_attitude, *attitude.span_s))
        position = position + R_ecef_body.apply(np.array(camera.lever_arm_body_m))
        quat = (R_ecef_body * camera.R_body_camera).as_quat().reshape(*line.shape, 4)
        quat *= np.where(np.sum(quat * quat[:, :1], axis=-1, keepdims=True) < 0, -1.0, 1.0)
        return np.concatenate([position.reshape(*line.shape, 3), quat], axis=-1)

    tolerance = np.array([POSITION_TOLERANCE_M] * 3 + [ROTATION_TOLERANCE] * 4)
    cubic = tabulate(evaluate, knots, tolerance)
    seconds = np.diff(timing.time_s(cubic.knots))
    return PoseTable(cubic, seconds, float(cubic.knots[0]), float(cubic.knots[-1]))


def direction_table(camera: Camera) -> DirectionTable:
    """Tabulate each CCD's directions over its samples and a margin to either side."""
    cubics = []
    margin = margin_px(camera.shape[1])
    for number, detector in enumerate(camera.detectors):
        low, high = detector.first_sample - margin, detector.last_sample + margin

        def evaluate(sample: FloatArray, number: int = number) -> FloatArray:
            return camera.tangents(number, sample)

        knots = merge_knots(detector.knots_sample, low, high, _LEAST_KNOT_STEP)
        cubics.append(tabulate(evaluate, knots, np.full(2, TANGENT_TOLERANCE)))
    return DirectionTable(
        np.array([detector.first_sample for detector in camera.detectors]),
        np.array([detector.last_sample for detector in camera.detectors]),
        np.cumsum([0, *(len(cubic.coefficients) for cubic in cubics)]),
        np.concatenate([cubic.knots for cubic in cubics]),
        np.concatenate([cubic.coefficients for cubic in cubics]),
        np.concatenate([cubic.bins for cubic in cubics]),
        np.cumsum([0, *(len(cubic.bins) for cubic in cubics)]),
        np.array([cubic.bin_origin for cubic in cubics]),
        np.array([cubic.bin_scale for cubic in cubics]),
    )
