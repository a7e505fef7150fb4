"""What a calibration gives: the camera, its curves with their deviations, checks of its worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.adjust import Adjustment
from geoposition.arrays import BoolArray, FloatArray
from geoposition.calib_fields.evaluation import Evaluation
from geoposition.calib_fields.matches import DomMatches
from geoposition.calib_fields.profiles import SpectralLine
from geoposition.camera import Camera
from geoposition.errors import ArgumentError
from geoposition.pushbroom import PushbroomModel

ARCSEC_RAD: Final = np.pi / 180.0 / 3600.0


@dataclass(frozen=True, slots=True)
class CalibrationScene:
    """One image of the camera over known ground: its model as it came, and its matches."""

    name: str
    model: PushbroomModel
    matches: DomMatches


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """What is estimated, and what is known beforehand: standard deviations, radians and metres.

    Look angles get polynomials of `degree` for each CCD; the attitude of each scene a bias of
    polynomials in time of `attitude_degree`. A wide prior of the mounting beside a narrow one of
    the attitude gives the mounting what one scene cannot tell apart. `reference_sigma_m` is the
    deviation per axis of the reference's place, a constant error of unknown direction;
    `height_sigma_m` that of the heights of single points.
    """

    degree: int = 3
    attitude_degree: int = 1
    mounting_sigma_rad: float = 3600.0 * ARCSEC_RAD
    attitude_sigma_rad: float = 20.0 * ARCSEC_RAD
    look_sigma_rad: float = 30.0 * ARCSEC_RAD
    reference_sigma_m: float = 0.0
    height_sigma_m: float = 1.0

    def __post_init__(self) -> None:
        if not 1 <= self.degree <= 5:
            raise ArgumentError(f"calibration: degree 1 to 5 expected, got {self.degree}")
        if not 0 <= self.attitude_degree <= 2:
            raise ArgumentError(
                f"calibration: attitude of degree 0 to 2 expected, got {self.attitude_degree}"
            )
        sigmas = self.mounting_sigma_rad, self.attitude_sigma_rad, self.look_sigma_rad
        if not all(0.0 < sigma < 0.1 for sigma in sigmas):
            raise ArgumentError("calibration: deviations of angles above 0 and below 0.1 rad")
        if not 0.0 < self.height_sigma_m < 1e3 or not 0.0 <= self.reference_sigma_m < 1e4:
            raise ArgumentError("calibration: deviations in metres, of heights above 0, expected")


@dataclass(frozen=True, slots=True, eq=False)
class LookCurve:
    """How the directions of one CCD changed: at `sample` (m,), in pixels, x along and y across.

    `change_px` (m, 2) is all of it, turn of the mounting and polynomials, with `sigma_px` (m, 2).
    `shape_px` is what no turn of the whole camera makes, with `shape_sigma_px`: what the scenes
    determine whatever their attitude was.
    """

    ccd: int
    sample: FloatArray
    change_px: FloatArray
    sigma_px: FloatArray
    shape_px: FloatArray
    shape_sigma_px: FloatArray


@dataclass(frozen=True, slots=True)
class SpreadCheck:
    """Points kept out of the fit: root mean square errors (line, sample), before and after.

    `stated_px` is what the matching says of itself: errors of that size are no model's.
    Vibrations found are taken out before and after.
    """

    name: str
    points: int
    before_px: tuple[float, float]
    after_px: tuple[float, float]
    stated_px: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class SceneCheck:
    """A scene kept out altogether, evaluated with the camera as it came and as calibrated."""

    name: str
    before: Evaluation
    after: Evaluation


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """One calibration, finished.

    `camera` is the first scene's with calibrated directions and mounting; the scenes' attitude
    biases are in `adjustment` alone. `vibrations` by scene are those found in the residuals and
    taken out of the measurements. `mounting_sigma_rad` (3,) holds the reference's deviation too.
    """

    options: CalibrationOptions
    scenes: tuple[CalibrationScene, ...]
    adjustment: Adjustment
    camera: Camera
    curves: tuple[LookCurve, ...]
    mounting_rad: FloatArray
    mounting_sigma_rad: FloatArray
    vibrations: tuple[tuple[SpectralLine, ...], ...]
    residual_px: tuple[FloatArray, ...]
    used: tuple[BoolArray, ...]
    points: int
    pixel_rad: float
    checks: tuple[SpreadCheck, ...]
    correlations: Mapping[str, float]
    """Largest correlations by pair of kinds: mounting with attitude, with looks, and so on."""
