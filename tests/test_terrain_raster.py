"""Rasters of every kind: systems, seams, poles, holes, tiles, sizes, and unusable ones."""

from __future__ import annotations

import logging
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning

from geoposition.arrays import FloatArray
from geoposition.datum import from_crs, to_crs
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.errors import (
    ArgumentError,
    GeometryError,
    MissingFileError,
    ProductError,
    UnsupportedError,
)
from geoposition.flags import Flag
from geoposition.rays import Rays
from geoposition.terrain.raster import RasterTerrain


def write(
    path: Path,
    height: FloatArray,
    transform: Affine | None,
    crs: str | None = "EPSG:4326",
    **more: object,
) -> Path:
    profile = {
        "driver": "GTiff",
        "height": height.shape[-2],
        "width": height.shape[-1],
        "count": 1,
        "dtype": "float64",
        "crs": crs,
        "transform": transform,
        **more,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        raster = rasterio.open(path, "w", **profile)
    with raster:
        bands = height if height.ndim == 3 else height[None]
        raster.write(bands.astype(str(profile["dtype"])))
    return path


def degrees(west: float, north: float, step: float) -> Affine:
    return Affine(step, 0.0, west, 0.0, -step, north)


def hills(lon_deg: FloatArray, lat_deg: FloatArray) -> FloatArray:
    """A smooth surface, periodic in longitude, of kilometres' waves."""
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    return np.asarray(
        800.0 + 300.0 * np.sin(500.0 * lon) * np.cos(400.0 * lat) + 90.0 * np.cos(1500.0 * lat)
    )


def node_grid(transform: Affine, rows: int, cols: int) -> tuple[FloatArray, FloatArray]:
    row, col = np.mgrid[0:rows, 0:cols] + 0.5
    return (
        transform.a * col + transform.b * row + transform.c,
        transform.d * col + transform.e * row + transform.f,
    )


def cell_means(nodes: FloatArray) -> FloatArray:
    return 0.25 * (nodes[:-1, :-1] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[1:, 1:])


def straight_down(geodetic: FloatArray, tilt: float = 0.4) -> Rays:
    target = geodetic_to_ecef(geodetic)
    axes = enu_axes(geodetic)
    local = np.array([tilt, 0.3 * tilt, -1.0]) / np.linalg.norm([tilt, 0.3 * tilt, 1.0])
    direction = axes @ local
    return Rays(target - 6e5 * direction, direction, np.zeros(len(target), np.uint8))


def assert_consistent(terrain: RasterTerrain, geodetic: FloatArray, tol_m: float = 1e-4) -> None:
    found = terrain.first_crossing(straight_down(geodetic))
    assert np.all(found.flag == Flag.OK), np.unique(found.flag)
    there = terrain.height_at(found.geodetic)
    assert np.all(there.flag == Flag.OK)
    np.testing.assert_allclose(there.height_m, found.geodetic[:, 2], atol=tol_m)


# systems ------------------------------------------------------------------------------------


def test_heights_are_the_nodes_and_bilinear_between(tmp_path: Path) -> None:
    transform = degrees(5.0, 45.0, 0.01)
    height = np.random.default_rng(0).uniform(0, 1000, (30, 40))
    terrain = RasterTerrain(write(tmp_path / "a.tif", height, transform))
    lon, lat = node_grid(transform, 30, 40)
    nodes = np.radians(np.stack([lon, lat], axis=-1))
    at_nodes = terrain.height_at(nodes)
    assert np.all(at_nodes.flag == Flag.OK)  # the border nodes too
    np.testing.assert_allclose(at_nodes.height_m, height, atol=1e-6)
    middle = terrain.height_at(
        0.25 * (nodes[:-1, :-1] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[1:, 1:])
    )
    mean = 0.25 * (height[:-1, :-1] + height[1:, :-1] + height[:-1, 1:] + height[1:, 1:])
    np.testing.assert_allclose(middle.height_m, mean, atol=1e-6)
    outside = terrain.height_at(
        np.radians([[4.99, 44.9], [5.2, 45.0], [5.2, 40.0], [-170.0, 44.9]])
    )
    assert np.all(outside.flag == Flag.OUTSIDE_TERRAIN)
    bad = terrain.height_at([[np.nan, 0.7], [0.1, 1.6], [np.inf, 0.0]])
    assert np.all(bad.flag == Flag.BAD_INPUT)
    with pytest.raises(ArgumentError, match="shape"):
        terrain.height_at([1.0])


@pytest.mark.parametrize(
    ("crs", "transform"),
    [
        ("EPSG:32631", Affine(30.0, 0.0, 660000.0, 0.0, -30.0, 4985000.0)),
        ("EPSG:32760", Affine(2.0, 0.0, 450000.0, 0.0, -2.0, 5900000.0)),
        ("EPSG:3857", Affine(50.0, 0.0, -2.0037e7, 0.0, -50.0, 8e6)),
        ("EPSG:2154", Affine(25.0, 10.0, 900000.0, 10.0, -25.0, 6400000.0)),  # turned
        ("EPSG:3413", Affine(100.0, 0.0, -15000.0, 0.0, -100.0, 14000.0)),  # holds the pole
        ("EPSG:3031", Affine(500.0, 0.0, -300000.0, 0.0, -500.0, 300000.0)),
        ("EPSG:4258", Affine(0.001, 0.0, 3.0, 0.0, -0.001, 47.0)),  # another geographic system
    ],
)
def test_the_map_of_any_system_is_right_to_the_promised_bound(
    tmp_path: Path, crs: str, transform: Affine
) -> None:
    rows, cols = 280, 300
    # a plane in row and column shows errors of position: 1 m per pixel and 1000 m per pixel
    row, col = np.mgrid[0:rows, 0:cols].astype(float)
    x, y = node_grid(transform, rows, cols)
    rng = np.random.default_rng(1)
    place = rng.uniform([3, 3], [rows - 4, cols - 4], (3000, 2))
    px, py = (
        transform.a * (place[:, 1] + 0.5) + transform.b * (place[:, 0] + 0.5) + transform.c,
        (transform.d * (place[:, 1] + 0.5) + transform.e * (place[:, 0] + 0.5) + transform.f),
    )
    geodetic = from_crs(crs, np.stack([px, py, np.zeros(3000)], axis=-1))
    for number, values in enumerate((row, col)):
        terrain = RasterTerrain(write(tmp_path / f"{number}.tif", values, transform, crs))
        found = terrain.height_at(geodetic)
        assert np.all(found.flag == Flag.OK)
        assert np.max(np.abs(found.height_m - place[:, number])) < 1.2e-4  # pixels
    waves = 400.0 + 100.0 * np.sin(row / 9.0) * np.cos(col / 7.0)
    terrain = RasterTerrain(write(tmp_path / "waves.tif", waves, transform, crs))
    inner = np.all(
        (place > 0.1 * np.array([rows, cols])) & (place < 0.9 * np.array([rows, cols])), 1
    )
    inside = geodetic[inner].copy()
    inside[:, 2] = 400.0
    assert_consistent(terrain, inside, 1e-6)
    assert x.shape == y.shape


def test_longitudes_up_to_360(tmp_path: Path) -> None:
    transform = degrees(352.0, 10.0, 0.01)
    lon, lat = node_grid(transform, 60, 400)
    terrain = RasterTerrain(write(tmp_path / "a.tif", hills(lon, lat), transform))
    rng = np.random.default_rng(2)
    place = np.radians(rng.uniform([-7.9, 9.5], [-4.1, 9.9], (500, 2)))
    geodetic = np.column_stack([place, np.full(500, 800.0)])
    assert np.all(terrain.height_at(place).flag == Flag.OK)
    assert_consistent(terrain, geodetic)
    found = terrain.first_crossing(straight_down(geodetic))
    assert np.all(np.abs(found.geodetic[:, 0]) < np.pi)


def test_tiles_meet_over_the_antimeridian(tmp_path: Path) -> None:
    paths = []
    for name, west in (("east", 179.0), ("west", -180.0)):
        transform = degrees(west - 0.0025, 52.0025, 0.005)  # 201 nodes: the tiles share a column
        lon, lat = node_grid(transform, 201, 201)
        paths.append(write(tmp_path / f"{name}.tif", hills(lon % 360.0, lat), transform))
    terrain = RasterTerrain(paths)
    lon_deg = np.array([179.5, 179.9999, -179.9999, -179.5, 180.0, -180.0, 179.99])
    place = np.radians(np.column_stack([lon_deg, np.full(7, 51.5)]))
    together = terrain.height_at(place)
    assert np.all(together.flag == Flag.OK)
    np.testing.assert_allclose(together.height_m[4], together.height_m[5], atol=1e-9)
    assert_consistent(terrain, np.column_stack([place, np.full(7, 800.0)]))
    # one file alone gives the same on its side
    alone = RasterTerrain(paths[1]).height_at(place[2:4])
    np.testing.assert_allclose(alone.height_m, together.height_m[2:4], atol=1e-9)


def test_a_global_raster_has_no_seam(tmp_path: Path) -> None:
    transform = degrees(-180.0, 90.0, 0.1)
    lon, lat = node_grid(transform, 1800, 3600)
    height = 500.0 + 400.0 * np.cos(np.radians(lat)) * np.sin(np.radians(3 * lon))
    path = write(tmp_path / "globe.tif", height, transform, dtype="float32")
    terrain = RasterTerrain(path, max_nodes=1_100_000)  # smaller than the raster: windows
    rng = np.random.default_rng(3)
    lon_deg = np.concatenate([rng.uniform(-180, 180, 200), [180.0, -180.0, 179.99, -179.99]])
    lat_deg = np.concatenate([rng.uniform(-80, 80, 200), [10.0, 10.0, -40.0, 40.0]])
    place = np.radians(np.column_stack([lon_deg, lat_deg]))
    found = terrain.height_at(place)
    assert np.all(found.flag == Flag.OK)
    expected = 500.0 + 400.0 * np.cos(place[:, 1]) * np.sin(3 * place[:, 0])
    np.testing.assert_allclose(found.height_m, expected, atol=0.01)
    geodetic = np.column_stack([place, found.height_m])
    assert_consistent(terrain, geodetic)


def test_near_a_pole_of_a_lon_lat_raster(tmp_path: Path) -> None:
    transform = Affine(0.5, 0.0, -180.25, 0.0, -0.01, 90.005)  # a row of nodes at the pole
    lon, lat = node_grid(transform, 200, 721)
    height = 100.0 + 2000.0 * (90.0 - lat) * np.cos(np.radians(lon - 30.0)) ** 2
    terrain = RasterTerrain(write(tmp_path / "cap.tif", height, transform))
    rng = np.random.default_rng(4)
    n = 300
    place = np.column_stack(
        [
            rng.uniform(-np.pi, np.pi, n),
            np.radians(90.0 - rng.uniform(0.0, 0.5, n)),
            np.full(n, 100.0),
        ]
    )
    place[:3, 1] = np.radians([90.0, 89.99999, 89.9999])
    found = terrain.first_crossing(straight_down(place, 0.2))
    assert np.all(found.flag == Flag.OK)
    there = terrain.height_at(found.geodetic)
    np.testing.assert_allclose(there.height_m, found.geodetic[:, 2], atol=1e-4)
    on_ray = straight_down(place, 0.2).at(found.range_m) - geodetic_to_ecef(found.geodetic)
    assert np.max(np.abs(on_ray)) < 1e-4


# holes and borders --------------------------------------------------------------------------


def test_holes_are_met_only_where_they_hide_the_ground(tmp_path: Path) -> None:
    transform = degrees(5.0, 45.0, 0.001)
    height = np.full((100, 100), 500.0)
    height[40:60, 40:60] = -9999.0
    height[10, 10] = np.nan
    height[90, 90] = 3e38
    path = write(tmp_path / "a.tif", height, transform, nodata=-9999.0)
    terrain = RasterTerrain(path)
    lon, lat = node_grid(transform, 100, 100)
    nodes = np.radians(np.stack([lon, lat], axis=-1))
    got = terrain.height_at(nodes)
    hole = (height == -9999.0) | ~np.isfinite(height) | (height > 1e4)
    np.testing.assert_array_equal(got.flag == Flag.NODATA, hole)
    assert np.all(np.isnan(got.height_m[hole]))
    geodetic = np.concatenate([nodes, np.full((100, 100, 1), 500.0)], axis=-1)
    found = terrain.first_crossing(straight_down(geodetic[1:-1, 1:-1].reshape(-1, 3), 0.3))
    flag = found.flag.reshape(98, 98)
    assert np.all(flag[42:55, 42:55] == Flag.NODATA)
    assert np.all(flag[2:8, 20:80] == Flag.OK)
    assert np.all(flag[70:85, 20:80] == Flag.OK)
    # a ray over the hole, well above the ground around it, lands beyond it
    far = np.array([[*nodes[50, 62], 500.0]])
    low = straight_down(far, 1.5)  # comes from the south-west, crosses the hole's corner high up
    assert terrain.first_crossing(low).flag[0] == Flag.OK


def test_masks_and_alpha_make_holes(tmp_path: Path) -> None:
    transform = degrees(5.0, 45.0, 0.001)
    bands = np.stack([np.full((50, 50), 500.0), np.full((50, 50), 255.0)])
    bands[1, :, 25:] = 0
    path = tmp_path / "alpha.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=50, width=50, count=2, dtype="uint16",
        crs="EPSG:4326", transform=transform, alpha="yes",
    ) as raster:  # fmt: skip
        raster.write(bands.astype("uint16"))
        assert raster.colorinterp[1] == ColorInterp.alpha
    terrain = RasterTerrain(path)
    found = terrain.height_at(np.radians([[5.01, 44.98], [5.04, 44.98]]))
    np.testing.assert_array_equal(found.flag, [Flag.OK, Flag.NODATA])


