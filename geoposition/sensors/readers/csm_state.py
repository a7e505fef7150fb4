"""State of the USGS CSM line scanner, as usgscsm and ASP write it, to a `LineScanner`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude, QuaternionCurve, continuous_unit_quaternions
from geoposition.camera import LineTiming
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, UnsupportedError
from geoposition.sensors.directions import Directions
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers.csm_focal_plane import FocalPlane
from geoposition.sensors.readers.csm_interpolation import CsmLagrangeCurve
from geoposition.sensors.readers.csm_json import JsonNode
from geoposition.sensors.readers.csm_scanner import LineScanner, facing_the_body
from geoposition.sensors.timing import ConstantLineRate, LineTimeTable
from geoposition.timescale import Epoch

J2000_TT_S = 43200.0
"""J2000.0 after 2000-01-01T00:00:00 TT, the zero of ephemeris time."""

RADIAL, KAGUYA = 0, 2
DISTORTIONS = (
    "radial", "transverse", "kaguyalism", "dawnfc", "lrolrocnac", "cahvor", "lunarorbiter",
    "radtan",
)  # fmt: skip

MAX_TIME_JUMP_LINES = 0.01
"""A line time table with larger jumps has gaps, which a continuous timing cannot follow."""


def ephemeris_epoch(seconds: float) -> Epoch:
    """Epoch of ephemeris time, seconds since J2000; TDB is taken as TT, 2 ms at the most."""
    return Epoch.from_tt(J2000_TT_S + seconds)


def scanner_from_state(node: JsonNode) -> LineScanner:
    """Read the model state `node`."""
    for i, value in enumerate(
        node.array("m_currentParameterValue") if node.has("m_currentParameterValue") else ()
    ):
        if value != 0.0:
            raise UnsupportedError(
                node.path,
                f"m_currentParameterValue[{i}]",
                f"no adjustment (0) expected, got {value:g}",
            )
    shape = (node.count("m_nLines"), node.count("m_nSamples"))
    centre_s = node.number("m_centerEphemerisTime")
    epoch = ephemeris_epoch(centre_s)
    timing = line_timing(
        node,
        epoch,
        node.array("m_intTimeLines"),
        node.array("m_intTimeStartTimes"),
        node.array("m_intTimes"),
        ("m_intTimeLines", "m_intTimeStartTimes", "m_intTimes"),
        shape[0],
    )
    order = 4 if node.number("m_platformFlag", 1.0) == 0 else 8
    position = _table(node, "m_positions", "m_numPositions", 3)
    quaternion = _table(node, "m_quaternions", "m_numQuaternions", 4)
    ephemeris = Ephemeris(
        epoch, _curve(node, "m_t0Ephem", "m_dtEphem", "m_positions", position, order)
    )
    times = np.arange(len(quaternion), dtype=np.float64)
    try:
        continuous = continuous_unit_quaternions(times, quaternion)
    except ArgumentError as error:
        node.refuse("m_quaternions", str(error))
    attitude = Attitude(
        epoch,
        QuaternionCurve(_curve(node, "m_t0Quat", "m_dtQuat", "m_quaternions", continuous, order)),
    )
    timed = centre_s != 0.0 or node.number("m_startingEphemerisTime", 0.0) != 0.0

    def build(camera: LineCamera) -> LineScanner:
        return LineScanner(
            node.path,
            camera,
            ephemeris,
            attitude,
            (node.number("m_majorAxis"), node.number("m_minorAxis")),
            (node.number("m_minElevation"), node.number("m_maxElevation")),
            _sensor(node.text("m_platformIdentifier", ""), node.text("m_sensorIdentifier", "")),
            epoch + float(timing.time_s(0.0)) if timed else None,
        )

    return facing_the_body(build, shape, timing, _focal_plane(node), _undistort(node))


def _table(node: JsonNode, key: str, count_key: str, columns: int) -> FloatArray:
    values = node.array(key)
    if len(values) % columns or len(values) < 2 * columns:
        node.refuse(
            key, f"a multiple of {columns} numbers, two rows or more, expected; got {len(values)}"
        )
    if node.has(count_key) and node.number(count_key) != len(values):
        node.refuse(
            count_key,
            f"{len(values)} expected, as many as {key} has; got {node.number(count_key):g}",
        )
    return values.reshape(-1, columns)


def _curve(
    node: JsonNode, start_key: str, step_key: str, key: str, values: FloatArray, order: int
) -> CsmLagrangeCurve:
    start_s, step_s = node.number(start_key), node.number(step_key)
    if step_s <= 0:
        node.refuse(step_key, f"a positive time step expected, got {step_s:g}")
    try:
        return CsmLagrangeCurve(start_s, step_s, values, order)
    except ArgumentError as error:
        node.refuse(key, str(error))


def _focal_plane(node: JsonNode) -> FocalPlane:
    z = node.number("m_zDirection", 1.0)
    if z not in (1.0, -1.0):
        node.refuse("m_zDirection", f"1 or -1 expected, got {z:g}")
    try:
        plane = FocalPlane.from_affine(
            node.array("m_iTransS", rows=3),
            node.array("m_iTransL", rows=3),
            (node.number("m_detectorLineOrigin"), node.number("m_detectorSampleOrigin")),
            (node.number("m_startingDetectorLine"), node.number("m_startingDetectorSample")),
            node.number("m_detectorSampleSumming"),
            node.number("m_focalLength"),
        )
    except ArgumentError as error:
        node.refuse("m_iTransS, m_iTransL, m_focalLength", str(error))
    return FocalPlane(plane.origin, plane.step, plane.focal_length, (z, z))


def _undistort(node: JsonNode) -> Callable[[FocalPlane], Directions]:
    kind = node.number("m_distortionType", 0.0)
    if kind not in (RADIAL, KAGUYA):
        known = int(kind) if kind == int(kind) and 0 <= kind < len(DISTORTIONS) else None
        raise UnsupportedError(
            node.path,
            "m_distortionType",
            f"0 (radial) or 2 (kaguyalism) expected, got {kind:g}"
            + (f" ({DISTORTIONS[known]})" if known is not None else ""),
        )
    if kind == RADIAL:
        coefficients = node.array("m_opticalDistCoeffs", rows=3)
    else:
        coefficients = node.array("m_opticalDistCoeffs", rows=10)

    def undistort(plane: FocalPlane) -> Directions:
        try:
            if kind == RADIAL:
                return plane.radial(coefficients)
            return plane.cubic_in_radius(coefficients)
        except ArgumentError as error:
            node.refuse("m_opticalDistCoeffs", str(error))

    return undistort


def line_timing(
    node: JsonNode,
    epoch: Epoch,
    first_lines: FloatArray,
    start_s: FloatArray,
    step_s: FloatArray,
    keys: tuple[str, str, str],
    lines: int,
) -> LineTiming:
    """Line times t(L) = start + step (L − first + 0.5) of CSM line L = our line + 0.5.

    One segment is a constant rate; several make a table. CSM switches segments at L = first,
    where the time is start + step / 2; ASP chains the start times, which hold half a line
    earlier, so that its times jump there by half the change of the step. The knots lie where
    the times fit together best; a jump above `MAX_TIME_JUMP_LINES` is refused.
    """
    count = len(first_lines)
    if count == 0:
        node.refuse(keys[0], "at least one entry expected")
    for key, values in zip(keys[1:], (start_s, step_s), strict=True):
        if len(values) != count:
            node.refuse(key, f"{count} entries expected, as in {keys[0]}; got {len(values)}")
    if np.any(step_s == 0) or np.any(np.sign(step_s) != np.sign(step_s[0])):
        node.refuse(keys[2], "line times other than 0, all of one sign, expected")
    if np.any(np.diff(first_lines) <= 0):
        node.refuse(keys[0], "strictly increasing lines expected")
    if count == 1:
        first_s = float(start_s[0] - (first_lines[0] - 1.0) * step_s[0])
        return ConstantLineRate(epoch, first_s, float(step_s[0]))
    jumps = []
    for later in (0.5, 0.0):
        met = start_s[:-1] + step_s[:-1] * (np.diff(first_lines) + later)
        jumps.append(np.abs(start_s[1:] + later * step_s[1:] - met) / np.abs(step_s[:-1]))
    later, jump = min(zip((0.5, 0.0), jumps, strict=True), key=lambda pair: float(pair[1].max()))
    worst = int(np.argmax(jump))
    if jump[worst] > MAX_TIME_JUMP_LINES:
        raise UnsupportedError(
            node.path,
            f"{keys[1]}[{worst + 1}]",
            f"continuous line times expected, there is a jump of {jump[worst]:.3g} lines",
        )
    knots = first_lines - 1.0 + later
    last = max(knots[-1] + 1.0, float(lines))
    rows = np.append(knots, last)
    times = np.append(
        start_s + later * step_s, start_s[-1] + step_s[-1] * (last - knots[-1] + later)
    )
    try:
        return LineTimeTable(epoch, rows, times)
    except ArgumentError as error:
        node.refuse(keys[1], str(error))


def _sensor(platform: str, sensor: str) -> str:
    return " ".join(part for part in (platform, sensor) if part) or "CSM line scanner"
