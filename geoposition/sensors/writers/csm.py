"""Write a rigorous model as a CSM line scanner state that ISIS and ASP load.

CSM knows straight rays only: position and rotation by Lagrange interpolation on equal time steps,
one focal plane, no aberration and no refraction. So the state holds our rays as they are at one
height (`height_m`): positions are the perspective centres, quaternions carry the detector's mean
directions onto the rays. Four things remain, and `CsmReport` states them as measured on the
scene, its edges included:

- between the tables' samples, kept below `tolerance_rad` up to 65,536 steps;
- aberration stretches the line of sight's fan by the component of v / c along it, 2.5e-5 at the
  most, and that component changes along the image as the satellite turns, which no rigid camera
  follows: at the ends of a line 4e-10 to 1.1e-9 rad for the WorldViews tried, 0.001 pixel and
  below 1 mm on the ground. Both are part of `max_angle_rad`;
- refraction and light time depend on the height: at the ends of the model's height range the
  straight rays miss ours by `max_shift_m`;
- a detector of several CCDs, or of a curve that no cubic follows, is missed by
  `max_angle_rad`; above `MAX_MISFIT_PX` pixels writing is refused.

Curved detectors are written as distortion 2 (kaguyalism), a cubic in the distance from an origin
put beyond the line's end; straight ones as distortion 0 without coefficients.

*Source.* Keys and formulas: usgscsm (public domain, DOI-USGS), `replaceModelState`,
`getModelState`, `updateState`; the model's name as first line is what ASP asks for.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.camera import LineTiming
from geoposition.constants import WGS84_A_M, WGS84_B_M
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import GeometryError, UnsupportedError
from geoposition.flags import has_result
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.readers.csm_interpolation import CsmLagrangeCurve
from geoposition.sensors.readers.csm_json import LINE_SCANNER, JsonNode
from geoposition.sensors.readers.csm_scanner import LineScanner
from geoposition.sensors.readers.csm_state import J2000_TT_S, KAGUYA, RADIAL, scanner_from_state
from geoposition.sensors.writers.atomic import files_whole
from geoposition.sensors.writers.csm_bake import Baked, bake, covered_lines
from geoposition.timescale import Epoch

MAX_MISFIT_PX = 0.1
"""A state that misses the model's directions by more is not written."""

_PARAMETERS = 16
_REAL = 2
"""CSM's parameter type of estimated quantities."""

_CHECK_LINES = 1025
_CHECK_SAMPLES = 17


@dataclass(frozen=True, slots=True)
class CsmReport:
    """What was written, and how far its rays are from the model's.

    `max_angle_rad`, `max_angle_px` and `max_centre_m` hold at `height_m`; `max_shift_m` is the
    ground distance at the ends of the model's height range.
    """

    path: Path
    height_m: float
    positions: int
    quaternions: int
    cubic_detector: bool
    max_angle_rad: float
    max_angle_px: float
    max_centre_m: float
    max_shift_m: float


def write_csm(
    model: PushbroomModel,
    path: str | Path,
    *,
    height_m: float | None = None,
    sensor: str = "",
    image: str = "",
    tolerance_rad: float = 1e-10,
) -> CsmReport:
    """Write `model` to `path` as a line scanner state, whole or not at all.

    `height_m`, the middle of the model's height range unless given, is where the rays are exact.
    `tolerance_rad` bounds what the interpolation of the attitude may miss. `sensor` and `image`
    are names for people. Raises `UnsupportedError` where CSM's focal plane cannot hold the
    camera, `GeometryError` where the model has no rays at its own edges.
    """
    path = Path(path)
    low, high = model.height_range_m
    height = 0.5 * (low + high) if height_m is None else float(height_m)
    baked = bake(model, height, tolerance_rad, tolerance_m=5e-6)
    state = _state(model, baked, height, sensor, image)
    # One key a line, as one can still read it; json's own indenting is slow on long lists.
    keys = (f'"{key}": {json.dumps(state[key], allow_nan=False)}' for key in sorted(state))
    text = "{\n" + ",\n".join(keys) + "\n}"
    scanner = scanner_from_state(JsonNode(path, "", json.loads(text)))
    report = _report(model, scanner, baked, path, height)
    # Coarse interpolation is the caller's wish, a camera that does not fit is not.
    coarse = baked.attitude_error_rad * report.max_angle_px / report.max_angle_rad
    if report.max_angle_px > MAX_MISFIT_PX + 2.0 * coarse:
        raise UnsupportedError(
            path,
            "focal plane",
            f"a camera that one straight or cubic line of detectors holds expected, this one is "
            f"missed by {report.max_angle_px:.3g} px",
        )
    files_whole({path: f"{LINE_SCANNER}\n{text}\n"})
    return report


