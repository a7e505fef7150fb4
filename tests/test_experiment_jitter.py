"""`experiment jitter`: a short scene from telemetry to both tables, and what its files are for."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from geoposition.calib_fields.synthetic_strip import MapModel
from geoposition.calib_fields.synthetic_texture import EndlessTexture
from geoposition.errors import ArgumentError
from geoposition.reimage.ortho import OrthoGrid
from geoposition.scripts.cli import run as command
from geoposition.scripts.experiments.jitter.cases import Size, cases
from geoposition.scripts.experiments.jitter.chain import fuse
from geoposition.scripts.experiments.jitter.outcome import Outcome
from geoposition.scripts.experiments.jitter.report import build
from geoposition.scripts.experiments.jitter.run import run_sized
from geoposition.scripts.experiments.jitter.scene import sight
from geoposition.scripts.experiments.jitter.truth import Telemetry, attainable
from geoposition.scripts.report import render
from geoposition.scripts.results import plain

ARCSEC = np.pi / 648000.0
SIZE = Size(4000, 320, 12.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path]:
    folder = tmp_path_factory.mktemp("jitter")
    return run_sized(folder, lambda done, total: None, cases(3, [5]), 3, SIZE, processes=1), folder


def test_every_figure_is_within_its_bound(made: tuple[Outcome, Path]) -> None:
    outcome = made[0]
    for scene in (*outcome.scenes, outcome.slow):
        chain = scene.chain
        steady, raw = chain.error_after, chain.error_before
        assert steady.relative_px <= 0.10
        assert scene.after.raw["relative_px"] <= 0.15
        assert raw.relative_px > 10.0 * steady.relative_px
        assert np.abs(chain.mapping_error.error_px).max() <= 0.01
        misfit = chain.after["rpc_misfit_px"]
        assert max(misfit["after"][axis]["max"] for axis in ("row", "col")) <= 0.002
        assert misfit["before"]["row"]["rms"] > 0.05
        # the shift is star noise, and as large as the covariance says
        sigma_px = chain.fused_sigma_rad[1::-1] / (0.5 / 490e3)
        assert np.all(np.abs(steady.mean_px) < 4.0 * sigma_px)


def test_the_orthophoto_sees_what_the_truth_says(made: tuple[Outcome, Path]) -> None:
    scene = made[0].scenes[0]
    patch = np.ones(6) / 6.0  # a patch of 64 lines takes the mean of six rows, 11 lines apart
    for found, error in (
        (scene.before, scene.chain.error_before),
        (scene.after, scene.chain.error_after),
    ):
        at = found.matches.model_px[found.matches.used]
        mean = np.stack([np.convolve(p, patch, "same") for p in error.profile_px.T], axis=-1)
        true = np.stack([np.interp(at[:, 0], error.rows, mean[:, k]) for k in (0, 1)], axis=-1)
        seen = found.matches.error_px[found.matches.used] - error.mean_px
        inside = (at[:, 0] > 100.0) & (at[:, 0] < SIZE.lines - 100.0)
        missed = (seen - true)[inside]
        assert len(missed) > 12
        assert np.sqrt(np.mean(missed**2)) < 0.1
        assert np.abs(missed.mean(axis=0)).max() < 0.05


def test_the_jitter_is_found_as_planted(made: tuple[Outcome, Path]) -> None:
    chain = made[0].scenes[0].chain
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        found = {round(peak.frequency_hz): peak for peak in chain.jitter.axes[axis]}
        for line in chain.case.lines:
            peak = found[round(line.frequency_hz)]
            off = peak.amplitude_rad - line.amplitude_arcsec[k] * ARCSEC
            assert abs(off) < 5.0 * peak.sigma_amplitude_rad
            assert abs(peak.frequency_hz - line.frequency_hz) < 5.0 * peak.sigma_frequency_hz


def test_json_has_the_contract(made: tuple[Outcome, Path]) -> None:
    found = json.loads(json.dumps(plain(made[0].as_json()), allow_nan=False))
    (scene,) = found["scenes"]
    assert (scene["time"], scene["region"]) == ("2015-09-26 13:52", "Dongying")
    assert scene["side_swing_deg"] == -7.711
    assert scene["epoch_utc"] == "2015-09-26T05:52:00Z"
    for stage in ("before", "after"):
        size = np.hypot(scene[f"m_x_{stage}"], scene[f"m_y_{stage}"])
        assert scene[f"relative_px_{stage}"] == pytest.approx(size, abs=0.01)
    assert all(goal["met"] for goal in found["goals"].values())
    assert found["tables"]["1"][0]["paper_relative_px"] == 3.817


def test_the_page_has_both_tables_and_all_figures(made: tuple[Outcome, Path]) -> None:
    page = render(build(made[0], plain(made[0].as_json())))
    assert page.count("data:image/png;base64") == 10
    for words in ("P table 1", "P table 2", "1.459", "0.955", "05-dongying-zy3", "met"):
        assert words in page
    (made[1] / "report.html").write_text(page, encoding="utf-8")


def test_files_are_what_commands_take(
    made: tuple[Outcome, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made[1] / made[0].scenes[0].chain.case.name
    told = folder / "telemetry"
    fused = tmp_path / "fused.csv"
    walk = str(0.015 * ARCSEC)
    for arguments in (
        ["attitude", "fuse", "--star", told / "star.csv", "--gyro", told / "displacement.csv",
         "--mounting", told / "mounting.toml", "--angle-random-walk", walk,
         "--rate-random-walk", "0", "--at", told / "times.csv", "-o", fused],
        ["attitude", "jitter", told / "onboard.csv", "--ephemeris", told / "ephemeris.csv"],
        ["info", folder / "after" / "steady.toml"],
    ):  # fmt: skip
        assert command([*map(str, arguments), "--json"]) == 0, capsys.readouterr().err
    again, ours = (np.loadtxt(p, delimiter=",", skiprows=1) for p in (fused, folder / "fused.csv"))
    assert np.array_equal(again[:, :8], ours[:, :8])


def test_the_same_seed_gives_the_same_scene(tmp_path: Path) -> None:
    short = Size(500, 64, 4.0)
    case = cases(3, [2])[0]
    for name in "ab":
        seen = sight(case, short)
        (tmp_path / name).mkdir()
        from geoposition.scripts.experiments.jitter.files import write_telemetry

        write_telemetry(seen, tmp_path / name / "telemetry")
        fuse(seen, tmp_path / name / "telemetry", tmp_path / name / "fused.csv")
    one, two = (sorted((tmp_path / name).rglob("*.*")) for name in "ab")
    assert [p.read_bytes() for p in one] == [p.read_bytes() for p in two]
    other = sight(replace(case, seed=case.seed + 1), short)
    assert not np.array_equal(other.scene.star.quat_xyzw, seen.scene.star.quat_xyzw)
    # the image's middle is the field's, to the side that the side swing says
    model = seen.true_model()
    middle = model.image_to_ground(np.array([249.5, 31.5]), 1100.0).geodetic
    assert np.degrees(middle[:2]) == pytest.approx(case.centre_deg, abs=1e-4)


def test_the_bound_is_a_random_walks_without_drift_or_stars() -> None:
    # stars and telemetry without end know drift and shift: the walk about its mean is left
    told = Telemetry(1e-3 * ARCSEC, 1e-3 + 10.0, 2, 0.015 * ARCSEC, 60.0, 0.05)
    assert attainable(told).relative_px < np.sqrt(2 * 0.015**2 * 0.05 / 6.0) / 0.2105
    told = Telemetry(5.0 * ARCSEC, 10.0, 2, 0.015 * ARCSEC, 60.0, 2.1)
    walk = 2.0 * 0.015**2 * 2.1 / 6.0
    # and the drift that 1200 samples of 5 arcsec leave, over 2.1 s
    drift = 2.0 * (5.0**2 / 1202) * 12.0 / 60.0**2 * 2.1**2 / 12.0
    wanted = np.sqrt(walk + drift) / 0.2105
    found = attainable(told)
    assert found.relative_px == pytest.approx(wanted, rel=0.05)
    assert found.absolute_px > 5.0 / np.sqrt(1202) / 0.2105
    assert found.relative_px < found.relative_95_px < 2.0 * found.relative_px


def test_the_texture_is_one_spline_everywhere() -> None:
    texture = EndlessTexture.of(4)
    rng = np.random.default_rng(5)
    row, col = rng.uniform(-5000.0, 5000.0, (2, 20, 30))
    wanted = np.zeros(row.shape)
    for tile, spread in zip(texture.tiles, texture.spreads, strict=True):
        place = [row / spread, col / spread]
        whole = tile[:-3, :-3].astype(np.float64)
        wanted += map_coordinates(whole, place, order=3, mode="grid-wrap", prefilter=False)
    assert texture.at(row, col) == pytest.approx(wanted, abs=2e-5)
    part = texture.pixels(100, 200, 40, 50)
    assert np.array_equal(part[10:, 20:], texture.pixels(110, 220, 30, 30))
    assert 0.05 < part.std() < 0.25
    assert np.isnan(texture.at(np.full((1, 1), np.nan), np.zeros((1, 1)))).all()
    with pytest.raises(ArgumentError, match="alike"):
        texture.at(row, col[:-1])


def test_a_map_is_a_sensor_model() -> None:
    model = MapModel(OrthoGrid("EPSG:32649", 700_000.0, 3_800_000.0, 0.5, (4000, 3000)))
    image = np.random.default_rng(6).uniform(0.0, 3000.0, (50, 2))
    ground = model.image_to_ground(image, 250.0).geodetic
    assert model.ground_to_image(ground).image_px == pytest.approx(image, abs=1e-4)
    rays = model.rays(image, 250.0)
    assert np.linalg.norm(rays.direction_ecef, axis=-1) == pytest.approx(1.0, abs=1e-12)


def test_impossible_choices_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for scenes in ("0", "6", "one"):
        assert command(["experiment", "jitter", "--quick", "--scenes", scenes]) == 2
        assert "--scenes" in capsys.readouterr().err
