"""Any push-broom model as straight rays of one rigid camera on equal time steps: CSM's form.

What bends our rays (aberration, light time, refraction at one height) is put into the attitude,
as far as a rotation of the whole line can hold it, and the mean rest into the directions of the
detector. What is left is the change of that rest along the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.readers.csm_interpolation import CsmLagrangeCurve

PADS = 4
"""Samples beyond either end, so that the image lies within full stencils of 8."""

_FIT_SAMPLES = 9
_FIT_LINES = 64
_FIRST_CELLS = 16
MAX_CELLS = 2**16
_LINEAR_TOLERANCE_RAD = 1e-11


@dataclass(frozen=True, slots=True)
class Detector:
    """Tangents of the line: polynomials `x`, `y`, ascending, in (sample − `origin`).

    `misfit_rad` is what the polynomials miss of the mean directions at the fitted samples.
    """

    x: FloatArray
    y: FloatArray
    origin: float
    misfit_rad: float

    def directions(self, sample: FloatArray) -> FloatArray:
        """Directions (..., 3) in the camera frame, of unit length."""
        s = np.asarray(sample, dtype=np.float64) - self.origin
        polyval = np.polynomial.polynomial.polyval
        d = np.stack([polyval(s, self.x), polyval(s, self.y), np.ones_like(s)], axis=-1)
        result: FloatArray = d / np.linalg.norm(d, axis=-1, keepdims=True)
        return result


@dataclass(frozen=True, slots=True)
class Baked:
    """Curves over seconds from the timing's epoch, and the detector.

    `attitude_error_rad` is the largest interpolation error between the samples of `quaternion`.
    """

    position: CsmLagrangeCurve
    quaternion: CsmLagrangeCurve
    detector: Detector
    attitude_error_rad: float


def bake(model: PushbroomModel, height_m: float, tolerance_rad: float, tolerance_m: float) -> Baked:
    """Bake the rays of `model` at `height_m`; tables are refined until both tolerances hold."""
    first, last = covered_lines(model, height_m)
    R_ecef_camera = _Attitude(model, height_m, np.linspace(first, last, _FIT_LINES))
    times = np.sort(model.camera.timing.time_s(np.array([first, last])))
    span = (float(times[0]), float(times[1]))

    def centres(time: FloatArray) -> FloatArray:
        lines = model.camera.timing.line_at(time)
        middle = np.full_like(lines, 0.5 * (model.shape[1] - 1))
        return model.rays(np.stack([lines, middle], axis=-1), height_m).origin_ecef_m

    position, _ = _refined(centres, span, tolerance_m)
    # A quaternion's components hold half the angle.
    quaternion, error = _refined(R_ecef_camera.quaternions, span, 0.5 * tolerance_rad)
    return Baked(position, quaternion, R_ecef_camera.detector, 2.0 * error)


def covered_lines(model: PushbroomModel, height_m: float) -> tuple[float, float]:
    """First and last line to write: the image to its edges, or to its outer pixels' centres."""
    lines, samples = model.shape
    for edge in (0.5, 0.0):
        ends = np.array([[-edge, 0.0], [lines - 1 + edge, samples - 1.0]])
        if np.all(has_result(model.rays(ends, height_m).flag)) and lines - 1 + 2 * edge > 0:
            return -edge, lines - 1 + edge
    raise GeometryError("CSM state: the model has no rays at the first or the last line")


class _Attitude:
    """Rotations camera to ECEF that carry the detector's directions onto the model's rays."""

    def __init__(self, model: PushbroomModel, height_m: float, lines: FloatArray):
        samples = model.shape[1]
        angle = np.pi * np.arange(_FIT_SAMPLES) / (_FIT_SAMPLES - 1)
        self._model, self._height_m = model, height_m
        self._samples = 0.5 * (samples - 1) - 0.5 * samples * np.cos(angle)
        start = self._bare(lines)
        rays = self._rays(lines)
        directions = np.mean(_seen(start, rays), axis=0)
        for _ in range(6):
            directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
            start = _turned_onto(start, directions, rays)
            directions = np.mean(_seen(start, rays), axis=0)
        self.detector = _detector(self._samples, directions[:, :2] / directions[:, 2:], samples)
        self._directions = self.detector.directions(self._samples)

    def _bare(self, lines: FloatArray) -> Rotation:
        """R_ecef_camera without corrections; held at the ends of the attitude's span."""
        camera, attitude = self._model.camera, self._model.attitude
        time = camera.timing.time_s(lines) + (camera.timing.epoch - attitude.epoch)
        return attitude.rotation(np.clip(time, *attitude.span_s)) * camera.R_body_camera

    def _rays(self, lines: FloatArray) -> FloatArray:
        """Rays (n, samples, 3); NaN where the model has none."""
        grid = np.stack(np.broadcast_arrays(lines[:, None], self._samples), axis=-1)
        return self._model.rays(grid, self._height_m).direction_ecef

    def quaternions(self, time: FloatArray) -> FloatArray:
        """Quaternions (n, 4), scalar last, at `time` (n,); NaN where the model has no rays."""
        lines = self._model.camera.timing.line_at(time)
        rays = self._rays(lines)
        known = np.all(np.isfinite(rays), axis=(1, 2))
        turned = self._bare(lines[known])
        for _ in range(2):
            turned = _turned_onto(turned, self._directions, rays[known])
        quats = np.full((len(time), 4), np.nan)
        known_quats = turned.as_quat()
        signs = np.sign(np.sum(known_quats[1:] * known_quats[:-1], axis=1))
        known_quats[1:] *= np.cumprod(signs)[:, None]
        quats[known] = known_quats
        return quats


