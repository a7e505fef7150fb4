"""`geoposition calibrate` on a synthetic field, its report in a browser, bad input."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from field_scene import FieldScene, make_field, scene, write_image

from geoposition.calib_fields.synthetic_dom import synthetic_image
from geoposition.scripts import cli
from geoposition.sensors.writers.model_file import write_model_file

SHAPE = (800, 500)
BIAS_ARCSEC, BOW_PX = (2.0, 3.0), (0.5, 2.0)


@dataclass(frozen=True)
class Run:
    """A field with two images of one camera, the folder of a calibration, and what it said."""

    field: FieldScene
    held: Path
    output: Path
    result: dict[str, Any]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("calibrate")
    true = scene(SHAPE, bias_arcsec=BIAS_ARCSEC, bow_px=BOW_PX)
    field = make_field(folder, SHAPE, true, noise=1.5)
    write_model_file(field.believed, folder / "model.toml", image=field.image_path)
    held = folder / "held.toml"
    other = synthetic_image(field.true, field.terrain, field.texture, noise=1.5, gain=0.7, seed=3)
    write_image(folder / "held.tif", other)
    write_model_file(field.believed, held, image=folder / "held.tif")
    output = folder / "out"
    command = [
        "calibrate", str(folder / "model.toml"), "--hold-out", str(held), "-o", str(output),
        "--dom", str(field.dom_path), "--dem", str(field.dem_path), "--search", "40",
    ]  # fmt: skip
    assert cli.run(command) == 0
    result = json.loads((output / "calibration.json").read_text(encoding="utf-8"))
    return Run(field, held, output, result)


def test_the_camera_is_right_on_a_scene_kept_out(run: Run) -> None:
    (check,) = run.result["held_out_scenes"]
    assert check["relative_px_before"] > 0.3
    assert check["relative_px"] < 0.05
    assert abs(check["bias_line_px"]) < 0.05
    assert abs(check["bias_sample_px"]) < 0.05
    (points,) = run.result["held_out_points"]
    assert max(points["rms_after_px"]) < 0.1 < max(points["rms_before_px"])
    ends = np.array(run.result["curves"][0]["shape_px"])[[0, -1], 1]
    assert np.allclose(ends, [-BOW_PX[1], BOW_PX[1]], atol=0.2)
    assert run.result["not_determined"]
    for name in run.result["outputs"]:
        assert Path(name).is_file()


def test_the_camera_goes_into_models(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = str(run.output / "camera.toml")
    ground = run.field.believed.image_to_ground(np.array([[400.0, 20.0]]), 400.0).geodetic
    command = ["calibrate", str(run.held), "--camera", camera, "-o", str(tmp_path), "--json"]
    assert cli.run(command) == 0
    (written,) = json.loads(capsys.readouterr().out)["outputs"]
    points = tmp_path / "points.csv"
    lon, lat, height = ground[0].tolist()
    points.write_text(
        f"id,lon,lat,height\n1,{math.degrees(lon)!r},{math.degrees(lat)!r},{height!r}\n"
    )
    out = tmp_path / "image.csv"
    assert cli.run(["project", written, str(points), "-o", str(out)]) == 0
    row = dict(zip(*(line.split(",") for line in out.read_text().splitlines()), strict=True))
    seen = np.array([float(row["row"]), float(row["col"])])
    # 20 samples from the end, where the cubic is 2 px
    assert np.max(np.abs(seen - run.field.true.ground_to_image(ground).image_px[0])) < 0.2
    assert cli.run([*command[:-1], "--degree", "3", "--camera", str(run.held)]) == 2
    assert "geoposition camera" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--dem", "{dem}"], "--dom and --dem"),
        (["--dom", "{dom}", "--dem", "{dem}", "--degree", "9"], "degree"),
        (["--dom", "{dom}", "--dem", "{srtm}"], "--geoid"),
        (["--dom", "{dom}", "--dem", "{zone}"], "heights where the image is"),
    ],
)
def test_bad_input_is_one_line(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    with rasterio.open(run.field.dem_path) as file:
        profile, heights = file.profile | {"crs": "EPSG:4326"}, file.read()
    for name, crs in (("srtm_n43.tif", "EPSG:4326"), ("zone.tif", "EPSG:32643")):
        with rasterio.open(tmp_path / name, "w", **profile | {"crs": crs}) as file:
            file.write(heights)
    paths = {
        "dom": str(run.field.dom_path),
        "dem": str(run.field.dem_path),
        "srtm": str(tmp_path / "srtm_n43.tif"),
        "zone": str(tmp_path / "zone.tif"),
    }
    given = [argument.format(**paths) for argument in arguments]
    model = str(run.field.dem_path.parent / "model.toml")
    for command in ("calibrate", "evaluate"):
        if command == "evaluate" and "--degree" in given:
            continue
        assert cli.run([command, model, *given, "-o", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_partly_clouded_scene_reports_its_coverage_and_heights(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cloud over the upper half; heights that are 2 m low; the calibrated camera."""
    source = run.field.source
    grey = np.array(source.read(source.extent))
    grey[:400] = 250.0 + np.random.default_rng(0).standard_normal((400, SHAPE[1]))
    write_image(tmp_path / "cloud.tif", grey)
    place = np.random.default_rng(1).uniform(20.0, 480.0, (300, 2))
    ground = run.field.believed.image_to_ground(place, 400.0).geodetic
    up = run.field.terrain.height_at(ground[:, :2]).height_m - 2.0
    up += np.random.default_rng(2).standard_normal(300)
    rows = np.column_stack([np.degrees(ground[:, :2]), up])
    lines = [f"{i},{lon!r},{lat!r},{h!r}" for i, (lon, lat, h) in enumerate(rows.tolist())]
    points = tmp_path / "points.csv"
    points.write_text("\n".join(["id,lon,lat,height", *lines]) + "\n", encoding="utf-8")
    command = [
        "evaluate", str(run.held), "--image", str(tmp_path / "cloud.tif"),
        "--dom", str(run.field.dom_path), "--dem", str(run.field.dem_path), "--search", "40",
        "--camera", str(run.output / "camera.toml"), "--points", str(points),
        "-o", str(tmp_path / "out"), "--json",
    ]  # fmt: skip
    assert cli.run(command) == 0
    result = json.loads(capsys.readouterr().out)
    assert 0.35 < result["coverage"] < 0.65
    assert result["rejected"]["low_correlation"] + result["rejected"]["no_texture"] > 20
    assert result["relative_px"] < 0.05
    low, high = result["bias_u_m_interval"]
    assert low < 2.0 < high < low + 1.0
    assert result["rmse_u_m"] == pytest.approx(np.hypot(2.0, 1.0), abs=0.25)
    # nine tenths of |N(2, 1)| lie below it
    assert result["le90_m"] == pytest.approx(3.28, abs=0.35)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "LE90" in page
    assert "coverage" in page


