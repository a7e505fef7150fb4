"""Dense surfaces of real Pleiades pairs: against another tool's surface, and against SRTM."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import rasterio

from geoposition.errors import GeometryError
from geoposition.scripts import dsm_run
from geoposition.sensors.readers import open_product

Facts = dict[str, object]


def run(products: list[Path], images: list[Path], request: dsm_run.Request) -> Facts:
    opened = [open_product(path) for path in products]
    return dsm_run.run(opened, images, request, lambda done, total: None)


def test_reunion_equals_another_tools_surface(
    real_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Of its cells 90 % and more are found, with an offset below 0.2 m and an NMAD below 0.6 m."""
    caplog.set_level(logging.ERROR)
    folder = real_data / "stereo/pleiades_reunion"
    images = [folder / "img_01.tif", folder / "img_02.tif"]
    out = tmp_path / "dsm.tif"
    request = dsm_run.Request(
        output=out,
        points=tmp_path / "dsm.laz",
        resolution=0.5,
        remove_bias=True,
        reference=folder / "expected_dsm.tif",
    )
    facts = run(images, [], request)
    residual = facts["residual_px"]
    assert residual["as_is"] == pytest.approx(0.36, abs=0.03)  # type: ignore[index]
    assert residual["bias_removed"] < 0.1  # type: ignore[index]
    assert facts["epipolar_residual_px"] < 0.1  # type: ignore[operator]
    comparison = facts["comparison"]
    assert comparison["reference_cover"] >= 0.90  # type: ignore[index]
    difference = comparison["difference_m"]  # type: ignore[index]
    assert abs(difference["median"]) <= 0.2
    assert difference["nmad"] <= 0.6
    # Cell by cell, without the comparison's own code.
    with rasterio.open(out) as raster, rasterio.open(folder / "expected_dsm.tif") as other:
        assert raster.crs == other.crs
        window = rasterio.windows.from_bounds(*other.bounds, transform=raster.transform)
        mine = raster.read(1, window=window, boundless=True, fill_value=np.nan)
        theirs = other.read(1)
    both = np.isfinite(mine) & np.isfinite(theirs)
    assert both.sum() >= 0.90 * np.isfinite(theirs).sum()
    off = (mine - theirs)[both]
    assert abs(np.median(off)) <= 0.2
    assert 1.4826 * np.median(np.abs(off - np.median(off))) <= 0.6


def test_ventoux_after_its_bias_is_removed(
    real_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Heights above the ellipsoid: some 52 m of geoid off from those above it."""
    caplog.set_level(logging.ERROR)
    folder, dem = real_data / "stereo/pleiades_ventoux", real_data / "dem"
    request = dsm_run.Request(
        output=tmp_path / "dsm.tif",
        remove_bias=True,
        reference=dem / "N44E005.hgt",
        geoid=dem / "egm96_15.gtx",
    )
    products = [folder / "left_image.geom", folder / "right_image.geom"]
    facts = run(products, [folder / "left_image.tif", folder / "right_image.tif"], request)
    assert facts["residual_px"]["as_is"] == pytest.approx(2.4, abs=0.1)  # type: ignore[index]
    assert facts["residual_px"]["bias_removed"] <= 0.3  # type: ignore[index]
    comparison = facts["comparison"]
    # Means over SRTM's 90 m cells: cell by cell the ravine that it smooths away is in the NMAD.
    cells = comparison["reference_cells_m"]  # type: ignore[index]
    assert cells["nmad"] <= 8.0
    assert abs(cells["median"]) < 10.0
    assert abs(comparison["difference_m"]["median"]) < 10.0  # type: ignore[index]


def test_swapped_images_are_refused(real_data: Path, tmp_path: Path) -> None:
    folder = real_data / "stereo/pleiades_reunion"
    images = [folder / "img_01.tif", folder / "img_02.tif"]
    with pytest.raises(GeometryError, match="swapped"):
        run(images, images[::-1], dsm_run.Request(output=tmp_path / "dsm.tif"))
    assert not list(tmp_path.iterdir())
