"""`geoposition evaluate` on a synthetic field: keys, files, lists, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pyogrio
import pytest
from field_scene import FieldScene, make_field, scene

from geoposition.calib_fields.evaluate import KEYS
from geoposition.scripts import cli
from geoposition.sensors.writers.model_file import write_model_file

SHAPE = (700, 600)


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> FieldScene:
    folder = tmp_path_factory.mktemp("field")
    found = make_field(folder, SHAPE, scene(SHAPE, bias_arcsec=(3.0, 0.0)), noise=1.0)
    write_model_file(found.believed, folder / "model.toml")
    return found


def arguments(field: FieldScene, output: Path) -> list[str]:
    folder = field.dom_path.parent
    return [
        "evaluate", str(folder / "model.toml"), "--image", str(field.image_path),
        "--dom", str(field.dom_path), "--dem", str(field.dem_path), "-o", str(output), "--json",
    ]  # fmt: skip


def test_one_scene(field: FieldScene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(arguments(field, tmp_path / "out")) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["points"] > 50
    for key in KEYS:
        low, high = result[f"{key}_interval"]
        assert low <= result[key] <= high
    # 3 arcseconds of roll at 600 km, across the track of an ascending pass: about east
    assert abs(abs(result["bias_e_m"]) - 8.6) < 1.0
    assert abs(result["bias_n_m"]) < 3.0
    assert result["relative_px"] < 0.05
    assert sum(result["rejected"].values()) + result["points"] == result["tried"]
    assert json.loads((tmp_path / "out" / "evaluation.json").read_text()) == result | {
        key: result[key] for key in KEYS
    }
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("<img ") >= 6
    assert ">nan" not in page
    info = pyogrio.read_info(tmp_path / "out" / "matches.gpkg")
    assert info["features"] == result["tried"]


def test_a_list_of_scenes(
    field: FieldScene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = field.dom_path.parent
    text = f"""
[defaults]
dom = "{field.dom_path}"
dem = "{field.dem_path}"
image = "{field.image_path}"
search_m = 30
[[scene]]
product = "{folder / "model.toml"}"
date = "2015-08-29 14:08"
region = "Songshan"
side_swing_deg = -4.965
[[scene]]
product = "{folder / "model.toml"}"
relative = "attitude"
region = "Yili"
"""
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    command = ["evaluate", str(tmp_path / "run.toml"), "-o", str(tmp_path / "out"), "--json"]
    assert cli.run(command) == 0
    scenes = json.loads(capsys.readouterr().out)["scenes"]
    assert [scene["region"] for scene in scenes] == ["Songshan", "Yili"]
    assert [scene["relative_removes"] for scene in scenes] == ["shift", "attitude"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Songshan" in page
    assert "−4.965" in page
    (tmp_path / "run.toml").write_text(text.replace("search_m", "serch_m"), encoding="utf-8")
    assert cli.run(command) == 2
    assert "serch_m" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--dom", "missing.tif", "missing.tif"),
        ("--relative", "nothing", "shift, affine, attitude"),
        ("--window", "3", "window"),
        ("--geoid", "missing.gtx", "name no geoid"),
    ],
)
def test_bad_usage_is_one_line(
    field: FieldScene,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
    value: str,
    words: str,
) -> None:
    assert cli.run([*arguments(field, tmp_path / "out"), option, value]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
