"""Adjustment on real products: planted and vendors' biases found and removed."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from geoposition.adjust import (
    Adjustment,
    adjust,
    adjusted_models,
    attitude_bias,
    image_bias,
    split_control,
    terrain_heights,
)
from geoposition.flags import Flag, has_result
from geoposition.matching import match_pair, open_image
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.product import Product
from geoposition.rpc.formats import read_rpc
from geoposition.rpc.model import RpcModel
from geoposition.sensors.readers import open_product
from geoposition.terrain import RasterTerrain
from geoposition.triangulate import triangulate


@dataclass(frozen=True)
class Pair:
    models: tuple[RpcModel, RpcModel]
    ties: TiePoints


def matched(images: tuple[Path, Path], rpcs: tuple[Path, Path]) -> Pair:
    models = (read_rpc(rpcs[0]), read_rpc(rpcs[1]))
    return Pair(
        models, match_pair(open_image(images[0]), models[0], open_image(images[1]), models[1])
    )


@pytest.fixture(scope="module")
def ventoux(real_data_root: Path | None) -> Callable[[str], Pair] | None:
    if real_data_root is None:
        return None
    folder = real_data_root / "stereo/pleiades_ventoux"
    images = (folder / "left_image.tif", folder / "right_image.tif")
    return lambda name: matched(images, (folder / "left_image.geom", folder / name))


def with_terrain(pair: Pair, terrain: RasterTerrain) -> Adjustment:
    """Bias of the right image; the DEM is asked where the points are, until that settles."""
    blocks = [image_bias("right", [1])]
    models = pair.models
    for _ in range(4):
        heights = terrain_heights(models, pair.ties, terrain, 5.0)
        done = adjust(pair.models, blocks, ties=pair.ties, heights=heights)
        models = done.models
    return done


def test_ventoux_planted_bias_is_found_and_removed(
    real_data: Path, ventoux: Callable[[str], Pair]
) -> None:
    """Sixty lines planted in the right model: found beside the pair's own bias to 0.3 px."""
    terrain = RasterTerrain(real_data / "dem/N44E005.hgt", real_data / "dem/egm96_15.gtx")
    plain, planted = ventoux("right_image.geom"), ventoux("right_image_bias.geom")
    before, after = with_terrain(plain, terrain), with_terrain(planted, terrain)
    np.testing.assert_allclose(after.values - before.values, [-60.0, 0.0], atol=0.3)
    assert np.median(triangulate(planted.models, planted.ties).residual_px) > 10.0
    assert np.median(triangulate(after.models, planted.ties).residual_px) < 0.1
    assert isinstance(after.models[1], RpcModel)


def test_ventoux_matches_alone_leave_the_parallax_to_the_prior(
    real_data: Path, ventoux: Callable[[str], Pair]
) -> None:
    pair = ventoux("right_image.geom")
    done = adjust(pair.models, [image_bias("right", [1])], ties=pair.ties)
    assert [weak.gain < 0.01 for weak in done.weak] == [True]
    assert np.median(triangulate(done.models, pair.ties).residual_px) < 0.1
    assert not done.rejected


def test_reunion_relative_bias_is_removed(real_data: Path) -> None:
    folder = real_data / "stereo/pleiades_reunion"
    images = (folder / "img_01.tif", folder / "img_02.tif")
    pair = matched(images, images)
    done = adjust(pair.models, [image_bias("right", [1], sigma_px=10.0)], ties=pair.ties)
    before, after = triangulate(pair.models, pair.ties), triangulate(done.models, pair.ties)
    assert np.nanmedian(before.residual_px) > 0.3
    assert np.nanmedian(after.residual_px) < 0.1
    assert has_result(after.flag).sum() >= has_result(before.flag).sum()


def quickbird(folder: Path) -> tuple[RpcModel, ControlPoints]:
    features = json.loads((folder / "gcps.geojson").read_text())["features"]
    ids = [feature["properties"]["id"] for feature in features]
    col_row = np.array([feature["properties"]["ji"] for feature in features])
    ground = np.array([feature["geometry"]["coordinates"] for feature in features])
    ground[:, :2] = np.radians(ground[:, :2])
    image = TiePoints(ids, [0] * len(ids), col_row[:, ::-1])
    covariance = diagonal_covariance(0.5, len(ids), 3)
    return read_rpc(folder / "qb2_basic1b.tif"), ControlPoints(
        np.array(ids), ground, covariance, image
    )


def test_quickbird_bias_and_what_each_point_says_of_it(real_data: Path) -> None:
    model, control = quickbird(real_data / "dom/quickbird2_baviaanskloof")
    blocks = [image_bias("bias", [0])]
    done = adjust([model], blocks, control=control, control_sigma_px=0.5)
    np.testing.assert_allclose(done.values[::-1], (-2.95, -2.09), atol=0.1)
    assert not done.rejected
    left_out = []
    for name in control.ids.tolist():
        others, one = split_control(control, [name])
        alone = adjust([model], blocks, control=others, check=one, control_sigma_px=0.5)
        left_out.append(alone.check.residual_px[0])
    assert np.max(np.hypot(*np.array(left_out).T)) < 0.25


def test_worldview_rigorous_and_rpc_adjustment_agree(real_data: Path) -> None:
    """The same control gives both the same place, but for motion no RPC follows."""
    folder = real_data / "linescan/worldview2_pair"
    products: list[Product] = [open_product(folder / f"wv_mvp_{k}.xml") for k in (1, 2)]
    rigorous = [product.model for product in products]
    rpcs = [product.vendor_rpc for product in products]
    assert all(rpc is not None for rpc in rpcs)
    blocks = [attitude_bias(f"image{k}", rigorous, [k]) for k in range(2)]
    rng = np.random.default_rng(0)
    truth = adjusted_models(rigorous, blocks, rng.normal(0.0, 2e-5, 6))
    size = np.array(rigorous[0].shape) - 1.0
    ground = (
        rigorous[0]
        .image_to_ground(
            rng.uniform(0.0, size, (300, 2)), rng.uniform(*rigorous[0].height_range_m, 300)
        )
        .geodetic
    )
    seen = [model.ground_to_image(ground) for model in truth]
    both = (seen[0].flag == Flag.OK) & (seen[1].flag == Flag.OK)
    n = int(both.sum())
    assert n > 100
    images = [points.image_px[both] + rng.normal(0.0, 0.3, (n, 2)) for points in seen]
    control = ControlPoints(
        np.arange(n), ground[both], diagonal_covariance(0.05, n, 3), TiePoints.of_pair(*images)
    )
    by_attitude = adjust(rigorous, blocks, control=control)
    in_image = [image_bias(f"image{k}", [k], degree=1) for k in range(2)]
    by_image = adjust([rpc for rpc in rpcs if rpc is not None], in_image, control=control)
    for k in range(2):
        line, sample = np.meshgrid(*(np.linspace(0.0, s, 60) for s in size), indexing="ij")
        grid = np.stack([line, sample], axis=-1).reshape(-1, 2)
        place = rigorous[0].image_to_ground(grid, float(np.mean(rigorous[0].height_range_m)))
        a = by_attitude.models[k].ground_to_image(place.geodetic).image_px
        b = by_image.models[k].ground_to_image(place.geodetic).image_px
        off = (a - b)[np.isfinite(a - b).all(axis=1)]
        assert len(off) > 1000
        assert np.all(np.abs(np.mean(off, axis=0)) < 0.05)
