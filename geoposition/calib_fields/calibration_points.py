"""What a calibration measures with: matches by scene, without vibrations, weighted by scatter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FloatArray
from geoposition.calib_fields.calibration import CalibrationScene
from geoposition.calib_fields.estimates import LEAST_POINTS
from geoposition.calib_fields.evaluate import spectrum_of, times_of
from geoposition.calib_fields.profiles import SpectralLine
from geoposition.pushbroom import PushbroomModel

_LEAST_SIGMA_PX: Final = 0.005
_NMAD: Final = 1.4826022185056018


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Points (n) of one scene: ground, where the image shows them, and how well that is known."""

    ground: FloatArray
    image_px: FloatArray
    covariance_px2: FloatArray


def known_points(scene: CalibrationScene) -> BoolArray:
    """Which matches of a scene count (n,)."""
    m = scene.matches
    result: BoolArray = m.used & np.isfinite(m.error_px).all(axis=1)
    return result


def measurements(scene: CalibrationScene) -> Measured:
    """Return the matches of a scene; patches that share pixels count as so many fewer."""
    rows = known_points(scene)
    m = scene.matches
    covariance = m.covariance_px2[rows] + _LEAST_SIGMA_PX**2 * np.eye(2)
    return Measured(m.ground[rows], m.image_px[rows], m.dependence * covariance)


def second_look(
    scene: CalibrationScene, own: Measured, model: PushbroomModel, good: BoolArray
) -> tuple[Measured, tuple[SpectralLine, ...]]:
    """Measurements without the vibrations found, weighted by the scatter that is left."""
    place = model.ground_to_image(own.ground).image_px
    residual = own.image_px - place
    lines: tuple[SpectralLine, ...] = ()
    if good.sum() >= LEAST_POINTS:
        lines = spectrum_of(scene.matches, model, place[good], residual[good]).lines
    time, _, _ = times_of(model, place[:, 0])
    time = time - 0.5 * (time[good].min() + time[good].max())
    moved = sum((line.measured(time) for line in lines), np.zeros_like(residual))
    left = residual[good] - moved[good]
    scatter = (_NMAD * np.median(np.abs(left - np.median(left, axis=0)), axis=0)) ** 2
    dependence = scene.matches.dependence
    stated = np.diagonal(own.covariance_px2[good], axis1=1, axis2=2).mean(axis=0) / dependence
    more = np.maximum(scatter - stated, 0.0)
    covariance = own.covariance_px2 + dependence * np.diag(more)
    return replace(own, image_px=own.image_px - moved, covariance_px2=covariance), lines
