"""Location on terrain with a made-up push-broom whose rays are straight, or bend by a known law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.locate import _fitted, _locate, _locate_bent, locate
from geoposition.rays import Rays
from geoposition.sensor_model import GroundPoints, ImagePoints, SensorModel
from geoposition.terrain import AnalyticTerrain, ConstantTerrain, Terrain
from geoposition.terrain.raster import RasterTerrain

LON0, LAT0 = np.radians(7.1), np.radians(45.9)
STEP_DEG = 1.0 / 3600.0


@dataclass(frozen=True, slots=True)
class SlidingCamera:
    """A camera that slides north 600 km up, 1 m a line, 1.5 m a sample, looking `tilt` aside.

    The point of height h is put `bend` (h / 1000)² metres east of the straight line, so a ray
    is exact at its own height only.
    """

    tilt: float = 0.3
    bend: float = 0.0
    shape: tuple[int, int] = (2000, 2000)
    height_range_m: tuple[float, float] = (0.0, 3000.0)

    def _straight(self, image_px: FloatArray) -> Rays:
        line, sample = image_px[..., 0], image_px[..., 1]
        centre = geodetic_to_ecef(np.array([LON0, LAT0, 0.0]))
        axes = enu_axes(np.array([LON0, LAT0, 0.0]))
        east = np.full(line.shape, -600e3 * self.tilt)
        origin = np.stack([east, line - 1000.0, np.full(line.shape, 600e3)], axis=-1)
        slope = self.tilt + (sample - 1000.0) * 1.5 / 600e3
        down = np.stack([slope, np.zeros(line.shape), -np.ones(line.shape)], axis=-1)
        down /= np.linalg.norm(down, axis=-1, keepdims=True)
        flag = np.zeros(line.shape, dtype=np.uint8)
        inside = np.all((image_px > -0.5) & (image_px < np.array(self.shape) - 0.5), axis=-1)
        near = np.all(np.abs(image_px - 1000.0) < 1500.0, axis=-1)
        flag[~inside] = Flag.OUTSIDE_IMAGE
        flag[~near] = Flag.OUTSIDE_MODEL
        origin = np.where(near[..., None], centre + origin @ axes.T, np.nan)
        return Rays(origin, down @ axes.T, flag)

    def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
        straight = self._straight(np.asarray(image_px, dtype=np.float64))
        east = enu_axes(np.array([LON0, LAT0, 0.0]))[:, 0]
        aside = self.bend * (np.asarray(height_m, dtype=np.float64) / 1000.0) ** 2
        shifted = straight.origin_ecef_m + np.asarray(aside)[..., None] * east
        return Rays(shifted, straight.direction_ecef, straight.flag)

    def image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> GroundPoints:
        image = np.asarray(image_px, dtype=np.float64)
        height = np.broadcast_to(np.asarray(height_m, dtype=np.float64), image.shape[:-1])
        rays = self.rays(image, height)
        geodetic, flag = np.full((*height.shape, 3), np.nan), np.array(rays.flag)
        for at in np.ndindex(height.shape):
            one = Rays(rays.origin_ecef_m[at], rays.direction_ecef[at], rays.flag[at])
            found = ConstantTerrain(float(height[at])).first_crossing(one)
            geodetic[at] = found.geodetic
        return GroundPoints(geodetic, flag)

    def ground_to_image(self, geodetic: ArrayLike) -> ImagePoints:
        raise NotImplementedError


@pytest.fixture(scope="module")
def terrain(tmp_path_factory: pytest.TempPathFactory) -> RasterTerrain:
    rng = np.random.default_rng(0)
    height = 800.0 + 2500.0 * gaussian_filter(rng.normal(size=(500, 600)), 6.0) * 6.0
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=500, width=600, count=1, dtype="float64",
        crs="EPSG:4326", transform=Affine(STEP_DEG, 0.0, 7.02, 0.0, -STEP_DEG, 45.97),
    ) as raster:  # fmt: skip
        raster.write(height, 1)
    return RasterTerrain(path)


def image_points(n: int, seed: int = 1) -> FloatArray:
    return np.random.default_rng(seed).uniform(0, 1999, (n, 2))


def assert_on_ray_and_ground(
    model: SlidingCamera, image: FloatArray, terrain: Terrain, found: GroundPoints
) -> None:
    """The model's own ray, exact at the found height, passes the found point of the surface."""
    height = found.geodetic[:, 2]
    rays = model.rays(image, height)
    offset = geodetic_to_ecef(found.geodetic) - rays.origin_ecef_m
    aside = np.linalg.norm(np.cross(offset, rays.direction_ecef), axis=-1)
    assert np.max(aside) < 1e-4
    np.testing.assert_allclose(terrain.height_at(found.geodetic).height_m, height, atol=1e-4)


