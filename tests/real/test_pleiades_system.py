"""The producer's system metadata against the producer's own grid and rational functions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.flags import Flag
from geoposition.product import Product
from geoposition.sensors.readers import pleiades_system
from geoposition.sensors.readers.location_grid import LocationGrid, read_location_grid
from geoposition.sensors.readers.source import Source

METADATA = "grids/PHRDIMAP_P1BP--2018122638935449CP.XML"
GRID = "grids/GRID_P1BP--2018122638935449CP.tif"


@pytest.fixture
def product(real_data: Path) -> Product:
    path = real_data / METADATA
    source = Source.of(path)
    assert pleiades_system.recognises(source)
    return pleiades_system.read(source)


@pytest.fixture
def grid(real_data: Path) -> LocationGrid:
    return read_location_grid(real_data / GRID)


def test_rigorous_model_is_the_producers_grid_to_a_quarter_millimetre(
    product: Product, grid: LocationGrid
) -> None:
    """65 x 65 nodes at 9 heights; what is left is one instant, 28 ns: START has seven decimals."""
    height = grid.geodetic[..., 2]
    ground = product.model.image_to_ground(grid.image_px, height)
    assert np.all(ground.flag == Flag.OK)
    metres = geodetic_to_ecef(ground.geodetic) - geodetic_to_ecef(grid.geodetic)
    assert np.max(np.linalg.norm(metres, axis=-1)) <= 3e-4
    back = product.model.ground_to_image(grid.geodetic).image_px - grid.image_px
    mean = back.mean(axis=(0, 1, 2))
    np.testing.assert_allclose(mean, [-3.8e-4, 3e-5], atol=3e-5)
    assert np.max(np.abs(back - mean)) <= 1e-5


def test_rational_functions_agree_as_well_as_their_maker_says(
    product: Product, grid: LocationGrid
) -> None:
    """Inside the heights they were fitted to; the maker's own figure is the mean fit error."""
    assert product.vendor_rpc is not None
    low, high = product.vendor_rpc.height_range_m
    assert (low, high) == (490.0, 660.0)
    image = grid.image_px[:, :, None, :]
    ground = product.model.image_to_ground(image, np.linspace(low, high, 3))
    difference = product.vendor_rpc.ground_to_image(ground.geodetic).image_px - image
    assert np.max(np.abs(difference)) <= 0.02
    assert np.max(difference.std(axis=(0, 1, 2))) <= 5e-3
    direct = product.vendor_rpc.direct_image_to_ground(image, np.linspace(low, high, 3))
    metres = geodetic_to_ecef(direct) - geodetic_to_ecef(ground.geodetic)
    assert np.max(np.linalg.norm(metres, axis=-1)) <= 0.02


def test_what_the_product_says(product: Product) -> None:
    assert product.sensor == "Pleiades-1B"
    assert product.model.shape == (38248, 40000)
    assert product.details["velocities_in_file"] == "inertial-on-itrs-axes"
    assert product.start is not None
    assert product.start.utc_iso(3) == "2018-12-26T10:48:55.449Z"