def test_rays_beside_the_raster_are_outside_and_those_from_beside_come_in(tmp_path: Path) -> None:
    transform = degrees(5.0, 45.0, 0.001)
    terrain = RasterTerrain(write(tmp_path / "a.tif", np.full((100, 100), 500.0), transform))
    aside = np.radians([[4.9, 44.95, 0.0], [5.05, 45.1, 0.0], [-175.0, 44.95, 0.0]])
    aside[:, 2] = 500.0
    assert np.all(terrain.first_crossing(straight_down(aside)).flag == Flag.OUTSIDE_TERRAIN)
    inside = np.array([[np.radians(5.0009), np.radians(44.95), 500.0]])
    found = terrain.first_crossing(straight_down(inside, 2.0))
    assert found.flag[0] == Flag.OK
    np.testing.assert_allclose(found.geodetic, inside, atol=1e-8)


def test_all_holes_is_refused(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.tif", np.full((50, 50), -9999.0), degrees(5, 45, 0.1), nodata=-9999.0
    )
    with pytest.raises(ProductError, match="no height"):
        RasterTerrain(path).height_at([0.1, 0.75])


# large rasters --------------------------------------------------------------------------------


def test_windows_give_what_the_whole_gives(tmp_path: Path) -> None:
    transform = Affine(10.0, 0.0, 600000.0, 0.0, -10.0, 5200000.0)
    row, col = np.mgrid[0:2600, 0:2400].astype(float)
    height = 900.0 + 400.0 * np.sin(row / 90.0) * np.cos(col / 70.0) + 60.0 * np.sin(col / 5.0)
    height[1200:1260, 900:1000] = np.nan
    path = write(
        tmp_path / "a.tif", height, transform, "EPSG:32632", dtype="float32", tiled=True,
        blockxsize=256, blockysize=256,
    )  # fmt: skip
    whole, windows = RasterTerrain(path), RasterTerrain(path, max_nodes=1_100_000)
    rng = np.random.default_rng(5)
    place = rng.uniform([-50, -50], [2650, 2450], (4000, 2))
    xy = np.column_stack(
        [600000.0 + 10 * place[:, 1], 5200000.0 - 10 * place[:, 0], np.zeros(4000)]
    )
    geodetic = from_crs("EPSG:32632", xy)
    geodetic[:, 2] = 900.0
    a, b = whole.height_at(geodetic), windows.height_at(geodetic)
    np.testing.assert_array_equal(a.flag, b.flag)
    # the tables' bound, 1e-4 px each, on slopes up to 1.5 m per pixel and 12 m per pixel waves
    np.testing.assert_allclose(a.height_m, b.height_m, atol=3e-3)
    for tilt in (0.1, 1.5):
        rays = straight_down(geodetic, tilt)
        c, d = whole.first_crossing(rays), windows.first_crossing(rays)
        np.testing.assert_array_equal(c.flag, d.flag)
        np.testing.assert_allclose(c.geodetic[:, 2], d.geodetic[:, 2], atol=5e-3)
        assert np.count_nonzero(c.flag == Flag.OK) > 3000


