"""A surface against a reference that is the same, moved, tilted, coarser or elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from geoposition.datum import from_crs
from geoposition.errors import GeometryError, ProductError, UnsupportedError
from geoposition.surface.cells import surface_cells
from geoposition.surface.compare import compare_points, compare_surface
from geoposition.surface.dsm import BANDS
from geoposition.terrain import RasterTerrain

WEST, NORTH = 700_000.0, 4_900_000.0
UTM = "EPSG:32631"


def hills(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    e, n = x - WEST, NORTH - y
    return 600.0 + 20.0 * np.sin(e / 35.0) * np.cos(n / 45.0) + 8.0 * np.sin((e + 2 * n) / 60.0)


def raster(
    path: Path,
    cells: int,
    step: float,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    tilt: tuple[float, float] = (0.0, 0.0),
    noise: float = 0.0,
    west: float = WEST,
    bands: int = 1,
) -> Path:
    """Hills moved by `shift` (e, n, u) and tilted (m/m)."""
    i, j = np.mgrid[0:cells, 0:cells]
    x, y = west + (j + 0.5) * step, NORTH - (i + 0.5) * step
    height = hills(x - shift[0], y - shift[1]) + shift[2]
    height += tilt[0] * (x - WEST) + tilt[1] * (y - NORTH)
    height += np.random.default_rng(1).normal(0.0, noise, height.shape) if noise else 0.0
    profile = {
        "driver": "GTiff", "dtype": "float32", "count": bands, "width": cells, "height": cells,
        "crs": UTM, "transform": from_origin(west, NORTH, step, step), "nodata": float("nan"),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as out:
        for band in range(bands):
            out.write(height.astype(np.float32), band + 1)
    return path


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (3.2, -1.7, 5.5), (-8.0, 6.0, -2.0)])
def test_a_shift_is_found(tmp_path: Path, shift: tuple[float, float, float]) -> None:
    reference = raster(tmp_path / "ref.tif", 500, 1.0)
    surface = raster(tmp_path / "dsm.tif", 380, 1.0, shift, noise=0.3, west=WEST + 60, bands=3)
    found = compare_surface(surface, RasterTerrain(reference))
    assert found.differences.shift is not None
    assert found.differences.after is not None
    np.testing.assert_allclose(found.differences.shift.enu_m, shift, atol=0.05)
    sigma = np.array(found.differences.shift.sigma_enu_m)
    assert np.all(np.abs(np.array(found.differences.shift.enu_m) - shift) < 6 * sigma + 0.02)
    assert found.differences.after.nmad == pytest.approx(0.3, rel=0.1)
    assert abs(found.differences.after.median) < 0.02
    assert found.cover == pytest.approx(1.0, abs=0.01)


def test_offset_tilt_and_classes(tmp_path: Path) -> None:
    reference = raster(tmp_path / "ref.tif", 400, 1.0)
    surface = raster(tmp_path / "dsm.tif", 400, 1.0, (0, 0, 1.5), tilt=(3e-3, 4e-3))
    found = compare_surface(surface, RasterTerrain(reference))
    assert found.differences.tilt_mm_per_m == pytest.approx(5.0, rel=0.02)
    assert found.differences.tilt_azimuth_deg == pytest.approx(
        np.degrees(np.arctan2(3, 4)), abs=1.0
    )
    counts = [part.count for part in found.differences.by_slope]
    assert sum(counts) == pytest.approx(found.differences.before.count, rel=0.02)
    assert all(part.count > 0 for part in found.differences.by_aspect)
    assert found.as_dict()["difference_m"]["count"] == found.differences.before.count  # type: ignore[index]


def test_a_shift_shows_by_aspect(tmp_path: Path) -> None:
    """Moved east, slopes that fall east are too high and those that fall west too low."""
    reference = raster(tmp_path / "ref.tif", 400, 1.0)
    surface = raster(tmp_path / "dsm.tif", 400, 1.0, (2.0, 0.0, 0.0))
    medians = {
        part.name: part.median_m
        for part in compare_surface(surface, RasterTerrain(reference)).differences.by_aspect
    }
    assert medians["E"] > 0.4
    assert medians["W"] < -0.4
    assert abs(medians["N"]) < 0.2


def test_a_coarse_reference_is_compared_with_means(tmp_path: Path) -> None:
    """What a coarse reference smooths away is no error of the surface's means."""
    coarse = tmp_path / "ref.tif"
    fine = raster(tmp_path / "dsm.tif", 600, 0.5)
    with rasterio.open(fine) as source:
        height = source.read(1).reshape(10, 60, 10, 60).mean(axis=(1, 3))
    profile = {
        "driver": "GTiff", "dtype": "float32", "count": 1, "width": 10, "height": 10,
        "crs": UTM, "transform": from_origin(WEST, NORTH, 30.0, 30.0),
    }  # fmt: skip
    with rasterio.open(coarse, "w", **profile) as out:
        out.write(height.astype(np.float32), 1)
    found = compare_surface(fine, RasterTerrain(coarse))
    assert found.by_reference_cell is not None
    assert found.by_reference_cell.count >= 64
    assert found.by_reference_cell.rmse < 0.01
    assert found.differences.before.nmad > 1.0


