"""Sparse matching on rendered images whose true correspondences are known."""

from __future__ import annotations

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from scipy.ndimage import gaussian_filter, map_coordinates
from synthetic_models import PLACE, ParallelModel

import geoposition.matching.pairs as matching
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.errors import (
    ArgumentError,
    GeometryError,
    MissingFileError,
    ProductError,
)
from geoposition.matching import MatchOptions, match_images, match_pair, open_image
from geoposition.matching.filter import common_offset, first_of_place, like_neighbours
from geoposition.matching.image import Window, stretched
from geoposition.matching.refine import refine
from geoposition.triangulate import triangulate
from geoposition.triangulate.bias import relative_bias

SIZE = 300
TEXTURE_M = 0.25
FIRST = ParallelModel((0.05, 0.40), shape=(SIZE, SIZE), margin_px=2000.0)
LOOK = ((0.02, -0.30), (SIZE, SIZE), 0.55, 0.35)
SECOND = ParallelModel(*LOOK, margin_px=2000.0)
THIRD = ParallelModel((0.30, 0.05), shape=(SIZE, SIZE), turn_rad=-0.2, margin_px=2000.0)
NARROW = MatchOptions(heights_m=(0.0, 120.0), max_bias_px=80.0)


def terrain_m(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    return 50.0 + 12.0 * np.sin(east / 40.0) * np.cos(north / 55.0)


def texture() -> np.ndarray:
    rng = np.random.default_rng(1)
    side = 1600
    layers = [
        gaussian_filter(rng.normal(size=(side, side)), s) * s * w for s, w in ((3, 1), (9, 2))
    ]
    return sum(layers) / np.std(sum(layers))


def ground_seen(model: ParallelModel, image_px: np.ndarray) -> np.ndarray:
    """Points (..., 3), east, north, up, of the terrain at image points."""
    height = np.full(image_px.shape[:-1], 50.0)
    local = np.empty((*image_px.shape[:-1], 3))
    for _ in range(6):
        ground = model.image_to_ground(image_px, height).geodetic
        local = (geodetic_to_ecef(ground) - geodetic_to_ecef(PLACE)) @ enu_axes(PLACE)
        height = terrain_m(local[..., 0], local[..., 1])
    return local


def rendered(model: ParallelModel, ground_texture: np.ndarray) -> np.ndarray:
    grid = np.stack(np.mgrid[:SIZE, :SIZE], axis=-1).astype(float)
    local = ground_seen(model, grid)
    half = 0.5 * len(ground_texture)
    at = [half - local[..., 1] / TEXTURE_M, half + local[..., 0] / TEXTURE_M]
    return map_coordinates(ground_texture, at, order=3, mode="nearest")


def write(path: Path, grey: np.ndarray, **more: object) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path, "w", driver="GTiff", height=grey.shape[0], width=grey.shape[1], count=1,
            dtype=grey.dtype, **more,
        ) as out:  # fmt: skip
            out.write(grey, 1)
    return path


def read(path: Path) -> np.ndarray:
    source = open_image(path)
    return source.read(source.extent).astype(np.uint16)


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("images")
    ground_texture = texture()
    rng = np.random.default_rng(2)
    paths = []
    for k, (model, gain) in enumerate(((FIRST, 150.0), (SECOND, 90.0), (THIRD, 120.0))):
        grey = 800.0 + 100.0 * k + gain * rendered(model, ground_texture)
        grey += rng.normal(0.0, 2.0, grey.shape)
        paths.append(write(folder / f"image_{k}.tif", np.clip(grey, 1, 65535).astype(np.uint16)))
    return paths


def true_partner(first_px: np.ndarray, second: ParallelModel) -> np.ndarray:
    local = ground_seen(FIRST, first_px)
    return local @ second.matrix.T + second.offset_px