def test_the_synthetic_camera_is_a_sensor_model() -> None:
    assert isinstance(SlidingCamera(), SensorModel)


@pytest.mark.parametrize("bend", [0.0, 0.3, 5.0])
@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.2])
def test_points_lie_on_the_ground_and_on_their_bent_rays(
    terrain: RasterTerrain, tilt: float, bend: float
) -> None:
    model = SlidingCamera(tilt, bend)
    image = image_points(3000)
    found = locate(model, image, terrain)
    assert np.mean(found.flag == Flag.OK) > 0.99
    ok = found.flag == Flag.OK
    assert set(np.unique(found.flag)) <= {Flag.OK, Flag.NOT_CONVERGED}
    assert_on_ray_and_ground(
        model, image[ok], terrain, GroundPoints(found.geodetic[ok], found.flag[ok])
    )


@pytest.mark.parametrize("bend", [0.0, 0.3])
@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.2])
def test_many_points_follow_the_fitted_bending(
    terrain: RasterTerrain, tilt: float, bend: float
) -> None:
    model = SlidingCamera(tilt, bend)
    image = image_points(6000)
    bend = _fitted(model, image, terrain, 1500.0)
    assert bend is not None
    found = _locate_bent(model, image, terrain, bend)
    assert found is not None  # the model confirmed it
    one_by_one, flag = _locate(model, image, terrain, 1500.0)
    # a bent ray that touches a ridge may end on it here and not settle there
    same = (found[1] == flag) & (np.abs(found[0][:, 2] - one_by_one[:, 2]) < 1e-3)
    assert np.mean(same) > 0.998
    assert np.mean(found[1] == Flag.OK) > 0.99
    assert_on_ray_and_ground(model, image[same], terrain, GroundPoints(found[0][same], flag[same]))


def test_a_bending_that_cannot_be_fitted_is_noticed(terrain: RasterTerrain) -> None:
    @dataclass(frozen=True, slots=True)
    class Trembling(SlidingCamera):
        def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
            image = np.asarray(image_px, dtype=np.float64)
            rays = SlidingCamera.rays(self, image, height_m)
            height = np.asarray(height_m, dtype=np.float64)
            aside = 0.05 * np.sin(image[..., 0] / 3.0) * height / 1000.0
            east = enu_axes(np.array([LON0, LAT0, 0.0]))[:, 0]
            return Rays(
                rays.origin_ecef_m + aside[..., None] * east, rays.direction_ecef, rays.flag
            )

    model = Trembling()
    image = image_points(6000)
    bend = _fitted(model, image, terrain, 1500.0)
    assert bend is not None
    assert _locate_bent(model, image, terrain, bend) is None
    found = locate(model, image, terrain)
    ok = found.flag == Flag.OK
    assert ok.mean() > 0.99
    assert_on_ray_and_ground(
        model, image[ok], terrain, GroundPoints(found.geodetic[ok], found.flag[ok])
    )


def test_constant_terrain_is_the_models_own_answer() -> None:
    model = SlidingCamera(bend=1.0)
    image = image_points(20)
    found = locate(model, image, ConstantTerrain(700.0))
    np.testing.assert_array_equal(found.geodetic, model.image_to_ground(image, 700.0).geodetic)


