"""From steady pixels to jittered ones: exact, within its bound, for one CCD and for several."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes
from scipy import ndimage

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.mapping import map_models
from geoposition.reimage.resample import Resampler
from geoposition.reimage.steady import steady_model
from geoposition.reimage.strips import displacement_px, parts_of, strips
from geoposition.reimage.virtual import cropped_model, ideal_camera, single_ccd
from geoposition.terrain import AnalyticTerrain

JITTER = (scenes.Jitter(0, 2e-6, 40.0), scenes.Jitter(1, 1.5e-6, 60.0, 1.0))


@pytest.fixture(scope="module")
def taken() -> PushbroomModel:
    scene = scenes.build(
        (1200, 900), jitter=JITTER, roll_deg=6.0, camera="polynomial", attitude_step_s=0.001,
        attitude="spline", spare_s=1.0,
    )  # fmt: skip
    return scene.model()


@pytest.fixture(scope="module")
def steady(taken: PushbroomModel) -> PushbroomModel:
    return steady_model(taken)[0]


def hills(lon: FloatArray, lat: FloatArray) -> FloatArray:
    return 400.0 + 150.0 * np.sin(lon * 6.4e6 / 700.0) * np.cos(lat * 6.4e6 / 500.0)


def random_pixels(shape: tuple[int, int], n: int) -> FloatArray:
    rng = np.random.default_rng(4)
    return np.floor(rng.uniform(0.0, 1.0, (n, 2)) * shape)


@pytest.mark.parametrize("bound", [0.005, 0.0005])
def test_every_pixel_is_within_the_bound(
    taken: PushbroomModel, steady: PushbroomModel, bound: float
) -> None:
    mapping = map_models(steady, taken, 300.0, bound)
    rows = mapping.rows(0, 1200)
    image = random_pixels(steady.shape, 4000)
    exact = taken.ground_to_image(steady.image_to_ground(image, 300.0).geodetic).image_px
    each = np.arange(900.0)
    place = rows.displacement_px(each)[image[:, 0].astype(int), image[:, 1].astype(int)] + image
    assert np.abs(place - exact).max() <= bound
    assert rows.error_px <= bound
    assert np.abs(place - image).max() > 1.0


def test_on_terrain_the_same_ground_is_seen(taken: PushbroomModel, steady: PushbroomModel) -> None:
    terrain = AnalyticTerrain(hills, 250.0, 550.0)
    mapping = map_models(steady, taken, terrain)
    rows = mapping.rows(400, 500)
    image = np.stack(np.meshgrid(np.arange(400.0, 500.0, 9), np.arange(5.0, 900.0, 40),
                                 indexing="ij"), axis=-1)  # fmt: skip
    from geoposition.locate import locate

    exact = taken.ground_to_image(locate(steady, image, terrain).geodetic).image_px
    place = rows.displacement_px(image[0, :, 1])[::9] + image
    assert np.abs(place - exact).max() <= 0.005
    # the height matters, and how much is stated
    flat = map_models(steady, taken, 400.0).rows(400, 500).displacement_px(image[0, :, 1])[::9]
    apart = np.abs(flat + image - exact).max()
    assert apart <= 200.0 * mapping.parallax_px_m.max() + 0.005


def test_windows_of_rows_are_parts_of_the_whole(
    taken: PushbroomModel, steady: PushbroomModel
) -> None:
    mapping = map_models(steady, taken, 300.0)
    whole, part = mapping.rows(0, 1200), mapping.rows(300, 340)
    assert whole.part(300, 340).places == pytest.approx(part.places, abs=1e-9)
    low, high = part.source_lines() or (0.0, 0.0)
    assert 290.0 < low < 310.0
    assert 330.0 < high < 350.0


def test_a_crop_is_the_whole_shifted(taken: PushbroomModel) -> None:
    crop = cropped_model(taken, 200, 100, (500, 600))
    image = random_pixels((500, 600), 500)
    whole = taken.image_to_ground(image + (200, 100), 120.0).geodetic
    assert crop.image_to_ground(image, 120.0).geodetic == pytest.approx(whole, abs=1e-12)
    assert crop.ground_to_image(whole).image_px == pytest.approx(image, abs=1e-5)
    assert cropped_model(taken, 0, 0, taken.shape) is taken
    with pytest.raises(ArgumentError, match="not all within"):
        cropped_model(taken, 1000, 0, (500, 600))


def test_models_that_see_different_ground_are_refused(taken: PushbroomModel) -> None:
    other = scenes.build((400, 300), orbit=scenes.Orbit.over(0.9, 0.1)).model()
    with pytest.raises(GeometryError, match="sees no pixel"):
        map_models(other, taken, 0.0)
    with pytest.raises(ArgumentError, match="positive bound"):
        map_models(taken, taken, 0.0, 0.0)


@pytest.mark.parametrize("overlap", [40, -6])
def test_an_ideal_line_is_stitched_from_staggered_ccds(overlap: int) -> None:
    """Three CCDs in two rows; the ground is a function of place, so every pixel is known."""
    ifov = 0.7 / 600e3
    ccds = scenes.focal_plane(3, 300, ifov, overlap_px=overlap, stagger_px=50)
    scene = scenes.build(
        (600, 900), ccds=ccds, jitter=JITTER, attitude_step_s=0.001, attitude="spline",
        spare_s=1.0,
    )  # fmt: skip
    taken = scene.model()
    smooth, _ = steady_model(taken)
    camera, segments = ideal_camera(smooth.camera)
    ideal = replace(smooth, camera=camera)
    assert ideal.shape == (600, 900 - 2 * overlap)
    assert [segment.number for segment in segments] == [0, 1, 2]
    tangents = camera.tangents(0, np.arange(5.0))
    assert np.ptp(np.diff(tangents, axis=0), axis=0) == pytest.approx([0.0, 0.0], abs=1e-18)

    image = np.concatenate(
        [brightness(single_ccd(taken, number), 300) for number in range(3)], axis=1
    )
    parts = parts_of(ideal, taken, 200.0, segments)
    made = list(strips(parts, lambda a, b: np.ascontiguousarray(image[None, a:b]),
                       Resampler("cubic"), rows=128))  # fmt: skip
    pixels = np.concatenate([strip.pixels[0] for strip in made])
    valid = np.concatenate([strip.valid for strip in made]) != 0
    wanted = brightness(ideal, ideal.shape[1])
    # where pixels are missing the kernel makes do with those that are there
    inner = ndimage.binary_erosion(valid, iterations=4)
    assert np.abs(pixels - wanted)[inner].max() < 0.5  # of 1000: cubic on waves of 40 px
    # 8 columns at the field's edges and 3 at a gap's come and go with the jitter
    seen = valid[80:-80].mean(axis=0)[8:-8]
    if overlap > 0:
        assert seen.min() == 1.0
    else:
        assert 2 <= np.sum(seen < 0.01) <= -2 * overlap
        assert -2 * overlap <= np.sum(seen < 0.99) <= 2 * (6 - overlap)
    moved = displacement_px(parts, made[1], np.array([10.0, 450.0]))
    assert np.isfinite(moved).all()


def brightness(model: PushbroomModel, samples: int) -> FloatArray:
    """Image of a ground of waves as `model` sees it, float32 (lines, samples)."""
    lines = model.shape[0]
    image = np.stack(
        np.meshgrid(
            np.arange(lines, dtype=np.float64), np.arange(samples, dtype=np.float64), indexing="ij"
        ),
        axis=-1,
    )
    ground = model.image_to_ground(image, 200.0).geodetic
    k = 6.4e6 * 2 * np.pi / 28.0
    waves = np.sin(ground[..., 0] * k * 0.7) + np.cos(ground[..., 1] * k)
    return np.asarray(1000.0 + 200.0 * waves, dtype=np.float32)  # type: ignore[return-value]