def _state(
    model: PushbroomModel, baked: Baked, height_m: float, sensor: str, image: str
) -> dict[str, Any]:
    """Build the JSON object."""
    lines, samples = model.shape
    timing = model.camera.timing
    middle_s = float(timing.time_s(0.5 * (lines - 1)))
    centre_epoch = Epoch((timing.epoch + middle_s).tai_s)
    shift_s = timing.epoch - centre_epoch
    first_lines, start_s, step_s = _line_times(timing, lines)
    centre_s = centre_epoch - Epoch.from_tt(J2000_TT_S)
    gsd_m, flying_height_m, reference = _reference(model, height_m)
    full_s = abs(float(timing.time_s(lines - 0.5) - timing.time_s(-0.5)))
    variances = np.repeat([1.0, 0.5, 1.0, 0.5, 0.25, 1.0], [3, 3, 3, 3, 3, 1]) * gsd_m**2
    position, quaternion = baked.position, baked.quaternion
    state = {
        "m_modelName": LINE_SCANNER,
        "m_imageIdentifier": image,
        "m_sensorName": "USGSAstroLineScanner",
        "m_platformName": "",
        "m_platformIdentifier": "",
        "m_sensorIdentifier": sensor,
        "m_nLines": lines,
        "m_nSamples": samples,
        "m_platformFlag": 1,
        "m_ikCode": 0,
        "m_intTimeLines": first_lines.tolist(),
        "m_intTimeStartTimes": (start_s + shift_s).tolist(),
        "m_intTimes": step_s.tolist(),
        "m_startingEphemerisTime": centre_s + shift_s + float(timing.time_s(0.0)),
        "m_centerEphemerisTime": centre_s,
        "m_majorAxis": WGS84_A_M,
        "m_minorAxis": WGS84_B_M,
        "m_minElevation": float(model.height_range_m[0]),
        "m_maxElevation": float(model.height_range_m[1]),
        "m_t0Ephem": position.start_s + shift_s,
        "m_dtEphem": position.step_s,
        "m_numPositions": position.values.size,
        "m_positions": position.values.ravel().tolist(),
        "m_velocities": position.rate(_times(position)).ravel().tolist(),
        "m_t0Quat": quaternion.start_s + shift_s,
        "m_dtQuat": quaternion.step_s,
        "m_numQuaternions": quaternion.values.size,
        "m_quaternions": quaternion.values.ravel().tolist(),
        "m_currentParameterValue": [0.0] * _PARAMETERS,
        "m_parameterType": [_REAL] * _PARAMETERS,
        "m_covariance": np.diag(variances).ravel().tolist(),
        "m_referencePointXyz": reference.tolist(),
        "m_gsd": gsd_m,
        "m_flyingHeight": flying_height_m,
        "m_halfSwath": 0.5 * gsd_m * samples,
        "m_halfTime": 0.5 * full_s,
        "m_sunPosition": [0.0, 0.0, 0.0],
        "m_sunVelocity": [0.0, 0.0, 0.0],
        "m_logFile": "",
    }
    return state | _focal_plane(model, baked, height_m)


def _times(curve: CsmLagrangeCurve) -> FloatArray:
    times: FloatArray = np.clip(curve.knots_s, *curve.span_s)
    return times