@pytest.mark.parametrize("bias_px", [(0.0, 0.0), (45.0, -30.0)])
def test_matches_are_where_the_ground_is(images: list[Path], bias_px: tuple[float, float]) -> None:
    """Rotated, foreshortened, differently lit; and with a model that is tens of pixels off."""
    wrong = ParallelModel(*LOOK, bias_px, margin_px=2000.0)
    done: list[tuple[int, int]] = []
    ties = match_pair(
        open_image(images[0]), FIRST, open_image(images[1]), wrong, NARROW,
        progress=lambda at, total: done.append((at, total)),
    )  # fmt: skip
    n = len(ties) // 2
    assert n > 150
    assert done == [(1, 1)]
    off = ties.image_px[n:] - true_partner(ties.image_px[:n], SECOND)
    assert np.median(np.hypot(*off.T)) < 0.08
    assert np.max(np.hypot(*off.T)) < 1.0
    # No half pixel anywhere: places are those of pixel centres.
    assert np.max(np.abs(np.median(off, axis=0))) < 0.02
    bias = relative_bias(ties, triangulate([FIRST, wrong], ties))[1]
    across = bias.observable[0]
    assert bias.bias_px @ across == pytest.approx(-np.array(bias_px) @ across, abs=0.05)


def test_intersected_matches_lie_on_the_terrain(images: list[Path]) -> None:
    ties = match_pair(open_image(images[0]), FIRST, open_image(images[1]), SECOND, NARROW)
    found = triangulate([FIRST, SECOND], ties)
    local = (geodetic_to_ecef(found.geodetic) - geodetic_to_ecef(PLACE)) @ enu_axes(PLACE)
    off = found.geodetic[:, 2] - terrain_m(local[:, 0], local[:, 1])
    assert abs(np.median(off)) < 0.02
    assert 1.4826 * np.median(np.abs(off)) < 0.08


def test_three_images_share_points(images: list[Path]) -> None:
    sources = [open_image(path) for path in images]
    models = [FIRST, SECOND, THIRD]
    ties = match_images(sources, models, NARROW)
    found = triangulate(models, ties)
    assert np.sum(found.rays == 3) > 50
    assert np.sum(found.rays == 2) > 50
    local = (geodetic_to_ecef(found.geodetic) - geodetic_to_ecef(PLACE)) @ enu_axes(PLACE)
    off = (found.geodetic[:, 2] - terrain_m(local[:, 0], local[:, 1]))[found.rays == 3]
    assert abs(np.median(off)) < 0.03
    with pytest.raises(ArgumentError, match="two images"):
        match_images(sources, models[:2])


def test_a_crop_keeps_the_frame_of_its_model(images: list[Path], tmp_path: Path) -> None:
    grey = read(images[1])
    transform = rasterio.Affine(1.0, 0.0, 60.0, 0.0, 1.0, 40.0)
    crop = open_image(write(tmp_path / "crop.tif", grey[40:280, 60:290], transform=transform))
    assert (crop.first_line, crop.first_sample, crop.shape) == (40, 60, (240, 230))
    ties = match_pair(open_image(images[0]), FIRST, crop, SECOND, NARROW)
    n = len(ties) // 2
    off = ties.image_px[n:] - true_partner(ties.image_px[:n], SECOND)
    assert n > 80
    assert np.median(np.hypot(*off.T)) < 0.08


