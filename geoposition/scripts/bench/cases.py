"""Our own work on known scenes, case by case; `beside` adds the peers to it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.intersect import intersect_pairs
from geoposition.locate import locate
from geoposition.rays import Rays
from geoposition.scripts.bench.measure import Case, Contender
from geoposition.scripts.bench.scenes import RigorousScene, RpcScene, image_grid
from geoposition.scripts.bench.work import RigorousWork, RpcWork, smooth_heights
from geoposition.sensor_model import GroundPoints, ImagePoints, SensorModel
from geoposition.terrain import Terrain
from geoposition.terrain.raster import RasterTerrain
from geoposition.triangulate import triangulate_pairs_weighted

OURS = "geoposition"
_EVERY = slice(None)


@dataclass(frozen=True, slots=True)
class Sizes:
    """Points per call: ours, the peers' that are compiled, and the slow ones'."""

    ours: int
    rpc: int
    compiled: int
    numpy: int
    slow: int


FULL = Sizes(ours=1_000_000, rpc=1_000_000, compiled=100_000, numpy=50_000, slow=2_000)
QUICK = Sizes(ours=20_000, rpc=40_000, compiled=4_000, numpy=2_000, slow=100)


def direct(work: RigorousWork) -> Case:
    """Image to ground at one height."""
    model = work.scene.model
    return Case(
        key="direct",
        title=f"direct, ellipsoid, {work.scene.name}",
        points=work.points,
        unit="m",
        tolerance=0.1,
        ours=Contender(
            OURS, _EVERY, lambda: model.image_to_ground(work.image_px, work.height_m), _ground
        ),
        target_mpoint_s=12.0,
        bytes_per_point=16 + 24 + 1,
    )


def inverse(work: RigorousWork) -> Case:
    """Ground to image."""
    model = work.scene.model
    return Case(
        key="inverse",
        title=f"inverse, {work.scene.name}",
        points=work.points,
        unit="px",
        tolerance=0.2,
        ours=Contender(OURS, _EVERY, lambda: model.ground_to_image(work.geodetic), _image),
        target_mpoint_s=6.0,
        bytes_per_point=24 + 16 + 1,
    )


def on_dem(work: RigorousWork, dem: Path) -> Case:
    """Image to ground on a raster."""
    scene = work.scene
    return _on_dem(scene.model, work.image_px, RasterTerrain(dem), "dem", f"on a DEM, {scene.name}")


def rpc_project(work: RpcWork, name: str) -> Case:
    """Ground to image by an RPC."""
    return Case(
        key="rpc-project",
        title=f"RPC, ground to image, {name}",
        points=work.points,
        unit="px",
        tolerance=1e-4,
        ours=Contender(OURS, _EVERY, lambda: work.model.ground_to_image(work.geodetic), _image),
        target_mpoint_s=150.0,
        bytes_per_point=24 + 16 + 1,
    )


def rpc_locate(work: RpcWork, name: str) -> Case:
    """Image to ground by an RPC, at given heights."""
    return Case(
        key="rpc-locate",
        title=f"RPC, image to ground, {name}",
        points=work.points,
        unit="m",
        tolerance=1e-2,
        ours=Contender(
            OURS, _EVERY, lambda: work.model.image_to_ground(work.image_px, work.height_m), _ground
        ),
        target_mpoint_s=20.0,
        bytes_per_point=16 + 8 + 24 + 1,
    )


def rpc_on_dem(work: RpcWork, scene: RpcScene) -> Case:
    """Image to ground by an RPC, on a raster."""
    terrain = RasterTerrain(scene.dem, scene.geoid)
    return _on_dem(scene.left, work.image_px, terrain, "rpc-dem", f"RPC on a DEM, {scene.name}")


def pair_rays(work: PairWork) -> Case:
    """Two-ray intersection, rays given."""
    rays_a, rays_b = work.sights()
    return Case(
        key="pair-rays",
        title="two-ray intersection, rays given",
        points=work.left.points,
        unit="m",
        tolerance=1e-2,
        ours=Contender(OURS, _EVERY, lambda: intersect_pairs(rays_a, rays_b), _ground),
        target_mpoint_s=5.0,
        bytes_per_point=2 * 49 + 24 + 8 + 1,
    )


def pair(work: PairWork) -> Case:
    """Two-ray intersection from matches."""
    return Case(
        key="pair",
        title=f"two-ray intersection from matches, {work.name}",
        points=work.left.points,
        unit="m",
        tolerance=0.5,
        ours=Contender(OURS, _EVERY, lambda: intersect_pairs(*work.sights()), _ground),
        target_mpoint_s=5.0,
        bytes_per_point=2 * 16 + 24 + 8 + 1,
    )


def pair_covariance(work: PairWork) -> Case:
    """Weighted two-ray intersection from matches, each point with its covariance."""
    left, right = work.left, work.right
    return Case(
        key="pair-covariance",
        title=f"the same, weighted, with covariance, {work.name}",
        points=left.points,
        unit="m",
        tolerance=0.5,
        ours=Contender(
            OURS,
            _EVERY,
            lambda: triangulate_pairs_weighted(
                left.model, right.model, left.image_px, right.image_px
            ),
            _ground,
        ),
        target_mpoint_s=3.0,
        bytes_per_point=2 * 16 + 24 + 72 + 8 + 1,
    )


@dataclass(frozen=True, slots=True)
class PairWork:
    """The same ground points in two RPCs, `middle_m` the middle of the left one's heights."""

    name: str
    left: RpcWork
    right: RpcWork
    middle_m: float

    def sights(self) -> tuple[Rays, Rays]:
        """Rays of either image."""
        return (
            self.left.model.rays(self.left.image_px, self.middle_m),
            self.right.model.rays(self.right.image_px, self.middle_m),
        )


