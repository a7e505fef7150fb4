"""Orthoimages: every pixel shows its own place, and says so where it cannot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import scenes

from geoposition.arrays import FloatArray
from geoposition.calib_fields.synthetic import synthetic_terrain
from geoposition.datum import from_crs, to_crs, utm_epsg
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.locate import locate
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.ortho import OrthoTask, block_means, ortho_window
from geoposition.reimage.ortho_grid import OrthoGrid
from geoposition.reimage.ortho_kernels import heights_on_mesh
from geoposition.scripts.cli import run
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.terrain import AnalyticTerrain, ConstantTerrain, RasterTerrain
from geoposition.terrain.mesh import height_mesh

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (700, 600)


@pytest.fixture(scope="module")
def scene() -> PushbroomModel:
    return scenes.build(SHAPE, roll_deg=18.0, pitch_deg=5.0, height_range_m=(0.0, 1500.0)).model()


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, scene: PushbroomModel) -> Path:
    """A product, a DEM, and an image whose grey values are a function of the ground's place."""
    folder = tmp_path_factory.mktemp("ortho")
    write_model_file(scene, folder / "scene.toml")
    middle = scene.image_to_ground([350.0, 300.0], 500.0).geodetic
    terrain = synthetic_terrain(
        middle[0], middle[1], 4000.0, 4000.0, seed=3, lowest_m=300.0, highest_m=700.0,
        step_rad=float(np.radians(0.5 / 3600.0)), shortest_m=300.0,
    )  # fmt: skip
    terrain.write(folder / "dem.tif")
    image = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float64) for n in SHAPE),
                                 indexing="ij"), axis=-1)  # fmt: skip
    ground = locate(scene, image, RasterTerrain(folder / "dem.tif")).geodetic
    grey = brightness(ground).astype(np.float32)
    profile = {"driver": "GTiff", "width": SHAPE[1], "height": SHAPE[0]}
    with rasterio.open(folder / "image.tif", "w", count=1, dtype="float32", **profile) as file:
        file.write(grey, 1)
    with rasterio.open(folder / "bytes.tif", "w", count=2, dtype="uint8", nodata=0, **profile) as f:
        f.write(np.stack([grey / 8.0, grey / 10.0]).astype(np.uint8))
    return folder


def brightness(geodetic: FloatArray) -> FloatArray:
    k = 6.4e6 * 2 * np.pi / 45.0
    return np.asarray(
        1000.0 + 200.0 * (np.sin(geodetic[..., 0] * k * 0.7) + np.cos(geodetic[..., 1] * k))
    )


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    capsys.readouterr()
    assert run([str(argument) for argument in (*arguments, "--json")]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


@pytest.mark.parametrize("crs", [None, "4326"])
def test_pixels_show_their_own_place(
    crs: str | None, files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = [] if crs is None else ["--crs", crs, "--res", "8e-6"]
    out = tmp_path / "ortho.tif"
    result = told(capsys, "ortho", files / "scene.toml", files / "image.tif", "-o", out,
                  "--dem", files / "dem.tif", *more)  # fmt: skip
    assert result["interpolation_error_px"] <= 0.005
    with rasterio.open(out) as made, rasterio.open(tmp_path / "ortho_flags.tif") as flags:
        pixels, transform, code = made.read(1), made.transform, made.crs.to_string()
        flag = flags.read(1)
        assert made.overviews(1)
        assert made.profile["tiled"]
    assert code == ("EPSG:4326" if crs else result["crs"])
    row, col = np.meshgrid(*(np.arange(n) + 0.5 for n in pixels.shape), indexing="ij")
    x, y = transform * (col, row)
    geodetic = from_crs(code, np.stack([x, y, np.zeros_like(x)], axis=-1))
    seen = flag == Flag.OK
    assert np.array_equal(seen, np.isfinite(pixels))
    assert 0.5 < seen.mean() < 1.0
    inner = seen & np.roll(seen, 4, 0) & np.roll(seen, -4, 0) & np.roll(seen, 4, 1)
    inner &= np.roll(seen, -4, 1)
    # of 200: cubic between pixels on waves of 60 pixels, and a tenth of a pixel is worth 2
    assert np.abs(pixels - brightness(geodetic))[inner].max() < 0.5


def test_places_are_the_models_own(scene: PushbroomModel, files: Path) -> None:
    terrain = RasterTerrain(files / "dem.tif")
    middle = scene.image_to_ground([350.0, 300.0], 500.0).geodetic
    grid = OrthoGrid.around(scene, terrain, f"EPSG:{utm_epsg(middle[0], middle[1])}", 0.7)
    window = grid.window(150, 150, 200, 230)
    found = ortho_window(OrthoTask(scene, terrain), window)
    row, col = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in window.shape), indexing="ij")
    ground = window.geodetic(row, col, 0.0)
    ground[..., 2] = terrain.height_at(ground).height_m
    exact = scene.ground_to_image(ground).image_px
    assert (found.flag == Flag.OK).all()
    assert np.abs(np.stack([found.line, found.sample], axis=-1) - exact).max() <= 0.005


