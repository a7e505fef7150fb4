"""`rpc fit`, `rpc compare` and `rpc convert` as people and scripts meet them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import scenes
from rasterio.transform import Affine

from geoposition.rpc.compare import compare
from geoposition.rpc.formats import read_rpc
from geoposition.scripts.cli import run
from geoposition.sensors.readers import open_product
from geoposition.sensors.writers.model_file import write_model_file

FILES = ("image.RPB", "image_RPC.TXT", "image_RPC.XML", "image.geom", "image.json", "image.tif")


@pytest.fixture(scope="module")
def model_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "scene.toml"
    write_model_file(scenes.build((2000, 1500), roll_deg=12.0).model(), path, sensor="synthetic")
    return path


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    capsys.readouterr()
    assert run([str(argument) for argument in (*arguments, "--json")]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert run([str(argument) for argument in arguments]) == 2
    out = capsys.readouterr()
    assert out.out == ""
    assert out.err.count("\n") == 1, out.err
    return out.err


@pytest.mark.parametrize("name", FILES)
def test_a_fit_is_written_and_read_again_by_gdal(
    name: str, model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = told(capsys, "rpc", "fit", model_path, "-o", tmp_path / name, "--verify")
    assert result["verified"]["points"] == 1000
    assert result["verified"]["max_px"] < 1e-6
    by_gdal = name.rpartition(".")[2] not in ("geom", "json")
    assert result["verified"]["reader"].startswith("GDAL" if by_gdal else "geoposition")
    assert max(result["check"][axis]["max"] for axis in ("row", "col")) < 1e-3
    written = read_rpc(tmp_path / name)
    found = compare(open_product(model_path).model, written, heights_m=[0.0, 5000.0])
    assert max(found.row.max, found.col.max) < 1e-3
    assert (written.direct is not None) == name.endswith((".XML", ".json"))


def test_options_reach_the_fit(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.json"
    told(
        capsys, "rpc", "fit", model_path, "-o", out, "--heights", -10, 990, "--degree", 2,
        "--denominators", "equal", "--no-direct",
    )  # fmt: skip
    model = read_rpc(out)
    assert model.height_range_m == (-10.0, 990.0)
    assert not np.any(model.line_num[10:])
    np.testing.assert_array_equal(model.line_den, model.samp_den)
    assert model.direct is None


def test_heights_come_from_the_dem_under_the_image(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = open_product(model_path).model
    corners = np.array([[0.0, 0.0], [0.0, 1499.0], [1999.0, 0.0], [1999.0, 1499.0]])
    lon, lat = np.degrees(model.image_to_ground(corners, 500.0).geodetic[:, :2]).T
    dem = tmp_path / "dem.tif"
    rng = np.random.default_rng(0)
    heights = rng.uniform(200.0, 700.0, (200, 200)).astype(np.float32)
    step = 0.002
    with rasterio.open(
        dem, "w", driver="GTiff", width=200, height=200, count=1, dtype="float32",
        crs="EPSG:4326",
        transform=Affine(step, 0.0, lon.mean() - 100 * step, 0.0, -step, lat.mean() + 100 * step),
    ) as file:  # fmt: skip
        file.write(heights, 1)
    result = told(capsys, "rpc", "fit", model_path, "-o", tmp_path / "a.RPB", "--dem", dem)
    low, high = read_rpc(tmp_path / "a.RPB").height_range_m
    assert 145.0 <= low <= 175.0
    assert 720.0 <= high <= 755.0
    assert "DEM" in result["heights"]


def test_the_report_stands_alone(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "fit.html"
    told(capsys, "rpc", "fit", model_path, "-o", tmp_path / "a.XML", "--report", report, "--verify")
    page = report.read_text()
    assert page.count("data:image/png;base64,") == 3
    assert "http" not in page.replace("http-equiv", "")
    for words in ("largest misfit", "read again", "Along the lines", "line num", "free of zeros"):
        assert words in page


def test_a_location_grid_is_checked_at_nodes_kept_out(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = open_product(model_path).model
    heights = (0.0, 1000.0, 2000.0, 3000.0, 4000.0)
    line, samp = np.arange(0.0, 2001.0, 100.0) - 0.5, np.arange(0.0, 1501.0, 100.0) - 0.5
    image = np.stack(np.meshgrid(line, samp, indexing="ij"), axis=-1)
    path = tmp_path / "grid.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=len(samp), height=len(line), count=10, dtype="float64",
        transform=Affine(100.0, 0.0, 0.0, 0.0, 100.0, 0.0),
    ) as file:  # fmt: skip
        for k, height in enumerate(heights):
            ground = np.degrees(model.image_to_ground(image, height).geodetic)
            for band in range(2):
                file.write(ground[..., band], 2 * k + band + 1)
                file.update_tags(**{f"ALTITUDE_B{2 * k + band}": str(height)})
    result = told(capsys, "rpc", "fit", path, "-o", tmp_path / "a_RPC.TXT", "--verify")
    assert result["source"] == "location grid"
    assert result["kept_out"]["points"] > 500
    assert result["kept_out"]["row"]["max"] < 1e-3
    found = compare(model, read_rpc(tmp_path / "a_RPC.TXT"), heights_m=[100.0, 3900.0])
    assert max(found.row.max, found.col.max) < 1e-3
    line_one = refused(capsys, "rpc", "fit", path, "-o", tmp_path / "b.RPB", "--heights", 0, 1)
    assert "its own heights" in line_one


def test_control_points_are_checked_by_leaving_out(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, rng = open_product(model_path).model, np.random.default_rng(0)
    image = rng.uniform(0.0, 1.0, (60, 2)) * model.shape
    ground = model.image_to_ground(image, rng.uniform(0.0, 800.0, 60)).geodetic
    image += 0.1 * rng.normal(size=image.shape)
    rows = ["id,row,col,lon,lat,height,sigma_px"]
    for k, ((row, col), (lon, lat, height)) in enumerate(zip(image, ground, strict=True)):
        rows.append(f"{k},{row},{col},{np.degrees(lon):.12f},{np.degrees(lat):.12f},{height},0.1")
    rows.append("bad,1,2,,,,0.1")
    table = tmp_path / "points.csv"
    table.write_text("\n".join(rows) + "\n")
    result = told(
        capsys, "rpc", "fit", table, "-o", tmp_path / "a.json", "--report", tmp_path / "a.html"
    )
    assert result["points"] == 60
    assert result["unreadable"] == 1
    assert 0.05 < result["leave_one_out"]["row"]["rms"] < 0.25


def test_convert_moves_with_the_image(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "a.json"
    told(capsys, "rpc", "fit", model_path, "-o", source)
    model, out = read_rpc(source), tmp_path / "b.json"
    image = np.array([[1000.0, 700.0], [1200.0, 760.0]])
    ground = model.image_to_ground(image, 300.0).geodetic
    for options, expected in (
        (("--bias", 1.5, -2), image + (1.5, -2.0)),
        (("--crop", 900, 600, 500, 400), image - (900.0, 600.0)),
        (("--overview", 2), (image + 0.5) / 2.0 - 0.5),
        (("--turn", 1), np.stack([1499.0 - image[:, 1], image[:, 0]], axis=1)),
        (("--crop", 900, 600, 500, 400, "--turn", 2), (499.0, 399.0) - (image - (900.0, 600.0))),
    ):
        result = told(capsys, "rpc", "convert", source, "-o", out, *options, "--verify")
        assert result["verified"]["passed"]
        found = read_rpc(out).ground_to_image(ground).image_px
        np.testing.assert_allclose(found, expected, atol=1e-7)
    assert read_rpc(out).shape == (500, 400)


def test_heights_beyond_the_fit_are_pointed_out(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.RPB"
    told(capsys, "rpc", "fit", model_path, "-o", out, "--heights", 0, 500)
    inside = told(capsys, "rpc", "compare", model_path, out, "--heights", 0, 500)
    assert "warning" not in inside
    beyond = told(capsys, "rpc", "compare", model_path, out, "--heights", 0, 4000)
    assert "0 .. 500 m" in beyond["warning"]


def test_refusals_are_one_line_and_leave_nothing(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.RPB"
    for arguments, words in (
        (("-o", tmp_path / "a.xyz"), "expected at its end"),
        (("-o", tmp_path / "no" / "a.RPB"), "does not exist"),
        (("-o", out, "--heights", 10, 0), "low to high"),
        (("-o", out, "--heights", 0, 1, "--dem", "x.tif"), "not both"),
        (("-o", out, "--geoid", "x.gtx"), "--dem"),
        (("-o", out, "--dem", tmp_path / "none.tif"), "none.tif"),
        (("-o", out, "--degree", 4), "--degree"),
        (("-o", out, "--degree", 1, "--limit", 1e-6), "misses the model"),
        (("-o", out, "--report", tmp_path / "a.pdf"), "html"),
    ):
        said = refused(capsys, "rpc", "fit", model_path, *arguments)
        assert words in said
        assert "misses" not in said or str(model_path) in said
        assert sorted(tmp_path.iterdir()) == []
    assert "none.xml" in refused(capsys, "rpc", "fit", tmp_path / "none.xml", "-o", out)
