"""`geoposition demo`: its files run in the library, its figures can be recomputed from them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_report import assert_stands_alone

from geoposition.accuracy import PointStatistics, point_statistics
from geoposition.errors import ProductError
from geoposition.locate import locate
from geoposition.observations import TiePoints
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts import cli
from geoposition.scripts.demo.folder import MARK_KEY, check_folder, whole_folder
from geoposition.scripts.tables import read_table
from geoposition.sensors.readers import open_product
from geoposition.sensors.simulate import simulate_scene
from geoposition.terrain.raster import RasterTerrain
from geoposition.triangulate import triangulate

CAMERAS = ("forward", "nadir", "backward")


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = cli.run([*arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo") / "scene"
    assert cli.run(["demo", "--out", str(folder), "--seed", "3", "--json"]) == 0
    return folder


@pytest.fixture(scope="module")
def figures(demo: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((demo / "demo.json").read_text(encoding="utf-8"))
    return result


def truth(demo: Path) -> tuple[np.ndarray, np.ndarray]:
    table = read_table(demo / "gcps.csv", ("lon", "lat", "height"))
    degrees = np.stack([table[name] for name in ("lon", "lat", "height")], axis=1)
    return table["id"], np.column_stack([np.radians(degrees[:, :2]), degrees[:, 2]])


def ties(demo: Path, prefix: str) -> TiePoints:
    table = read_table(demo / "ties.csv", ("row", "col"), texts=("id", "product"))
    rows = np.flatnonzero(np.char.startswith(table["id"].astype(np.str_), prefix))
    product = [CAMERAS.index(Path(str(name)).stem) for name in table["product"][rows]]
    image = np.stack([table["row"], table["col"]], axis=1)[rows]
    return TiePoints(table["id"][rows].astype(np.str_), np.array(product), image.astype(np.float64))


def models(folder: Path) -> list[PushbroomModel]:
    opened = [open_product(folder / f"{name}.toml").model for name in CAMERAS]
    assert all(isinstance(model, PushbroomModel) for model in opened)
    return opened  # type: ignore[return-value]


def close(found: PointStatistics, stated: dict[str, Any], within_m: float) -> None:
    for name, axis in found.axes.items():
        for key, value in axis.as_dict().items():
            assert value == pytest.approx(stated[name][key], abs=within_m), (name, key)
    for key in ("horizontal_rmse_m", "rmse_3d_m", "ce90_m", "le90_m"):
        assert getattr(found, key) == pytest.approx(stated[key], abs=within_m)


def test_folder_holds_what_it_lists(demo: Path, figures: dict[str, Any]) -> None:
    present = {p.relative_to(demo).as_posix() for p in demo.rglob("*") if p.is_file()}
    assert present == set(figures["files"])
    for name in ("report.html", "demo.json", "ties.csv", "gcps.csv", "points.csv", "dem.tif"):
        assert name in present
    assert [p.name for p in demo.parent.iterdir()] == ["scene"]


def test_models_reopen_to_the_same_rays(demo: Path) -> None:
    scene = simulate_scene(seed=3)
    for folder, kind in ((demo, scene.measured), (demo / "true", scene.true)):
        for name, opened in zip(CAMERAS, models(folder), strict=True):
            pixel = np.random.default_rng(1).uniform(0, 1, (200, 2)) * opened.shape
            mine, theirs = kind[name].rays(pixel, 900.0), opened.rays(pixel, 900.0)
            np.testing.assert_array_equal(mine.origin_ecef_m, theirs.origin_ecef_m)
            np.testing.assert_array_equal(mine.direction_ecef, theirs.direction_ecef)


@pytest.mark.parametrize("kind", ["true", "measured"])
def test_check_points_recomputed_from_the_files(
    demo: Path, figures: dict[str, Any], kind: str
) -> None:
    ids, true = truth(demo)
    assert len(ids) == figures["check_points"] >= 250
    found = triangulate(models(demo / "true" if kind == "true" else demo), ties(demo, "c"), 0.3)
    assert list(found.ids) == list(ids)
    stated = figures["intersection"][f"{kind}_models"]
    # image points are written to 1e-4 px: a fraction of a millimetre
    close(point_statistics(found.geodetic, true), stated["errors_m"], 2e-3)
    for k, axis in enumerate("enu"):
        sigma = np.sqrt(np.mean(found.sigma_enu_m[:, k] ** 2))
        assert sigma == pytest.approx(stated["stated_sigma_m"][axis], rel=1e-5)


def test_sigma_is_right_with_true_models_only(figures: dict[str, Any]) -> None:
    parts = figures["intersection"]
    n = figures["check_points"]
    for axis in "enu":
        # the deviation of the root of a mean of n squares is 1 / sqrt(2 n): four of them
        right = pytest.approx(1.0, abs=4 / np.sqrt(2 * n))
        assert parts["true_models"]["error_over_sigma"][axis] == right
    assert max(parts["measured_models"]["error_over_sigma"].values()) > 3.0


def test_causes_add_up(figures: dict[str, Any]) -> None:
    causes = figures["error_causes"]
    assert causes["all"] == figures["intersection"]["measured_models"]["errors_m"]
    image = causes["image points"]["rmse_3d_m"]
    # 5 cm of orbit are lost beside 0.3 px
    assert causes["orbit"]["rmse_3d_m"] == pytest.approx(image, rel=0.05)
    for name in ("attitude noise", "mounting"):
        assert causes[name]["rmse_3d_m"] > image
    # means are nearly linear in small causes: the mounting's and the noise's are the whole's
    for axis in "enu":
        parts = [causes[name][axis]["mean"] for name in ("orbit", "attitude noise", "mounting")]
        mean = sum(parts) - 2 * causes["image points"][axis]["mean"]
        assert causes["all"][axis]["mean"] == pytest.approx(mean, abs=0.05)


def test_residuals_are_the_measured_models(demo: Path, figures: dict[str, Any]) -> None:
    _, true = truth(demo)
    tie = ties(demo, "c")
    for k, model in enumerate(models(demo)):
        off = tie.image_px[tie.product == k] - model.ground_to_image(true).image_px
        stated = figures["control_residuals_px"][CAMERAS[k]]
        assert off[:, 0].mean() == pytest.approx(stated["row"]["mean"], abs=1e-4)
        assert off[:, 1].std(ddof=1) == pytest.approx(stated["col"]["std"], abs=1e-4)


def test_heights_recomputed(demo: Path, figures: dict[str, Any]) -> None:
    dem = RasterTerrain(demo / "dem.tif")
    _, true = truth(demo)
    np.testing.assert_allclose(dem.height_at(true).height_m, true[:, 2], rtol=0, atol=1e-5)
    found = triangulate(models(demo), ties(demo, "g"), 0.3)
    error = found.geodetic[:, 2] - dem.height_at(found.geodetic).height_m
    stated = figures["heights"]["measured_models"]
    assert np.count_nonzero(np.isfinite(error)) == pytest.approx(stated["count"], abs=3)
    assert np.sqrt(np.nanmean(error**2)) == pytest.approx(stated["rmse"], abs=5e-3)
    # true models: nothing but image noise, and no bias
    bare = figures["heights"]["true_models"]
    assert abs(bare["mean"]) < 4 * bare["std"] / np.sqrt(bare["count"])


def test_single_image_recomputed_by_the_command(
    demo: Path, figures: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "located.csv"
    status, _, _ = run(
        capsys, "locate", str(demo / "nadir.toml"), str(demo / "points.csv"),
        "--dem", str(demo / "dem.tif"), "-o", str(out), "--json",
    )  # fmt: skip
    assert status == 0
    table = read_table(out, ("lon", "lat", "height"))
    found = np.stack([np.radians(table["lon"]), np.radians(table["lat"]), table["height"]], axis=1)
    close(point_statistics(found, truth(demo)[1]), figures["single_image"]["nadir"], 1e-3)
    tie = ties(demo, "c")
    nadir = tie.image_px[tie.product == CAMERAS.index("nadir")]
    direct = locate(models(demo)[1], nadir, RasterTerrain(demo / "dem.tif"))
    np.testing.assert_allclose(found, direct.geodetic, rtol=0, atol=1e-6)


def test_intersect_command_gives_the_same(
    demo: Path, figures: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, _ = run(
        capsys, "intersect", *(str(demo / f"{name}.toml") for name in CAMERAS),
        "--ties", str(demo / "ties.csv"), "--gcps", str(demo / "gcps.csv"), "--sigma", "0.3",
        "--image-noise-only",
        "-o", str(tmp_path / "out.csv"), "--json",
    )  # fmt: skip
    assert status == 0
    rmse = json.loads(out)["rmse_m"]
    stated = figures["intersection"]["measured_models"]["errors_m"]
    for axis in "enu":
        assert rmse[axis] == pytest.approx(stated[axis]["rmse"], abs=2e-3)


def test_one_arcsecond_is_range_times_angle(figures: dict[str, Any]) -> None:
    lines = figures["one_arcsecond"]
    assert len(lines) == 4
    for line in lines:
        assert line["measured_m"] == pytest.approx(line["expected_m"], rel=0.01), line["what"]
    assert lines[0]["measured_m"] == pytest.approx(511.5e3 * np.radians(1 / 3600), rel=0.01)


def test_report_stands_alone(demo: Path, figures: dict[str, Any]) -> None:
    html = (demo / "report.html").read_text(encoding="utf-8")
    found = assert_stands_alone(html)
    assert found.tags.count("img") == 6
    words = " ".join(" ".join(found.words).split())
    rmse = figures["intersection"]["measured_models"]["errors_m"]["rmse_3d_m"]
    assert f"{rmse:.1f} m" in words
    assert "geoposition intersect forward.toml nadir.toml backward.toml --ties ties.csv" in words
    assert "seed 3" in words


def test_json_on_stdout_is_the_file(
    demo: Path, figures: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    # The same seed again, into the same folder, with a file of the user's in it.
    (demo / "out.csv").write_text("mine")
    (demo / "true" / "notes.txt").write_text("mine too")
    status, out, err = run(capsys, "demo", "--out", str(demo), "--seed", "3", "--json")
    assert (status, err) == (0, "")
    printed = json.loads(out)
    assert Path(printed.pop("report")) == demo / "report.html"
    assert Path(printed.pop("out")) == demo
    assert printed.pop("seconds") > 0.0
    assert printed == figures
    assert (demo / "out.csv").read_text() == "mine"
    assert (demo / "true" / "notes.txt").read_text() == "mine too"
    assert not list(demo.glob(".geoposition*"))
    (demo / "out.csv").unlink()
    (demo / "true" / "notes.txt").unlink()


# Refusals ------------------------------------------------------------------------------------


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    status, out, err = run(capsys, "demo", *arguments)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def test_refuses_folders_that_are_not_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("years of work")
    assert "mine: a new folder" in refused(capsys, "--out", str(mine))
    (mine / "demo.json").write_text("{}")
    assert "mine: a new folder" in refused(capsys, "--out", str(mine))
    assert {p.name for p in mine.iterdir()} == {"thesis.txt", "demo.json"}
    file = tmp_path / "file"
    file.write_text("x")
    assert "this is a file" in refused(capsys, "--out", str(file))
    assert "does not exist" in refused(capsys, "--out", str(tmp_path / "no" / "demo"))
    assert "--image-sigma" in refused(
        capsys, "--out", str(tmp_path / "new"), "--image-sigma", "nan"
    )
    assert "seed" in refused(capsys, "--out", str(tmp_path / "new"), "--seed", "-1")
    assert {p.name for p in tmp_path.iterdir()} == {"mine", "file"}


def test_a_failure_leaves_nothing_behind(tmp_path: Path) -> None:
    new, old = tmp_path / "new", tmp_path / "old"
    old.mkdir()
    (old / "demo.json").write_text(json.dumps({MARK_KEY: 1, "files": ["a.txt", "demo.json"]}))
    (old / "a.txt").write_text("former")
    for path in (new, old):
        with pytest.raises(RuntimeError), whole_folder(path) as folder:  # noqa: PT012
            (folder / "a.txt").write_text("half")
            raise RuntimeError
    assert not new.exists()
    assert (old / "a.txt").read_text() == "former"
    assert {p.name for p in old.iterdir()} == {"demo.json", "a.txt"}
    assert [p.name for p in tmp_path.iterdir()] == ["old"]


def test_renewal_removes_former_files_and_none_outside(tmp_path: Path) -> None:
    path, outside = tmp_path / "demo", tmp_path / "outside.txt"
    outside.write_text("safe")
    path.mkdir()
    names = ["stale.txt", "../outside.txt", str(outside), "", 7, "demo.json"]
    (path / "demo.json").write_text(json.dumps({MARK_KEY: 1, "files": names}))
    (path / "stale.txt").write_text("old")
    (path / "mine.txt").write_text("mine")
    with whole_folder(path) as folder:
        (folder / "part").mkdir()
        (folder / "part" / "new.txt").write_text("new")
        (folder / "demo.json").write_text(json.dumps({MARK_KEY: 1, "files": []}))
    assert outside.read_text() == "safe"
    present = {p.relative_to(path).as_posix() for p in path.rglob("*") if p.is_file()}
    assert present == {"demo.json", "mine.txt", "part/new.txt"}


def test_an_empty_folder_is_welcome(tmp_path: Path) -> None:
    check_folder(tmp_path)
    with whole_folder(tmp_path) as folder:
        (folder / "demo.json").write_text("{}")
    assert [p.name for p in tmp_path.iterdir()] == ["demo.json"]
    with pytest.raises(ProductError, match="a former demo"):
        check_folder(tmp_path)
