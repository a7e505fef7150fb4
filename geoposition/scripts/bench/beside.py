"""The location cases, each alone with its target and beside the peers that do the same."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from geoposition.scripts.bench import (
    cases,
    peer_asgard,
    peer_gdal,
    peer_pyrugged,
    peer_rpcm,
    peer_shareloc,
    peer_usgscsm,
)
from geoposition.scripts.bench.cases import PairWork, Sizes
from geoposition.scripts.bench.measure import Case, Contender, Missing
from geoposition.scripts.bench.scenes import RigorousScene, RpcScene, write_terrain


def rigorous_cases(scene: RigorousScene, folder: Path, sizes: Sizes) -> Iterator[Case]:
    """Direct, inverse, and direct on a raster, of a rigorous model."""
    full = cases.rigorous_work(scene, sizes.ours)
    like = cases.rigorous_work(scene.without_refraction(), sizes.ours)
    dem = write_terrain(folder / "terrain.tif", full.geodetic, 0.1)
    yield cases.direct(full)
    yield _beside(
        cases.direct(like),
        peer_usgscsm.MISSING,
        peer_asgard.direct(like, sizes.numpy),
        peer_pyrugged.direct(like, sizes.slow),
    )
    yield cases.inverse(full)
    yield _beside(
        cases.inverse(like),
        peer_usgscsm.MISSING,
        peer_asgard.inverse(like, sizes.slow),
        peer_pyrugged.inverse(like, sizes.slow),
    )
    yield cases.on_dem(full, dem)
    yield _beside(
        cases.on_dem(like, dem),
        peer_asgard.on_dem(like, dem, sizes.slow),
        peer_pyrugged.on_dem(like, dem, sizes.slow),
    )


def _beside(case: Case, *peers: Contender | Missing) -> Case:
    title = "the same without refraction, as peers have it"
    return replace(case, key=f"{case.key}-peers", title=title, target_mpoint_s=None, peers=peers)


def rpc_cases(scene: RpcScene, sizes: Sizes) -> Iterator[Case]:
    """Both directions of an RPC, its location on a raster, and a pair's intersection."""
    work = cases.rpc_work(scene, sizes.rpc)
    each = sizes.compiled
    yield replace(
        cases.rpc_project(work, scene.name),
        peers=(
            peer_shareloc.project(work, each),
            peer_gdal.project(work, each),
            peer_rpcm.project(work, each),
        ),
    )
    yield replace(
        cases.rpc_locate(work, scene.name),
        peers=(
            peer_shareloc.locate(work, each),
            peer_gdal.locate(work, each),
            peer_rpcm.locate(work, each),
        ),
    )
    part = cases.rpc_work(scene, sizes.ours)
    box = np.degrees(part.geodetic[:, :2])
    (west, south), (east, north) = box.min(axis=0) - 0.05, box.max(axis=0) + 0.05
    roi = [float(south), float(west), float(north), float(east)]
    yield replace(
        cases.rpc_on_dem(part, scene),
        # shareloc's rays are straight in longitude and latitude: decimetres over much relief
        tolerance=0.5,
        peers=(peer_shareloc.locate_on_dem(part, scene.dem, scene.geoid, roi, each),),
    )
    yield from _pair_cases(cases.pair_work(scene, part), each)


def _pair_cases(work: PairWork, each: int) -> Iterator[Case]:
    rays = peer_shareloc.intersect(*work.sights(), each)
    around = work.middle_m - 50.0, work.middle_m + 50.0
    matches = peer_shareloc.triangulate(work.left, work.right, around, each)
    yield replace(cases.pair_rays(work), peers=(rays,))
    yield replace(cases.pair(work), peers=(matches,))
    yield replace(cases.pair_covariance(work), peers=(matches,))