def rigorous_work(scene: RigorousScene, points: int) -> RigorousWork:
    """Image points over the whole scene, and the ground they show at smooth heights."""
    model = scene.model
    low, high = model.height_range_m
    height_m = float(np.clip(200.0, low, high))
    image = image_grid(model.shape, points)
    heights = smooth_heights(image, height_m, height_m + 500.0)
    return RigorousWork(scene, image, height_m, model.image_to_ground(image, heights).geodetic)


def rpc_work(scene: RpcScene, points: int) -> RpcWork:
    """Image points over the left image, heights within the model's range, and the ground."""
    low, high = scene.left.height_range_m
    image = image_grid(scene.left.shape, points)
    heights = smooth_heights(image, low + 0.3 * (high - low), low + 0.7 * (high - low))
    ground = scene.left.image_to_ground(image, heights)
    return RpcWork(scene.left, image, heights, ground.geodetic)


def pair_work(scene: RpcScene, left: RpcWork) -> PairWork:
    """Match a pair: where the right image shows what the left one does."""
    other = scene.right.ground_to_image(left.geodetic).image_px
    seen = np.flatnonzero(np.isfinite(other).all(axis=1))
    height, geodetic = left.height_m[seen], left.geodetic[seen]
    low, high = scene.left.height_range_m
    return PairWork(
        scene.name,
        RpcWork(scene.left, left.image_px[seen], height, geodetic),
        RpcWork(scene.right, other[seen], height, geodetic),
        0.5 * (low + high),
    )


def _on_dem(
    model: SensorModel, image_px: FloatArray, terrain: Terrain, key: str, title: str
) -> Case:
    return Case(
        key=key,
        title=title,
        points=len(image_px),
        unit="m",
        tolerance=0.1,
        ours=Contender(OURS, _EVERY, lambda: locate(model, image_px, terrain), _ground),
        target_mpoint_s=5.0,
        bytes_per_point=16 + 24 + 1,
    )


def _ground(raw: Any) -> FloatArray:
    points: GroundPoints = raw
    return geodetic_to_ecef(points.geodetic)


def _image(raw: Any) -> FloatArray:
    points: ImagePoints = raw
    return points.image_px
