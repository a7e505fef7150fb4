"""Calibration of a camera on known ground: look angles by CCD and mounting, for scenes together.

The unknowns are those of `adjust`: polynomials of the look angles for each CCD (P 10), the
mounting, and for each scene a bias of its attitude. The measurements are matches with a reference
orthophoto. What the data cannot tell apart rests on the priors and is said: a constant look angle
is a turn of the mounting, and with one scene a turn of the mounting is a bias of its attitude.

Vibrations found in the residuals of a first solution are taken out of the measurements, and the
scatter about it sets their weight in the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from geoposition.adjust import (
    Adjustment,
    Block,
    Status,
    adjust,
    adjusted_models,
    attitude_bias,
    look_angles,
    mounting,
)
from geoposition.arrays import BoolArray, FloatArray
from geoposition.calib_fields.calibration import (
    Calibration,
    CalibrationOptions,
    CalibrationScene,
    SceneCheck,
    SpreadCheck,
)
from geoposition.calib_fields.calibration_points import (
    Measured,
    known_points,
    measurements,
    second_look,
)
from geoposition.calib_fields.camera_curves import camera_curves, correlations, pixel_angle_rad
from geoposition.calib_fields.estimates import chess_board
from geoposition.calib_fields.evaluate import (
    EvaluationOptions,
    detectors_of,
    evaluate,
)
from geoposition.calib_fields.rematch import rematched
from geoposition.camera import Camera
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError, GeometryError
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.pushbroom import PushbroomModel

MOUNTING: Final = "mounting"
_POINTS_PER_TERM: Final = 4
_SAME_PX: Final = 0.005
_PLACE_SIGMA_M: Final = 1e-3
"""Ground points are where they are by definition: the matching's error is in the image."""


def calibrate(
    scenes: Sequence[CalibrationScene], options: CalibrationOptions | None = None
) -> Calibration:
    """Calibrate the camera that all `scenes` share.

    Half of each scene's points, in fields of a chess board, check a solution of the other half;
    the result is that of all points. `GeometryError` where the scenes' cameras differ in size, or
    a CCD has too few points.
    """
    options = options or CalibrationOptions()
    scenes = tuple(scenes)
    _require(scenes, options)
    models = [scene.model for scene in scenes]
    blocks = _blocks(models, options)
    measured = [measurements(scene) for scene in scenes]
    first = _solved(models, blocks, measured, options)
    weighted, vibrations = [], []
    for k, (scene, own) in enumerate(zip(scenes, measured, strict=True)):
        model = first.models[k]
        assert isinstance(model, PushbroomModel)
        own, lines = second_look(scene, own, model, _good(first, len(scenes))[k])
        weighted.append(own)
        vibrations.append(lines)
    done = _solved(models, blocks, weighted, options)
    curves = camera_curves(models[0].camera, done, options.reference_sigma_m / _height_m(models[0]))
    good = _good(done, len(scenes))
    residual = [
        own.image_px - model.ground_to_image(own.ground).image_px
        for own, model in zip(weighted, done.models, strict=True)
    ]
    return Calibration(
        options=options,
        scenes=scenes,
        adjustment=done,
        camera=_camera_of(models[0], blocks, done),
        curves=curves.looks,
        mounting_rad=curves.mounting_rad,
        mounting_sigma_rad=curves.mounting_sigma_rad,
        vibrations=tuple(vibrations),
        residual_px=tuple(residual),
        used=tuple(good),
        points=int(sum(g.sum() for g in good)),
        pixel_rad=pixel_angle_rad(models[0].camera),
        checks=_kept_out(scenes, blocks, weighted, options),
        correlations=correlations(done),
    )


def check_scene(
    scene: CalibrationScene, calibrated: PushbroomModel, options: EvaluationOptions
) -> SceneCheck:
    """Evaluate a scene that took no part, by its model as it came and with the new camera."""
    return SceneCheck(
        scene.name,
        evaluate(scene.matches, scene.model, options),
        evaluate(rematched(scene.matches, calibrated), calibrated, options),
    )


def _require(scenes: Sequence[CalibrationScene], options: CalibrationOptions) -> None:
    if not scenes:
        raise ArgumentError("calibration: one or more scenes expected")
    base = scenes[0].model.camera
    for scene in scenes[1:]:
        if not same_directions(base, scene.model.camera):
            raise GeometryError(
                f"{scene.name}: look angles or mounting differ from those of {scenes[0].name}: "
                "scenes of one camera expected"
            )
    number = np.concatenate(
        [detectors_of(scene.model, scene.matches.model_px[known_points(scene)]) for scene in scenes]
    )
    for ccd in range(len(base.detectors)):
        count, least = int(np.sum(number == ccd)), _POINTS_PER_TERM * (options.degree + 1)
        if count < least:
            raise GeometryError(
                f"calibration: CCD {ccd} has {count} matches, {least} are needed for degree "
                f"{options.degree}"
            )


