"""Gridding: weighted means against a plain computation, placement, layers, filling, memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from geoposition.datum import to_crs
from geoposition.errors import ArgumentError, GeometryError
from geoposition.surface.dsm import BANDS, DsmGrid, Surface, is_geographic
from geoposition.surface.map_points import TOLERANCE_M, to_map

UTM = "EPSG:32631"
WEST, NORTH = 700_000.0, 4_900_000.0


def grid(cells: int = 40, resolution: float = 0.5) -> DsmGrid:
    side = cells * resolution
    low, high = np.array([WEST, NORTH - side]), np.array([WEST + side, NORTH])
    return DsmGrid.around(UTM, resolution, low, high)


def cloud(n: int, side: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    place = np.column_stack([WEST + side * rng.random(n), NORTH - side * rng.random(n)])
    points = np.column_stack([place, 800.0 + rng.normal(0, 3, n)])
    return points, rng.uniform(0.1, 0.5, n).astype(np.float32)


def written(
    surface: Surface, path: Path, **options: object
) -> tuple[np.ndarray, dict[str, object]]:
    surface.write(path, **options)  # type: ignore[arg-type]
    with rasterio.open(path) as raster:
        return raster.read(), {
            "transform": raster.transform, "crs": raster.crs, "tags": raster.tags(),
            "bands": raster.descriptions, "nodata": raster.nodata, "tiled": raster.is_tiled,
        }  # fmt: skip


def test_cells_are_the_weighted_means_of_their_points(tmp_path: Path) -> None:
    points, sigma = cloud(3000, 20.0)
    with Surface(grid(), tmp_path, 800.0) as surface:
        for part in range(0, 3000, 700):
            surface.add(points[part : part + 700], sigma[part : part + 700])
        layers, facts = written(surface, tmp_path / "dsm.tif")
        top, left, bottom, right = surface.bounds
    row = (NORTH - points[:, 1]) / 0.5 - 0.5
    column = (points[:, 0] - WEST) / 0.5 - 0.5
    for i, j in ((5, 7), (20, 20), (33, 2)):
        w = np.clip(1 - np.abs(row - i), 0, 1) * np.clip(1 - np.abs(column - j), 0, 1)
        mean = np.sum(w * points[:, 2]) / w.sum()
        variance = np.sum(w * (sigma**2 + (points[:, 2] - mean) ** 2)) / w.sum()
        height, count, error = layers[:, i - top, j - left]
        assert height == pytest.approx(mean, abs=1e-3)
        assert error == pytest.approx(np.sqrt(variance), rel=1e-3)
        assert count == np.sum(w > 0)
    assert (bottom - top, right - left) == layers.shape[1:]
    assert facts["bands"] == BANDS
    assert facts["tiled"]
    assert np.isnan(facts["nodata"])  # type: ignore[arg-type]
    assert "ellipsoid" in facts["tags"]["HEIGHTS"]  # type: ignore[index]
    assert [path.name for path in tmp_path.iterdir()] == ["dsm.tif"]


def test_a_plane_comes_back_at_the_cells_centres(tmp_path: Path) -> None:
    """No half-cell shift: a plane sampled by a regular grid of points is that plane again."""
    step = np.arange(0.05, 20.0, 0.1)
    x, y = (axis.ravel() for axis in np.meshgrid(WEST + step, NORTH - step))
    plane = 700.0 + 0.3 * (x - WEST) - 0.7 * (y - NORTH)
    with Surface(grid(), tmp_path, 700.0) as surface:
        surface.add(np.column_stack([x, y, plane]), np.full(len(x), 0.1, dtype=np.float32))
        layers, facts = written(surface, tmp_path / "dsm.tif")
    i, j = np.mgrid[0 : layers.shape[1], 0 : layers.shape[2]]
    cx, cy = facts["transform"] * (j + 0.5, i + 0.5)  # type: ignore[operator]
    inner = np.s_[2:-2, 2:-2]
    expected = 700.0 + 0.3 * (cx - WEST) - 0.7 * (cy - NORTH)
    np.testing.assert_allclose(layers[0][inner], expected[inner], atol=2e-3)


def test_corners_are_whole_multiples() -> None:
    made = DsmGrid.around(UTM, 0.7, np.array([1000.3, 2000.2]), np.array([1010.1, 2004.9]))
    assert made.west / 0.7 == pytest.approx(round(made.west / 0.7))
    assert made.west <= 1000.3
    assert made.north >= 2004.9
    assert made.west + made.shape[1] * 0.7 >= 1010.1
    assert made.north - made.shape[0] * 0.7 <= 2000.2


@pytest.mark.parametrize("resolution", [0.0, -1.0, float("nan"), 1e-9])
def test_useless_resolutions_are_refused(resolution: float) -> None:
    with pytest.raises(ArgumentError, match="resolution"):
        DsmGrid.around(UTM, resolution, np.zeros(2), np.full(2, 1e4))


def test_holes_inside_are_filled_and_the_outside_is_not(tmp_path: Path) -> None:
    step = np.arange(0.25, 60.0, 0.5)
    x, y = (axis.ravel() for axis in np.meshgrid(WEST + step, NORTH - step))
    east, south = x - WEST, NORTH - y
    hole = (np.abs(east - 20) < 3) & (np.abs(south - 25) < 4)
    beyond = east + south > 80
    keep = ~hole & ~beyond
    plane = 500.0 + 0.2 * east
    points = np.column_stack([x, y, plane])[keep]
    sigma = np.full(len(points), 0.2, dtype=np.float32)
    found = []
    for fill in (False, True):
        with Surface(grid(120), tmp_path, 500.0) as surface:
            surface.add(points, sigma)
            found.append(written(surface, tmp_path / "dsm.tif", fill=fill)[0])
    bare, filled = found
    in_hole = np.s_[45:56, 36:45]
    assert np.isnan(bare[0][in_hole]).all()
    np.testing.assert_allclose(
        filled[0][in_hole],
        500.0 + 0.2 * 0.5 * (np.arange(36, 45) + 0.5) * np.ones((11, 1)),
        atol=0.4,
    )
    assert np.all(filled[1][in_hole] == 0)
    assert np.isnan(filled[2][in_hole]).all()
    assert np.isnan(filled[0][110, 110])
    same = np.isfinite(bare[0])
    assert np.array_equal(bare[0][same], filled[0][same])


def test_points_elsewhere_or_without_numbers_do_nothing(tmp_path: Path) -> None:
    points, sigma = cloud(50, 20.0)
    with Surface(grid(), tmp_path, 800.0) as surface:
        surface.add(points + [1e6, 0.0, 0.0], sigma)
        surface.add(np.full((3, 3), np.nan), sigma[:3])
        with pytest.raises(GeometryError, match="no point"):
            surface.write(tmp_path / "dsm.tif")
        mixed = points.copy()
        mixed[::2, 2] = np.nan
        surface.add(mixed, sigma)
        layers, _ = written(surface, tmp_path / "dsm.tif")
    assert np.nansum(layers[1]) <= 25 * 4
    assert 780.0 < np.nanmedian(layers[0]) < 820.0


@pytest.mark.parametrize("crs", [UTM, "EPSG:4326", "EPSG:2154"])
def test_map_coordinates_are_those_of_the_projection(crs: str) -> None:
    rng = np.random.default_rng(0)
    place = np.radians([5.2, 44.2]) + rng.uniform(-3e-4, 3e-4, (5000, 2))
    geodetic = np.column_stack([place, rng.uniform(0, 900, 5000)])
    exact = to_crs(crs, geodetic)
    off = np.abs(to_map(crs, geodetic, is_geographic(crs)) - exact)[:, :2]
    assert np.max(off) < (1e-8 if is_geographic(crs) else TOLERANCE_M)
    np.testing.assert_array_equal(to_map(crs, geodetic)[:, 2], geodetic[:, 2])


def test_unknown_systems_are_refused() -> None:
    with pytest.raises(ArgumentError, match="unknown"):
        is_geographic("EPSG:1")
