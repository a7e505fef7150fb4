"""`geoposition dsm` on small made-up images: outputs, the bias, the reference, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from dense_scenes import MIDDLE_M, Pair, pair, rpc, texture, write
from rasterio.transform import from_origin

from geoposition.datum import from_crs
from geoposition.scripts.cli import run


@pytest.fixture(scope="module")
def biased(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """A pair whose second image lies 2 samples, across the epipolar lines, beside its model."""
    return pair(tmp_path_factory.mktemp("biased"), shifts=((0.0, 2.0),))


def level(folder: Path, name: str, lon: float, lat: float, height: float = MIDDLE_M) -> Path:
    path = folder / name
    profile = {
        "driver": "GTiff", "dtype": "float32", "count": 1, "width": 60, "height": 60,
        "crs": "EPSG:4326", "transform": from_origin(lon - 0.03, lat + 0.03, 0.001, 0.001),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as out:
        out.write(np.full((60, 60), height, dtype=np.float32), 1)
    return path


def dsm(scene: Pair, out: Path, *more: object) -> int:
    return run([str(part) for part in ("dsm", *scene.paths, "-o", out, *more)])


def test_a_surface_and_a_cloud(
    biased: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, cloud = tmp_path / "dsm.tif", tmp_path / "dsm.laz"
    reference = level(tmp_path, "ref.tif", 7.0, 44.0)
    options = ("--points", cloud, "--remove-bias", "--reference", reference, "--json")
    assert dsm(biased, out, *options) == 0
    facts = json.loads(capsys.readouterr().out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dsm.laz", "dsm.tif", "ref.tif"]
    first, second = facts["relative_bias_px"]
    np.testing.assert_allclose(first["row_col"], 0.0)
    np.testing.assert_allclose(second["row_col"], (0.0, 2.0), atol=0.05)
    assert second["removed"]
    assert facts["residual_px"]["as_is"] == pytest.approx(1.0, abs=0.05)
    assert facts["residual_px"]["bias_removed"] < 0.1
    assert facts["epipolar_residual_px"] < 0.1
    assert facts["matched_share"] > 0.8
    assert facts["crs"] == "EPSG:32632"
    assert facts["comparison"]["difference_m"]["count"] > 100_000
    with rasterio.open(out) as raster:
        layers, crs, transform = raster.read(), raster.crs, raster.transform
        assert raster.descriptions == ("height", "count", "error")
        assert "ellipsoid" in raster.tags()["HEIGHTS"]
    assert list(layers.shape[1:]) == facts["shape"]
    # The heights that were put in, where the first image, straight down, shows them.
    row, column = np.nonzero(np.isfinite(layers[0]))
    pick = np.random.default_rng(0).integers(0, len(row), 4000)
    row, column = row[pick], column[pick]
    x, y = transform * (column + 0.5, row + 0.5)
    ground = from_crs(crs.to_wkt(), np.column_stack([x, y, layers[0][row, column]]))
    image = np.rint(biased.models[0].ground_to_image(ground).image_px - (0.0, 1.0)).astype(int)
    inside = np.all((image >= 0) & (image < 512), axis=1)
    off = (ground[:, 2] - biased.height_m[tuple(np.clip(image, 0, 511).T)])[inside]
    assert abs(np.median(off)) < 0.1
    assert np.percentile(np.abs(off), 90) < 0.5
    points = laspy.read(cloud)
    assert len(points) == facts["points"]
    assert abs(np.median(points.z) - np.nanmedian(layers[0])) < 1.0


def test_bias_left_in_moves_nothing_but_is_reported(
    biased: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "dsm.tif"
    assert dsm(biased, out, "--resolution", "1", "--crs", "2154", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert not facts["relative_bias_px"][1]["removed"]
    np.testing.assert_allclose(facts["relative_bias_px"][1]["row_col"], (0.0, 2.0), atol=0.05)
    assert facts["matched_share"] > 0.8
    assert facts["comparison"] is None
    with rasterio.open(out) as raster:
        assert raster.crs.to_epsg() == 2154
        assert raster.res == (1.0, 1.0)


def test_from_a_dem_filled(
    biased: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dem = level(tmp_path, "dem.tif", 7.0, 44.0)
    shares = []
    for more in ((), ("--fill",)):
        assert dsm(biased, tmp_path / "dsm.tif", "--dem", dem, "--json", *more) == 0
        capsys.readouterr()
        with rasterio.open(tmp_path / "dsm.tif") as raster:
            shares.append(np.isfinite(raster.read(1)).mean())
    assert shares[0] < shares[1] <= 1.0


def refused(capsys: pytest.CaptureFixture[str], folder: Path, status: int) -> str:
    """Exit 2, one line, and nothing left behind."""
    assert status == 2
    err = capsys.readouterr().err
    lines = [line for line in err.splitlines() if line.startswith("geoposition:")]
    assert len(lines) == 1, err
    assert not [path for path in folder.iterdir() if "dsm" in path.name]
    return lines[0]


def test_images_that_do_not_overlap(
    biased: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = rpc(512, 0.8, shift=(90_000.0, 0.0))
    other = Pair(
        [biased.paths[0], write(tmp_path / "far.tif", texture(512), far)],
        [biased.models[0], far],
        biased.height_m,
    )
    line = refused(capsys, tmp_path, dsm(other, tmp_path / "dsm.tif"))
    assert "do not overlap" in line


def test_images_of_other_ground(
    biased: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The right models with the wrong pixels, and with none to speak of."""
    for name, grey in (("swap.tif", texture(512, 77)), ("flat.tif", np.full((512, 512), 700.0))):
        path = write(tmp_path / name, grey, biased.models[1])
        other = Pair([biased.paths[0], path], biased.models, biased.height_m)
        line = refused(capsys, tmp_path, dsm(other, tmp_path / "dsm.tif"))
        assert "matching" in line


def test_terrain_elsewhere(
    biased: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    away = level(tmp_path, "away.tif", 20.0, 10.0)
    for option in ("--dem", "--reference"):
        line = refused(capsys, tmp_path, dsm(biased, tmp_path / "dsm.tif", option, away))
        assert "away.tif" in line


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (("--resolution", "-1"), "resolution"),
        (("--crs", "EPSG:1"), "coordinate"),
        (("--heights", "10", "5"), "--heights"),
        (("--heights", "8000", "9000"), "matching"),
        (("--points", "cloud.xyz"), ".las"),
        (("--geoid", "x.gtx"), "--geoid"),
        (("--image", "a.tif"), "--image"),
    ],
)
def test_bad_usage(
    biased: Pair,
    tmp_path: Path,
    more: tuple[str, ...],
    named: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert named in refused(capsys, tmp_path, dsm(biased, tmp_path / "dsm.tif", *more))


def test_one_product_is_no_pair(
    biased: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status = run(["dsm", str(biased.paths[0]), "-o", str(tmp_path / "dsm.tif")])
    assert "two or more" in refused(capsys, tmp_path, status)
