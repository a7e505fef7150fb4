"""Producer's grid against the vendor RPC: the row and column conventions of both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geoposition.errors import MissingFileError, ProductError
from geoposition.rpc.formats import read_rpc
from geoposition.sensors.readers.location_grid import read_location_grid

GRIDS = "grids"
NAME = "P1BP--2017092838284574CP"


def test_vendor_rpc_against_the_producers_grid(real_data: Path) -> None:
    grid = read_location_grid(real_data / GRIDS / f"GRID_{NAME}.tif")
    rpc = read_rpc(real_data / GRIDS / f"RPC_{NAME}.XML")
    np.testing.assert_array_equal(grid.height_m, [-30.0, 1202.5, 2435.0, 3667.5, 4900.0])
    image = rpc.ground_to_image(grid.geodetic).image_px
    difference = np.abs(image - grid.image_px).max(axis=(1, 2, 3))
    assert np.all(difference <= 0.1)
    np.testing.assert_allclose(difference[:2], [0.0018, 0.0020], atol=5e-5)


def test_other_rasters_are_refused(real_data: Path, tmp_path: Path) -> None:
    with pytest.raises(ProductError, match=r"longitude and latitude|one height"):
        read_location_grid(real_data / GRIDS / f"MNT_{NAME}.tif")
    with pytest.raises(MissingFileError):
        read_location_grid(tmp_path / "none.tif")
    empty = tmp_path / "empty.tif"
    empty.write_bytes(b"")
    with pytest.raises(ProductError, match="GeoTIFF"):
        read_location_grid(empty)
