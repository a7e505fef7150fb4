"""The command line as people and scripts meet it: tables, flags, JSON, one-line refusals."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import scenes

from geoposition.scripts.cli import run
from geoposition.sensors.writers.model_file import write_model_file


@pytest.fixture(scope="module")
def model_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "scene.toml"
    write_model_file(scenes.build((2000, 1500), roll_deg=12.0).model(), path, sensor="synthetic")
    return path


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def text(path: Path, content: str) -> Path:
    path.write_text(content)
    return path


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run, expect exit 2 and one line; return the line."""
    assert run([str(argument) for argument in arguments]) == 2
    out = capsys.readouterr()
    assert out.out == ""
    assert out.err.count("\n") == 1, out.err
    assert "Traceback" not in out.err
    return out.err


POINTS = "id,row,col,height\na,0,0,100\nb,1999,1499,2000\nc,1000,700.5,-50\n"


def test_locate_then_project_returns_the_pixels(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = text(tmp_path / "points.csv", POINTS)
    ground, image = tmp_path / "ground.csv", tmp_path / "image.csv"
    assert run(["locate", str(model_path), str(points), "-o", str(ground), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["points"], result["ok"]) == (3, 3)
    assert list(rows(ground)[0]) == ["id", "row", "col", "lon", "lat", "height", "flag"]
    assert run(["project", str(model_path), str(ground), "-o", str(image)]) == 0
    assert list(rows(image)[0]) == ["id", "lon", "lat", "height", "row", "col", "flag"]
    for before, after in zip(rows(points), rows(image), strict=True):
        assert after["id"] == before["id"]
        assert after["flag"] == "ok"
        # 1e-12 deg in the table is 0.1 µm.
        assert abs(float(after["row"]) - float(before["row"])) < 1e-5
        assert abs(float(after["col"]) - float(before["col"])) < 1e-5


def test_parquet_in_and_out(model_path: Path, tmp_path: Path) -> None:
    points = text(tmp_path / "points.csv", POINTS)
    first, second = tmp_path / "ground.parquet", tmp_path / "ground.csv"
    for out in (first, second):
        assert run(["locate", str(model_path), str(points), "-o", str(out)]) == 0
    columns = pq.read_table(first).to_pydict()
    assert [str(v) for v in columns["id"]] == [row["id"] for row in rows(second)]
    assert np.allclose(columns["lon"], [float(row["lon"]) for row in rows(second)], atol=1e-12)
    back = tmp_path / "back.parquet"
    assert run(["project", str(model_path), str(first), "-o", str(back)]) == 0
    assert pq.read_table(back).num_rows == 3


def test_a_batch_keeps_its_good_points(model_path: Path, tmp_path: Path) -> None:
    bad = POINTS + "d,nan,5,0\ne,,5,0\nf,word,5,0\ng,1e9,5,0\nh,-50,10,0\ni,5,inf,0\nj,5,5,1e99\n"
    points, out = text(tmp_path / "points.csv", bad), tmp_path / "out.csv"
    assert run(["locate", str(model_path), str(points), "-o", str(out)]) == 0
    found = {row["id"]: row for row in rows(out)}
    assert [found[i]["flag"] for i in "abc"] == ["ok"] * 3
    assert [found[i]["flag"] for i in "defi"] == ["bad_input"] * 4
    assert found["g"]["flag"] == "outside_model"
    assert found["h"]["flag"] == "outside_image"
    assert found["h"]["lon"]
    assert found["j"]["flag"] in {"no_intersection", "bad_input"}
    assert not found["d"]["lon"]
    clean = tmp_path / "clean.csv"
    good = text(tmp_path / "good.csv", POINTS)
    assert run(["locate", str(model_path), str(good), "-o", str(clean)]) == 0
    assert rows(clean) == [found[i] for i in "abc"]


def test_one_height_for_all(model_path: Path, tmp_path: Path) -> None:
    points = text(tmp_path / "points.csv", "id,row,col\n1,10,20\n")
    out = tmp_path / "out.csv"
    assert run(["locate", str(model_path), str(points), "-o", str(out), "--height", "321.5"]) == 0
    assert float(rows(out)[0]["height"]) == 321.5


def test_info_is_json(model_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(model_path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["lines"], facts["samples"], facts["sensor"]) == (2000, 1500, "synthetic")
    assert facts["corrections"]["velocity_aberration"] is True
    # 0.7 m at nadir; a roll of 12° stretches it across track by more than 1 / cos^2.
    assert 0.69 < facts["ground_sample_m"]["row"] < 0.75
    assert 0.73 < facts["ground_sample_m"]["col"] < 0.80
    assert 12.0 < facts["satellite_zenith_deg"] < 14.5


def test_export_and_compare(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # A CSM state has straight rays: exact at one height, where the refraction was baked in.
    for name, more, bound_px in (
        ("copy.toml", [], 1e-6),
        ("state.json", ["--height", "1500"], 5e-3),
    ):
        out = tmp_path / name
        assert run(["export", str(model_path), "-o", str(out), *more]) == 0
        capsys.readouterr()
        arguments = ["rpc", "compare", str(model_path), str(out), "--heights", "1490", "1510"]
        assert run([*arguments, "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        assert result["points"] == 21 * 21 * 5
        assert result["row"]["max"] < bound_px
        assert result["col"]["max"] < bound_px


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("", "empty"),
        ("id,row,col,height\n", "no points"),
        ("id,row\na,1\n", "col"),
        ("row,col\n1,1\n", "id"),
        ("id,row,col,height\na,1\n", "columns"),
        ("id,row,row,col\na,1,1,1\n", "once"),
        ("id,row,col,height\na,nan,nan,0\n", "no point has a result"),
        ("id,row,col,height\na,1e9,0,0\n", "1 outside_model"),
        ("id,row,col\na,1,1\n", "height"),
        ("\xff\xfe\x00garbage", "expected"),
    ],
)
def test_bad_tables_are_refused_in_one_line(
    content: str,
    named: str,
    model_path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    points = tmp_path / "points.csv"
    points.write_bytes(content.encode("latin-1"))
    line = refused(capsys, "locate", model_path, points, "-o", tmp_path / "out.csv")
    assert "points.csv" in line
    assert named in line
    assert [path.name for path in tmp_path.iterdir()] == ["points.csv"]


def test_bad_usage_is_refused_in_one_line(
    model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = text(tmp_path / "points.csv", POINTS)
    out = tmp_path / "out.csv"
    assert "no such file" in refused(capsys, "info", tmp_path / "none.xml")
    assert "product" in refused(capsys, "locate")
    assert "bogus" in refused(capsys, "bogus")
    assert "--height" in refused(
        capsys, "locate", model_path, points, "-o", out, "--height", "1", "--dem", "x.tif"
    )
    assert "--geoid" in refused(capsys, "locate", model_path, points, "-o", out, "--geoid", "x")
    assert "x.tif" in refused(capsys, "locate", model_path, points, "-o", out, "--dem", "x.tif")
    assert "folder" in refused(capsys, "locate", model_path, points, "-o", tmp_path)
    assert "folder" in refused(capsys, "locate", model_path, points, "-o", tmp_path / "no/out.csv")
    assert "no RPC" in refused(capsys, "rpc", "compare", model_path)
    assert "ending" in refused(capsys, "export", model_path, "-o", tmp_path / "model.xyz")
    assert "product" in refused(capsys, "info", points)
    assert not out.exists()


def test_an_output_is_whole_or_absent(
    model_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A write that fails midway leaves the former file as it was, and nothing beside it."""
    points = text(tmp_path / "points.csv", POINTS)
    out = text(tmp_path / "out.csv", "former\n")
    import pyarrow.csv as pa_csv

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", str(out))

    monkeypatch.setattr(pa_csv, "write_csv", full)
    assert run(["locate", str(model_path), str(points), "-o", str(out)]) == 2
    assert out.read_text() == "former\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.csv", "points.csv"]


def test_ids_that_need_quotes_survive(model_path: Path, tmp_path: Path) -> None:
    points = text(tmp_path / "points.csv", 'id,row,col,height\n"a, ""b""",1,1,0\n')
    out = tmp_path / "out.csv"
    assert run(["locate", str(model_path), str(points), "-o", str(out)]) == 0
    assert rows(out)[0]["id"] == 'a, "b"'


@pytest.mark.parametrize("name", ["info", "locate", "project", "intersect", "export", "demo"])
def test_every_command_has_help_with_an_example(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([name, "--help"]) == 0
    assert f"geoposition {name}" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["evaluate", "calibrate", "adjust"])
def test_help_shows_the_names_of_tables(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([name, "--help"]) == 0
    assert ("[[image]]" if name == "adjust" else "[[scene]]") in capsys.readouterr().out


@pytest.mark.parametrize("name", ["compare", "convert"])
def test_every_rpc_command_has_help_with_an_example(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["rpc", name, "--help"]) == 0
    assert f"geoposition rpc {name}" in capsys.readouterr().out
