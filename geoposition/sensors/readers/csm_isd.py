"""Image support data (ISD) of a line scanner, as ALE writes them, to a `LineScanner`.

*Source.* usgscsm, `constructStateFromIsd`, and ALE's rotation chains (both public domain):
quaternions are scalar first; the pointing turns J2000 to sensor axes, the body's rotation J2000 to
its fixed axes, each an optional constant rotation times a slerp between its samples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude, QuaternionCurve, continuous_unit_quaternions
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, UnsupportedError
from geoposition.rotation import quat_xyzw_from_wxyz
from geoposition.sensors.directions import Directions
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers.csm_focal_plane import FocalPlane
from geoposition.sensors.readers.csm_interpolation import CsmLagrangeCurve
from geoposition.sensors.readers.csm_json import JsonNode
from geoposition.sensors.readers.csm_scanner import LineScanner, facing_the_body
from geoposition.sensors.readers.csm_state import ephemeris_epoch, line_timing

_METRES = {"m": 1.0, "km": 1000.0}


def scanner_from_isd(node: JsonNode) -> LineScanner:
    """Read the support data `node`."""
    shape = (node.count("image_lines"), node.count("image_samples"))
    centre_s = node.number("center_ephemeris_time")
    epoch = ephemeris_epoch(centre_s)
    rate = node.array("line_scan_rate", columns=3)
    keys = ("line_scan_rate", "line_scan_rate", "line_scan_rate")
    timing = line_timing(node, epoch, rate[:, 0], rate[:, 1], rate[:, 2], keys, shape[0])
    R_fixed_j2000 = _Rotations(node.child("body_rotation"))
    ephemeris = Ephemeris(epoch, _positions(node, R_fixed_j2000, centre_s))
    attitude = Attitude(epoch, QuaternionCurve(_attitude(node, R_fixed_j2000, centre_s)))
    radii, heights = node.child("radii"), node.child("reference_height")
    sensor = f"{node.text('name_platform', '')} {node.text('name_sensor', '')}".strip()

    def build(camera: LineCamera) -> LineScanner:
        return LineScanner(
            node.path,
            camera,
            ephemeris,
            attitude,
            (_length(radii, "semimajor", "km"), _length(radii, "semiminor", "km")),
            (_length(heights, "minheight", "m"), _length(heights, "maxheight", "m")),
            sensor or "CSM line scanner",
            epoch + float(timing.time_s(0.0)),
        )

    return facing_the_body(build, shape, timing, _focal_plane(node), _undistort(node))


def _unit(node: JsonNode, default: str) -> float:
    unit = node.text("unit", default).lower()
    if unit not in _METRES:
        node.refuse("unit", f"m or km expected, got {unit}")
    return _METRES[unit]


def _length(node: JsonNode, key: str, default_unit: str) -> float:
    return node.number(key) * _unit(node, default_unit)


class _Rotations:
    """Rotation from J2000 over time: constant rotation × slerp between samples."""

    def __init__(self, node: JsonNode):
        quats = node.array("quaternions", columns=4)
        self.node = node
        self.times_s = sample_times(node, len(quats))
        try:
            quats = continuous_unit_quaternions(self.times_s, quat_xyzw_from_wxyz(quats))
        except ArgumentError as error:
            node.refuse("quaternions", str(error))
        self._first = Rotation.from_quat(quats[0])
        self._slerp = Slerp(self.times_s, Rotation.from_quat(quats)) if len(quats) > 1 else None
        self._constant = Rotation.identity()
        if node.has("constant_rotation"):
            matrix = node.array("constant_rotation", rows=9).reshape(3, 3)
            if (
                not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
                or np.linalg.det(matrix) < 0
            ):
                node.refuse("constant_rotation", "a rotation matrix, row by row, expected")
            self._constant = Rotation.from_matrix(matrix)

    def at(self, times_s: FloatArray) -> Rotation:
        """Rotations at ephemeris times (n,); one sample alone holds for ever."""
        if self._slerp is None:
            return self._constant * self._first
        low, high = self.times_s[0], self.times_s[-1]
        if times_s[0] < low - 1e-6 or times_s[-1] > high + 1e-6:
            self.node.refuse(
                "ephemeris_times",
                f"{times_s[0]:.6f} .. {times_s[-1]:.6f} s expected to be covered, "
                f"these are {low:.6f} .. {high:.6f} s",
            )
        return self._constant * self._slerp(np.clip(times_s, low, high))


def sample_times(node: JsonNode, count: int) -> FloatArray:
    """Ephemeris times of `count` samples, strictly increasing."""
    times = node.array("ephemeris_times", rows=count)
    if np.any(np.diff(times) <= 0):
        node.refuse("ephemeris_times", "strictly increasing times expected")
    return times


def _uniform(node: JsonNode, times_s: FloatArray) -> float:
    """Step of `times_s`, which must be equal to 1e-3 of it: CSM interpolates on equal steps."""
    if len(times_s) < 2:
        node.refuse("ephemeris_times", "at least two times expected")
    step = float(times_s[-1] - times_s[0]) / (len(times_s) - 1)
    if np.max(np.abs(np.diff(times_s) - step)) > 1e-3 * step:
        node.refuse("ephemeris_times", "equal time steps expected")
    return step


def _positions(node: JsonNode, R_fixed_j2000: _Rotations, centre_s: float) -> CsmLagrangeCurve:
    child = node.child("instrument_position")
    positions = child.array("positions", columns=3) * _unit(child, "km")
    times = sample_times(child, len(positions))
    step = _uniform(child, times)
    fixed = R_fixed_j2000.at(times).apply(positions)
    return CsmLagrangeCurve(float(times[0] - centre_s), step, fixed)


def _attitude(node: JsonNode, R_fixed_j2000: _Rotations, centre_s: float) -> CsmLagrangeCurve:
    R_sensor_j2000 = _Rotations(node.child("instrument_pointing"))
    times = R_sensor_j2000.times_s
    if len(R_fixed_j2000.times_s) > 1:
        merged = np.union1d(times, R_fixed_j2000.times_s)
        low = max(times[0], R_fixed_j2000.times_s[0])
        high = min(times[-1], R_fixed_j2000.times_s[-1])
        times = merged[(merged >= low) & (merged <= high)]
    if len(times) < 2:
        R_sensor_j2000.node.refuse(
            "ephemeris_times", "two or more times expected that the body's rotation covers too"
        )
    R_fixed_sensor = R_fixed_j2000.at(times) * R_sensor_j2000.at(times).inv()
    step = float(times[-1] - times[0]) / (len(times) - 1)
    equal = np.minimum(times[0] + step * np.arange(len(times)), times[-1])
    quats = continuous_unit_quaternions(equal, Slerp(times, R_fixed_sensor)(equal).as_quat())
    return CsmLagrangeCurve(float(times[0] - centre_s), step, quats)


def _focal_plane(node: JsonNode) -> FocalPlane:
    centre = node.child("detector_center")
    try:
        return FocalPlane.from_affine(
            node.array("focal2pixel_samples", rows=3),
            node.array("focal2pixel_lines", rows=3),
            (centre.number("line"), centre.number("sample")),
            (node.number("starting_detector_line"), node.number("starting_detector_sample")),
            node.number("detector_sample_summing"),
            node.child("focal_length_model").number("focal_length"),
        )
    except ArgumentError as error:
        node.refuse("focal2pixel_samples, focal2pixel_lines, focal_length_model", str(error))


def _undistort(node: JsonNode) -> Callable[[FocalPlane], Directions]:
    distortion = node.child("optical_distortion")
    if set(distortion.data) != {"radial"}:
        raise UnsupportedError(
            node.path,
            "optical_distortion",
            f"radial alone expected, got {', '.join(sorted(distortion.data)) or 'nothing'}",
        )
    radial = distortion.child("radial")
    coefficients = radial.array("coefficients", rows=3)

    def undistort(plane: FocalPlane) -> Directions:
        try:
            return plane.radial(coefficients)
        except ArgumentError as error:
            radial.refuse("coefficients", str(error))

    return undistort