def test_ground_below_all_dry_land_is_found_in_windows(tmp_path: Path) -> None:
    transform = degrees(140.0, 12.0, 0.001)
    height = np.full((1100, 1100), -9000.0, dtype=np.float32)
    path = write(tmp_path / "sea.tif", height, transform, dtype="float32")
    terrain = RasterTerrain(path, max_nodes=1_100_000)
    place = np.array([[np.radians(140.5), np.radians(11.5), -9000.0]])
    found = terrain.first_crossing(straight_down(place, 0.2))
    assert found.flag[0] == Flag.OK
    np.testing.assert_allclose(found.geodetic, place, atol=1e-6)


def test_a_vrt_over_tiles_is_one_raster(tmp_path: Path) -> None:
    height = np.random.default_rng(0).uniform(0, 1000, (40, 60))
    write(tmp_path / "a.tif", height[:, :30], degrees(5.0, 45.0, 0.01))
    write(tmp_path / "b.tif", height[:, 30:], degrees(5.3, 45.0, 0.01))
    source = """<SimpleSource><SourceFilename relativeToVRT="1">{name}</SourceFilename>
      <SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="30" ySize="40"/>
      <DstRect xOff="{at}" yOff="0" xSize="30" ySize="40"/></SimpleSource>"""
    (tmp_path / "both.vrt").write_text(
        """<VRTDataset rasterXSize="60" rasterYSize="40"><SRS>EPSG:4326</SRS>
        <GeoTransform>5.0, 0.01, 0.0, 45.0, 0.0, -0.01</GeoTransform>
        <VRTRasterBand dataType="Float64" band="1">"""
        + source.format(name="a.tif", at=0)
        + source.format(name="b.tif", at=30)
        + "</VRTRasterBand></VRTDataset>"
    )
    lon, lat = node_grid(degrees(5.0, 45.0, 0.01), 40, 60)
    nodes = np.radians(np.stack([lon, lat], axis=-1))
    for paths in (tmp_path / "both.vrt", [tmp_path / "a.tif", tmp_path / "b.tif"]):
        found = RasterTerrain(paths).height_at(nodes)
        np.testing.assert_allclose(found.height_m, height, atol=1e-6)
        across = RasterTerrain(paths).height_at(cell_means(nodes)[:, 29])
        np.testing.assert_allclose(across.height_m, cell_means(height)[:, 29], atol=1e-6)


