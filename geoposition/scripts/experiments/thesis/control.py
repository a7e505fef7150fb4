"""42 ground points, ten of them control: bias compensation and the others' errors.

Models as the ground has them (measured orbit, one of three attitudes, a mounting that is some
arcseconds off) are compensated by `adjust`; check points are intersected before and after.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from geoposition.adjust import (
    Adjustment,
    Block,
    adjust,
    attitude_bias,
    attitude_process,
    best_layout,
    predict,
    split_control,
)
from geoposition.arrays import BoolArray, FloatArray
from geoposition.attitude import Attitude
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.experiments.thesis.scene import Scene
from geoposition.scripts.experiments.thesis.telemetry import Telemetry
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.simulate import ARCSEC_RAD

POINTS: Final = 42
CONTROL: Final = 10
GPS_SIGMA_M: Final = 0.05
IMAGE_SIGMA_PX: Final = 0.3
MOUNTING_PRIOR_ARCSEC: Final = 20.0
"""What is believed of the mounting: ten times worse would change nothing."""
PROCESS_KNOTS_S: Final = 1.0

BiasModel: TypeAlias = Literal["constant", "linear", "quadratic", "process"]
BIAS_MODELS: Final[tuple[BiasModel, ...]] = ("constant", "linear", "quadratic", "process")
_DEGREE: Final[Mapping[str, int]] = {"constant": 0, "linear": 1, "quadratic": 2, "process": 0}


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Ground points (n, 3) and which of them are control."""

    ground: FloatArray
    is_control: BoolArray

    @property
    def ids(self) -> list[str]:
        """Names of all points."""
        return [f"g{k + 1:02d}" for k in range(len(self.ground))]

    @property
    def check_ids(self) -> list[str]:
        """Names of the check points."""
        return [name for name, used in zip(self.ids, self.is_control, strict=True) if not used]


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Check points' errors of one adjustment, metres.

    `enu_m`, `xyz_m` (2, n, 3): before and after; `expected_enu_m2` (3,) the mean variance that
    the adjustment states, the points' own GPS error included.
    """

    enu_m: FloatArray
    xyz_m: FloatArray
    expected_enu_m2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """RMS errors (3,) that image noise alone leaves: east, north, up and X, Y, Z, metres."""

    enu_m: FloatArray
    xyz_m: FloatArray

    @property
    def space_m(self) -> float:
        """In space."""
        return float(np.sqrt(np.sum(self.enu_m**2)))


def layout(scene: Scene, ground: FloatArray, count: int = CONTROL) -> Layout:
    """Choose the control among `ground` (n, 3): the points most useful beside each other."""
    models = list(scene.models.values())
    blocks = bias_blocks(models, list(scene.models), "constant")
    chosen, _ = best_layout(models, blocks, ground, ground, count, sigma_enu_m=GPS_SIGMA_M)
    return Layout(ground, np.isin(np.arange(len(ground)), chosen))


def bias_blocks(
    models: Sequence[PushbroomModel], names: Sequence[str], kind: BiasModel
) -> list[Block]:
    """Unknowns of one bias model, of each image its own. *Source*: T 2.8.

    "process" adds the attitude's own error, as its covariance states it, to the constant.
    """
    sigma = MOUNTING_PRIOR_ARCSEC * ARCSEC_RAD
    blocks = [
        attitude_bias(name, models, [k], degree=_DEGREE[kind], sigma_rad=sigma)
        for k, name in enumerate(names)
    ]
    if kind == "process":
        blocks += [
            attitude_process(f"{name}-attitude", models, [k], spacing_s=PROCESS_KNOTS_S)
            for k, name in enumerate(names)
        ]
    return blocks


def measured_models(scene: Scene, telemetry: Telemetry, attitude: Attitude) -> list[PushbroomModel]:
    """Models as the ground has them, in the scene's order of cameras."""
    found = []
    for name, model in scene.models.items():
        turn = telemetry.mounting_error_rad[name]
        assert isinstance(model.camera, LineCamera)
        camera = model.camera.with_parameters(
            {f"mounting_{axis}_rad": float(turn[k]) for k, axis in enumerate("xyz")}
        )
        found.append(
            replace(model, camera=camera, ephemeris=telemetry.ephemeris, attitude=attitude)
        )
    return found


def measured_points(scene: Scene, plan: Layout, random: np.random.SeedSequence) -> ControlPoints:
    """All points as GPS has them, and as they were marked in the images."""
    gps, marks = (np.random.default_rng(stream) for stream in random.spawn(2))
    known = moved(plan.ground, gps.normal(0.0, GPS_SIGMA_M, plan.ground.shape))
    ids = np.array(plan.ids)
    count = len(scene.models)
    image = [
        model.ground_to_image(plan.ground).image_px
        + marks.normal(0.0, IMAGE_SIGMA_PX, (len(ids), 2))
        for model in scene.models.values()
    ]
    ties = TiePoints(
        np.tile(ids, count), np.repeat(np.arange(count), len(ids)), np.concatenate(image)
    )
    return ControlPoints(ids, known, diagonal_covariance(GPS_SIGMA_M, len(ids), 3), ties)


def moved(geodetic: FloatArray, offset_enu_m: FloatArray) -> FloatArray:
    """Points (n, 3) moved by east, north, up (n, 3)."""
    step = np.einsum("nij,nj->ni", enu_axes(geodetic), offset_enu_m)
    return np.asarray(ecef_to_geodetic(geodetic_to_ecef(geodetic) + step))


def compensate(
    models: Sequence[PushbroomModel],
    blocks: Sequence[Block],
    points: ControlPoints,
    plan: Layout,
    ties: TiePoints | None = None,
) -> Adjustment:
    """Adjust with the control, check points kept out; all measurements are believed."""
    control, check = split_control(points, plan.check_ids)
    return adjust(
        models,
        blocks,
        control=control,
        check=check,
        ties=ties,
        control_sigma_px=IMAGE_SIGMA_PX,
        tie_sigma_px=IMAGE_SIGMA_PX,
        robust=None,
    )


def errors_of(done: Adjustment, points: ControlPoints) -> Errors:
    """Errors of the check points against their given positions."""
    rows = np.flatnonzero(np.isin(points.ids, done.check.ids))
    axes = enu_axes(points.geodetic[rows])
    enu = np.stack([done.check.error_before_enu_m, done.check.error_enu_m])
    expected = np.mean(done.check.sigma_enu_m**2, axis=0) + GPS_SIGMA_M**2
    return Errors(enu, np.einsum("nij,bnj->bni", axes, enu), expected)


def predicted(scene: Scene, plan: Layout, blocks: Sequence[Block]) -> Limit:
    """RMS errors of the check points that image noise alone leaves, attitude perfect."""
    models = list(scene.models.values())
    check = plan.ground[~plan.is_control]
    expected = predict(
        models,
        blocks,
        plan.ground[plan.is_control],
        check,
        sigma_enu_m=GPS_SIGMA_M,
        sigma_px=IMAGE_SIGMA_PX,
    )
    enu = expected.covariance_enu_m2 + GPS_SIGMA_M**2 * np.eye(3)
    axes = enu_axes(check)
    xyz = axes @ enu @ np.swapaxes(axes, 1, 2)
    return Limit(*(np.sqrt(np.mean(np.einsum("nii->ni", c), axis=0)) for c in (enu, xyz)))
