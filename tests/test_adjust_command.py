"""`geoposition adjust`: a simulated pair through the command, its files, refusals, hard cases."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import adjust_files
import adjust_scene
import numpy as np
import pytest
from adjust_files import adjust, write_control, write_run

from geoposition.observations import ControlPoints, TiePoints
from geoposition.scripts.adjust.example import EXAMPLE
from geoposition.scripts.adjust.input import read_run
from geoposition.scripts.cli import run
from geoposition.sensors.readers import open_product

CONTROL = '[control]\nfile = "gcps.csv"\nsigma_m = 0.05\nimage_sigma_px = 0.3\n'
TIES = '[ties]\nfile = "ties.csv"\nsigma_px = 0.3\n'
QUIET = "[output]\nreport = false\ncsm = false\nmodels = false\n"
MODELS = "[output]\nreport = false\ncsm = false\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("adjust")


@pytest.fixture(scope="module")
def case(folder: Path) -> adjust_scene.Case:
    return adjust_files.write_scene(folder)


@pytest.fixture(scope="module")
def done(folder: Path, case: adjust_scene.Case) -> tuple[Path, dict[str, Any]]:
    """Run with control, check points, ties, report and plan."""
    path = write_run(folder / "run.toml", CONTROL, TIES, "[check]\nevery = 4\n",
                     "[plan]\ncount = 3\n")  # fmt: skip
    status, facts = adjust(path, folder / "out")
    assert status == 0
    return folder / "out", facts


def changed(case: adjust_scene.Case, **parts: Any) -> ControlPoints:
    """Control with other ground or image points."""
    known = case.control
    assert known.image is not None
    image = TiePoints(known.image.ids, known.image.product, parts.get("px", known.image.image_px))
    ground = parts.get("geodetic", known.geodetic)
    return ControlPoints(known.ids, ground, known.covariance_enu_m2, image)


def run_on(folder: Path, name: str, control: ControlPoints, *tables: str) -> dict[str, Any]:
    write_control(folder / f"{name}.csv", control)
    path = write_run(folder / f"{name}.toml", CONTROL.replace("gcps", name), QUIET, *tables)
    status, facts = adjust(path, folder / name)
    assert status == 0
    return facts


# What comes out ------------------------------------------------------------------------------


def test_biases_come_back_and_check_points_are_as_predicted(
    done: tuple[Path, dict[str, Any]], case: adjust_scene.Case
) -> None:
    _, facts = done
    found = {p["name"]: (p["value"], p["sigma"]) for p in facts["parameters"]}
    assert list(found) == [
        f"{image}.attitude_bias.{axis}_0"
        for image in adjust_files.NAMES
        for axis in ("roll", "pitch", "yaw")
    ]
    off = [(v - t) / s for (v, s), t in zip(found.values(), case.theta, strict=True)]
    assert np.max(np.abs(off)) < 3.5
    assert facts["check_rmse_m"] < 1.5 * facts["predicted_check_rmse_m"]
    assert facts["check_rmse_before_m"] > 20.0 > 5.0 > facts["check_rmse_m"]
    assert facts["rejected"] == []
    assert 0.8 < facts["sigma0"] < 1.2
    assert facts["relative"]["after"]["residual_px"]["median"] < 0.3
    assert facts["relative"]["before"]["residual_px"]["median"] > 3.0
    assert facts["control"]["points"] == 32
    assert facts["check"]["points"] == 10


def test_adjusted_models_are_products_that_hit_the_truth(
    done: tuple[Path, dict[str, Any]], case: adjust_scene.Case
) -> None:
    out, facts = done
    given = adjust_scene.pair()
    for written, true, was in zip(facts["models"], case.truth, given, strict=True):
        model = open_product(out / written["model"]).model
        image = np.random.default_rng(0).uniform(600.0, 15000.0, (50, 2))
        ground = true.image_to_ground(image, 800.0).geodetic
        off = model.ground_to_image(ground).image_px - image
        before = was.ground_to_image(ground).image_px - image
        assert np.sqrt(np.mean(off**2)) < 0.2 < 2.0 < np.sqrt(np.mean(before**2))


def test_tables_and_report_say_the_same(done: tuple[Path, dict[str, Any]]) -> None:
    out, facts = done
    assert sorted(path.name for path in out.iterdir()) == sorted(facts["files"])
    points = adjust_files.rows(out / "points.csv")
    check = [row for row in points if row["role"] == "check"]
    rmse = np.sqrt(np.mean([
        sum(float(row[f"error_{a}_after"]) ** 2 for a in "enu") for row in check
    ]))  # fmt: skip
    assert rmse == pytest.approx(facts["check_rmse_m"], rel=1e-6)
    assert {row["flag"] for row in check} == {"check"}
    image = adjust_files.rows(out / "image_points.csv")
    assert len(image) == 2 * len(points)
    rows = [r for r in image if r["role"] == "control" and r["product"] == "forward"]
    mean = np.mean([float(r["residual_row_px"]) for r in rows])
    said = facts["images"][0]["residual_px"]["control"]["after"]["mean"]["row"]
    assert mean == pytest.approx(said, abs=1e-6)
    page = (out / "report.html").read_text(encoding="utf-8")
    for words in ("east", "CE90", "LE90", "Predicted and measured", "Planning", "sha256",
                  "forward.attitude_bias.roll_0"):  # fmt: skip
        assert words in page
    expected = [p["expected_rmse_m"] for p in facts["plan"]["points"]]
    assert expected == sorted(expected, reverse=True)


def test_blunders_among_the_control_are_found_and_explained(
    folder: Path, case: adjust_scene.Case
) -> None:
    """Eight of 42 points wrong by 10 to 1000 pixels, or as much on the ground."""
    assert case.control.image is not None
    rng = np.random.default_rng(11)
    bad = rng.choice(42, 8, replace=False)
    px, ground = case.control.image.image_px.copy(), case.control.geodetic.copy()
    for k, i in enumerate(bad):
        size = 10.0 ** rng.uniform(1.0, 3.0)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        direction = np.array([np.cos(angle), np.sin(angle)])
        if k % 2:
            px[i + 42 * (k // 2 % 2)] += size * direction
        else:
            ground[i, :2] += size * 3.0 * direction / 6.4e6
    facts = run_on(folder, "blunders", changed(case, px=px, geodetic=ground))
    assert sorted(facts["rejected"]) == sorted(f"p{i}" for i in bad)
    assert all(r["reason"] for r in facts["rejections"])
    predicted = np.sqrt(sum(v**2 for v in facts["control"]["predicted_m"].values()))
    assert facts["control_rmse_m"] < 1.2 * predicted


def test_swapped_rows_and_columns_are_diagnosed(folder: Path, case: adjust_scene.Case) -> None:
    assert case.control.image is not None
    swapped = changed(case, px=case.control.image.image_px[:, ::-1])
    write_control(folder / "swapped.csv", swapped)
    path = write_run(folder / "swapped.toml", CONTROL.replace("gcps", "swapped"), QUIET)
    status, facts = adjust(path, folder / "swapped")
    told = [finding["name"] for finding in facts.get("diagnosis", [])]
    assert told[:1] == ["swapped-row-col"] or status == 2


def test_leave_one_out_predicts_each_point(folder: Path, case: adjust_scene.Case) -> None:
    assert case.control.image is not None
    some = ControlPoints(
        case.control.ids[:6], case.control.geodetic[:6], case.control.covariance_enu_m2[:6],
        case.control.image.selected(np.isin(case.control.image.ids, case.control.ids[:6])),
    )  # fmt: skip
    facts = run_on(folder, "few", some)
    alone = facts["leave_one_out"]
    assert len(alone["errors_m"]) == 6
    assert len(alone["points"]) == 12
    after = facts["images"][0]["residual_px"]["control"]["after"]
    assert alone["residual_px"]["rms"]["row"] > after["rms"]["row"]


def test_ties_alone_follow_the_first_image(folder: Path, case: adjust_scene.Case) -> None:
    path = write_run(folder / "ties.toml", TIES, QUIET)
    (folder / "ties").mkdir()
    (folder / "ties" / "adjustment.json").write_text('{"older": true}')
    status, facts = adjust(path, folder / "ties")
    assert status == 0
    assert [image["held"] for image in facts["images"]] == [True, False]
    assert facts["control_rmse_m"] is None
    assert facts["relative"]["after"]["residual_px"]["median"] < 0.3
    assert facts["weak"]
    assert "older" not in facts


def test_control_measured_among_the_ties(folder: Path, case: adjust_scene.Case) -> None:
    """Ground positions alone in one table, all image points in another, as the demo writes them."""
    rows = adjust_files.rows(folder / "gcps.csv")
    ground = {r["id"]: f"{r['id']},{r['lon']},{r['lat']},{r['height']}" for r in rows}
    text = "\n".join(["id,lon,lat,height", *ground.values()])
    (folder / "ground.csv").write_text(text + "\n")
    image = [f"{r['id']},{r['product']},{r['row']},{r['col']}" for r in rows]
    (folder / "all.csv").write_text((folder / "ties.csv").read_text() + "\n".join(image) + "\n")
    path = write_run(folder / "shared.toml", CONTROL.replace("gcps", "ground"),
                     TIES.replace("ties.csv", "all.csv"), QUIET)  # fmt: skip
    whole = write_run(folder / "whole.toml", CONTROL, TIES, QUIET)
    first, second = adjust(path, folder / "shared")[1], adjust(whole, folder / "whole")[1]
    assert first["ties"]["points"] == 200
    for a, b in zip(first["parameters"], second["parameters"], strict=True):
        assert a["value"] == pytest.approx(b["value"], rel=1e-9)


UNKNOWNS = """
[[unknown]]
kind = "attitude-bias"
degree = "linear"
images = "forward"
sigma_arcsec = [20, 20, 40]
[[unknown]]
kind = "attitude_spline"
images = ["backward"]
knots = 5
sigma = 20
[[unknown]]
kind = "orbit"
sigma_m = 1.0
drift_sigma_m_s = 0.01
[[unknown]]
kind = "time_offset"
sigma_s = 1e-5
[[unknown]]
kind = "mounting"
sigma_rad = 1e-6
[[unknown]]
kind = "look_angles"
degree = 1
sigma_arcsec = 0.1
[[unknown]]
kind = "image_bias"
images = ["forward"]
degree = "shift"
sigma_px = 0.05
"""


def test_every_kind_of_unknown_has_its_name(folder: Path, case: adjust_scene.Case) -> None:
    path = write_run(folder / "kinds.toml", CONTROL, UNKNOWNS, MODELS)
    status, facts = adjust(path, folder / "kinds")
    assert status == 0
    names = [p["name"] for p in facts["parameters"]]
    blocks = list(dict.fromkeys(name.rsplit(".", 1)[0] for name in names))
    assert blocks == [
        "forward.attitude_bias", "backward.attitude_spline", "forward.orbit", "backward.orbit",
        "forward.time_offset", "backward.time_offset", "forward+backward.mounting",
        "forward+backward.look_angles", "forward.image_bias",
    ]  # fmt: skip
    prior = {p["name"]: p["prior_sigma"] / adjust_scene.ARCSEC for p in facts["parameters"]}
    assert prior["forward.attitude_bias.yaw_0"] == pytest.approx(40.0)
    assert prior["backward.attitude_spline.roll_k0"] == pytest.approx(20.0)
    assert facts["weak"]
    # The forward model has an image bias on top: it is told as the RPC fitted to it.
    assert facts["models"][0]["model"] == "forward_RPC.TXT"


def test_one_table_of_image_points_serves_control_check_and_ties(
    folder: Path, case: adjust_scene.Case, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rows of other points are left alone, even those in images that are not adjusted."""
    assert case.control.image is not None
    ground = adjust_files.rows(folder / "gcps.csv")[: len(case.control)]
    for name, part in (("some", ground[:30]), ("rest", ground[30:])):
        lines = [",".join(row[k] for k in ("id", "lon", "lat", "height")) for row in part]
        (folder / f"{name}.csv").write_text("\n".join(["id,lon,lat,height", *lines]) + "\n")
    points = [",".join(row[k] for k in ("id", "product", "row", "col"))
              for row in adjust_files.rows(folder / "gcps.csv")]  # fmt: skip
    ties = (folder / "ties.csv").read_text().splitlines()
    everything = [ties[0], *points, *ties[1:], "far,nadir,10,10"]
    (folder / "everything.csv").write_text("\n".join(everything) + "\n")
    control = CONTROL.replace("gcps", "some") + 'image_points = "everything.csv"\n'
    path = write_run(folder / "shared.toml", control, '[check]\nfile = "rest.csv"\n', QUIET)
    status, facts = adjust(path, folder / "shared")
    assert status == 0
    assert (facts["control"]["points"], facts["check"]["points"]) == (30, 12)
    assert facts["check_rmse_m"] < 5.0
    lines = (folder / "some.csv").read_text().replace("\np", "\nq").splitlines()
    (folder / "strange.csv").write_text("\n".join(f"x{x}" if i else x for i, x in enumerate(lines)))
    path = write_run(folder / "none.toml", control.replace("some", "strange"), QUIET)
    capsys.readouterr()
    assert adjust(path, folder / "none")[0] == 2
    said = capsys.readouterr().err
    assert "everything.csv" in said
    assert "strange.csv" in said