def same_directions(first: Camera, second: Camera) -> bool:
    """Whether two cameras look the same way, to a few thousandths of a pixel."""
    ends = [[(d.first_sample, d.last_sample) for d in c.detectors] for c in (first, second)]
    if ends[0] != ends[1]:
        return False
    bound = _SAME_PX * pixel_angle_rad(first)
    for k, (low, high) in enumerate(ends[0]):
        sample = np.linspace(low, high, 17)
        if np.max(np.abs(first.tangents(k, sample) - second.tangents(k, sample))) > bound:
            return False
    turned = (first.R_body_camera.inv() * second.R_body_camera).magnitude()
    return bool(turned <= bound)


def _blocks(models: Sequence[PushbroomModel], options: CalibrationOptions) -> list[Block]:
    every = range(len(models))
    blocks = [mounting(MOUNTING, every, sigma_rad=options.mounting_sigma_rad)]
    blocks += [
        look_angles(
            f"ccd{k}",
            every,
            degree=options.degree,
            detector=k,
            sigma_rad=options.look_sigma_rad,
        )
        for k in range(len(models[0].camera.detectors))
    ]
    blocks += [
        attitude_bias(
            f"attitude{k + 1}",
            models,
            [k],
            degree=options.attitude_degree,
            sigma_rad=options.attitude_sigma_rad,
        )
        for k in every
    ]
    return blocks


def _solved(
    models: Sequence[PushbroomModel],
    blocks: Sequence[Block],
    measured: Sequence[Measured],
    options: CalibrationOptions,
    keep: Sequence[BoolArray] | None = None,
) -> Adjustment:
    """Adjust; of each scene's points those in `keep`, if given."""
    kept = keep or [np.ones(len(own.ground), dtype=np.bool_) for own in measured]
    product = np.repeat(np.arange(len(measured)), [int(k.sum()) for k in kept])
    ids = np.arange(len(product))
    sigma = np.array([_PLACE_SIGMA_M, _PLACE_SIGMA_M, options.height_sigma_m])

    def joined(name: str) -> FloatArray:
        return np.concatenate(
            [getattr(own, name)[k] for own, k in zip(measured, kept, strict=True)]
        )

    table = TiePoints(ids, product, joined("image_px"), joined("covariance_px2"))
    control = ControlPoints(ids, joined("ground"), diagonal_covariance(sigma, len(ids), 3), table)
    return adjust(models, blocks, control=control)


def _good(done: Adjustment, scenes: int) -> list[BoolArray]:
    """Which points of each scene the adjustment used, in their order."""
    used = done.control.status[done.control.point] == Status.USED
    return [used[done.control.product == k] for k in range(scenes)]


def _camera_of(model: PushbroomModel, blocks: Sequence[Block], done: Adjustment) -> Camera:
    """Camera of `model` with calibrated mounting and looks; the attitude stays as it is."""
    own = [block for block in blocks if block.kind in ("mounting", "look")]
    values = np.concatenate([done.block_values(block.name) for block in own])
    alone = [replace(block, images=(0,)) for block in own]
    (calibrated,) = adjusted_models([model], alone, values)
    assert isinstance(calibrated, PushbroomModel)
    return calibrated.camera


def _kept_out(
    scenes: Sequence[CalibrationScene],
    blocks: Sequence[Block],
    measured: Sequence[Measured],
    options: CalibrationOptions,
) -> tuple[SpreadCheck, ...]:
    """Solve with half of the points, and judge the other half by it."""
    held = [chess_board(own.image_px) for own in measured]
    half = _solved(
        [scene.model for scene in scenes], blocks, measured, options, [~own for own in held]
    )
    checks = []
    for scene, own, out, model in zip(scenes, measured, held, half.models, strict=True):
        errors = [
            own.image_px[out] - judge.ground_to_image(own.ground[out]).image_px
            for judge in (scene.model, model)
        ]
        stated = np.diagonal(own.covariance_px2[out], axis1=1, axis2=2).mean(axis=0)
        sizes = [_rms(error) for error in errors]
        noise = np.sqrt(stated / scene.matches.dependence)
        checks.append(
            SpreadCheck(
                scene.name, int(out.sum()), sizes[0], sizes[1], (float(noise[0]), float(noise[1]))
            )
        )
    return tuple(checks)


def _rms(error_px: FloatArray) -> tuple[float, float]:
    known = error_px[np.isfinite(error_px).all(axis=1)]
    line, sample = np.sqrt(np.mean(known**2, axis=0))
    return float(line), float(sample)


def _height_m(model: PushbroomModel) -> float:
    """Distance from the satellite to the ground in the middle of the image, metres."""
    lines, samples = model.shape
    middle = np.array([0.5 * (lines - 1.0), 0.5 * (samples - 1.0)])
    height = float(np.mean(model.height_range_m))
    ground = geodetic_to_ecef(model.image_to_ground(middle, height).geodetic)
    return float(np.linalg.norm(model.rays(middle, height).origin_ecef_m - ground))