def test_ground_behind_a_ridge_is_told(scene: PushbroomModel) -> None:
    """A wall along the track: its shadow lies on the side away from the satellite."""
    middle = scene.image_to_ground([350.0, 300.0], 0.0).geodetic
    origin = scene.rays([350.0, 300.0], 0.0).origin_ecef_m
    east = 6.378e6 * np.cos(middle[1])

    def wall(lon: FloatArray, lat: FloatArray) -> FloatArray:
        return 40.0 * np.exp(-(((lon - middle[0]) * east / 6.0) ** 2))

    terrain = AnalyticTerrain(wall, 0.0, 40.0, step_m=1.0)
    epsg = utm_epsg(middle[0], middle[1])
    grid = OrthoGrid.around(scene, ConstantTerrain(0.0), f"EPSG:{epsg}", 1.0)
    centre = grid.shape[0] // 2 - 20, grid.shape[1] // 2 - 50
    window = grid.window(*centre, 40, 100)
    plain = ortho_window(OrthoTask(scene, terrain), window)
    asked = ortho_window(OrthoTask(scene, terrain, occlusion=True), window)
    hidden = asked.flag == Flag.NO_INTERSECTION
    assert (plain.flag == Flag.OK).all()
    assert np.isnan(asked.line[hidden]).all()
    # tan(18 deg) of shadow from 40 m, less the wall's own slope
    width = hidden.sum(axis=1)
    assert np.all((width > 8) & (width < 16))
    lon = window.geodetic(np.full(100, 20.0), np.arange(100.0), 0.0)[:, 0]
    side = np.sign(lon[hidden[20]].mean() - middle[0])
    from geoposition.ellipsoid import ecef_to_geodetic

    assert side == -np.sign(ecef_to_geodetic(origin)[0] - middle[0])


