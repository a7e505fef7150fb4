"""`experiment real`: the chains on the public samples, their figures, files and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from geoposition.adjust.unknowns import ARCSEC_RAD
from geoposition.flags import has_result
from geoposition.matching import MatchOptions
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.formats import read_rpc
from geoposition.rpc.model import RpcModel
from geoposition.scripts import experiment_real_run
from geoposition.scripts.cli import run
from geoposition.scripts.experiment_real_run import Request
from geoposition.scripts.experiments.real import survey, worldview
from geoposition.scripts.experiments.real.side_by_side import nmad_interval_m
from geoposition.scripts.experiments.real.size import Size
from geoposition.scripts.experiments.real.sources import (
    REUNION,
    SOURCES,
    VENTOUX,
    WORLDVIEW,
    find,
)
from geoposition.scripts.tables import read_table
from geoposition.scripts.tie_tables import read_checks, read_ties
from geoposition.sensors.readers import open_product

SMALL = Size(runs=5, matching=MatchOptions(tile_features=4000), reports=False)
PUBLISHED_PX = {
    "wv1": {"row": (-0.01, 0.06, 0.13), "col": (0.00, 0.10, 0.18)},
    "wv2": {"row": (0.06, 0.07, 0.17), "col": (-0.03, 0.22, 0.38)},
}
"""Vendor's RPC less an independent model of the products as delivered: mean, std, largest."""


@pytest.fixture(scope="module")
def made(
    real_data_root: Path | None, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any]] | None:
    """Folder and figures of one run over all samples, smaller still than --quick."""
    if real_data_root is None:
        return None
    folder = tmp_path_factory.mktemp("real") / "out"
    experiment_real_run.run(Request(real_data_root, 1, SMALL, folder), json=False)
    figures: dict[str, Any] = json.loads((folder / "real.json").read_text(encoding="utf-8"))
    return folder, figures


Made = tuple[Path, dict[str, Any]]


def test_planted_attitude_is_found_and_check_points_meet_their_prediction(
    real_data: Path, made: Made
) -> None:
    found = made[1]["chains"][WORLDVIEW]
    left = np.array([found["attitude_left_arcsec"][name] for name in ("wv1", "wv2")])
    sigma = np.array(found["attitude_sigma_arcsec"]).reshape(2, 3)
    assert np.all(np.abs(left) < 4.0 * sigma)
    assert np.all(sigma[:, :2] < 0.02)
    check = found["check_points"]
    # 8" to 20" from 770 km
    assert 100.0 < check["before"]["rmse_3d_m"] < 300.0
    predicted = found["adjust"]["predicted_check_rmse_m"]
    assert check["after"]["rmse_3d_m"] < 1.4 * predicted < 0.5
    # the delivered models with the same marks: what is left is the marks' noise
    assert check["after"]["rmse_3d_m"] < 1.1 * check["reference"]["rmse_3d_m"]
    assert found["adjust"]["rejected"] == []
    low, high = found["repeated"]["ratio_interval"]
    assert high - low < 0.4
    assert abs(found["repeated"]["ratio"] - 1.0) < high - low


def test_adjustment_reported_its_check_points_as_intersection_finds_them(
    real_data: Path, made: Made
) -> None:
    found = made[1]["chains"][WORLDVIEW]
    after, adjusted = found["check_points"]["after"], found["adjust"]
    assert after["rmse_3d_m"] == pytest.approx(adjusted["check_rmse_m"], rel=0.02)


@pytest.mark.parametrize("name", PUBLISHED_PX)
def test_vendors_rpc_differs_by_the_known_motion(real_data: Path, made: Made, name: str) -> None:
    found = made[1]["chains"][WORLDVIEW]
    image = list(PUBLISHED_PX).index(name)
    rpc = found["rpc"][name]
    for k, axis in enumerate(("row", "col")):
        mean, std, largest = PUBLISHED_PX[name][axis]
        delivered, adjusted = rpc["vendor_less_reference"][axis], rpc["vendor_less_adjusted"][axis]
        # as an independent program found it, to its rounding
        assert delivered["mean"] == pytest.approx(mean, abs=0.006)
        assert delivered["std"] == pytest.approx(std, abs=0.006)
        assert delivered["max"] == pytest.approx(largest, abs=0.006)
        # and the adjusted model by the same, but for what control of this quality leaves
        off_mean = found["repeated"]["image_mean_px"][image][k]
        off_std = found["repeated"]["image_std_px"][image][k]
        assert abs(adjusted["mean"] - delivered["mean"]) < 4.0 * off_mean
        assert abs(adjusted["std"] - delivered["std"]) < 2.0 * off_std
        assert off_std < 0.1
        # it is motion along the lines, and no RPC follows it better than the one fitted here
        assert rpc["not_of_the_row_px"][axis] < 0.005
        assert rpc["ours_less_adjusted"][axis]["std"] < 1.05 * adjusted["std"]


