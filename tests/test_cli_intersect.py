"""`geoposition intersect` with a table of ties: names of products, checks, outputs, refusals."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import scenes

from geoposition.arrays import FloatArray
from geoposition.constants import GM_M3_S2
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.cli import run
from geoposition.sensors.writers.model_file import write_model_file

CENTRE_PX = np.array([999.5, 749.5])


def model_from(seconds_later: float, pitch_deg: float) -> PushbroomModel:
    orbit = scenes.Orbit.over(0.2, 0.75)
    turn = np.sqrt(GM_M3_S2 / orbit.semi_major_m**3) * seconds_later
    orbit = replace(orbit, anomaly_rad=orbit.anomaly_rad + float(turn))
    return scenes.build((2000, 1500), pitch_deg=pitch_deg, orbit=orbit).model()


def looking_at(centre: FloatArray, seconds_later: float) -> PushbroomModel:
    """Model from further along the orbit, pitched so that its centre sees `centre`."""
    pitch, step = 0.0, 1e-3
    for _ in range(8):
        seen, moved = (
            model_from(seconds_later, p).image_to_ground(CENTRE_PX, centre[2]).geodetic[:2]
            for p in (pitch, pitch + step)
        )
        slope = (moved - seen) / step
        pitch += float(slope @ (centre[:2] - seen) / (slope @ slope))
    return model_from(seconds_later, pitch)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two models that look at one place, and ties and control of known points."""
    folder = tmp_path_factory.mktemp("stereo")
    first = model_from(0.0, 0.0)
    centre = first.image_to_ground(CENTRE_PX, 500.0).geodetic
    second = looking_at(centre, 25.0)
    write_model_file(first, folder / "nadir.toml")
    write_model_file(second, folder / "back.toml")
    rng = np.random.default_rng(5)
    ground = centre + rng.uniform(-1, 1, (40, 3)) * [3e-5, 3e-5, 300.0]
    ties, gcps = ["id,product,row,col"], ["id,lon,lat,height"]
    for i, point in enumerate(ground):
        lon, lat = np.degrees(point[:2])
        gcps.append(f"p{i},{lon:.15g},{lat:.15g},{point[2]:.9g}")
        for name, model in (("nadir.toml", first), ("back", second)):
            image = model.ground_to_image(point)
            assert image.flag == 0
            line, sample = image.image_px
            ties.append(f"p{i},{name},{line:.12g},{sample:.12g}")
    (folder / "ties.csv").write_text("\n".join(ties) + "\n")
    (folder / "gcps.csv").write_text("\n".join(gcps) + "\n")
    return folder


def intersect(scene: Path, out: Path, *more: object) -> int:
    products = [scene / "nadir.toml", scene / "back.toml"]
    return run([str(a) for a in ("intersect", *products, "-o", out, *more)])


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_known_points_come_back(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.csv"
    ties = ("--ties", scene / "ties.csv", "--gcps", scene / "gcps.csv", "--json")
    assert intersect(scene, out, *ties) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["matches"], result["intersected"], result["checked"]) == (40, 40, 40)
    assert result["residual_px"]["p95"] < 1e-4
    # Line times of a table are read to 1e-9 s and image points to 1e-8 px: far below 1 mm.
    assert max(result["rmse_m"].values()) < 1e-3
    assert list(rows(out)[0]) == [
        "id", "lon", "lat", "height", "sigma_e", "sigma_n", "sigma_u", "residual_px", "rays",
        "flag", "convergence_deg", "weak", "rejected",
    ]  # fmt: skip
    assert {row["flag"] for row in rows(out)} == {"ok"}


def test_stated_sigma_scales_with_the_image_noise(scene: Path, tmp_path: Path) -> None:
    sigma_u = []
    for sigma in ("0.3", "0.6"):
        out = tmp_path / "out.csv"
        assert intersect(scene, out, "--ties", scene / "ties.csv", "--sigma", sigma) == 0
        sigma_u.append(float(rows(out)[0]["sigma_u"]))
    assert sigma_u[1] == pytest.approx(2 * sigma_u[0], rel=1e-4)


@pytest.mark.parametrize("ending", ["geojson", "gpkg", "parquet"])
def test_other_outputs(scene: Path, tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"points.{ending}"
    assert intersect(scene, out, "--ties", scene / "ties.csv") == 0
    if ending != "parquet":
        info = pyogrio.read_info(out)
        assert info["features"] == 40
        assert info["geometry_type"] == "Point Z"
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


def test_bad_rays_do_not_harm_the_others(scene: Path, tmp_path: Path) -> None:
    ties = tmp_path / "ties.csv"
    more = "alone,0,10,10\nlost,0,nan,5\nlost,1,5,5\n"
    ties.write_text((scene / "ties.csv").read_text() + more)
    out = tmp_path / "out.csv"
    assert intersect(scene, out, "--ties", ties) == 0
    found = {row["id"]: row["flag"] for row in rows(out)}
    assert found.pop("alone") == "too_few_rays"
    assert found.pop("lost") != "ok"
    assert set(found.values()) == {"ok"}


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("id,product,row,col\na,other,1,1\n", "other"),
        ("id,product,row,col\na,7,1,1\n", "7"),
        ("id,product,row,col\na,0,1,1\na,0,2,2\n", "twice"),
        ("id,product,row,col\na,0,1,1\nb,1,2,2\n", "too_few_rays"),
        ("id,row,col\na,1,1\n", "product"),
    ],
)
def test_bad_ties_are_refused_in_one_line(
    scene: Path, tmp_path: Path, content: str, named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    ties = tmp_path / "ties.csv"
    ties.write_text(content)
    assert intersect(scene, tmp_path / "out.csv", "--ties", ties) == 2
    line = capsys.readouterr().err
    assert named in line
    assert line.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["ties.csv"]


def test_bad_usage(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, ties = tmp_path / "out.csv", scene / "ties.csv"
    assert intersect(scene, out) == 2
    assert "--ties" in capsys.readouterr().err
    assert intersect(scene, out, "--ties", ties, "--match") == 2
    assert intersect(scene, out, "--match") == 2
    assert "--image" in capsys.readouterr().err
    assert run(["intersect", str(scene / "nadir.toml"), "-o", str(out), "--ties", str(ties)]) == 2
    assert "two or more" in capsys.readouterr().err
    empty = tmp_path / "gcps.csv"
    empty.write_text("id,lon,lat,height\nzz,1,1,1\n")
    assert intersect(scene, out, "--ties", ties, "--gcps", empty) == 2
    assert "gcps" in capsys.readouterr().err
