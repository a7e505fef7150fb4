"""Whole pairs and triplets with known heights: accuracy, streaming, biases, refusals."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from dense_scenes import MIDDLE_M, Pair, pair
from scipy.ndimage import map_coordinates

from geoposition.dense import (
    DenseOptions,
    DensePoints,
    ShiftedModel,
    Tally,
    coarse_surface,
    dense_points,
    mutual_shifts_px,
    shifted_models,
    terrain_field,
)
from geoposition.dense.epipolar import epipolar_tile
from geoposition.dense.ground_fit import TOLERANCE_M, ground_fit
from geoposition.dense.pair_tile import View
from geoposition.errors import ArgumentError, GeometryError
from geoposition.matching.image import Window
from geoposition.observations import TiePoints
from geoposition.terrain import ConstantTerrain
from geoposition.triangulate import triangulate_pairs

SOMEWHERE = np.array([256.0, 256.0])


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return pair(tmp_path_factory.mktemp("two"))


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return pair(
        tmp_path_factory.mktemp("three"),
        parallax=((0.8, 0.0), (-0.5, 0.5)),
        shifts=((0, 0), (0, 0)),
    )


def matched(scene: Pair, views: list[View] | None = None, **options: int) -> list[DensePoints]:
    views = views or scene.views()
    surface = coarse_surface(views, scene.start(), SOMEWHERE)
    return list(dense_points(views, surface, DenseOptions(**options)))


def errors(scene: Pair, found: list[DensePoints]) -> tuple[np.ndarray, np.ndarray]:
    """Height less truth at the first image's pixels, and the same over its sigma."""
    image = np.concatenate([part.first_px for part in found])
    height = np.concatenate([part.geodetic[:, 2] for part in found])
    sigma = np.concatenate([part.sigma_m for part in found])
    off = height - map_coordinates(scene.height_m, image.T, order=1, mode="nearest")
    return off, off / sigma


def spread(values: np.ndarray) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def test_heights_are_those_that_were_put_in(two: Pair) -> None:
    off, ratio = errors(two, matched(two))
    assert len(off) > 0.9 * two.height_m.size
    assert abs(np.median(off)) < 0.02
    assert spread(off) < 0.08
    assert np.mean(np.abs(off) > 0.5) < 0.01
    assert 0.6 < spread(ratio) < 1.7


def test_tiles_make_no_seams(two: Pair) -> None:
    """Each pixel once, and the same heights whatever the tiles."""
    large, small = matched(two), matched(two, tile_px=160)
    assert len(small) == 9
    places = np.concatenate([part.first_px for part in small])
    assert len(np.unique(places, axis=0)) == len(places)
    maps = []
    for found in (large, small):
        grid = np.full(two.height_m.shape, np.nan)
        for part in found:
            row, column = part.first_px.astype(int).T
            grid[row, column] = part.geodetic[:, 2]
        maps.append(grid)
    both = np.isfinite(maps[0]) & np.isfinite(maps[1])
    assert both.mean() > 0.9
    assert np.percentile(np.abs(maps[0] - maps[1])[both], 99) < 0.2
    # At the seams no worse than elsewhere.
    seams = both.copy()
    seams[:, [k for k in range(512) if min(abs(k - 171), abs(k - 341)) > 2]] = False
    truth = two.height_m
    assert spread((maps[1] - truth)[seams]) < 1.5 * spread((maps[1] - truth)[both])


def test_three_images_see_a_point_together(two: Pair, three: Pair) -> None:
    found = matched(three)
    rays = np.concatenate([part.rays for part in found])
    assert set(np.unique(rays)) == {2, 3}
    assert np.mean(rays == 3) > 0.7
    off, ratio = errors(three, found)
    assert abs(np.median(off)) < 0.02
    assert np.mean(np.abs(off[rays == 3]) > 0.5) < 0.005
    pairs_off, _ = errors(three, matched(three, three.views()[:2]))
    assert spread(off[rays == 3]) < spread(pairs_off)
    assert 0.6 < spread(ratio) < 1.8


def test_images_at_odds_give_no_point(three: Pair) -> None:
    """A third image whose model is 8 px off along its parallax contradicts the others."""
    views = three.views()
    wrong = ShiftedModel(three.models[2], np.array([-6.0, 6.0]))
    views[2] = View(views[2].source, wrong, wrong)
    found = matched(three, views)
    rays = np.concatenate([part.rays for part in found])
    assert np.mean(rays == 3) < 0.05


def test_ground_fit_equals_the_intersection(two: Pair) -> None:
    first, second = two.models
    tile = epipolar_tile(first, second, Window(64, 64, 384, 384), two.start())
    assert tile is not None
    fit = ground_fit(tile, first, second)
    assert fit is not None
    rng = np.random.default_rng(3)
    image = rng.uniform(64, 447, (500, 2))
    other = tile.second_px(image, rng.uniform(*tile.disparities_px, 500))
    exact = triangulate_pairs(first, second, image, other).geodetic
    off = (fit.at(image, other) - exact) * [4.6e6, 6.4e6, 1.0]
    assert np.max(np.abs(off)) < 2.0 * TOLERANCE_M