def test_tiles_cover_evenly(images: list[Path]) -> None:
    tiled = MatchOptions(heights_m=(0.0, 120.0), max_bias_px=20.0, tile_px=75, tile_features=640)
    ties = match_pair(open_image(images[0]), FIRST, open_image(images[1]), SECOND, tiled)
    n = len(ties) // 2
    cells = np.unique(((ties.image_px[:n] + 0.5) // 75.0).astype(int), axis=0)
    assert len(cells) >= 12
    off = ties.image_px[n:] - true_partner(ties.image_px[:n], SECOND)
    assert np.median(np.hypot(*off.T)) < 0.08
    few = MatchOptions(heights_m=(0.0, 120.0), max_bias_px=20.0, tile_px=75, max_tiles=5)
    ties = match_pair(open_image(images[0]), FIRST, open_image(images[1]), SECOND, few)
    cells = np.unique(((ties.image_px[: len(ties) // 2] + 0.5) // 75.0).astype(int), axis=0)
    assert len(cells) <= 5


def test_images_without_texture_or_common_ground(images: list[Path], tmp_path: Path) -> None:
    flat = open_image(write(tmp_path / "flat.tif", np.full((SIZE, SIZE), 500, dtype=np.uint16)))
    noise = np.random.default_rng(3).integers(100, 900, (SIZE, SIZE)).astype(np.uint16)
    other = open_image(write(tmp_path / "noise.tif", noise))
    first = open_image(images[0])
    for second in (flat, other):
        with pytest.raises(GeometryError, match="no texture") as caught:
            match_pair(first, FIRST, second, SECOND, NARROW)
        assert "\n" not in str(caught.value)
    away = ParallelModel(SECOND.lean, (SIZE, SIZE), shift_px=(5000.0, 0.0), margin_px=2000.0)
    with pytest.raises(GeometryError, match=r"image_0.tif and image_1.tif do not overlap"):
        match_pair(first, FIRST, open_image(images[1]), away, NARROW)


def test_nodata_is_no_texture(images: list[Path], tmp_path: Path) -> None:
    grey = read(images[1])
    grey[:, 200:] = 0
    path = write(tmp_path / "hole.tif", grey, nodata=0)
    ties = match_pair(open_image(images[0]), FIRST, open_image(path), SECOND, NARROW)
    n = len(ties) // 2
    assert n > 60
    assert np.max(ties.image_px[n:, 1]) < 200.0


def test_places_of_features_are_unbiased() -> None:
    """Blobs at known places: the detector's pixel centres are ours."""
    rng = np.random.default_rng(4)
    row, column = np.mgrid[:300, :300].astype(float)
    places = np.stack(np.meshgrid(np.arange(30, 280, 40), np.arange(30, 280, 40)), -1).reshape(
        -1, 2
    )
    places = places + rng.uniform(-0.5, 0.5, places.shape)
    grey = sum(np.exp(-((row - r) ** 2 + (column - c) ** 2) / 8.0) for r, c in places)
    keypoints = matching._detector().detect((255.0 * grey / grey.max()).astype(np.uint8), None)
    found = np.array([point.pt for point in keypoints])[:, ::-1]
    off = found[:, None] - places
    nearest = off[np.arange(len(found)), np.argmin(np.hypot(*off.T).T, axis=1)]
    nearest = nearest[np.hypot(*nearest.T) < 1.0]
    assert len(nearest) >= len(places)
    np.testing.assert_allclose(nearest.mean(axis=0), 0.0, atol=0.02)
    assert cv2.__version__


def test_refinement_finds_a_known_shift() -> None:
    rng = np.random.default_rng(5)
    base = gaussian_filter(rng.normal(size=(200, 200)), 2.0) * 100.0
    truth = np.array([[1.02, 0.05], [-0.04, 0.97]])
    row, column = np.mgrid[:200, :200].astype(float)
    back = np.linalg.inv(truth)
    centred = np.stack([row - 100.0, column - 100.0], axis=-1)
    source = centred @ back.T + 100.0
    second = 40.0 + 1.7 * map_coordinates(base, [source[..., 0], source[..., 1]], order=3)
    points = rng.uniform(40.0, 160.0, (60, 2))
    expected = (points - 100.0) @ truth.T + 100.0
    place = expected + rng.uniform(-0.7, 0.7, points.shape)
    place[0] = (3.0, 3.0)
    correlation, converged = np.empty(60), np.empty(60, dtype=bool)
    begin = np.broadcast_to(np.eye(2), (60, 2, 2)).copy()
    refine(base, second, points, begin, 2.0, place, correlation, converged)
    assert not converged[0]
    np.testing.assert_array_equal(place[0], (3.0, 3.0))
    assert np.mean(converged[1:]) > 0.95
    assert np.max(np.hypot(*(place - expected)[converged].T)) < 0.02
    assert np.min(correlation[converged]) > 0.999


def test_common_offset_among_false_ones() -> None:
    rng = np.random.default_rng(6)
    values = np.concatenate([rng.normal(37.0, 0.3, 40), rng.uniform(-100, 100, 300)])
    offset = common_offset(values, 100.0)
    assert offset.across_px == pytest.approx(37.0, abs=0.3)
    for nothing in (rng.uniform(-100, 100, 300), np.array([]), np.array([1.0, 1.1, 1.2])):
        with pytest.raises(GeometryError, match="no texture"):
            common_offset(nothing, 100.0)


def test_matches_unlike_their_neighbours_and_repeated_places() -> None:
    rng = np.random.default_rng(7)
    first = rng.uniform(0, 1000, (400, 2))
    along = 0.2 * first[:, 0] + 0.1 * first[:, 1]
    along[::40] += 60.0
    keep = like_neighbours(first, along)
    assert not np.any(keep[::40])
    assert np.mean(keep) > 0.95
    second = first + 5.0
    twice = np.vstack([first, first[:3]]), np.vstack([second, second[:3] + 0.01])
    rank = np.concatenate([np.full(400, 2.0), [1.0, 3.0, 1.0]])
    kept = first_of_place(*twice, rank)
    np.testing.assert_array_equal(kept[:3], [False, True, False])
    np.testing.assert_array_equal(kept[400:], [True, False, True])


def test_where_an_image_file_lies_in_its_model(tmp_path: Path) -> None:
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8)
    shifted = rasterio.Affine(1.0, 0.0, 30.0, 0.0, 1.0, 20.0)
    north_up = rasterio.Affine(0.5, 0.0, 30.0, 0.0, -0.5, 20.0)
    utm = rasterio.Affine(1.0, 0.0, 500000.0, 0.0, -1.0, 4e6)
    plain = open_image(write(tmp_path / "plain.tif", grey))
    assert (plain.first_line, plain.first_sample) == (0, 0)
    crop = open_image(write(tmp_path / "crop.tif", grey, transform=shifted))
    assert (crop.first_line, crop.first_sample) == (20, 30)
    np.testing.assert_array_equal(crop.read(Window(21, 33, 2, 3)), grey[1:3, 3:6])
    for name, transform, crs in (("half", north_up, None), ("utm", utm, "EPSG:32631")):
        source = open_image(write(tmp_path / f"{name}.tif", grey, transform=transform, crs=crs))
        assert (source.first_line, source.first_sample) == (0, 0)
    given = open_image(tmp_path / "crop.tif", first_pixel=(7, 9))
    assert (given.first_line, given.first_sample) == (7, 9)
    with pytest.raises(ArgumentError, match="outside the image"):
        crop.read(Window(0, 0, 2, 2))
    with pytest.raises(ProductError, match="band 2 expected"):
        open_image(tmp_path / "plain.tif", band=2)
    with pytest.raises(MissingFileError, match="no such file"):
        open_image(tmp_path / "none.tif")
    (tmp_path / "text.tif").write_text("nothing")
    with pytest.raises(ProductError, match="not readable"):
        open_image(tmp_path / "text.tif")


def test_stretch() -> None:
    grey = np.linspace(1000.0, 3000.0, 10001).reshape(1, -1)
    grey[0, :3] = np.nan
    level, mask = stretched(grey)
    np.testing.assert_array_equal(mask[0, :5], [0, 0, 0, 255, 255])
    assert (level[0, 3], level[0, 5000], level[0, -1]) == (0, 127, 255) or level[0, 5000] == 128
    flat, _ = stretched(np.full((4, 4), 7.0))
    assert np.ptp(flat) == 0
    _, none = stretched(np.full((4, 4), np.nan))
    assert not none.any()


def test_options_that_are_none() -> None:
    for wrong in (
        {"max_bias_px": 0.0},
        {"ratio": 1.2},
        {"tile_px": 10},
        {"max_tiles": 0},
        {"heights_m": (10.0, 10.0)},
        {"correlation": 1.0},
    ):
        with pytest.raises(ArgumentError, match="matching"):
            MatchOptions(**wrong)
