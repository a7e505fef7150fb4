"""Stereo on real products: Pleiades pairs through their RPCs, WorldView-2 both ways."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio

from geoposition.datum import to_crs
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.flags import Flag, has_result
from geoposition.matching import match_pair, open_image
from geoposition.observations import TiePoints
from geoposition.product import Product
from geoposition.rpc.formats import read_rpc
from geoposition.rpc.model import RpcModel
from geoposition.sensor_model import SensorModel
from geoposition.sensors.readers import open_product
from geoposition.triangulate import IntersectedPoints, triangulate, triangulate_pairs
from geoposition.triangulate.bias import RelativeBias, relative_bias

NMAD = 1.4826


@dataclass(frozen=True)
class Pair:
    ties: TiePoints
    models: tuple[RpcModel, RpcModel]
    points: IntersectedPoints
    bias: tuple[RelativeBias, ...]


def matched(images: tuple[Path, Path], rpcs: tuple[Path, Path]) -> Pair:
    models = (read_rpc(rpcs[0]), read_rpc(rpcs[1]))
    ties = match_pair(open_image(images[0]), models[0], open_image(images[1]), models[1])
    points = triangulate(models, ties)
    return Pair(ties, models, points, relative_bias(ties, points))


@pytest.fixture(scope="module")
def reunion(real_data_root: Path | None) -> Pair | None:
    if real_data_root is None:
        return None
    folder = real_data_root / "stereo/pleiades_reunion"
    images = (folder / "img_01.tif", folder / "img_02.tif")
    return matched(images, images)


def ventoux(root: Path, right_rpc: str) -> Pair:
    folder = root / "stereo/pleiades_ventoux"
    images = (folder / "left_image.tif", folder / "right_image.tif")
    return matched(images, (folder / "left_image.geom", folder / right_rpc))


@pytest.fixture(scope="module")
def unplanted(real_data_root: Path | None) -> Pair | None:
    return None if real_data_root is None else ventoux(real_data_root, "right_image.geom")


@pytest.fixture(scope="module")
def planted(real_data_root: Path | None) -> Pair | None:
    return None if real_data_root is None else ventoux(real_data_root, "right_image_bias.geom")


def bilinear(path: Path, geodetic: np.ndarray) -> np.ndarray:
    """Heights of a raster at ground points, NaN outside and beside holes."""
    with rasterio.open(path) as raster:
        grid, crs, transform = raster.read(1).astype(float), raster.crs.to_wkt(), raster.transform
    place = to_crs(crs, geodetic)
    column = (place[:, 0] - transform.c) / transform.a - 0.5
    row = (place[:, 1] - transform.f) / transform.e - 0.5
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < grid.shape[0] - 1) & (j < grid.shape[1] - 1)
    out = np.full(len(geodetic), np.nan)
    i, j, u, v = i[inside], j[inside], (row - i)[inside], (column - j)[inside]
    out[inside] = (1 - u) * ((1 - v) * grid[i, j] + v * grid[i, j + 1]) + u * (
        (1 - v) * grid[i + 1, j] + v * grid[i + 1, j + 1]
    )
    return out


def test_reunion_heights_agree_with_another_tools_surface(real_data: Path, reunion: Pair) -> None:
    found = has_result(reunion.points.flag)
    assert found.sum() >= 3000
    points = reunion.points.geodetic[found]
    off = points[:, 2] - bilinear(real_data / "stereo/pleiades_reunion/expected_dsm.tif", points)
    off = off[np.isfinite(off)]
    assert len(off) > 1500
    assert abs(np.median(off)) <= 0.2
    assert NMAD * np.median(np.abs(off - np.median(off))) <= 0.6
    assert np.mean(np.abs(off) > 5.0) < 0.005
    assert np.median(reunion.points.residual_px[found]) == pytest.approx(0.36, abs=0.03)


def test_ventoux_relative_bias_is_found(real_data: Path, unplanted: Pair) -> None:
    """(0.6, 2.3) px as (line, sample) in image 1 of the pair: half of it, as residuals show it."""
    first = unplanted.bias[0]
    assert first.count >= 465
    np.testing.assert_allclose(first.residual_px, (0.63, 2.3), atol=0.1)
    assert np.median(unplanted.points.residual_px) == pytest.approx(2.4, abs=0.1)
    assert np.all(first.residual_sigma_px < 0.01)
    np.testing.assert_allclose(first.bias_px, 2.0 * first.residual_px, rtol=0.02)
    # Taken from the image, nothing is left but matching noise.
    mended = unplanted.ties.shifted(0, -first.bias_px)
    points = triangulate(unplanted.models, mended)
    assert np.median(points.residual_px) < 0.1


def test_ventoux_planted_bias_is_found(real_data: Path, unplanted: Pair, planted: Pair) -> None:
    """Sixty lines added to the model of image 2 show by their part across the chords."""
    before, after = unplanted.bias[1], planted.bias[1]
    assert after.count > 0.9 * before.count
    across = after.observable[0]
    expected = (np.array([-60.0, 0.0]) @ across) * across
    np.testing.assert_allclose(after.bias_px - before.bias_px, expected, atol=0.05)
    assert np.hypot(*expected) > 15.0


def test_crops_lie_where_their_geotransform_says(real_data: Path) -> None:
    folder = real_data / "stereo/pleiades_ventoux"
    left, right = open_image(folder / "left_image.tif"), open_image(folder / "right_image.tif")
    assert (left.first_line, left.first_sample) == (5000, 5000)
    assert (right.first_line, right.first_sample) == (5162, 4915)
    crop = open_image(real_data / "stereo/pleiades_reunion/img_01.tif")
    assert (crop.first_line, crop.first_sample) == (0, 0)


@pytest.fixture(scope="module")
def worldview(real_data_root: Path | None) -> tuple[Product, Product] | None:
    if real_data_root is None:
        return None
    folder = real_data_root / "linescan/worldview2_pair"
    return open_product(folder / "wv_mvp_1.xml"), open_product(folder / "wv_mvp_2.xml")


def common_ground(first: SensorModel, second: SensorModel, n: int) -> tuple[np.ndarray, TiePoints]:
    """Ground points that both models see, and where they see them."""
    rng = np.random.default_rng(1)
    image = rng.uniform((0.0, 0.0), np.array(first.shape) - 1.0, (n, 2))
    height = rng.uniform(*first.height_range_m, n)
    ground = first.image_to_ground(image, height).geodetic
    a, b = first.ground_to_image(ground), second.ground_to_image(ground)
    both = (a.flag == Flag.OK) & (b.flag == Flag.OK)
    return ground[both], TiePoints.of_pair(a.image_px[both], b.image_px[both])


def enu_error(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    off = geodetic_to_ecef(found) - geodetic_to_ecef(truth)
    return np.einsum("nji,nj->ni", enu_axes(truth), off)


def test_worldview_ties_give_the_ground_back(
    real_data: Path, worldview: tuple[Product, Product]
) -> None:
    models = [product.model for product in worldview]
    ground, ties = common_ground(*models, 20_000)
    assert len(ground) > 10_000
    found = triangulate(models, ties)
    assert np.all(found.flag == Flag.OK)
    assert np.max(np.abs(enu_error(found.geodetic, ground))) < 1e-4
    assert np.max(found.residual_px) < 1e-4
    n = len(ground)
    dense = triangulate_pairs(*models, ties.image_px[:n], ties.image_px[n:])
    # A ray is used up to a metre off the height it was made for: refraction, 0.2 mm per metre.
    assert np.max(np.abs(enu_error(dense.geodetic, ground))) < 5e-4


def test_rigorous_model_and_vendor_rpc_mixed(
    real_data: Path, worldview: tuple[Product, Product]
) -> None:
    """What the RPC's misfit moves an image point by, it moves the ground by no more than that."""
    rigorous, second = worldview[0].model, worldview[1].model
    rpc = worldview[1].vendor_rpc
    assert rpc is not None
    ground, ties = common_ground(rigorous, second, 20_000)
    n = len(ground)
    misfit = np.hypot(*(ties.image_px[n:] - rpc.ground_to_image(ground).image_px).T)
    found = triangulate([rigorous, rpc], ties, 1.0)
    assert np.all(found.flag == Flag.OK)
    error = np.abs(enu_error(found.geodetic, ground))
    assert np.all(error <= 1.01 * found.sigma_enu_m * misfit[:, None] + 1e-4)
    assert np.max(found.residual_px) <= np.max(misfit)
    assert np.max(misfit) < 0.45
