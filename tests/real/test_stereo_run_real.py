"""Whole stereo runs on real products: what the command says, bias removed, rigorous and RPC."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from geoposition.accuracy import enu_errors_m
from geoposition.flags import Flag
from geoposition.observations import TiePoints
from geoposition.scripts.cli import run
from geoposition.sensors.readers import open_product
from geoposition.triangulate import triangulate


def intersect(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, object]:
    assert run(["intersect", *map(str, arguments), "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize("removed", [False, True])
def test_reunion(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], removed: bool
) -> None:
    folder = real_data / "stereo/pleiades_reunion"
    images = [folder / "img_01.tif", folder / "img_02.tif"]
    found = intersect(
        capsys, *images, "--match", "-o", tmp_path / "points.csv",
        "--reference", folder / "expected_dsm.tif", *(["--remove-bias"] if removed else []),
    )  # fmt: skip
    assert found["intersected"] >= 3000
    difference = found["reference"]["difference_m"]
    assert abs(difference["median"]) <= 0.2
    assert difference["nmad"] <= 0.6
    assert found["residual_px"]["median"] < (0.1 if removed else 0.4)


def test_ventoux(real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, dem = real_data / "stereo/pleiades_ventoux", real_data / "dem"
    sides = ("left_image", "right_image")
    images = [part for name in sides for part in ("--image", folder / f"{name}.tif")]
    page = tmp_path / "report.html"
    found = intersect(
        capsys, *(folder / f"{name}.geom" for name in sides), *images, "--match",
        "--remove-bias", "-o", tmp_path / "points.gpkg", "--report", page,
        "--reference", dem / "N44E005.hgt", "--geoid", dem / "egm96_15.gtx",
    )  # fmt: skip
    assert found["residual_before_removal_px"]["median"] == pytest.approx(2.4, abs=0.1)
    assert found["residual_px"]["median"] <= 0.3
    # Ellipsoidal beside orthometric heights would be off by 50 m.
    assert abs(found["reference"]["difference_m"]["median"]) < 10.0
    assert page.stat().st_size > 100_000


@pytest.mark.parametrize("pair", ["reunion", "ventoux"])
def test_swapped_images_are_refused(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], pair: str
) -> None:
    folder = real_data / f"stereo/pleiades_{pair}"
    if pair == "reunion":
        images = [folder / "img_01.tif", folder / "img_02.tif"]
        products = images
    else:
        images = [folder / "left_image.tif", folder / "right_image.tif"]
        products = [folder / "left_image.geom", folder / "right_image.geom"]
    swapped = [part for image in images[::-1] for part in ("--image", str(image))]
    arguments = ["intersect", *map(str, products), *swapped, "--match"]
    assert run([*arguments, "-o", str(tmp_path / "points.csv")]) == 2
    line = capsys.readouterr().err
    assert "swapped" in line
    assert line.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_worldview_pair_rigorous_and_by_rpc(real_data: Path) -> None:
    """The same ties through rigorous models and through the vendor's RPCs.

    Rows are off by up to 0.17 px between the two, columns by up to 0.38 px: attitude motion
    that an RPC cannot follow. Half a metre a pixel makes of it what is bounded here.
    """
    folder = real_data / "linescan/worldview2_pair"
    products = [open_product(folder / f"wv_mvp_{k}.xml") for k in (1, 2)]
    rigorous = [product.model for product in products]
    rpcs = [product.vendor_rpc for product in products]
    assert rpcs[0] is not None
    assert rpcs[1] is not None
    rng = np.random.default_rng(1)
    image = rng.uniform((0.0, 0.0), np.array(rigorous[0].shape) - 1.0, (20_000, 2))
    height = rng.uniform(*rigorous[0].height_range_m, len(image))
    ground = rigorous[0].image_to_ground(image, height).geodetic
    seen = [model.ground_to_image(ground) for model in rigorous]
    both = (seen[0].flag == Flag.OK) & (seen[1].flag == Flag.OK)
    assert both.sum() > 10_000
    ties = TiePoints.of_pair(*(points.image_px[both] for points in seen))
    by_rigorous = triangulate(rigorous, ties)
    by_rpc = triangulate([rpcs[0], rpcs[1]], ties)
    off = enu_errors_m(by_rpc.geodetic, by_rigorous.geodetic)
    assert np.all(np.median(np.abs(off), axis=0) <= 0.1)
    assert np.max(np.linalg.norm(off, axis=1)) < 0.4
    # No more than the RPCs' misfit in the images makes of the ground.
    misfit = np.linalg.norm(
        [
            ties.image_px[ties.product == k] - rpc.ground_to_image(by_rigorous.geodetic).image_px
            for k, rpc in enumerate(rpcs)
            if rpc is not None
        ],
        axis=(0, 2),
    )
    unit = triangulate(rigorous, ties, 1.0).sigma_enu_m
    assert np.all(np.abs(off) <= 1.01 * unit * misfit[:, None] + 1e-3)