BROWSER = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (found := shutil.which(name))
    ),
    None,
)
PROBE = """<script>addEventListener("load", () => {
  const wide = [...document.querySelectorAll(".table")].filter(t => t.scrollWidth > t.clientWidth);
  const seen = [...document.images].filter(i => i.complete && i.naturalWidth > 0);
  document.title = `probe ${document.documentElement.scrollWidth - innerWidth} ${wide.length} `
    + `${seen.length} ${document.images.length} end`;
});</script>"""


@pytest.mark.skipif(BROWSER is None, reason="NO BROWSER: Chromium renders the reports where it is")
def test_the_report_reads_in_a_browser(run: Run, tmp_path: Path) -> None:
    """All pictures are shown, nothing is wider than the page, and it prints."""
    page = (run.output / "report.html").read_text(encoding="utf-8")
    probed = tmp_path / "probed.html"
    probed.write_text(page.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    base = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1100,900"]

    def browse(*options: str) -> str:
        done = subprocess.run(
            [*base, f"--user-data-dir={tmp_path / 'profile'}", *options, probed.as_uri()],
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        )
        return done.stdout

    found = re.search(r"<title>probe (-?\d+) (\d+) (\d+) (\d+) end</title>", browse("--dump-dom"))
    assert found is not None
    over, wide, seen, images = (int(n) for n in found.groups())
    assert over <= 0
    assert wide == 0
    assert seen == images == 2
    pdf = tmp_path / "report.pdf"
    browse("--no-pdf-header-footer", f"--print-to-pdf={pdf}")
    assert pdf.read_bytes().startswith(b"%PDF")
    assert pdf.stat().st_size > 50_000