def _line_times(timing: LineTiming, lines: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """CSM's segments: t(L) = start + step (L − first + 0.5) for CSM lines L >= first.

    CSM changes segments at L = first, so a knot at our line r has first = r + 0.5 and a start
    half a step before the knot's time. The first segment, also valid before it, starts at line 0.
    """
    knots = np.asarray(timing.knots_line, dtype=np.float64)
    rows = np.concatenate([[0.0], knots[(knots > 0.0) & (knots < lines - 0.5)]])
    ends = np.append(rows[1:], rows[-1] + 1.0)
    times, end_times = timing.time_s(rows), timing.time_s(ends)
    step = (end_times - times) / (ends - rows)
    if len(rows) == 1 and lines > 2:
        # One rate: the longest baseline gives it best.
        step = (timing.time_s(np.array([lines - 1.0])) - times) / (lines - 1)
    return rows + 0.5, times - 0.5 * step, step


def _reference(model: PushbroomModel, height_m: float) -> tuple[float, float, FloatArray]:
    """Ground sample distance and flying height, metres, and ECEF point of the image's centre."""
    lines, samples = model.shape
    centre = np.array([0.5 * (lines - 1), 0.5 * (samples - 1)])
    ground = model.image_to_ground([centre, centre + 0.5], height_m)
    if not np.all(has_result(ground.flag)):
        raise GeometryError("CSM state: the image's centre does not meet the ground")
    point, beside = geodetic_to_ecef(ground.geodetic)
    gsd_m = float(np.linalg.norm(beside - point)) * 2 / math.sqrt(2.0)
    origin = model.rays(centre, height_m).origin_ecef_m
    return gsd_m, float(np.linalg.norm(origin - point)), point


def _focal_plane(model: PushbroomModel, baked: Baked, height_m: float) -> dict[str, Any]:
    """Focal plane in pixels: its unit is the angle of one sample.

    The transform to lines is such that a ground point seen one detector line off was, or will
    be, imaged one line away: CSM's ground-to-image steps by it.
    """
    detector = baked.detector
    slope = np.array([detector.x[1], detector.y[1]])
    focal = 1.0 / float(np.linalg.norm(slope))
    per_sample = slope * focal
    constant = np.array([detector.x[0], detector.y[0]]) * focal
    cubic = len(detector.x) > 2
    # Distortion 2 counts from the focal plane's origin: the constant goes to its coefficients.
    origin = np.zeros(2) if cubic else constant
    matrix = np.linalg.inv(np.stack([per_sample, _per_line(model, baked, height_m, focal)], axis=1))
    offset = matrix @ (origin - per_sample * detector.origin)
    plane = {
        "m_focalLength": focal,
        "m_zDirection": 1.0,
        "m_iTransS": [0.5 - offset[0], *matrix[0].tolist()],
        "m_iTransL": [-offset[1], *matrix[1].tolist()],
        "m_detectorSampleOrigin": 0.0,
        "m_detectorLineOrigin": 0.0,
        "m_startingDetectorSample": 0.0,
        "m_startingDetectorLine": 0.0,
        "m_detectorSampleSumming": 1.0,
        "m_detectorLineSumming": 1.0,
        "m_distortionType": KAGUYA if cubic else RADIAL,
        "m_opticalDistCoeffs": [0.0, 0.0, 0.0],
    }
    if cubic:
        x, y = detector.x * focal, detector.y * focal
        # Coefficients: boresight, then constant, r, r^2, r^3; r is a sample's distance.
        plane["m_opticalDistCoeffs"] = [0.0, x[0], 0.0, x[2], x[3], 0.0, y[0], 0.0, y[2], y[3]]
    return plane


def _per_line(model: PushbroomModel, baked: Baked, height_m: float, focal: float) -> FloatArray:
    """Where the ground of the next line appears in the focal plane, relative to this line's."""
    samples = model.shape[1]
    middle = 0.5 * (samples - 1)
    first, last = covered_lines(model, height_m)
    pair = np.array([[first, middle], [min(first + 1.0, last), middle]])
    ground = geodetic_to_ecef(model.image_to_ground(pair, height_m).geodetic)
    origin = model.rays(pair[0], height_m).origin_ecef_m
    camera = model.camera
    time = camera.timing.time_s(np.array([first])) + (camera.timing.epoch - model.attitude.epoch)
    R_ecef_camera = (
        model.attitude.rotation(np.clip(time, *model.attitude.span_s)) * camera.R_body_camera
    )
    seen = R_ecef_camera.inv().apply(ground - origin)
    tangents = focal * seen[:, :2] / seen[:, 2:]
    step: FloatArray = (tangents[1] - tangents[0]) / (pair[1, 0] - pair[0, 0])
    across = np.array([-baked.detector.y[1], baked.detector.x[1]]) * focal
    if abs(float(step @ across)) < 1e-3:  # no scan to speak of: any line axis will do
        return across
    return step


def _report(
    model: PushbroomModel, scanner: LineScanner, baked: Baked, path: Path, height_m: float
) -> CsmReport:
    """Compare the state, as read back, with the model on a grid over the scene and its edges."""
    first, last = covered_lines(model, height_m)
    samples = model.shape[1]
    # Irrational steps: no resonance with the tables.
    inner = (np.arange(1, _CHECK_LINES) * (math.sqrt(5) - 1) / 2) % 1.0
    line = first + (last - first) * np.concatenate([[0.0, 1.0], inner])
    sample = np.linspace(-0.5, samples - 0.5, _CHECK_SAMPLES)
    grid = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1).reshape(-1, 2)
    centre, direction = scanner.rays(grid)
    rays = model.rays(grid, height_m)
    angle = np.linalg.norm(np.cross(rays.direction_ecef, direction), axis=-1)
    off = np.linalg.norm(rays.origin_ecef_m - centre, axis=-1)
    shift = 0.0
    for height in model.height_range_m:
        ground = model.image_to_ground(grid, height)
        to_point = geodetic_to_ecef(ground.geodetic) - centre
        miss = np.linalg.norm(np.cross(to_point, direction), axis=-1)
        shift = max(shift, float(np.max(miss[has_result(ground.flag)], initial=0.0)))
    known = has_result(rays.flag)
    pixel_rad = math.hypot(baked.detector.x[1], baked.detector.y[1])
    worst = max(float(np.max(angle[known])), baked.attitude_error_rad)
    return CsmReport(
        path=path,
        height_m=height_m,
        positions=len(baked.position.values),
        quaternions=len(baked.quaternion.values),
        cubic_detector=len(baked.detector.x) > 2,
        max_angle_rad=worst,
        max_angle_px=worst / pixel_rad,
        max_centre_m=float(np.max(off[known])),
        max_shift_m=shift,
    )
