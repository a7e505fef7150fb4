"""The list of cases, each with its contenders."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.intersect import intersect_pairs
from geoposition.locate import locate
from geoposition.rays import Rays
from geoposition.scripts.bench import (
    peer_asgard,
    peer_gdal,
    peer_pyrugged,
    peer_rpcm,
    peer_shareloc,
    peer_usgscsm,
)
from geoposition.scripts.bench.measure import Case, Contender
from geoposition.scripts.bench.scenes import (
    RigorousScene,
    RpcScene,
    image_grid,
    write_terrain,
)
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


def rigorous_cases(scene: RigorousScene, folder: Path, sizes: Sizes) -> Iterator[Case]:
    """Direct, inverse, and direct on a raster, of a rigorous model."""
    like_peers = rigorous_work(scene.without_refraction(), sizes.ours)
    full = rigorous_work(scene, sizes.ours)
    yield _direct(full, "direct", f"direct, ellipsoid, {scene.name}", 12.0)
    yield replace(
        _direct(like_peers, "direct-peers", "the same without refraction, as peers have it", None),
        peers=(
            peer_usgscsm.MISSING,
            peer_asgard.direct(like_peers, sizes.numpy),
            peer_pyrugged.direct(like_peers, sizes.slow),
        ),
    )
    yield _inverse(full, "inverse", f"inverse, {scene.name}", 6.0)
    yield replace(
        _inverse(
            like_peers, "inverse-peers", "the same without refraction, as peers have it", None
        ),
        peers=(
            peer_usgscsm.MISSING,
            peer_asgard.inverse(like_peers, sizes.slow),
            peer_pyrugged.inverse(like_peers, sizes.slow),
        ),
    )
    dem = write_terrain(folder / "terrain.tif", full.geodetic, 0.1)
    terrain = RasterTerrain(dem)
    yield _on_dem(scene.model, full.image_px, terrain, "dem", f"on a DEM, {scene.name}", 5.0)
    yield replace(
        _on_dem(
            like_peers.scene.model,
            like_peers.image_px,
            terrain,
            "dem-peers",
            "the same without refraction, as peers have it",
            None,
        ),
        peers=(
            peer_asgard.on_dem(like_peers, dem, sizes.slow),
            peer_pyrugged.on_dem(like_peers, dem, sizes.slow),
        ),
    )


def rpc_cases(scene: RpcScene, sizes: Sizes) -> Iterator[Case]:
    """Both directions of an RPC, its location on a raster, and a pair's intersection."""
    work = rpc_work(scene, sizes.rpc)
    model = scene.left
    yield Case(
        key="rpc-project",
        title=f"RPC, ground to image, {scene.name}",
        points=work.points,
        unit="px",
        tolerance=1e-4,
        ours=Contender(OURS, _EVERY, lambda: model.ground_to_image(work.geodetic), _image),
        peers=(
            peer_shareloc.project(work, sizes.compiled),
            peer_gdal.project(work, sizes.compiled),
            peer_rpcm.project(work, sizes.compiled),
        ),
        target_mpoint_s=150.0,
        bytes_per_point=24 + 16 + 1,
    )
    yield Case(
        key="rpc-locate",
        title=f"RPC, image to ground, {scene.name}",
        points=work.points,
        unit="m",
        tolerance=1e-2,
        ours=Contender(
            OURS, _EVERY, lambda: model.image_to_ground(work.image_px, work.height_m), _ground
        ),
        peers=(
            peer_shareloc.locate(work, sizes.compiled),
            peer_gdal.locate(work, sizes.compiled),
            peer_rpcm.locate(work, sizes.compiled),
        ),
        target_mpoint_s=20.0,
        bytes_per_point=16 + 8 + 24 + 1,
    )
    part = rpc_work(scene, sizes.ours)
    terrain = RasterTerrain(scene.dem, scene.geoid)
    case = _on_dem(model, part.image_px, terrain, "rpc-dem", f"RPC on a DEM, {scene.name}", 5.0)
    box = np.degrees(part.geodetic[:, :2])
    (west, south), (east, north) = box.min(axis=0) - 0.05, box.max(axis=0) + 0.05
    roi = [float(south), float(west), float(north), float(east)]
    yield replace(
        case,
        # shareloc's rays are straight in longitude and latitude: decimetres over much relief
        tolerance=0.5,
        peers=(peer_shareloc.locate_on_dem(part, scene.dem, scene.geoid, roi, sizes.compiled),),
    )
    yield from _pair_cases(scene, part, sizes)