def test_terrain_goes_to_other_processes(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((20, 20), 7.0), degrees(5.0, 45.0, 0.01))
    copy = pickle.loads(pickle.dumps(RasterTerrain(path)))
    assert copy.height_at(np.radians([5.1, 44.9])).height_m == pytest.approx(7.0)


def test_height_range_over_a_region(tmp_path: Path) -> None:
    transform = degrees(5.0, 45.0, 0.001)
    height = np.full((300, 300), 500.0)
    height[150, 150], height[160, 140], height[10, 10] = 900.0, 100.0, 3000.0
    terrain = RasterTerrain(write(tmp_path / "a.tif", height, transform))
    corners = np.radians([[5.12, 44.87], [5.18, 44.83]])
    assert terrain.height_range_m(corners) == (100.0, 900.0)
    assert terrain.height_range_m(np.radians([[5.0, 45.0], [5.3, 44.7]])) == (100.0, 3000.0)
    with pytest.raises(GeometryError, match="no height"):
        terrain.height_range_m(np.radians([[9.0, 44.0]]))


# unusable ------------------------------------------------------------------------------------


def test_what_is_no_raster_of_heights_is_refused(tmp_path: Path) -> None:
    transform = degrees(5.0, 45.0, 0.01)
    flat = np.full((20, 20), 5.0)
    with pytest.raises(MissingFileError, match="no such file"):
        RasterTerrain(tmp_path / "absent.tif")
    (tmp_path / "text.tif").write_text("not a raster")
    (tmp_path / "empty.tif").write_bytes(b"")
    whole = write(tmp_path / "whole.tif", flat, transform).read_bytes()
    (tmp_path / "cut.tif").write_bytes(whole[:100])
    for name in ("text.tif", "empty.tif", "cut.tif"):
        with pytest.raises(ProductError, match=name):
            RasterTerrain(tmp_path / name)
    with pytest.raises(ProductError, match="coordinate system"):
        RasterTerrain(write(tmp_path / "nocrs.tif", flat, transform, None))
    with pytest.raises(ProductError, match="geotransform"):
        RasterTerrain(write(tmp_path / "noplace.tif", flat, None))
    with pytest.raises(UnsupportedError, match="one band"):
        RasterTerrain(write(tmp_path / "rgb.tif", np.stack([flat] * 3), transform, count=3))
    with pytest.raises(UnsupportedError, match="complex"):
        RasterTerrain(write(tmp_path / "complex.tif", flat, transform, dtype="complex64"))
    with pytest.raises(ProductError, match="2 x 2"):
        RasterTerrain(write(tmp_path / "line.tif", flat[:1], transform))
    with pytest.raises(ArgumentError, match="at least one"):
        RasterTerrain([])


