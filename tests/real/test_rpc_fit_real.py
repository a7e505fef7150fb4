"""RPCs fitted to real products, beside their makers' RPCs and grids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geoposition.rpc.compare import Comparison, compare
from geoposition.rpc.fit import fit_model, fit_samples
from geoposition.rpc.formats import write_rpc
from geoposition.rpc.formats.verify import verify_rpc
from geoposition.sensors.readers import open_product
from geoposition.sensors.readers.location_grid import read_location_grid

WORLDVIEW = (
    "linescan/worldview2_pair/wv_mvp_1.xml",
    "linescan/worldview2_pair/wv_mvp_2.xml",
    "linescan/worldview1_tile/"
    "WV01_20210201005130_10200100A1865800_21FEB01005130-P1BS-016263048010_01_P001.xml",
)
GRIDS = ("2017092838284574CP", "2018122638935449CP")


def test_pleiades_rigorous_model_to_rpc(real_data: Path) -> None:
    product = open_product(real_data / "linescan/pleiades1a")
    fit = fit_model(product.model)
    assert fit.check is not None
    assert fit.check.largest_px <= 0.001
    assert product.vendor_rpc is not None
    found = compare(fit.model, product.vendor_rpc)
    # The constant between the maker's rigorous model and RPC, and nothing else.
    assert found.row.mean == pytest.approx(0.093, abs=0.001)
    assert found.col.mean == pytest.approx(-0.021, abs=0.001)
    assert max(found.row.max_without_mean, found.col.max_without_mean) < 0.001


@pytest.mark.parametrize("name", WORLDVIEW)
def test_worldview_misfit_is_below_the_vendors(name: str, real_data: Path) -> None:
    """The rest is attitude motion; ours is the smaller in mean, scatter and maximum."""
    product = open_product(real_data / name)
    assert product.vendor_rpc is not None
    fit = fit_model(product.model)
    heights = np.linspace(*product.vendor_rpc.height_range_m, 5)

    def misfit(model: object) -> Comparison:
        return compare(product.model, model, heights_m=heights, grid=(301, 11, 5))  # type: ignore[arg-type]

    ours, theirs = misfit(fit.model), misfit(product.vendor_rpc)
    for axis in ("row", "col"):
        mine, vendors = getattr(ours, axis), getattr(theirs, axis)
        assert mine.std <= vendors.std
        assert mine.max <= vendors.max
        assert np.hypot(mine.mean, mine.std) <= np.hypot(vendors.mean, vendors.std)
    assert fit.check is not None
    assert fit.check.cube_range.min() > 0.5


def test_spot6_rigorous_model_to_rpc(real_data: Path) -> None:
    fit = fit_model(open_product(real_data / "linescan/spot6/SPOT6.XML").model)
    assert fit.check is not None
    assert fit.check.largest_px < 0.04


@pytest.mark.parametrize("name", GRIDS)
def test_producers_grids_at_nodes_kept_out(name: str, real_data: Path) -> None:
    grid = read_location_grid(real_data / f"grids/GRID_P1BP--{name}.tif")
    image = np.broadcast_to(grid.image_px, grid.geodetic.shape[:-1] + (2,))
    used = np.zeros(image.shape[:-1], dtype=bool)
    used[:, ::3, ::3] = True
    fit = fit_samples(image[used], grid.geodetic[used])
    missed = fit.model.ground_to_image(grid.geodetic[~used]).image_px - image[~used]
    assert np.abs(missed).max() <= 0.01
    # A height layer kept out, as well; its neighbours are hundreds of metres away.
    layer = len(grid.height_m) // 2
    others = np.arange(len(grid.height_m)) != layer
    fit = fit_samples(image[others], grid.geodetic[others])
    missed = fit.model.ground_to_image(grid.geodetic[layer]).image_px - image[layer]
    assert np.abs(missed).max() <= 0.01


@pytest.mark.parametrize("name", ["a.RPB", "a_RPC.TXT", "a_RPC.XML", "a.geom", "a.json", "a.tif"])
def test_gdal_places_the_pixel_where_we_do(name: str, real_data: Path, tmp_path: Path) -> None:
    fit = fit_model(open_product(real_data / WORLDVIEW[0]).model)
    write_rpc(fit.model, tmp_path / name)
    verified = verify_rpc(fit.model, tmp_path / name)
    assert verified.points == 1000
    assert verified.max_px < 1e-6