def test_analytic_and_constant_agree_on_flat_ground() -> None:
    model = SlidingCamera(bend=2.0)
    image = image_points(30)
    flat = AnalyticTerrain(lambda lon, lat: 700.0 + 0.0 * lon, 600.0, 800.0)
    found = locate(model, image, flat)
    constant = locate(model, image, ConstantTerrain(700.0))
    moved = geodetic_to_ecef(found.geodetic) - geodetic_to_ecef(constant.geodetic)
    assert np.max(np.linalg.norm(moved, axis=-1)) < 1e-4


def test_flags_keep_their_points_and_the_others_results(terrain: RasterTerrain) -> None:
    image = np.array(
        [[1000.0, 1000.0], [-100.0, 1000.0], [1000.0, -9000.0], [np.nan, 5.0], [500.0, 500.0]]
    )
    found = locate(SlidingCamera(bend=0.5), image, terrain)
    assert found.flag[0] == found.flag[4] == Flag.OK
    assert found.flag[1] == Flag.OUTSIDE_IMAGE
    assert np.all(np.isfinite(found.geodetic[[0, 1, 4]]))
    assert found.flag[2] == Flag.OUTSIDE_MODEL
    assert found.flag[3] not in (Flag.OK, Flag.OUTSIDE_IMAGE)
    assert np.all(np.isnan(found.geodetic[[2, 3]]))


def test_bad_points_among_many_cost_the_others_nothing(terrain: RasterTerrain) -> None:
    model = SlidingCamera(0.3, 0.3)
    image = image_points(6000)
    image[[3, 700]] = np.nan
    image[5, 0] = np.inf
    image[9] = -1e6
    found = locate(model, image, terrain)
    lost = np.isin(np.arange(6000), [3, 5, 9, 700])
    assert np.all(np.isnan(found.geodetic[lost]))
    assert not np.any(np.isin(found.flag[lost], [Flag.OK, Flag.OUTSIDE_IMAGE]))
    good = locate(model, image[~lost], terrain)
    np.testing.assert_array_equal(found.flag[~lost], good.flag)
    # two fits of the bending, each right to 1e-4 m aside, on slopes of up to 10
    np.testing.assert_allclose(found.geodetic[~lost], good.geodetic, rtol=0, atol=1e-3)
    nothing = locate(model, np.full((6000, 2), np.nan), terrain)
    assert np.all(np.isnan(nothing.geodetic))


def test_chunks_change_nothing_and_progress_is_told(terrain: RasterTerrain) -> None:
    model = SlidingCamera(0.4, 0.8)
    image = image_points(1000).reshape(10, 100, 2)
    told: list[tuple[int, int]] = []
    whole = locate(model, image, terrain)
    parts = locate(model, image, terrain, lambda done, total: told.append((done, total)), chunk=300)
    assert told == [(300, 1000), (600, 1000), (900, 1000), (1000, 1000)]
    assert whole.geodetic.shape == (10, 100, 3)
    np.testing.assert_array_equal(whole.flag, parts.flag)
    moved = geodetic_to_ecef(whole.geodetic) - geodetic_to_ecef(parts.geodetic)
    assert np.nanmax(np.linalg.norm(moved, axis=-1)) < 1e-3


def test_nothing_in_nothing_out_and_bad_shapes(terrain: RasterTerrain) -> None:
    empty = locate(SlidingCamera(), np.zeros((0, 2)), terrain)
    assert empty.geodetic.shape == (0, 3)
    with pytest.raises(ArgumentError, match="image points"):
        locate(SlidingCamera(), np.zeros((4, 3)), terrain)
    with pytest.raises(ArgumentError, match="chunk"):
        locate(SlidingCamera(), np.zeros((4, 2)), terrain, chunk=0)


def test_a_scene_beside_the_raster_is_outside(terrain: RasterTerrain) -> None:
    far = SlidingCamera(tilt=0.35)
    moved = locate(far, image_points(50), terrain)
    assert np.all(moved.flag == Flag.OK)
    beside = AnalyticTerrain(lambda lon, lat: np.full(lon.shape, np.nan), 0.0, 10.0)
    assert np.all(locate(far, image_points(5), beside).flag == Flag.NODATA)