def test_pixels_cut_short_name_the_file(tmp_path: Path) -> None:
    height = np.random.default_rng(0).uniform(0, 1, (400, 400))
    path = write(tmp_path / "cut.tif", height, degrees(5.0, 45.0, 0.01))
    path.write_bytes(path.read_bytes()[:300_000])
    with pytest.raises(ProductError, match=r"cut\.tif"):
        RasterTerrain(path).height_at(np.radians([6.0, 42.0]))


def test_feet_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "feet.tif", np.full((20, 20), 5.0), degrees(5.0, 45.0, 0.01))
    with rasterio.open(path, "r+") as raster:
        raster.units = ("ft",)
    with pytest.raises(UnsupportedError, match="metres"):
        RasterTerrain(path)


def test_scale_and_offset_are_applied(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((20, 20), 50), degrees(5.0, 45.0, 0.01), dtype="int16")
    with rasterio.open(path, "r+") as raster:
        raster.scales, raster.offsets = (0.1,), (100.0,)
    assert RasterTerrain(path).height_at(np.radians([5.1, 44.9])).height_m == pytest.approx(105.0)


def test_tiles_of_another_lattice_or_system_are_refused(tmp_path: Path) -> None:
    flat = np.full((20, 20), 5.0)
    first = write(tmp_path / "a.tif", flat, degrees(5.0, 45.0, 0.01))
    for name, transform, crs in (
        ("shifted", degrees(5.2 + 0.004, 45.0, 0.01), "EPSG:4326"),
        ("coarser", degrees(5.2, 45.0, 0.02), "EPSG:4326"),
        ("utm", Affine(30, 0, 6e5, 0, -30, 5e6), "EPSG:32631"),
    ):
        other = write(tmp_path / f"{name}.tif", flat, transform, crs)
        with pytest.raises(UnsupportedError, match=name):
            RasterTerrain([first, other])