def _pair_cases(scene: RpcScene, left: RpcWork, sizes: Sizes) -> Iterator[Case]:
    other = scene.right.ground_to_image(left.geodetic).image_px
    seen = np.flatnonzero(np.isfinite(other).all(axis=1))
    height = left.height_m[seen]
    geodetic = left.geodetic[seen]
    left = RpcWork(scene.left, left.image_px[seen], height, geodetic)
    right = RpcWork(scene.right, other[seen], height, geodetic)
    low, high = scene.left.height_range_m
    middle = 0.5 * (low + high)

    def sights() -> tuple[Rays, Rays]:
        return (
            scene.left.rays(left.image_px, middle),
            scene.right.rays(right.image_px, middle),
        )

    rays_a, rays_b = sights()
    yield Case(
        key="pair-rays",
        title="two-ray intersection, rays given",
        points=left.points,
        unit="m",
        tolerance=1e-2,
        ours=Contender(OURS, _EVERY, lambda: intersect_pairs(rays_a, rays_b), _ground),
        peers=(peer_shareloc.intersect(rays_a, rays_b, sizes.compiled),),
        target_mpoint_s=5.0,
        bytes_per_point=2 * 49 + 24 + 8 + 1,
    )
    yield Case(
        key="pair",
        title=f"two-ray intersection from matches, {scene.name}",
        points=left.points,
        unit="m",
        tolerance=0.5,
        ours=Contender(OURS, _EVERY, lambda: intersect_pairs(*sights()), _ground),
        peers=(
            peer_shareloc.triangulate(left, right, (middle - 50.0, middle + 50.0), sizes.compiled),
        ),
        target_mpoint_s=5.0,
        bytes_per_point=2 * 16 + 24 + 8 + 1,
    )
    yield Case(
        key="pair-covariance",
        title=f"the same, weighted, with covariance, {scene.name}",
        points=left.points,
        unit="m",
        tolerance=0.5,
        ours=Contender(
            OURS,
            _EVERY,
            lambda: triangulate_pairs_weighted(
                scene.left, scene.right, left.image_px, right.image_px
            ),
            _ground,
        ),
        peers=(
            peer_shareloc.triangulate(left, right, (middle - 50.0, middle + 50.0), sizes.compiled),
        ),
        target_mpoint_s=3.0,
        bytes_per_point=2 * 16 + 24 + 72 + 8 + 1,
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


def _direct(work: RigorousWork, key: str, title: str, target: float | None) -> Case:
    model = work.scene.model
    return Case(
        key=key,
        title=title,
        points=work.points,
        unit="m",
        tolerance=0.1,
        ours=Contender(
            OURS, _EVERY, lambda: model.image_to_ground(work.image_px, work.height_m), _ground
        ),
        target_mpoint_s=target,
        bytes_per_point=16 + 24 + 1,
    )


def _inverse(work: RigorousWork, key: str, title: str, target: float | None) -> Case:
    model = work.scene.model
    return Case(
        key=key,
        title=title,
        points=work.points,
        unit="px",
        tolerance=0.2,
        ours=Contender(OURS, _EVERY, lambda: model.ground_to_image(work.geodetic), _image),
        target_mpoint_s=target,
        bytes_per_point=24 + 16 + 1,
    )


def _on_dem(
    model: SensorModel,
    image_px: FloatArray,
    terrain: Terrain,
    key: str,
    title: str,
    target: float | None,
) -> Case:
    return Case(
        key=key,
        title=title,
        points=len(image_px),
        unit="m",
        tolerance=0.1,
        ours=Contender(OURS, _EVERY, lambda: locate(model, image_px, terrain), _ground),
        target_mpoint_s=target,
        bytes_per_point=16 + 24 + 1,
    )


def _ground(raw: Any) -> FloatArray:
    points: GroundPoints = raw
    return geodetic_to_ecef(points.geodetic)


def _image(raw: Any) -> FloatArray:
    points: ImagePoints = raw
    return points.image_px