def _seen(R_ecef_camera: Rotation, rays: FloatArray) -> FloatArray:
    """Rays (n, m, 3) in the camera frames (n,)."""
    seen: FloatArray = np.einsum("nji,nmj->nmi", R_ecef_camera.as_matrix(), rays)
    return seen


def _turned_onto(start: Rotation, directions: FloatArray, rays: FloatArray) -> Rotation:
    """One Gauss-Newton step of the rotations (n,) that carry `directions` (m, 3) onto `rays`."""
    seen = _seen(start, rays)
    normal = np.einsum("mi,mi->", directions, directions) * np.eye(3) - directions.T @ directions
    turn = np.sum(np.cross(directions, seen), axis=1) @ np.linalg.pinv(normal)
    return start * Rotation.from_rotvec(turn)


def _detector(samples: FloatArray, tangents: FloatArray, count: int) -> Detector:
    """Linear tangents where they are, else cubic, in the sample from `origin`."""
    for degree in (1, 3):
        # CSM's cubic is in the distance from the origin, which must lie outside the line.
        origin = 0.0 if degree == 1 else -(100.0 + 0.1 * count)
        scaled = (samples - origin) / count
        fit, *_ = np.linalg.lstsq(
            np.vander(scaled, degree + 1, increasing=True), tangents, rcond=None
        )
        misfit = np.vander(scaled, degree + 1, increasing=True) @ fit - tangents
        worst = float(np.max(np.linalg.norm(misfit, axis=-1)))
        if worst <= _LINEAR_TOLERANCE_RAD:
            break
    coefficients = fit / float(count) ** np.arange(degree + 1)[:, None]
    return Detector(coefficients[:, 0], coefficients[:, 1], origin, worst)


def _refined(
    evaluate: Callable[[FloatArray], FloatArray], span_s: tuple[float, float], tolerance: float
) -> tuple[CsmLagrangeCurve, float]:
    """Curve through `evaluate` on equal steps over `span_s`, and what its middles miss.

    Steps are halved until that is within `tolerance`, or they are `MAX_CELLS`.

    `evaluate` gives NaN where nothing is known, at the ends only.
    """
    cells = _FIRST_CELLS
    step = (span_s[1] - span_s[0]) / cells
    steps = np.arange(-PADS, cells + PADS + 1, dtype=np.float64)
    known = evaluate(span_s[0] + step * steps)
    while True:
        values = _with_ends(known)
        curve = CsmLagrangeCurve(span_s[0] - PADS * step, step, values)
        middle_s: FloatArray = span_s[0] + step * (np.arange(0.5 - PADS, cells + PADS))
        middles = evaluate(middle_s)
        if middles.shape[1] == 4:
            middles *= np.where(np.sum(middles * values[:-1], axis=1) < 0, -1.0, 1.0)[:, None]
        inside = slice(PADS, PADS + cells)
        off = curve.value(middle_s[inside]) - middles[inside]
        error = float(np.max(np.linalg.norm(off, axis=1)))
        if error <= tolerance or 2 * cells > MAX_CELLS:
            return curve, error
        half = PADS // 2
        merged = np.empty((2 * (cells + PADS) + 1, values.shape[1]))
        merged[0::2] = known[half : len(known) - half]
        merged[1::2] = middles[half : len(middles) - half]
        known, cells, step = merged, 2 * cells, 0.5 * step


def _with_ends(values: FloatArray) -> FloatArray:
    """Fill unknown rows at either end by the polynomial through the 8 known rows next to it.

    The stencils there then see one polynomial, as if they had been pushed inwards.
    """
    known = np.flatnonzero(np.all(np.isfinite(values), axis=1))
    low, high = known[0], known[-1]
    result = values.copy()
    for gap, nodes in (
        (np.arange(0, low), np.arange(low, low + 8)),
        (np.arange(high + 1, len(values)), np.arange(high - 7, high + 1)),
    ):
        for i in gap:
            weights = [np.prod([(i - m) / (n - m) for m in nodes if m != n]) for n in nodes]
            result[i] = weights @ values[nodes]
    return result