# vertical datum ------------------------------------------------------------------------------


@pytest.fixture
def geoid_file(tmp_path: Path) -> Path:
    transform = Affine(1.0, 0.0, -0.5, 0.0, -1.0, 60.5)
    lon, lat = node_grid(transform, 61, 31)
    return write(tmp_path / "geoid.tif", 40.0 + 0.1 * lon - 0.2 * lat, transform, dtype="float32")


def test_the_geoid_is_added_at_the_nodes(tmp_path: Path, geoid_file: Path) -> None:
    transform = degrees(5.0, 45.0, 0.01)
    path = write(tmp_path / "a.tif", np.full((60, 60), 100.0), transform)
    terrain = RasterTerrain(path, geoid_file)
    found = terrain.height_at(np.radians([5.3, 44.7]))
    assert found.height_m == pytest.approx(140.0 + 0.53 - 8.94, abs=1e-5)
    assert "geoid.tif" in terrain.provenance[1]
    # beyond the geoid's grid there is no height
    far = write(tmp_path / "far.tif", np.full((60, 60), 100.0), degrees(40.0, 45.0, 0.01))
    with pytest.raises(ProductError, match="no height"):
        RasterTerrain(far, geoid_file).height_at(np.radians([40.3, 44.7]))


def test_a_stated_vertical_datum_decides(
    tmp_path: Path, geoid_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    flat, transform = np.full((20, 20), 5.0), degrees(5.0, 45.0, 0.01)
    utm = Affine(30.0, 0.0, 6e5, 0.0, -30.0, 5e6)
    for number, (crs, where) in enumerate(
        [("EPSG:4326+5773", transform), ("EPSG:9518", transform), ("EPSG:32631+5773", utm)]
    ):
        path = write(tmp_path / f"ortho{number}.tif", flat, where, crs)
        with pytest.raises(UnsupportedError, match=r"EGM.*geoid") as refusal:
            RasterTerrain(path)
        assert "\n" not in str(refusal.value)
        assert "EGM" in RasterTerrain(path, geoid_file).provenance[1]
    ellipsoidal = write(tmp_path / "ell.tif", flat, transform, "EPSG:4979")
    with caplog.at_level(logging.WARNING):
        assert "ellipsoidal" in RasterTerrain(ellipsoidal).provenance[1]
    assert not caplog.records
    with pytest.raises(UnsupportedError, match="no geoid"):
        RasterTerrain(ellipsoidal, geoid_file)
    unstated = write(tmp_path / "unstated.tif", flat, transform)
    with caplog.at_level(logging.WARNING):
        assert "no vertical datum" in RasterTerrain(unstated).provenance[1]
    assert "no vertical datum" in caplog.text


def test_projected_positions_do_not_need_the_vertical_part(
    tmp_path: Path, geoid_file: Path
) -> None:
    utm = Affine(30.0, 0.0, 6e5, 0.0, -30.0, 5e6)
    path = write(tmp_path / "a.tif", np.arange(400.0).reshape(20, 20), utm, "EPSG:32631+5773")
    terrain = RasterTerrain(path, geoid_file)
    place = from_crs("EPSG:32631", np.array([6e5 + 315.0, 5e6 - 315.0, 0.0]))
    lon_deg, lat_deg = np.degrees(place[:2])
    expected = 210.0 + 40.0 + 0.1 * lon_deg - 0.2 * lat_deg
    assert terrain.height_at(place).height_m == pytest.approx(expected, abs=3e-3)
    assert to_crs("EPSG:32631", place)[0] == pytest.approx(6e5 + 315.0)
