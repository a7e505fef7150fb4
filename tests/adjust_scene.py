"""A ZY-3-like pair for adjustment tests: forward and backward camera, control, matches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from geoposition.adjust import Block, adjusted_models, attitude_bias
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.flags import Flag
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.sensor_model import SensorModel
from geoposition.sensors.simulate import SceneOptions, simulate_scene, zy3_cameras

ARCSEC = np.pi / 180.0 / 3600.0
NOISE_PX = 0.3
GPS_M = 0.05


@cache
def pair(seams: bool = True) -> tuple[SensorModel, SensorModel]:
    """Forward and backward model without any error; without `seams` as an RPC can follow them."""
    still = SceneOptions(
        jitter_arcsec=(0.0, 0.0, 0.0),
        drift_arcsec=0.0,
        star_noise_arcsec=(0.0, 0.0, 0.0),
        gps_sigma_m=0.0,
        mounting_bias_arcsec=0.0,
    )
    forward, _, backward = zy3_cameras()
    if not seams:
        level = {"ccd_offset_px": (0.0,), "ccd_rotation_rad": (0.0,)}
        forward, backward = replace(forward, **level), replace(backward, **level)
    scene = simulate_scene(still, 1, (forward, backward))
    return scene.true["forward"], scene.true["backward"]


def attitude_blocks(sigma_arcsec: float = 10.0, degree: int = 0) -> list[Block]:
    return [
        attitude_bias(name, pair(), [image], degree=degree, sigma_rad=sigma_arcsec * ARCSEC)
        for image, name in enumerate(("forward", "backward"))
    ]


def common_ground(n: int, seed: int = 0) -> np.ndarray:
    """Ground points (n, 3) that both images show."""
    rng = np.random.default_rng(seed)
    first, second = pair()
    image = rng.uniform(500.0, np.array(first.shape) - 500.0, (2 * n + 20, 2))
    ground = first.image_to_ground(image, rng.uniform(500.0, 1500.0, len(image))).geodetic
    return ground[second.ground_to_image(ground).flag == Flag.OK][:n]


def measured(
    models: Sequence[SensorModel],
    ground: np.ndarray,
    rng: np.random.Generator,
    noise_px: float = NOISE_PX,
) -> list[np.ndarray]:
    """Image points of `ground` in each model, with noise."""
    return [
        model.ground_to_image(ground).image_px + rng.normal(0.0, noise_px, (len(ground), 2))
        for model in models
    ]


def control_points(
    ground: np.ndarray, images: list[np.ndarray], sigma_m: float = GPS_M, prefix: str = "p"
) -> ControlPoints:
    ids = [f"{prefix}{i}" for i in range(len(ground))]
    ties = TiePoints.of_pair(images[0], images[1], ids=ids)
    return ControlPoints(np.array(ids), ground, diagonal_covariance(sigma_m, len(ids), 3), ties)


def moved_enu(ground: np.ndarray, offset_enu_m: np.ndarray) -> np.ndarray:
    step = np.einsum("nij,nj->ni", enu_axes(ground), offset_enu_m)
    return ecef_to_geodetic(geodetic_to_ecef(ground) + step)


@dataclass(frozen=True)
class Case:
    """One draw: true unknowns, true models, and what was measured."""

    theta: np.ndarray
    truth: tuple[SensorModel, ...]
    control: ControlPoints


def draw(seed: int, ground: np.ndarray, blocks: list[Block], seams: bool = True) -> Case:
    """Unknowns drawn from their priors, and noisy control measured with the true models."""
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=sum(len(b) for b in blocks))
    theta *= np.concatenate([b.prior_sigma for b in blocks])
    truth = adjusted_models(pair(seams), blocks, theta)
    images = measured(truth, ground, rng)
    known = moved_enu(ground, rng.normal(0.0, GPS_M, ground.shape))
    return Case(theta, truth, control_points(known, images))
