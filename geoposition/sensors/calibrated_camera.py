"""A calibrated camera as a line camera: polynomials stay polynomials, so that files hold them."""

from __future__ import annotations

import numpy as np

from geoposition.adjust.corrected_model import CorrectedCamera, LookCorrection
from geoposition.arrays import FloatArray
from geoposition.camera import Camera
from geoposition.sensors.directions import Directions, PolynomialDirections, TableDirections
from geoposition.sensors.line_camera import Ccd, LineCamera, Mounting


def line_camera(camera: Camera) -> Camera:
    """Return `camera` as a `LineCamera` of polynomials where its directions are polynomials.

    Corrected polynomials of tangents (and straight lines between two samples) become polynomials
    over the CCD's own samples from −1 to 1, as P 10 has them. Other cameras are returned as they
    are: a writer tabulates them.
    """
    if not isinstance(camera, CorrectedCamera) or not isinstance(camera.base, LineCamera):
        return camera
    ccds = []
    for number, ccd in enumerate(camera.base.ccds):
        own = camera.detectors[number]
        looks = [look for look in camera.looks if look.detector in (None, number)]
        sums = _polynomials(ccd.directions, looks, (own.first_sample, own.last_sample))
        if sums is None:
            return camera
        ccds.append(Ccd(ccd.samples, sums))
    mounting = Mounting(camera.R_body_camera, camera.lever_arm_body_m)
    return LineCamera(camera.shape[0], camera.timing, tuple(ccds), mounting)


def _polynomials(
    base: Directions, looks: list[LookCorrection], ends: tuple[float, float]
) -> PolynomialDirections | None:
    middle, half = 0.5 * (ends[0] + ends[1]), max(0.5 * (ends[1] - ends[0]), 0.5)
    if isinstance(base, PolynomialDirections) and not base.angles:
        inner = np.polynomial.Polynomial([(middle - base.offset) / base.scale, half / base.scale])
        x, y = (_composed(table, inner) for table in (base.x_coefficients, base.y_coefficients))
    elif isinstance(base, TableDirections) and len(base.samples) == 2:
        at = base.tangents(np.array([middle - half, middle + half]))
        x, y = (_line(at[:, k]) for k in (0, 1))
    else:
        return None
    for look in looks:
        low, high = look.ends
        span = max(0.5 * (high - low), 0.5)
        inner = np.polynomial.Polynomial([(middle - 0.5 * (low + high)) / span, half / span])
        added = [_composed(look.tangents_rad[:, k], inner) for k in (0, 1)]
        x, y = (_sum(a, b) for a, b in zip((x, y), added, strict=True))
    return PolynomialDirections(x, y, middle, half)


def _composed(coefficients: FloatArray, inner: np.polynomial.Polynomial) -> FloatArray:
    return np.asarray(np.polynomial.Polynomial(coefficients)(inner).coef, dtype=np.float64)


def _sum(first: FloatArray, second: FloatArray) -> FloatArray:
    result: FloatArray = np.zeros(max(len(first), len(second)))
    result[: len(first)] += first
    result[: len(second)] += second
    return result


def _line(ends: FloatArray) -> FloatArray:
    return np.array([0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])], dtype=np.float64)
