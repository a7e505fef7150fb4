"""First crossings against closed forms and against a dense march along the ray."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.flags import Flag
from geoposition.rays import Rays
from geoposition.terrain import AnalyticTerrain, ConstantTerrain
from geoposition.terrain.raster import RasterTerrain

STEP_DEG = 1.0 / 3600.0
ROWS, COLS = 180, 200
WEST_DEG, NORTH_DEG = 7.0, 46.0


def rays_to(
    lon_lat_h: FloatArray, off_nadir_deg: FloatArray, azimuth_deg: FloatArray, range_m: float = 5e5
) -> Rays:
    """Rays that come to the geodetic points at an angle from the vertical there."""
    target = geodetic_to_ecef(lon_lat_h)
    axes = enu_axes(lon_lat_h)
    off, azimuth = np.radians(off_nadir_deg), np.radians(azimuth_deg)
    local = np.stack(
        [
            np.sin(off) * np.sin(azimuth),
            np.sin(off) * np.cos(azimuth),
            -np.cos(off) * np.ones_like(azimuth),
        ],
        axis=-1,
    )
    direction = np.einsum("...ij,...j->...i", axes, local)
    return Rays(
        target - range_m * direction, direction, np.zeros(direction.shape[:-1], dtype=np.uint8)
    )


def rugged(seed: int, roughness_m: float = 1.0, rows: int = ROWS, cols: int = COLS) -> FloatArray:
    """Mountains with slopes up to about 70 degrees at 30 m."""
    rng = np.random.default_rng(seed)
    height = np.zeros((rows, cols))
    for width, size in ((1.5, 60.0), (4.0, 300.0), (15.0, 2500.0)):
        height += size * width**0.5 * gaussian_filter(rng.normal(size=(rows, cols)), width)
    height *= roughness_m
    return np.asarray(height - height.min() + 200.0)


def write(
    path: Path, height: FloatArray, crs: str = "EPSG:4326", transform: object = None, **more: object
) -> Path:
    if transform is None:
        transform = Affine(STEP_DEG, 0.0, WEST_DEG, 0.0, -STEP_DEG, NORTH_DEG)
    profile = {
        "driver": "GTiff",
        "height": height.shape[0],
        "width": height.shape[1],
        "count": 1,
        "dtype": "float64",
        "crs": crs,
        "transform": transform,
        **more,
    }
    with rasterio.open(path, "w", **profile) as raster:
        raster.write(height.astype(str(profile["dtype"])), 1)
    return path


def surface(height: FloatArray, geodetic: FloatArray) -> FloatArray:
    """Independent bilinear height; NaN outside."""
    col = (np.degrees(geodetic[..., 0]) - WEST_DEG) / STEP_DEG - 0.5
    row = (NORTH_DEG - np.degrees(geodetic[..., 1])) / STEP_DEG - 0.5
    out = map_coordinates(height, [np.ravel(row), np.ravel(col)], order=1, cval=np.nan)
    return np.asarray(out).reshape(np.shape(row))


def march(height: FloatArray, rays: Rays, k: int, near_m: float, far_m: float, step_m: float):
    """First range in near .. far where ray k is not above the surface; NaN if it always is."""
    t = np.arange(near_m, far_m, step_m)
    points = rays.origin_ecef_m[k] + t[:, None] * rays.direction_ecef[k]
    geodetic = ecef_to_geodetic(points)
    below = geodetic[:, 2] <= surface(height, geodetic)
    return t[np.argmax(below)] if below.any() else np.nan


def middle_targets(n: int, rng: np.random.Generator) -> FloatArray:
    places = rng.uniform([0.4, 0.4], [0.6, 0.6], (n, 2))
    lon = WEST_DEG + places[:, 0] * COLS * STEP_DEG
    lat = NORTH_DEG - places[:, 1] * ROWS * STEP_DEG
    return np.stack([np.radians(lon), np.radians(lat), np.full(n, 1000.0)], axis=-1)


@pytest.mark.parametrize("height_m", [-400.0, 0.0, 8800.0])
def test_constant_terrain_is_met_at_its_height_everywhere(height_m: float) -> None:
    lat = np.radians([-90.0, -89.999, -45.0, 0.0, 10.0, 60.0, 89.9999, 90.0])
    places = np.stack([np.radians([0, 179.9999, -180, 33, 180, -75, 12, 0]), lat, lat * 0], -1)
    places[:, 2] = height_m
    for off in (0.0, 30.0, 60.0, 75.0):
        rays = rays_to(places, np.full(8, off), np.linspace(0, 350, 8))
        found = ConstantTerrain(height_m).first_crossing(rays)
        assert np.all(found.flag == Flag.OK)
        np.testing.assert_allclose(found.range_m, 5e5, atol=2e-6)
        np.testing.assert_allclose(found.geodetic[:, 2], height_m, atol=2e-8)


def test_constant_terrain_misses() -> None:
    up = np.array([[7e6, 0.0, 0.0]])
    flags = np.zeros(1, dtype=np.uint8)
    terrain = ConstantTerrain(0.0)
    away = terrain.first_crossing(Rays(up, np.array([[1.0, 0.0, 0.0]]), flags))
    aside = terrain.first_crossing(Rays(up, np.array([[0.0, 1.0, 0.0]]), flags))
    under = terrain.first_crossing(Rays(up * 0.9, np.array([[-1.0, 0.0, 0.0]]), flags))
    nan = terrain.first_crossing(Rays(up * np.nan, np.array([[-1.0, 0.0, 0.0]]), flags))
    for found in (away, aside, under):
        assert found.flag[0] == Flag.NO_INTERSECTION
        assert np.isnan(found.geodetic).all()
    assert nan.flag[0] == Flag.BAD_INPUT


def test_analytic_cone_is_met_where_geometry_says() -> None:
    lon0, lat0 = np.radians(20.0), np.radians(30.0)
    apex, slope = 1000.0, 1.0
    centre = geodetic_to_ecef(np.array([lon0, lat0, 0.0]))

    def cone(lon: FloatArray, lat: FloatArray) -> FloatArray:
        foot = geodetic_to_ecef(np.stack([lon, lat, np.zeros_like(lon)], axis=-1))
        return apex - slope * np.linalg.norm(foot - centre, axis=-1)

    terrain = AnalyticTerrain(cone, -3000.0, apex)
    # an almost level ray towards the axis
    target = np.array([[lon0, lat0, 600.0]])
    rays = rays_to(target, np.array([89.0]), np.array([90.0]), range_m=20e3)
    found = terrain.first_crossing(rays)
    assert found.flag[0] == Flag.OK
    reached = found.geodetic[0]
    assert reached[2] == pytest.approx(terrain.height_at(reached).height_m, abs=1e-5)
    # in the plane through the axis: 600 + x tan 1° = 1000 − x
    expected = 400.0 / (1.0 + np.tan(np.radians(1.0)))
    range_to_axis = 20e3 - found.range_m[0]
    assert range_to_axis * np.cos(np.radians(1.0)) == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize("seed", [0, 1])
def test_raster_crossings_equal_a_march_of_one_centimetre(tmp_path: Path, seed: int) -> None:
    height = rugged(seed)
    terrain = RasterTerrain(write(tmp_path / "dem.tif", height))
    rng = np.random.default_rng(10 + seed)
    n = 8
    rays = rays_to(middle_targets(n, rng), rng.uniform(0, 65, n), rng.uniform(0, 360, n))
    found = terrain.first_crossing(rays)
    assert np.all(found.flag == Flag.OK)
    top = ConstantTerrain(height.max() + 1).first_crossing(rays).range_m
    for k in range(n):
        first = march(height, rays, k, top[k], found.range_m[k] + 1.0, 0.01)
        assert first - 0.01 - 1e-4 <= found.range_m[k] <= first + 1e-4


def test_raster_crossings_lie_on_the_surface_and_on_the_ray(tmp_path: Path) -> None:
    height = rugged(5)
    terrain = RasterTerrain(write(tmp_path / "dem.tif", height))
    rng = np.random.default_rng(3)
    n = 20_000
    rays = rays_to(middle_targets(n, rng), rng.uniform(0, 70, n), rng.uniform(0, 360, n))
    found = terrain.first_crossing(rays)
    ok = found.flag == Flag.OK
    assert ok.mean() > 0.9
    there = terrain.height_at(found.geodetic[ok])
    assert np.all(there.flag == Flag.OK)
    np.testing.assert_allclose(there.height_m, found.geodetic[ok, 2], atol=1e-6)
    np.testing.assert_allclose(
        surface(height, found.geodetic[ok]), found.geodetic[ok, 2], atol=1e-6
    )
    on_ray = geodetic_to_ecef(found.geodetic[ok]) - rays.at(found.range_m)[ok]
    assert np.max(np.linalg.norm(on_ray, axis=-1)) < 5e-6


def test_hints_change_time_only(tmp_path: Path) -> None:
    terrain = RasterTerrain(write(tmp_path / "dem.tif", rugged(6)))
    rng = np.random.default_rng(4)
    rays = rays_to(middle_targets(500, rng), rng.uniform(0, 60, 500), rng.uniform(0, 360, 500))
    plain = terrain.first_crossing(rays)
    for hint in (-5e4, 0.0, 4e5, rng.uniform(0, 3000, 500)):
        hinted = terrain.first_crossing(rays, hint)
        np.testing.assert_array_equal(hinted.flag, plain.flag)
        np.testing.assert_allclose(hinted.range_m, plain.range_m, atol=5e-6)


def test_a_ridge_is_hit_and_not_the_valley_behind(tmp_path: Path) -> None:
    height = np.full((ROWS, COLS), 300.0)
    height[:, 100] = 1500.0  # a wall of one node
    terrain = RasterTerrain(write(tmp_path / "dem.tif", height))
    wall_lon = np.radians(WEST_DEG + 100.5 * STEP_DEG)
    lat = np.radians(NORTH_DEG - 90.3 * STEP_DEG)
    offsets = np.array([-2.0, -0.3, -0.01, -1e-4, 1e-4, 0.01, 0.3, 2.0])
    crest = np.stack([np.full(8, wall_lon), np.full(8, lat), 1500.0 + offsets], axis=-1)
    # look from the east, 60 degrees off nadir, just under and just over the crest
    found = terrain.first_crossing(rays_to(crest, np.full(8, 60.0), np.full(8, 270.0)))
    assert np.all(found.flag == Flag.OK)
    assert np.all(found.geodetic[:4, 2] > 1490.0)
    np.testing.assert_allclose(found.geodetic[4:, 2], 300.0, atol=1e-6)


def test_plateau_and_cliff(tmp_path: Path) -> None:
    height = np.full((ROWS, COLS), 100.0)
    height[:90] = 1100.0  # a cliff of 1000 m over one pixel, looking south
    terrain = RasterTerrain(write(tmp_path / "dem.tif", height))
    lon = np.radians(WEST_DEG + 100.2 * STEP_DEG)
    edge_lat = NORTH_DEG - 90.0 * STEP_DEG
    face = np.array([lon, np.radians(edge_lat), 600.0])
    found = terrain.first_crossing(rays_to(face, np.array(40.0), np.array(0.0)))
    # half way down the face, half way between its nodes
    assert found.flag == Flag.OK
    np.testing.assert_allclose(found.geodetic[:2], face[:2], atol=2e-12)
    assert found.geodetic[2] == pytest.approx(600.0, abs=1e-5)
    behind = terrain.first_crossing(rays_to(face, np.array(40.0), np.array(180.0)))
    assert behind.geodetic[2] == pytest.approx(1100.0, abs=1e-6)  # from the north: the plateau


@pytest.fixture(scope="module")
def mountains(tmp_path_factory: pytest.TempPathFactory) -> tuple[RasterTerrain, FloatArray]:
    height = rugged(11, 1.5)
    path = write(tmp_path_factory.mktemp("dem") / "dem.tif", height)
    return RasterTerrain(path), height


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(
    off=st.floats(0.0, 75.0),
    azimuth=st.floats(0.0, 360.0),
    row=st.floats(60.0, 120.0),
    col=st.floats(60.0, 140.0),
    aim_m=st.floats(200.0, 2500.0),
)
def test_nothing_is_met_before_the_first_crossing(
    mountains: tuple[RasterTerrain, FloatArray],
    off: float,
    azimuth: float,
    row: float,
    col: float,
    aim_m: float,
) -> None:
    terrain, height = mountains
    place = np.radians([WEST_DEG + col * STEP_DEG, NORTH_DEG - row * STEP_DEG])
    rays = rays_to(np.array([[*place, aim_m]]), np.array([off]), np.array([azimuth]))
    found = terrain.first_crossing(rays)
    top = ConstantTerrain(float(height.max()) + 1.0).first_crossing(rays).range_m[0]
    bottom = ConstantTerrain(float(height.min()) - 1.0).first_crossing(rays).range_m[0]
    first = march(height, rays, 0, top, bottom, 0.2)
    if found.flag[0] == Flag.OK:
        # the march may step over a graze of less than its step, never see one earlier
        assert not first < found.range_m[0] - 1e-3
        z = surface(height, found.geodetic[0])
        assert z == pytest.approx(found.geodetic[0, 2], abs=1e-6)
    else:
        assert found.flag[0] == Flag.OUTSIDE_TERRAIN
        assert np.isnan(first) or _starts_outside(height, rays, top)


def _starts_outside(height: FloatArray, rays: Rays, top_m: float) -> bool:
    start = ecef_to_geodetic(rays.origin_ecef_m[0] + top_m * rays.direction_ecef[0])
    return bool(np.isnan(surface(height, start)))


def test_a_ray_that_starts_under_the_ground_meets_nothing(tmp_path: Path) -> None:
    terrain = RasterTerrain(write(tmp_path / "dem.tif", np.full((ROWS, COLS), 1000.0)))
    place = np.array([np.radians(WEST_DEG + 0.02), np.radians(NORTH_DEG - 0.02), 900.0])
    assert terrain.first_crossing(rays_to(place, np.array(5.0), np.array(9.0), 10.0)).flag == (
        Flag.NO_INTERSECTION
    )
    above = terrain.first_crossing(rays_to(place, np.array(5.0), np.array(9.0), 150.0))
    assert above.flag == Flag.OK  # and one from a low aeroplane does
    assert above.geodetic[2] == pytest.approx(1000.0, abs=1e-6)


def test_batches_of_any_shape_keep_it(tmp_path: Path) -> None:
    terrain = RasterTerrain(write(tmp_path / "dem.tif", np.full((ROWS, COLS), 10.0)))
    targets = middle_targets(6, np.random.default_rng(0)).reshape(2, 3, 3)
    rays = rays_to(targets, np.full((2, 3), 10.0), np.zeros((2, 3)))
    found = terrain.first_crossing(rays, np.zeros((2, 3)))
    assert found.range_m.shape == found.flag.shape == (2, 3)
    assert found.geodetic.shape == (2, 3, 3)
    empty = terrain.first_crossing(Rays(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.uint8)))
    assert empty.flag.shape == (0,)


def test_the_rays_own_flags_stay(tmp_path: Path) -> None:
    terrain = RasterTerrain(write(tmp_path / "dem.tif", np.full((ROWS, COLS), 10.0)))
    targets = middle_targets(4, np.random.default_rng(0))
    rays = rays_to(targets, np.full(4, 10.0), np.zeros(4))
    origin = rays.origin_ecef_m.copy()
    origin[[1, 2]] = np.nan
    own = np.array([0, Flag.OUTSIDE_MODEL, 0, Flag.OUTSIDE_IMAGE], dtype=np.uint8)
    for surface_ in (terrain, ConstantTerrain(10.0)):
        found = surface_.first_crossing(Rays(origin, rays.direction_ecef, own))
        np.testing.assert_array_equal(found.flag, [0, Flag.OUTSIDE_MODEL, Flag.BAD_INPUT, 0])