def test_ventoux(real_data: Path, made: Made) -> None:
    found = made[1]["chains"][VENTOUX]
    sparse, dense = found["sparse"], found["dense"]
    assert sparse["intersected"] >= 300
    assert sparse["residual_before_removal_px"]["median"] == pytest.approx(2.39, abs=0.02)
    assert sparse["residual_px"]["median"] == pytest.approx(0.034, abs=0.004)
    row, col = np.abs(sparse["relative_bias_px"][1]["residual"])
    assert (col, row) == pytest.approx((2.3, 0.6), abs=0.06)
    cells = dense["comparison"]["reference_cells_m"]
    assert cells["count"] == 6
    assert cells["nmad"] == pytest.approx(5.6, abs=0.3)
    assert abs(cells["median"]) < 5.0


def test_reunion(real_data: Path, made: Made) -> None:
    found = made[1]["chains"][REUNION]
    sparse, dense = found["sparse"], found["dense"]
    assert sparse["residual_before_removal_px"]["median"] == pytest.approx(0.36, abs=0.01)
    assert sparse["residual_px"]["median"] < 0.04
    points = found["sparse_less_reference"]["difference_m"]
    assert abs(points["median"]) < 0.06
    assert points["nmad"] < 0.30
    comparison = dense["comparison"]
    assert comparison["reference_cover"] > 0.95
    assert comparison["difference_m"]["median"] == pytest.approx(-0.02, abs=0.02)
    assert comparison["difference_m"]["nmad"] == pytest.approx(0.345, abs=0.01)
    # no height can agree better than its own noise lets it
    assert points["nmad"] > sparse["sigma_enu_m"]["total"]["u"]