def test_flat_ground_tells_no_shift(tmp_path: Path) -> None:
    i, j = np.mgrid[0:200, 0:200]
    profile = {
        "driver": "GTiff", "dtype": "float32", "count": 1, "width": 200, "height": 200,
        "crs": UTM, "transform": from_origin(WEST, NORTH, 1.0, 1.0),
    }  # fmt: skip
    paths = []
    for name, level in (("a.tif", 100.0), ("b.tif", 100.7)):
        paths.append(tmp_path / name)
        with rasterio.open(paths[-1], "w", **profile) as out:
            out.write((level + 0.002 * np.sin(i + j)).astype(np.float32), 1)
    found = compare_surface(paths[1], RasterTerrain(paths[0]))
    assert found.differences.shift is None
    assert found.differences.after is None
    assert found.differences.before.median == pytest.approx(0.7, abs=1e-3)


def test_a_reference_elsewhere_is_refused(tmp_path: Path) -> None:
    reference = raster(tmp_path / "ref.tif", 100, 1.0, west=WEST + 50_000)
    surface = raster(tmp_path / "dsm.tif", 100, 1.0)
    with pytest.raises(GeometryError, match="no heights where"):
        compare_surface(surface, RasterTerrain(reference))
    bare = tmp_path / "bare.tif"
    bare.write_bytes(b"not a raster")
    with pytest.raises(ProductError):
        compare_surface(bare, RasterTerrain(surface))


def test_points_show_the_same_shift_as_a_surface(tmp_path: Path) -> None:
    reference = raster(tmp_path / "ref.tif", 500, 1.0)
    surface = raster(tmp_path / "dsm.tif", 380, 1.0, (3.2, -1.7, 5.5), noise=0.3, west=WEST + 60)
    cells = surface_cells(surface)
    rows = np.random.default_rng(4).choice(len(cells.height_m), 4000, replace=False)
    points = from_crs(cells.crs, np.column_stack([cells.xy, cells.height_m])[rows])
    points[::50] = np.nan
    found = compare_points(points, RasterTerrain(reference))
    assert found.shift is not None
    assert found.after is not None
    np.testing.assert_allclose(found.shift.enu_m, (3.2, -1.7, 5.5), atol=0.1)
    assert found.after.nmad == pytest.approx(0.3, rel=0.1)
    assert sum(part.count for part in found.by_slope) == pytest.approx(3920, rel=0.05)


def test_points_elsewhere_are_refused(tmp_path: Path) -> None:
    reference = raster(tmp_path / "ref.tif", 100, 1.0)
    with pytest.raises(GeometryError, match="no heights where"):
        compare_points(np.full((40, 3), 0.3), RasterTerrain(reference))
    with pytest.raises(GeometryError, match="no heights where"):
        compare_points(np.empty((0, 3)), RasterTerrain(reference))


def test_a_surface_serves_as_terrain(tmp_path: Path) -> None:
    """The first of several bands, if it is named `height`."""
    plain = raster(tmp_path / "plain.tif", 100, 1.0)
    layers = raster(tmp_path / "layers.tif", 100, 1.0, bands=3)
    with pytest.raises(UnsupportedError, match="one band of heights"):
        RasterTerrain(layers)
    with rasterio.open(layers, "r+") as out:
        out.descriptions = BANDS
    cells = surface_cells(plain)
    points = from_crs(cells.crs, np.column_stack([cells.xy, cells.height_m]))[5050:5060]
    one, other = (RasterTerrain(path).height_at(points).height_m for path in (plain, layers))
    np.testing.assert_array_equal(one, other)
