"""Attitude pages and experiments: complete, self-contained, with the figures of the result."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path

import attitude_scene
import numpy as np
import pytest

from geoposition.scripts.attitude import figures as attitude_figures
from geoposition.scripts.attitude import fusion as attitude_fusion
from geoposition.scripts.attitude import fusion_report as attitude_fusion_report
from geoposition.scripts.attitude.input import Sources
from geoposition.scripts.cli import run
from geoposition.scripts.experiment_run import flat_tables


@pytest.fixture(scope="module")
def fusion(tmp_path_factory: pytest.TempPathFactory) -> attitude_fusion.FusionRun:
    scene = attitude_scene.write(tmp_path_factory.mktemp("scene"), span_s=60.0)
    return attitude_fusion.fuse(
        Sources(scene.star, scene.gyro, scene.mounting),
        attitude_fusion.Options(
            method="ekf",
            angle_random_walk=attitude_scene.SIGMA_V,
            rate_random_walk=attitude_scene.SIGMA_U,
            gate=0.999,
        ),
        lambda done, total: None,
    )


class _Links(HTMLParser):
    """Collects whatever a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            local = value is None or value.startswith(("data:", "#"))
            if name in ("src", "href") and not local:
                self.fetched.append(str(value))


def test_the_fusion_page_stands_alone_and_holds_its_figures(
    fusion: attitude_fusion.FusionRun, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    attitude_fusion_report.write(path, fusion)
    html = path.read_text()
    links = _Links()
    links.feed(html)
    assert links.fetched == []
    for title in ("Attitude", "Gyro drift", "Innovations", "Spectra", "Input"):
        assert f">{title}<" in html
    assert html.count("data:image/png") == 5
    assert f"{fusion.summary['star_samples']} star samples of 2 head(s)" in html


def test_star_minus_estimate_is_the_star_noise(fusion: attitude_fusion.FusionRun) -> None:
    times, difference = attitude_fusion_report.star_minus_estimate(fusion)
    assert len(times) == len(fusion.telemetry.star)
    rms = np.sqrt(np.mean(difference[20:] ** 2))
    assert rms == pytest.approx(attitude_scene.SIGMA_STAR, rel=0.15)


def test_a_warning_of_inconsistency_stands_on_the_complementary_page(
    fusion: attitude_fusion.FusionRun,
) -> None:
    from dataclasses import replace

    from geoposition.scripts.report import render

    other = replace(fusion, options=replace(fusion.options, method="cf-ukf"))
    assert "are too small" in render(attitude_fusion_report.build(other))
    assert "are too small" not in render(attitude_fusion_report.build(fusion))


def test_spectra_are_thinned_without_losing_a_line() -> None:
    frequency = np.arange(1, 40001) / 40000.0
    density = np.ones((40000, 1))
    density[23456] = 1e6
    small = np.ones((40000, 1))
    drawn = attitude_figures.spectra(frequency, density, ("roll",), "″²/Hz", (0.5, 2.0))
    flat = attitude_figures.spectra(frequency, small, ("roll",), "″²/Hz", (0.5, 2.0))
    assert drawn[:8] == b"\x89PNG\r\n\x1a\n"
    assert drawn != flat


def test_bands_of_long_series_stay_small() -> None:
    times = np.arange(600_000) / 10_000.0
    values = np.random.default_rng(1).standard_normal((600_000, 3))
    drawn = attitude_figures.bands(
        attitude_figures.Band(times, values, np.ones_like(values)), ("x", "y", "z"), "″"
    )
    assert len(drawn) < 500_000


@pytest.mark.parametrize("name", ["thesis-ch3", "thesis-ch4"])
def test_experiments_print_tables_and_write_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    folder = tmp_path / "out"
    assert run(["experiment", name, "--runs", "2", "-o", str(folder), "--json"]) == 0
    out = capsys.readouterr()
    result = json.loads(out.out)
    assert result["runs"] == 2
    methods = {"thesis-ch3": ("ekf-6", "ukf", "cf-ukf"), "thesis-ch4": ("ekf-15", "rts", "graph")}
    for method in methods[name]:
        assert len(result["rms_arcsec"][method]) == 3
    assert all({"truth", "mean", "sigma"} <= set(one) for one in result["gyro_parameters"].values())
    assert json.loads((folder / f"{name}.json").read_text())["tables"] == result["tables"]
    page = (folder / f"{name}.html").read_text()
    for number in flat_tables(result):
        assert f"{name}, {number}" in page


def test_experiments_refuse_a_folder_that_is_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "file"
    path.write_text("")
    assert run(["experiment", "thesis-ch3", "--runs", "2", "-o", str(path)]) == 2
    assert "this is a file" in capsys.readouterr().err


def test_mounted_heads_are_compared_in_the_body(fusion: attitude_fusion.FusionRun) -> None:
    _, difference = attitude_fusion_report.star_minus_estimate(fusion)
    head = fusion.telemetry.star.head
    assert np.all(np.abs(difference[head == 1].mean(axis=0)) < 2.0 * attitude_scene.SIGMA_STAR)
