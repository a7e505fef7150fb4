"""SRTM tile and its UTM version, the EGM96 grid, and rasterio's own sampling."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from geoposition.arrays import FloatArray
from geoposition.datum import Geoid, from_crs
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.flags import Flag, has_result
from geoposition.locate import locate
from geoposition.rays import Rays
from geoposition.rpc.formats import read_rpc
from geoposition.terrain.raster import RasterTerrain

UTM31 = "EPSG:32631"


@pytest.fixture
def dem(real_data: Path) -> Path:
    return real_data / "dem"


def places(n: int, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    lon_lat = np.radians(rng.uniform([5.05, 44.05], [5.95, 44.95], (n, 2)))
    return np.column_stack([lon_lat, np.full(n, 800.0)])


def slanted(geodetic: FloatArray, off_nadir_deg: float, azimuth_deg: float) -> Rays:
    off, azimuth = np.radians([off_nadir_deg, azimuth_deg])
    local = [np.sin(off) * np.sin(azimuth), np.sin(off) * np.cos(azimuth), -np.cos(off)]
    target = geodetic_to_ecef(geodetic)
    direction = enu_axes(geodetic) @ np.array(local)
    return Rays(target - 7e5 * direction, direction, np.zeros(len(target), np.uint8))


def test_heights_at_nodes_are_rasterios_plus_the_geoid(dem: Path) -> None:
    geoid = Geoid.from_file(dem / "egm96_15.gtx")
    terrain = RasterTerrain(dem / "N44E005.hgt", dem / "egm96_15.gtx")
    rng = np.random.default_rng(1)
    row, col = rng.integers(0, 1201, (2, 5000))
    with rasterio.open(dem / "N44E005.hgt") as raster:
        lon, lat = (np.asarray(part) for part in raster.xy(row, col))
        sampled = np.array([value[0] for value in raster.sample(zip(lon, lat, strict=True))])
    geodetic = np.radians(np.column_stack([lon, lat]))
    found = terrain.height_at(geodetic)
    hole = sampled == -32768
    np.testing.assert_array_equal(found.flag == Flag.NODATA, hole)
    expected = sampled[~hole] + geoid.undulation_m(geodetic)[~hole]
    np.testing.assert_allclose(found.height_m[~hole], expected, atol=1e-5)
    assert "SRTM" not in terrain.provenance[1]
    assert "EGM96" in RasterTerrain(dem / "N44E005.hgt").provenance[1]


def test_utm_nodes_are_rasterios(dem: Path) -> None:
    terrain = RasterTerrain(dem / "N44E005_UTM.tif")
    rng = np.random.default_rng(2)
    with rasterio.open(dem / "N44E005_UTM.tif") as raster:
        band = raster.read(1)
        row, col = rng.integers(0, min(band.shape), (2, 5000))
        x, y = (np.asarray(part) for part in raster.xy(row, col))
    geodetic = from_crs(UTM31, np.column_stack([x, y, np.zeros(5000)]))
    # the table's place is right to 1e-4 pixel, and cliffs are 500 m per pixel; what lies on a
    # node is interpolated with its neighbours there, so holes spread by one pixel
    found = terrain.height_at(geodetic)
    ok = found.flag == Flag.OK
    assert ok.mean() > 0.9
    np.testing.assert_allclose(found.height_m[ok], band[row, col][ok], atol=0.05)


def test_the_tile_and_its_utm_version_agree_within_the_resampling(dem: Path) -> None:
    a = RasterTerrain(dem / "N44E005.hgt", dem / "egm96_15.gtx")
    b = RasterTerrain(dem / "N44E005_UTM.tif", dem / "egm96_15.gtx")
    geodetic = places(50_000)
    first, second = a.height_at(geodetic), b.height_at(geodetic)
    both = (first.flag == Flag.OK) & (second.flag == Flag.OK)
    assert both.mean() > 0.98
    difference = (first.height_m - second.height_m)[both]
    # integer metres and a resampling of 92 m x 66 m to 90 m pixels: no bias, metres of noise
    assert abs(np.mean(difference)) < 0.1
    assert np.median(np.abs(difference)) < 1.5
    assert np.std(difference) < 4.0


@pytest.mark.parametrize("name", ["N44E005.hgt", "N44E005_UTM.tif"])
def test_crossings_lie_on_the_surface_and_on_the_ray(dem: Path, name: str) -> None:
    terrain = RasterTerrain(dem / name, dem / "egm96_15.gtx")
    for off, azimuth in ((3.0, 10.0), (35.0, 100.0), (60.0, 280.0)):
        rays = slanted(places(20_000, 3), off, azimuth)
        found = terrain.first_crossing(rays)
        ok = found.flag == Flag.OK
        assert ok.mean() > 0.93
        assert set(np.unique(found.flag)) <= {Flag.OK, Flag.NODATA, Flag.OUTSIDE_TERRAIN}
        there = terrain.height_at(found.geodetic[ok])
        np.testing.assert_allclose(there.height_m, found.geodetic[ok, 2], atol=1e-4)
        aside = geodetic_to_ecef(found.geodetic[ok]) - rays.at(found.range_m)[ok]
        assert np.max(np.linalg.norm(aside, axis=-1)) < 1e-5


def test_height_range_of_the_tile(dem: Path) -> None:
    with rasterio.open(dem / "N44E005.hgt") as raster:
        band = raster.read(1, masked=True)
    terrain = RasterTerrain(dem / "N44E005.hgt")
    low, high = terrain.height_range_m(np.radians([[5.0, 44.0], [6.0, 45.0]]))
    assert (low, high) == (float(band.min()), float(band.max()))


def test_locate_on_the_tile_agrees_with_the_models_own_height(real_data: Path) -> None:
    """An RPC over the Ventoux: each point is the model's own at its height, and on the DEM."""
    model = read_rpc(real_data / "stereo" / "pleiades_ventoux" / "left_image.tif")
    terrain = RasterTerrain(real_data / "dem" / "N44E005.hgt", real_data / "dem" / "egm96_15.gtx")
    rng = np.random.default_rng(4)
    image = rng.uniform(0, 1, (20_000, 2)) * np.array(model.shape)
    found = locate(model, image, terrain)
    ok = has_result(found.flag)
    assert ok.mean() > 0.95
    height = found.geodetic[ok, 2]
    np.testing.assert_allclose(terrain.height_at(found.geodetic[ok]).height_m, height, atol=1e-4)
    exact = geodetic_to_ecef(model.image_to_ground(image[ok], height).geodetic)
    moved = np.linalg.norm(exact - geodetic_to_ecef(found.geodetic[ok]), axis=-1)
    assert np.max(moved) < 2e-4