def test_every_file_is_what_commands_take(
    real_data: Path, made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made[0]
    pair = folder / WORLDVIEW
    for place, kind in (("working", PushbroomModel), ("reference", PushbroomModel),
                        ("adjusted", PushbroomModel)):  # fmt: skip
        products = [pair / place / f"{name}.toml" for name in ("wv1", "wv2")]
        assert all(isinstance(open_product(path).model, kind) for path in products)
    for path in (pair / "vendor/wv1.RPB", pair / "rpc/wv2.RPB", *folder.glob("*/agreeing/*.RPB")):
        assert isinstance(read_rpc(path), RpcModel)
    assert len(read_checks(pair / "gcps.csv").ids) == survey.CONTROL
    assert len(read_ties(pair / "ties.csv", products)) == 2 * (
        survey.CONTROL + survey.CHECK + survey.TIES
    )
    found = read_table(pair / "points-after.csv", ("lon", "lat", "height"))
    assert np.isfinite(found["height"]).all()
    samples = real_data / "stereo/pleiades_ventoux"
    ventoux = folder / VENTOUX
    agreeing = [ventoux / f"agreeing/{side}_image.RPB" for side in ("left", "right")]
    for arguments in (
        ["adjust", pair / "RUN.toml", "-o", tmp_path / "adjusted"],
        ["rpc", "compare", pair / "adjusted/wv1.toml", pair / "vendor/wv1.RPB"],
        ["intersect", *agreeing, "--ties", ventoux / "ties.csv", "-o", tmp_path / "points.csv"],
        ["dsm", *agreeing, "--image", samples / "left_image.tif",
         "--image", samples / "right_image.tif",
         "--ties", ventoux / "ties.csv", "-o", tmp_path / "dsm.tif"],
    ):  # fmt: skip
        capsys.readouterr()
        assert run([*map(str, arguments), "--json"]) == 0, capsys.readouterr().err
        facts = json.loads(capsys.readouterr().out)
        if arguments[0] == "adjust":
            wanted = made[1]["chains"][WORLDVIEW]["adjust"]["check_rmse_m"]
            assert facts["check_rmse_m"] == pytest.approx(wanted, abs=1e-6)
        if arguments[0] == "intersect":
            # the bias is out of the models already
            assert facts["residual_px"]["median"] == pytest.approx(0.034, abs=0.004)
    with rasterio.open(ventoux / "dsm.tif") as ours, rasterio.open(tmp_path / "dsm.tif") as again:
        assert np.array_equal(ours.read(), again.read(), equal_nan=True)


def test_the_page_has_all_chains_and_no_trace_of_where_it_was_made(
    real_data: Path, made: Made
) -> None:
    folder, figures = made
    page = (folder / "report.html").read_text(encoding="utf-8")
    for sources in SOURCES.values():
        assert sources.title.replace("'", "&#39;") in page
    assert page.count("data:image/png;base64") == 6
    for beside in figures["side_by_side"].values():
        assert all(np.isfinite(figure["ours"]) and figure["why"] for figure in beside)
    assert ".part" not in page
    assert ".part" not in (folder / WORLDVIEW / "adjusted/adjustment.json").read_text()
    assert [path.name for path in folder.parent.iterdir()] == ["out"]


def test_the_same_seed_measures_the_same(real_data: Path, made: Made, tmp_path: Path) -> None:
    """Models, control and marks to the last byte; what follows them is repeated above."""
    for seed in (1, 2):
        folder = tmp_path / str(seed)
        (folder / "working").mkdir(parents=True)
        worldview.measure(delivered(real_data), folder, seed)
        names = [path.relative_to(folder) for path in folder.rglob("*.csv")]
        assert len(names) > 8
        same = [
            (folder / name).read_bytes() == (made[0] / WORLDVIEW / name).read_bytes()
            for name in names
        ]
        assert all(same) == (seed == 1)


def delivered(samples: Path) -> dict[str, PushbroomModel]:
    models: dict[str, PushbroomModel] = {}
    for name, path in find(samples).paths[WORLDVIEW].items():
        model = open_product(path).model
        assert isinstance(model, PushbroomModel)
        models[name] = model
    return models


def test_the_planted_bias_is_what_it_says(real_data: Path) -> None:
    """The same seed gives the same survey; the reference stays as it is."""
    models = delivered(real_data)
    one, two = (survey.planted(models, np.random.default_rng(3)) for _ in range(2))
    for name, bias in zip(models, survey.BIAS_ARCSEC, strict=True):
        turn = survey.attitude_left_arcsec(models[name], one[name])
        # a mean over 75 samples of 0.005"
        assert turn == pytest.approx(bias, abs=0.004)
        times = models[name].attitude.curve.knots_s
        pair = (m[name].attitude.rotation(times).as_quat() for m in (one, two))
        assert np.array_equal(*pair)
    points = survey.survey(list(models.values()), np.random.default_rng(4))
    for model, image in zip(models.values(), points.image_px, strict=True):
        seen = model.ground_to_image(points.geodetic)
        assert has_result(seen.flag).all()
        assert seen.image_px == pytest.approx(image, abs=1e-6)
    noise = points.marks(np.random.default_rng(5)).image_px - points.image_px.reshape(-1, 2)
    assert noise.std() == pytest.approx(survey.IMAGE_SIGMA_PX, rel=0.1)
    assert survey.NOISE_ARCSEC * ARCSEC_RAD * 770e3 / 0.5 < 0.5 * survey.IMAGE_SIGMA_PX


def test_nmad_of_few_normal_errors_scatters() -> None:
    low, high = nmad_interval_m(6, 3.8)
    assert low < 3.8 < high
    assert high > 2.0 * 3.8 * 0.8
    few = nmad_interval_m(20_000 // 100, 1.0)
    assert few == pytest.approx((1.0, 1.0), abs=0.25)


def test_absent_chains_are_skipped_by_name(tmp_path: Path) -> None:
    for name in SOURCES[REUNION].files.values():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "stereo/pleiades_ventoux").mkdir()
    found = find(tmp_path)
    assert list(found.paths) == [REUNION]
    assert found.as_notes() == {
        WORLDVIEW: "skipped: no folder linescan/worldview2_pair",
        VENTOUX: "skipped: no folder dem",
    }


def test_refusals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing there, a file missing in a folder, a folder that is not ours: one line each."""
    samples = tmp_path / "samples"
    samples.mkdir()
    wanted = {"linescan/worldview2_pair": samples}
    for word, folder in {**wanted, "a folder with the public samples": tmp_path / "no"}.items():
        assert run(["experiment", "real", str(folder), "-o", str(tmp_path / "out")]) == 2
        assert word in capsys.readouterr().err
    (samples / "linescan/worldview2_pair").mkdir(parents=True)
    assert run(["experiment", "real", str(samples), "-o", str(tmp_path / "out")]) == 2
    assert "wv_mvp_1.xml" in capsys.readouterr().err
    for name in SOURCES[WORLDVIEW].files.values():
        (samples / name).write_text("<isd/>")
    full = tmp_path / "full"
    full.mkdir()
    (full / "thesis.doc").touch()
    assert run(["experiment", "real", str(samples), "-o", str(full)]) == 2
    assert "former run" in capsys.readouterr().err
    # what fails on the way leaves nothing
    assert run(["experiment", "real", str(samples), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full", "samples"]