def ties_of(scene: Pair, shifts: list[tuple[float, float]]) -> TiePoints:
    rng = np.random.default_rng(6)
    image = rng.uniform(100, 400, (300, 2))
    ground = scene.models[0].image_to_ground(image, rng.uniform(480, 520, 300)).geodetic
    rows = [
        model.ground_to_image(ground).image_px + shift + rng.normal(0, 0.05, (300, 2))
        for model, shift in zip(scene.models, [(0.0, 0.0), *shifts], strict=True)
    ]
    n = len(scene.models)
    return TiePoints(np.tile(np.arange(300), n), np.repeat(np.arange(n), 300), np.concatenate(rows))


def test_a_bias_across_is_found_in_a_pair_and_the_whole_one_in_a_triplet(three: Pair) -> None:
    """Image 2 has its parallax along lines: of (1.5, −2.5) the samples show alone."""
    ties = ties_of(three, [(1.5, -2.5), (0.7, 3.1)])
    shifts = mutual_shifts_px(three.models, ties)
    np.testing.assert_allclose(shifts[0], 0.0)
    np.testing.assert_allclose(shifts[1], (0.0, -2.5), atol=0.03)
    # The pair's points are 1.5 / 0.8 m too high; the third image then looks off by so much.
    high = 1.5 / 0.8
    np.testing.assert_allclose(shifts[2], (0.7 + 0.5 * high, 3.1 - 0.5 * high), atol=0.03)
    mended = shifted_models(three.models, shifts)
    assert mended[0] is three.models[0]
    image = np.array([[200.0, 210.0]])
    ground = mended[1].image_to_ground(image, 505.0).geodetic
    np.testing.assert_allclose(mended[1].ground_to_image(ground).image_px, image, atol=1e-6)
    sight = mended[1].rays(image, 505.0)
    np.testing.assert_allclose(
        sight.direction_ecef, three.models[1].rays(image - shifts[1], 505.0).direction_ecef
    )


def test_an_image_without_ties_is_refused(three: Pair) -> None:
    ties = ties_of(three, [(0.0, 0.0), (0.0, 0.0)])
    with pytest.raises(ArgumentError, match="image 2"):
        mutual_shifts_px(three.models, ties.selected(ties.product < 2))


def test_great_relief_goes_coarse_to_fine(tmp_path: Path) -> None:
    """200 m of heights, 160 px of parallax: found, though the fine search spans far less."""
    v, u = np.mgrid[0:768, 0:768].astype(float)
    heights = MIDDLE_M + 100.0 * np.sin(v / 210.0 + 0.3) * np.cos(u / 270.0)
    scene = pair(tmp_path, 768, height_m=heights)
    tally = Tally()
    views = scene.views()
    surface = coarse_surface(views, scene.start(130.0, 130.0), np.array([384.0, 384.0]))
    found = list(dense_points(views, surface, tally=tally))
    off, _ = errors(scene, found)
    assert len(off) > 0.6 * heights.size
    assert spread(off) < 0.2
    assert np.mean(np.abs(off) > 2.0) < 0.02
    assert max(tally.disparities) < 160.0


def test_progress_and_tally(two: Pair) -> None:
    seen: list[tuple[int, int]] = []
    views, tally = two.views(), Tally()
    surface = coarse_surface(views, two.start(), SOMEWHERE)
    options = DenseOptions(tile_px=256)
    points = list(
        dense_points(views, surface, options, tally, lambda done, total: seen.append((done, total)))
    )
    assert seen == [(k, 4) for k in range(1, 5)]
    assert tally.tried == two.height_m.size
    assert tally.points == sum(map(len, points))
    assert tally.epipolar_residual_px < 0.01


def test_memory_is_that_of_a_tile(two: Pair) -> None:
    """Points are handed out tile by tile: quarter the tile, and less is held."""
    views = two.views()
    surface = coarse_surface(views, two.start(), SOMEWHERE)
    peaks = []
    for size in (512, 128):
        tracemalloc.start()
        for _ in dense_points(views, surface, DenseOptions(tile_px=size)):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 0.5 * peaks[0]


def test_a_dem_elsewhere_is_refused(two: Pair) -> None:
    field = terrain_field(two.models[0], ConstantTerrain(MIDDLE_M), Window(0, 0, 512, 512), 64.0)
    np.testing.assert_allclose(field.height_m, MIDDLE_M, atol=1e-3)
    outside = Window(20_000, 20_000, 512, 512)
    with pytest.raises(GeometryError, match="DEM"):
        terrain_field(two.models[0], ConstantTerrain(MIDDLE_M), outside, 64.0)


def test_images_of_one_direction_are_refused(two: Pair) -> None:
    view = two.views()[0]
    with pytest.raises(GeometryError, match="parallax"):
        coarse_surface([view, view], two.start(), SOMEWHERE)


def test_nothing_in_common_is_refused(two: Pair, tmp_path: Path) -> None:
    """Featureless ground: matching at the coarsest scale finds nothing to go by."""
    from dense_scenes import write

    flat = np.full(two.height_m.shape, 700.0)
    views = two.views()
    blank = Pair([two.paths[0], write(tmp_path / "flat.tif", flat)], two.models, two.height_m)
    views = blank.views()
    with pytest.raises(GeometryError, match="matches"):
        coarse_surface(views, two.start(), SOMEWHERE)
