"""Stereo runs on synthetic scenes: bias removal, checks, reference, report, refusals."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
import rasterio
from error_models import turned_in_body
from rasterio.transform import from_bounds
from stereo_scenes import views

from geoposition.error_budget.influence import ARCSEC_RAD
from geoposition.flags import Flag
from geoposition.observations import TiePoints
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.cli import run
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.triangulate import triangulate
from geoposition.triangulate.mend import mended

NAMES = ("forward", "nadir", "backward")
COUNT = 400


@pytest.fixture(scope="module")
def true_models() -> list[PushbroomModel]:
    return views((-35.0, 0.0, 35.0))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory, true_models: list[PushbroomModel]) -> Path:
    """Three images with attitudes wrong by arcseconds, ties with noise, check points, a DEM."""
    folder = tmp_path_factory.mktemp("triplet")
    rng = np.random.default_rng(1)
    image = rng.uniform((600.0, 300.0), (1400.0, 1200.0), (COUNT, 2))
    ground = true_models[1].image_to_ground(image, 500.0 + 40.0 * rng.random(COUNT)).geodetic
    ties, gcps = ["id,product,row,col"], ["id,lon,lat,height"]
    turns = np.array([[1.5, -2.0, 0.0], [0.0, 0.0, 0.0], [-2.5, 1.0, 0.0]]) * ARCSEC_RAD
    for name, model, turn in zip(NAMES, true_models, turns, strict=True):
        write_model_file(turned_in_body(model, turn), folder / f"{name}.toml")
        write_model_file(model, folder / f"true_{name}.toml")
        seen = model.ground_to_image(ground)
        assert np.all(seen.flag == Flag.OK)
        noisy = seen.image_px + rng.normal(0.0, 0.1, (COUNT, 2))
        ties += [f"p{i},{name},{a:.6f},{b:.6f}" for i, (a, b) in enumerate(noisy)]
    degrees = np.degrees(ground[:, :2])
    for i in range(0, COUNT, 8):
        gcps.append(f"p{i},{degrees[i, 0]:.12f},{degrees[i, 1]:.12f},{ground[i, 2]:.6f}")
    (folder / "ties.csv").write_text("\n".join(ties) + "\n")
    (folder / "gcps.csv").write_text("\n".join(gcps) + "\n")
    low, high = degrees.min(axis=0) - 0.01, degrees.max(axis=0) + 0.01
    for name, off in (("dem.tif", 0.0), ("elsewhere.tif", 20.0)):
        with rasterio.open(
            folder / name, "w", driver="GTiff", width=50, height=50, count=1, dtype="float32",
            crs="EPSG:4979", transform=from_bounds(low[0] + off, low[1], high[0] + off, high[1],
                                                   50, 50),
        ) as raster:  # fmt: skip
            raster.write(np.full((50, 50), 515.0, dtype=np.float32), 1)
    return folder


def intersect(scene: Path, out: Path, *more: object, names: tuple[str, ...] = NAMES) -> int:
    products = [scene / f"{name}.toml" for name in names]
    options = ("--ties", scene / "ties.csv", "-o", out, "--json", *more)
    return run([str(a) for a in ("intersect", *products, *options)])


def test_a_triplet_agrees_after_its_bias_is_removed(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Tri-stereo: residuals of 0.2 px at most, by constant turns of rigorous models."""
    assert intersect(scene, tmp_path / "a.csv") == 0
    left_in = json.loads(capsys.readouterr().out)
    assert intersect(scene, tmp_path / "b.csv", "--remove-bias") == 0
    removed = json.loads(capsys.readouterr().out)
    assert left_in["residual_px"]["median"] > 1.0
    before = removed["residual_before_removal_px"]["median"]
    assert before == pytest.approx(left_in["residual_px"]["median"], abs=1e-6)
    assert removed["residual_px"]["median"] <= 0.2
    assert removed["sigma_px"] == pytest.approx(0.1, rel=0.15)
    assert [change["product"] for change in removed["bias_removal"]] == [0, 1, 2]
    assert removed["bias_removal"][0]["attitude_arcsec"] is None
    # Against the first image: what was planted in the others less its own, but for the height.
    turn = removed["bias_removal"][2]["attitude_arcsec"]
    assert turn[0] == pytest.approx(4.0, abs=0.6)
    assert all(len(bias["bias"]) == 2 for bias in removed["relative_bias_px"])