# What is refused -----------------------------------------------------------------------------

REFUSED = {
    "key": ("[control]\nfile='gcps.csv'\nsigma_metres=1", "did you mean sigma_m"),
    "table": ("[controll]\nfile='gcps.csv'", "did you mean control"),
    "file": ("[control]\nfile='none.csv'", "[control] file: an existing file expected"),
    "number": (CONTROL.replace("0.05", "'fine'"), "[control] sigma_m: a number expected"),
    "zero": (CONTROL.replace("0.05", "0"), "a positive number expected"),
    "kind": (CONTROL + "[[unknown]]\nkind='magic'", "one of attitude_bias, "),
    "no kind": (CONTROL + "[[unknown]]\ndegree=1", "[[unknown]] 1: kind"),
    "image": (CONTROL + "[[unknown]]\nkind='orbit'\nimages=['nadir']", "forward, backward"),
    "unit": (CONTROL + "[[unknown]]\nkind='orbit'\nsigma_px=1", "sigma_m (or sigma"),
    "degree": (CONTROL + "[[unknown]]\nkind='image_bias'\ndegree=3", "degree 0 (shift) or 1"),
    "twice": (CONTROL + "[[unknown]]\nkind='orbit'\n[[unknown]]\nkind='orbit'", "there twice"),
    "nothing": ("[robust]\nenabled = true", "[control], [ties] or both expected"),
    "ids": (CONTROL + "[check]\nids = ['p1', 'zz']", "'zz' is no point"),
    "two ways": (CONTROL + "[check]\nevery = 2\nfraction = 0.5", "one of file, ids, every"),
    "all": (CONTROL + "[check]\nfraction = 1.5", "between 0 and 1"),
    "heights": (CONTROL + "heights = 'orthometric'", "a geoid grid expected"),
    "toml": ("[control\nfile=1", "TOML expected"),
    "ties": ("[ties]\nmatch = true\nfile = 'ties.csv'", "either a file of ties or match"),
    "rpc": ("[ties]\nfile = 'ties.csv'\n[[image]]\nproduct='forward.toml'\nid='x'\nrpc=true",
            "came without an RPC"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_key_is_refused_by_name(
    folder: Path, case: adjust_scene.Case, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    tables, message = REFUSED[name]
    path = write_run(folder / f"bad-{name.replace(' ', '-')}.toml", tables)
    assert run(["adjust", str(path), "-o", str(folder / "refused")]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not (folder / "refused").exists()


def test_a_run_that_fails_leaves_the_folder_alone(
    folder: Path, case: adjust_scene.Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = folder / "kept"
    out.mkdir()
    (out / "adjustment.json").write_text("{}")
    path = write_run(folder / "kept.toml", CONTROL, MODELS)
    before = set(folder.iterdir())
    monkeypatch.setattr(
        "geoposition.scripts.adjust.run.write_models",
        lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")),
    )
    assert run(["adjust", str(path), "-o", str(out)]) == 2
    assert (out / "adjustment.json").read_text() == "{}"
    assert set(folder.iterdir()) == before


def test_the_example_is_a_run_that_can_be_read(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["adjust", "--example"]) == 0
    assert capsys.readouterr().out == EXAMPLE
    for name in ("left.XML", "right.XML", "gcps.csv"):
        (tmp_path / name).touch()
    (tmp_path / "run.toml").write_text(EXAMPLE)
    assert len(read_run(tmp_path / "run.toml").images) == 2
    for key in ("spacing_s", "family_risk", "leave_one_out", "dem_geoid", "drift_sigma_m_s"):
        assert f"{key} =" in EXAMPLE


def test_an_rpc_of_rigorous_products_can_be_adjusted_in_their_place(
    folder: Path, case: adjust_scene.Case, tmp_path: Path
) -> None:
    """Models without seams, which an RPC follows: the same control, the same places."""
    del case
    from geoposition.adjust import adjusted_models
    from geoposition.rpc.fit import fit_model
    from geoposition.rpc.formats import write_rpc
    from geoposition.sensors.writers.model_file import write_model_file

    models = adjust_scene.pair(False)
    truth = adjusted_models(models, adjust_scene.attitude_blocks(), adjust_files.THETA)
    for name, model in zip(adjust_files.NAMES, models, strict=True):
        write_model_file(model, tmp_path / f"{name}.toml")
        write_rpc(fit_model(model).model, tmp_path / f"{name}_RPC.TXT")
    ground = adjust_scene.common_ground(42)
    images = adjust_scene.measured(truth, ground, np.random.default_rng(1))
    write_control(tmp_path / "gcps.csv", adjust_scene.control_points(ground, images))
    rigorous = write_run(tmp_path / "rigorous.toml", CONTROL, MODELS)
    text = rigorous.read_text()
    for name in adjust_files.NAMES:
        text = text.replace(f'"{name}.toml"', f'"{name}.toml"\nrpc = "{name}_RPC.TXT"')
    affine = '[[unknown]]\nkind = "image_bias"\ndegree = 1\n'
    (tmp_path / "rpc.toml").write_text(text + affine)
    first = adjust(rigorous, tmp_path / "a")[1]
    second = adjust(tmp_path / "rpc.toml", tmp_path / "b")[1]
    assert [image["model"] for image in second["images"]] == ["rpc", "rpc"]
    for a, b in zip(first["models"], second["models"], strict=True):
        one, two = (
            open_product(tmp_path / "a" / a["model"]),
            open_product(tmp_path / "b" / b["rpc"]),
        )
        off = (
            one.model.ground_to_image(ground).image_px - two.model.ground_to_image(ground).image_px
        )
        assert np.all(np.abs(np.mean(off, axis=0)) < 0.05)


def test_example_keys_are_toml() -> None:
    assert set(tomllib.loads(EXAMPLE)) == {
        "image", "control", "ties", "check", "unknown", "output",
    }  # fmt: skip
