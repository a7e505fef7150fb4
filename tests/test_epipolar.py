"""Epipolar tiles: where things lie in them, and how far models stray from their rows."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from dense_scenes import rpc
from synthetic_models import ParallelModel

from geoposition.dense.epipolar import EpipolarTile, epipolar_tile, residual_px
from geoposition.dense.height_field import HeightField, fill_holes, level_field
from geoposition.dense.resample import read_reduced, to_second
from geoposition.matching.image import ImageSource, Window

CORE = Window(1500, 1600, 400, 300)


EXTENT = Window(0, 0, 4000, 4000)


def bumpy() -> HeightField:
    flat = level_field(EXTENT, 500.0, 50.0)
    rng = np.random.default_rng(1)
    heights = (flat.height_m + rng.normal(0, 3.0, flat.height_m.shape)).astype(np.float32)
    return HeightField(flat.first_px, 50.0, heights, flat.low_m - 20.0, flat.high_m + 30.0)


def models(turn_rad: float, lean: tuple[float, float]) -> tuple[ParallelModel, ParallelModel]:
    return ParallelModel((0.02, -0.05)), ParallelModel(lean, turn_rad=turn_rad)


@pytest.mark.parametrize(
    ("turn_rad", "lean", "reduction"),
    list(product((0.0, 0.3, 1.4), ((0.0, 0.4), (0.35, 0.2)), (1, 4))),
)
def test_a_point_off_the_surface_stays_in_its_row(
    turn_rad: float, lean: tuple[float, float], reduction: int
) -> None:
    """Parallel lines of sight: rows are exact, and disparities are proportional to height."""
    first, second = models(turn_rad, lean)
    tile = epipolar_tile(first, second, CORE, bumpy(), reduction)
    assert tile is not None
    assert residual_px(tile, first, second) < 1e-4
    level = level_field(Window(0, 0, 4000, 4000), 500.0, 50.0).within(-20.0, 30.0)
    plain = epipolar_tile(first, second, CORE, level, reduction)
    assert plain is not None
    image = np.array([[1600.0, 1650.0], [1888.0, 1888.0]])
    for above in (-15.0, 0.0, 25.0):
        truth = second.ground_to_image(first.image_to_ground(image, 500.0 + above).geodetic)
        found = plain.second_px(image, np.full(2, above * plain.px_per_m))
        np.testing.assert_allclose(found, truth.image_px, atol=2e-3)


def test_the_range_of_heights_becomes_that_of_disparities() -> None:
    first, second = models(0.0, (0.0, 0.4))
    level = level_field(Window(0, 0, 4000, 4000), 500.0, 50.0).within(-20.0, 30.0)
    tile = epipolar_tile(first, second, CORE, level, slack_px=4.0)
    assert tile is not None
    ends = sorted((-20.0 * tile.px_per_m, 30.0 * tile.px_per_m))
    assert tile.disparities_px[0] == pytest.approx(ends[0] - 4.0, abs=1.0)
    assert tile.disparities_px[1] == pytest.approx(ends[1] + 4.0, abs=1.0)


def test_bent_epipolar_lines_show_in_the_residual() -> None:
    """A sight bent by b px per km² leaves its row by about b times the square of the height."""
    first = ParallelModel((0.0, 0.0))
    second = ParallelModel((0.4, 0.0), bend_px=400.0)
    level = level_field(Window(0, 0, 4000, 4000), 100.0, 50.0).within(-100.0, 100.0)
    tile = epipolar_tile(first, second, CORE, level)
    assert tile is not None
    # Lines: 400 (h / km)² about its tangent at 100 m, 100 m away, is 4 px.
    assert residual_px(tile, first, second) == pytest.approx(4.0, rel=0.2)
    near = epipolar_tile(first, second, CORE, level.within(-10.0, 10.0))
    assert near is not None
    assert residual_px(near, first, second) < 0.2


def test_no_parallax_is_no_tile() -> None:
    first, _ = models(0.0, (0.0, 0.4))
    assert epipolar_tile(first, first, CORE, bumpy()) is None


def test_no_common_ground_is_no_tile() -> None:
    first = ParallelModel((0.0, 0.0))
    second = ParallelModel((0.0, 0.4), shift_px=(50_000.0, 0.0))
    assert epipolar_tile(first, second, CORE, bumpy()) is None


@pytest.mark.parametrize("lean", [(0.0, 0.4), (0.4, 0.05), (-0.3, 0.28)])
def test_both_views_show_the_same_ground(lean: tuple[float, float]) -> None:
    """Grey values that are functions of the ground: equal in both views of the true surface."""
    first, second = ParallelModel((0.0, 0.0)), ParallelModel(lean, turn_rad=0.2)
    field = bumpy()
    tile = epipolar_tile(first, second, CORE, field)
    assert tile is not None
    window = tile.first_window
    grid = np.mgrid[
        window.line : window.line + window.lines, window.sample : window.sample + window.samples
    ].astype(float)

    def shade(line: np.ndarray, sample: np.ndarray) -> np.ndarray:
        return 100.0 * np.sin(line / 9.0) * np.cos(sample / 11.0)

    a = tile.view_first(shade(*grid).astype(np.float32), window)
    other = tile.second_window()
    # What the second image shows: found by resampling the first along the tile's own mapping.
    v, u = np.mgrid[0 : tile.shape[0], 0 : tile.shape[1]].astype(float)
    place = tile.origin_px + v[..., None] * tile.e_v + u[..., None] * tile.e_u
    np.testing.assert_allclose(a, shade(place[..., 0], place[..., 1]), atol=0.05)
    seen = tile.second_px(place.reshape(-1, 2), 0.0)
    assert np.all(seen >= (other.line, other.sample))
    assert np.all(seen <= (other.line + other.lines, other.sample + other.samples))
    ramp = np.mgrid[
        other.line : other.line + other.lines, other.sample : other.sample + other.samples
    ].astype(np.float32)
    for axis in range(2):
        b = tile.view_second(np.ascontiguousarray(ramp[axis]), other)
        np.testing.assert_allclose(b.reshape(-1), seen[:, axis], atol=2e-3)


def test_disparities_go_back_to_the_pixels_of_the_first_image() -> None:
    """A disparity that is linear over the tile is found at every pixel, whatever the shear."""
    first, second = ParallelModel((0.0, 0.0)), ParallelModel((0.3, 0.25))
    tile = epipolar_tile(first, second, CORE, bumpy())
    assert tile is not None
    v, u = np.mgrid[0 : tile.shape[0], 0 : tile.shape[1]].astype(np.float32)
    disparity = (2.0 + 0.01 * v - 0.02 * u).astype(np.float32)
    disparity[10:20, 30:40] = np.nan
    second_px = np.empty((CORE.lines, CORE.samples, 2))
    sigma = np.empty((CORE.lines, CORE.samples), dtype=np.float32)
    major = int(np.argmax(np.abs(tile.e_u)))
    offset = np.array([CORE.line, CORE.sample]) - tile.origin_px
    row = offset[1 - major] - tile.e_u[1 - major] * offset[major]
    to_second(
        disparity, np.ones_like(disparity), np.array([row, offset[major]]), major,
        np.array([CORE.line, CORE.sample], dtype=float), tile.e_u, 1.0, *tile.kernel_parts(),
        second_px, sigma,
    )  # fmt: skip
    grid = np.mgrid[0 : CORE.lines, 0 : CORE.samples].reshape(2, -1).T.astype(float)
    image = grid + (CORE.line, CORE.sample)
    along = image[:, major] - tile.origin_px[major]
    across = image[:, 1 - major] - tile.origin_px[1 - major] - tile.e_u[1 - major] * along
    expected = tile.second_px(image, 2.0 + 0.01 * across - 0.02 * along)
    found = second_px.reshape(-1, 2)
    known = np.isfinite(found[:, 0])
    assert known.mean() > 0.99
    np.testing.assert_allclose(found[known], expected[known], atol=1e-3)


def test_reduced_pixels_are_means(tmp_path: object) -> None:
    rng = np.random.default_rng(2)
    grey = rng.normal(size=(40, 60))

    class Memory(ImageSource):
        def read(self, window: Window) -> np.ndarray:
            return grey[
                window.line : window.line + window.lines,
                window.sample : window.sample + window.samples,
            ]

    source = Memory(None, (40, 60))  # type: ignore[arg-type]
    found = read_reduced(source, Window(-3, 4, 30, 80), 4)
    assert found is not None
    reduced, window = found
    assert window == Window(1, 4, 24, 56)
    block = grey[1:25, 4:60].reshape(6, 4, 14, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(reduced, block, atol=1e-6)
    assert read_reduced(source, Window(100, 0, 8, 8), 4) is None


def test_holes_are_filled_between_their_edges() -> None:
    v, u = np.mgrid[0:60, 0:80]
    plane = (100.0 + 0.5 * v - 0.25 * u).astype(np.float32)
    holed = plane.copy()
    holed[20:35, 30:50] = np.nan
    filled = fill_holes(holed)
    assert np.array_equal(filled[np.isfinite(holed)], plane[np.isfinite(holed)])
    assert np.max(np.abs(filled - plane)) < 4.0
    assert plane.min() <= filled.min() <= filled.max() <= plane.max()


def test_rpc_models_have_tiles_too() -> None:
    first, second = rpc(512, 0.0), rpc(512, 0.6, 0.3)
    level = level_field(Window(0, 0, 512, 512), 500.0, 64.0).within(-20.0, 20.0)
    tile = epipolar_tile(first, second, Window(100, 100, 256, 256), level)
    assert isinstance(tile, EpipolarTile)
    assert residual_px(tile, first, second) < 1e-3
    assert abs(tile.px_per_m) == pytest.approx(0.6, rel=1e-3)