def test_several_bands_nodata_and_area_means(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "coarse.tif"
    told(
        capsys,
        "ortho",
        files / "scene.toml",
        files / "bytes.tif",
        "-o",
        out,
        "--dem",
        files / "dem.tif",
        "--res",
        7,
        "--method",
        "area",
        "--compress",
        "lzw",
    )
    with rasterio.open(out) as made:
        assert made.count == 2
        assert made.nodata == 0
        values = made.read()
    seen = values[0] > 0
    with rasterio.open(files / "bytes.tif") as image:
        whole = image.read()
    assert seen.mean() > 0.5
    for band in range(2):
        assert values[band][seen].mean() == pytest.approx(whole[band].mean(), rel=0.01)
    # means over 10 x 10 pixels of waves of 45 m: the waves stay, damped
    assert values[0][seen].std() < whole[0].std()


@pytest.mark.parametrize(("crs", "step"), [("EPSG:32740", 20.0), ("EPSG:4979", 2e-4)])
def test_heights_over_a_mesh_are_the_terrains_own(tmp_path: Path, crs: str, step: float) -> None:
    """In both systems, with holes and beyond the raster's border."""
    shape, middle = (300, 320), np.array([[np.radians(55.5), np.radians(-21.1), 0.0]])
    x, y = to_crs(crs, middle)[0, :2] - step * np.array([160.0, -150.0])
    height = np.cumsum(np.random.default_rng(2).normal(0.0, 4.0, shape), axis=0)
    height[40:60, 200:230] = np.nan
    with rasterio.open(tmp_path / "dem.tif", "w", driver="GTiff", width=320, height=300, count=1,
                       dtype="float64", nodata=np.nan, crs=crs,
                       transform=rasterio.Affine(step, 0, x, 0, -step, y)) as file:  # fmt: skip
        file.write(height, 1)
    terrain = RasterTerrain(tmp_path / "dem.tif")
    at = to_crs("EPSG:32740", middle)[0]
    grid = OrthoGrid("EPSG:32740", at[0] - 3600.0, at[1] + 3300.0, 6.0, (1100, 1200))
    rows, cols = (64.0 * np.arange(n) for n in (19, 20))
    nodes = grid.geodetic(*np.meshgrid(rows, cols, indexing="ij"), 0.0)[..., :2]
    mesh = height_mesh(terrain, nodes)
    assert mesh is not None
    found, flag = np.empty(grid.shape), np.empty(grid.shape, np.uint8)
    heights_on_mesh(mesh.height_m, mesh.place, 64, found, flag)
    pixels = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in grid.shape), indexing="ij")
    exact = terrain.height_at(grid.geodetic(*pixels, 0.0))
    # at a border or a hole's edge a millimetre decides
    assert np.mean(flag != exact.flag) < 1e-4
    assert set(np.unique(flag)) == {Flag.OK, Flag.NODATA, Flag.OUTSIDE_TERRAIN}
    both = np.isfinite(found) & np.isfinite(exact.height_m)
    assert np.nanmin(found) >= mesh.lowest_m
    assert np.abs(found - exact.height_m)[both].max() < 0.01


def test_means_are_of_the_valid_ones() -> None:
    values = np.arange(16.0).reshape(1, 4, 4)
    valid = np.ones((4, 4), np.uint8)
    valid[0, 0] = valid[2:, 2:] = 0
    mean, seen = block_means(values, valid, 2)
    assert seen.tolist() == [[1, 1], [1, 0]]
    assert mean[0, 0, 0] == pytest.approx((1 + 4 + 5) / 3)
    assert mean[0, 1, 0] == pytest.approx((8 + 9 + 12 + 13) / 4)


def test_what_cannot_be_done_is_refused(
    scene: PushbroomModel, files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ArgumentError, match="positive resolution"):
        OrthoGrid.around(scene, ConstantTerrain(0.0), "EPSG:32633", 0.0)
    with pytest.raises(ArgumentError, match="too many"):
        OrthoGrid.around(scene, ConstantTerrain(0.0), "EPSG:32631", 1e-6)
    far = AnalyticTerrain(lambda lon, lat: np.full(lon.shape, np.nan), 0.0, 1.0)
    with pytest.raises(GeometryError, match="no height"):
        OrthoGrid.around(scene, far, "EPSG:32631", 1.0)
    small = tmp_path / "small.tif"
    with rasterio.open(small, "w", driver="GTiff", width=700, height=800, count=1,
                       dtype="uint8") as file:  # fmt: skip
        file.write(np.ones((1, 800, 700), np.uint8))
    capsys.readouterr()
    arguments = ["ortho", files / "scene.toml", small, "-o", tmp_path / "o.tif",
                 "--dem", files / "dem.tif"]  # fmt: skip
    assert run([str(a) for a in arguments]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "small.tif" in message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.tif"]