def test_a_turned_model_moves_as_asked(true_models: list[PushbroomModel]) -> None:
    model = true_models[0]
    image = np.array([[700.0, 500.0], [1200.0, 900.0], [1000.0, 300.0]])
    ground = model.image_to_ground(image, 500.0).geodetic
    changed = mended(model, np.array([3.0, -2.0]), image, np.full(3, 500.0))
    moved = changed.model.ground_to_image(ground).image_px - image
    # A turn is a shift but for the perspective over the image, here 0.3 %.
    np.testing.assert_allclose(moved, np.tile([3.0, -2.0], (3, 1)), atol=0.012)
    np.testing.assert_allclose(moved.mean(axis=0), [3.0, -2.0], atol=1e-5)
    assert changed.turn_rad is not None
    assert np.hypot(*changed.turn_rad[:2]) == pytest.approx(
        0.7 * np.hypot(3.0, 2.0) / 610e3, rel=0.15
    )
    assert mended(model, np.zeros(2), image, np.zeros(3)).model is model


def test_checks_and_reference(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ("--gcps", scene / "gcps.csv", "--reference", scene / "dem.tif")
    names = tuple(f"true_{name}" for name in NAMES)
    ties = scene / "true_ties.csv"
    text = (scene / "ties.csv").read_text()
    ties.write_text(re.sub(r",(forward|nadir|backward),", r",true_\1,", text))
    out = tmp_path / "c.csv"
    products = [str(scene / f"{name}.toml") for name in names]
    arguments = ["intersect", *products, "--ties", str(ties), "-o", str(out), "--json"]
    assert run([*arguments, *map(str, more)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["checked"] == COUNT / 8
    for axis in "enuxyz":
        facts = found["check"][axis]
        assert 0.0 <= facts["least"] <= abs(facts["mean"]) + facts["std"]
        assert facts["most"] == pytest.approx(max(-facts["minimum"], facts["maximum"]))
        assert facts["rmse"] < 0.5
    # Stated sigmas are what the check points find.
    assert found["rmse_m"]["u"] == pytest.approx(found["sigma_enu_m"]["total"]["u"], rel=0.4)
    assert {"ce90_m", "le90_m"} <= set(found["check"])
    reference = found["reference"]
    assert reference["points"] == COUNT
    assert reference["difference_m"]["mean"] == pytest.approx(5.0, abs=2.0)


def test_stated_model_errors_enter_the_sigmas(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "d.csv"
    sigmas = ("--attitude-sigma", 1.0, "--orbit-sigma", 2.0)
    assert intersect(scene, out, "--covariance", *sigmas) == 0
    found = json.loads(capsys.readouterr().out)
    sigma = found["sigma_enu_m"]
    for axis in "enu":
        parts = np.hypot(sigma["image_points"][axis], sigma["models"][axis])
        assert sigma["total"][axis] == pytest.approx(parts, rel=0.05)
    assert sigma["models"]["u"] > 3.0
    assert found["model_sigma"][0] == {
        "attitude_arcsec": pytest.approx([1.0] * 3),
        "orbit_m": pytest.approx([2.0] * 3),
    }
    with out.open(newline="") as file:
        row = next(csv.DictReader(file))
    axes = [float(row[f"axis{k}_m"]) for k in (1, 2, 3)]
    assert axes == sorted(axes, reverse=True)
    trace = sum(float(row[name]) for name in ("c_ee", "c_nn", "c_uu"))
    assert trace == pytest.approx(sum(axis**2 for axis in axes), rel=1e-4)
    assert float(row["sigma_u"]) == pytest.approx(np.sqrt(float(row["c_uu"])), rel=1e-4)
    assert float(row["s_uu"]) < float(row["c_uu"])
    assert intersect(scene, tmp_path / "e.csv", "--image-noise-only", *sigmas) == 2
    assert "--image-noise-only" in capsys.readouterr().err
    assert intersect(scene, tmp_path / "e.csv", "--attitude-sigma", -1) == 2


def test_a_wrong_ray_is_named_in_the_table(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ties, out = tmp_path / "ties.csv", tmp_path / "points.csv"
    lines = (scene / "ties.csv").read_text().splitlines()
    place = lines[1 + COUNT + 7].split(",")
    assert place[:2] == ["p7", "nadir"]
    place[3] = f"{float(place[3]) + 25.0:.3f}"
    lines[1 + COUNT + 7] = ",".join(place)
    ties.write_text("\n".join(lines) + "\n")
    assert intersect(scene, out, "--ties", ties) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rejected_rays"] == [0, 1, 0]
    with out.open(newline="") as file:
        rows = {row["id"]: row for row in csv.DictReader(file)}
    assert (rows["p7"]["rejected"], rows["p7"]["rays"], rows["p7"]["flag"]) == ("1", "2", "ok")
    assert {row["rejected"] for name, row in rows.items() if name != "p7"} == {""}


def test_the_report_stands_alone_and_says_it_all(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "stereo.html"
    more = ("--gcps", scene / "gcps.csv", "--reference", scene / "dem.tif", "--remove-bias")
    assert intersect(scene, tmp_path / "points.gpkg", "--report", page, *more) == 0
    assert json.loads(capsys.readouterr().out)["report"] == str(page)
    text = page.read_text()
    assert not re.search(r"(?:src|href)=\"(?!data:|#)", text)
    for words in (
        "Images and geometry", "base to height", "Footprints", "How the matches",
        "Relative bias", "Residual vectors", "Heights of the intersected", "CE90", "|min|",
        "Provenance", "forward.toml", "dem.tif", "ties.csv",
    ):  # fmt: skip
        assert words in text, words
    # Footprints, density, vectors, a histogram for each image, heights, their differences.
    assert text.count("data:image/png") == 3 + 3 + 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["points.gpkg", "stereo.html"]


@pytest.mark.parametrize(
    ("more", "names", "said"),
    [
        (("--reference", "elsewhere.tif"), NAMES, "no height at any"),
        ((), ("true_nadir", "true_forward", "true_backward"), ""),
        (("--geoid", "dem.tif"), NAMES, "--reference"),
        (("--min-convergence", "120"), NAMES, "--min-convergence"),
        (("--report", "stereo.txt"), NAMES, "html"),
    ],
)
def test_refusals_are_one_line_and_leave_nothing(
    scene: Path,
    tmp_path: Path,
    more: tuple[str, ...],
    names: tuple[str, ...],
    said: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if not more:
        # The products in another order, the ties by their numbers.
        text = (scene / "ties.csv").read_text()
        for k, name in enumerate(NAMES):
            text = text.replace(f",{name},", f",{k},")
        more, said = ("--ties", str(scene / "numbered.csv")), "swapped"
        (scene / "numbered.csv").write_text(text)
    options = [scene / a if a.endswith(".tif") else a for a in more]
    assert intersect(scene, tmp_path / "points.csv", *options, names=names) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_rays_that_hardly_converge_are_refused_where_asked(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert intersect(scene, tmp_path / "a.csv", "--min-convergence", "80") == 2
    assert "weak_geometry" in capsys.readouterr().err


def test_the_budget_on_the_command_line(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = str(scene / "true_forward.toml"), str(scene / "true_nadir.toml")
    assert run(["info", first, "--budget", "--pair", second, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    causes = {line["cause"] for line in found["budget"]["lines"]}
    assert {"turn about body x", "orbit up", "line time", "height of the surface"} <= causes
    assert {line["image"] for line in found["pair_budget"]["lines"]} == {0, 1}
    assert run(["info", first, "--budget"]) == 0
    assert "turn about orbit left" in capsys.readouterr().out
    assert run(["info", first, "--pair", second]) == 2
    assert "--budget" in capsys.readouterr().err


def test_a_constant_turn_is_all_that_was_wrong(true_models: list[PushbroomModel]) -> None:
    """The planted turn found back in full where nothing is hidden: both image directions."""
    turn = np.array([2.0, -3.0, 0.0]) * ARCSEC_RAD
    wrong = turned_in_body(true_models[1], turn)
    image = np.stack(np.meshgrid([600.0, 1000.0, 1400.0], [300.0, 1200.0]), axis=-1).reshape(-1, 2)
    ground = true_models[1].image_to_ground(image, 500.0).geodetic
    shift = np.mean(image - wrong.ground_to_image(ground).image_px, axis=0)
    changed = mended(wrong, shift, wrong.ground_to_image(ground).image_px, ground[:, 2])
    assert changed.turn_rad is not None
    np.testing.assert_allclose(changed.turn_rad, -turn, atol=0.02 * ARCSEC_RAD)
    ties = TiePoints.of_pair(image, true_models[0].ground_to_image(ground).image_px)
    found = triangulate([changed.model, true_models[0]], ties)
    assert np.max(found.residual_px) < 0.02
