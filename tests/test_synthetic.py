"""Synthetic terrain: stated range and smoothness, repeatable, and read back as written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geoposition.calib_fields.synthetic import fractal_field, synthetic_terrain
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError, ProductError
from geoposition.terrain.raster import RasterTerrain

LON, LAT = np.radians(113.0), np.radians(34.5)


def test_range_size_and_seed() -> None:
    one = synthetic_terrain(LON, LAT, 20e3, 30e3, seed=1)
    assert one.height_m.min() == 500.0
    assert one.height_m.max() == 2500.0
    rows, cols = one.height_m.shape
    corner = np.array([[one.west_rad, one.north_rad, 0.0]])
    east = corner + [[(cols - 1) * one.step_rad, 0.0, 0.0]]
    south = corner - [[0.0, (rows - 1) * one.step_rad, 0.0]]
    size = [np.linalg.norm(geodetic_to_ecef(p - corner * 0) - geodetic_to_ecef(corner))
            for p in (east, south)]  # fmt: skip
    # the north edge is 0.2 % shorter than the middle
    assert size == pytest.approx([20e3, 30e3], rel=0.01)
    again = synthetic_terrain(LON, LAT, 20e3, 30e3, seed=1)
    np.testing.assert_array_equal(one.height_m, again.height_m)
    assert np.any(one.height_m != synthetic_terrain(LON, LAT, 20e3, 30e3, seed=2).height_m)
    assert not one.height_m.flags.writeable


def test_spectrum_falls_as_stated_and_ends() -> None:
    n, step = 512, 50.0
    power = np.zeros((n, n // 2 + 1))
    window = np.hanning(n)[:, None] * np.hanning(n)[None]
    for seed in range(8):
        field = fractal_field((n, n), (step, step), 800.0, 3.0, np.random.default_rng(seed))
        power += np.abs(np.fft.rfft2((field - field.mean()) * window)) ** 2
    k = np.hypot(np.fft.fftfreq(n, step)[:, None], np.fft.rfftfreq(n, step)[None])
    band = (k > 1 / 8000.0) & (k < 1 / 1600.0)
    slope = np.polyfit(np.log(k[band]), np.log(power[band]), 1)[0]
    assert slope == pytest.approx(-3.0, abs=0.25)
    # beyond twice the shortest wavelength's wave number next to nothing is left
    assert power[k > 2 / 800.0].sum() < 1e-6 * power.sum()


def test_a_reader_finds_the_same_heights(tmp_path: Path) -> None:
    terrain = synthetic_terrain(LON, LAT, 8e3, 6e3, seed=3, lowest_m=-20.0, highest_m=100.0)
    path = tmp_path / "dem.tif"
    terrain.write(path)
    dem = RasterTerrain(path)
    assert any("ellipsoidal heights, as the raster states" in fact for fact in dem.provenance)
    rows, cols = terrain.height_m.shape
    row, col = np.meshgrid(np.arange(1, rows - 1), np.arange(1, cols - 1), indexing="ij")
    places = np.stack(
        [terrain.west_rad + col * terrain.step_rad, terrain.north_rad - row * terrain.step_rad],
        axis=-1,
    )
    found = dem.height_at(places).height_m
    # the raster's geotransform is in degrees: places agree to rounding, some micrometres
    np.testing.assert_allclose(found, terrain.height_m[1:-1, 1:-1], rtol=0, atol=1e-5)


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="lowest < highest"):
        synthetic_terrain(LON, LAT, 8e3, 6e3, lowest_m=5.0, highest_m=5.0)
    with pytest.raises(ArgumentError, match="pixels each way"):
        synthetic_terrain(LON, LAT, 100.0, 6e3)
    small = synthetic_terrain(LON, LAT, 2e3, 2e3)
    with pytest.raises(ProductError, match="writable place"):
        small.write(tmp_path / "missing" / "dem.tif")
