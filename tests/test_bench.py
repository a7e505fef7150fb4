"""The benchmarks run, compare before they time, and name the peers they could not have."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest

from geoposition.arrays import FloatArray
from geoposition.scripts.bench import __main__ as bench
from geoposition.scripts.bench import markdown, report
from geoposition.scripts.bench.growth import by_points
from geoposition.scripts.bench.limits import FLOP, Machine, limit_of
from geoposition.scripts.bench.machine import PeakMemory
from geoposition.scripts.bench.measure import (
    Case,
    CaseResult,
    Contender,
    Missing,
    Spread,
    measure,
)
from geoposition.scripts.bench.remap import ortho_cases, remap_cases
from geoposition.scripts.bench.runs import run
from geoposition.scripts.bench.scenes import rigorous_scenes

KEYS = {
    "direct", "direct-peers", "inverse", "inverse-peers", "dem", "dem-peers",
    "rpc-project", "rpc-locate", "rpc-dem", "rpc-fit", "pair-rays", "pair", "pair-covariance",
}  # fmt: skip
TARGETS = {
    "direct": 12.0,
    "inverse": 6.0,
    "dem": 5.0,
    "rpc-project": 150.0,
    "rpc-locate": 20.0,
    "rpc-dem": 5.0,
    "rpc-fit": 0.032 / 0.06,
    "pair-rays": 5.0,
    "pair": 5.0,
    "pair-covariance": 3.0,
}
Quick: TypeAlias = tuple[list[CaseResult], dict[str, Any]]
PEERS = ("usgscsm", "ASGARD", "pyrugged", "shareloc", "GDAL", "rpcm")


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Quick:
    path = tmp_path_factory.mktemp("bench") / "bench.json"
    found = run(None, True, 2, ("rigorous", "rpc"))
    path.write_text(json.dumps(report.as_json(found)))
    return found.cases, json.loads(path.read_text())


def test_every_case_is_measured_with_its_target(quick: Quick) -> None:
    results, _ = quick
    assert {result.case.key for result in results} == KEYS
    targets = {result.case.key: result.case.target_mpoint_s for result in results}
    assert {key: value for key, value in targets.items() if value is not None} == TARGETS
    for result in results:
        ours = result.rows[0]
        assert ours.name == "geoposition"
        assert not ours.reason
        assert ours.mpoint_s is not None
        assert 0.0 < ours.mpoint_s.low <= ours.mpoint_s.median <= ours.mpoint_s.high


def test_every_peer_is_named_measured_or_excused(quick: Quick) -> None:
    results, _ = quick
    rows = [row for result in results for row in result.rows[1:]]
    for peer in PEERS:
        assert any(row.name.startswith(peer) for row in rows), peer
    for row in rows:
        # a peer that is there does the same work; one that is not says why
        assert row.reason or (row.ratio is not None and row.compared > 0), row.name
        assert not row.reason.startswith(("failed", "not the same")), f"{row.name}: {row.reason}"


def test_gdal_agrees_with_our_rpc(quick: Quick) -> None:
    by_key = {result.case.key: result for result in quick[0]}
    for key, limit in (("rpc-project", 1e-6), ("rpc-locate", 1e-5)):
        gdal = next(row for row in by_key[key].rows if row.name.startswith("GDAL"))
        assert gdal.difference is not None
        assert gdal.difference < limit


def test_the_file_says_what_the_figures_depend_on(quick: Quick) -> None:
    told = quick[1]
    assert {case["key"] for case in told["cases"]} == KEYS
    assert told["environment"]["cores"] >= 1
    assert told["environment"]["numba"]
    assert all(rate > 0.0 for rate in told["copy_gb_s"].values())
    for case in told["cases"]:
        assert case["limit"]["mpoint_s"] > case["rows"][0]["mpoint_s"]["median"], case["key"]


def test_the_limit_is_the_nearer_of_memory_and_arithmetic() -> None:
    case = replace(_case(), key="rpc-project", bytes_per_point=40)
    memory = limit_of(case, Machine(4.0, 1e6))
    assert memory is not None
    assert (memory.what, memory.mpoint_s) == ("memory", 100.0)
    arithmetic = limit_of(case, Machine(4.0, 0.01 * FLOP["rpc-project"]))
    assert arithmetic is not None
    assert arithmetic.what == "arithmetic"
    assert arithmetic.mpoint_s == pytest.approx(10.0)
    assert limit_of(replace(case, key="direct-peers"), Machine(1e6, 1.0)) is not None
    assert limit_of(replace(case, key="unknown", bytes_per_point=0), Machine(1.0, 1.0)) is None


def test_growth_has_a_rate_for_every_size() -> None:
    growth = by_points(rigorous_scenes(None), quick=True)
    assert growth.sizes == (1_000, 10_000)
    assert all(rate > 0.0 for rate in growth.rows["synthetic"])


def test_opencv_and_gdal_resample_to_the_same_pixels(tmp_path: Path) -> None:
    made = [*remap_cases(quick=True), *ortho_cases(tmp_path, quick=True)]
    results = {case.key: measure(case, 1) for case in made}
    for key, result in results.items():
        for row in result.rows[1:]:
            assert not row.reason, f"{key}, {row.name}: {row.reason}"
    # rounding alone, but for noise where the map's interpolation or GDAL's tolerance shows
    assert results["remap-bilinear"].rows[1].difference == 1.0
    exact = results["ortho-bilinear"].rows[1].difference
    assert exact is not None
    assert exact <= 1.0


def test_the_page_keeps_what_is_around_its_tables(tmp_path: Path) -> None:
    page = tmp_path / "bench.md"
    text = "| new |"
    assert markdown.placed(text, page) == "| new |\n"
    page.write_text(f"# Head\n\n{markdown.BEGIN}\nold\n{markdown.END}\n\nTail\n")
    new = markdown.placed(text, page)
    assert new == f"# Head\n\n{markdown.BEGIN}\n\n| new |\n\n{markdown.END}\n\nTail\n"


def test_the_page_names_command_machine_and_every_contender() -> None:
    found = report.Report({"processor": "P", "cores": 2}, "synthetic")
    found.cases = [measure(_case(Missing("gone", "has | a reason")), 2)]
    found.times_s = {"start": Spread(0.1, 0.2, 0.3)}
    found.copy_gb_s = {1: 8.0, 2: 12.0}
    text = markdown.as_markdown(found, "python -m geoposition.scripts.bench --repeats 2")
    assert "--repeats 2\n```" in text
    assert "processor P, cores 2" in text
    assert "2 thread(s) 12.0 GB/s" in text
    assert "has \\| a reason" in text
    assert "| start | 0.1 | 0.2 | 0.3 |" in text
    tables = [line for line in text.splitlines() if line.startswith("| ours") or "gone" in line]
    assert {line.replace("\\|", "").count("|") for line in tables} == {11}


def _contender(name: str, answer: FloatArray, run: Callable[[], Any] | None = None) -> Contender:
    return Contender(name, slice(None), run or (lambda: answer), lambda raw: raw)


def _case(*peers: Contender | Missing) -> Case:
    ours = _contender("ours", np.zeros((10, 2)))
    return Case("key", "title", 10, "px", 0.1, ours, peers)


def test_a_peer_with_other_results_is_not_timed() -> None:
    off = _contender("off", np.full((10, 2), 0.2))
    half = np.zeros((10, 2))
    half[:5] = np.nan
    result = measure(_case(off, _contender("half", half), _contender("same", np.zeros((10, 2)))), 3)
    assert "0.283 px from ours" in result.rows[1].reason
    assert "only 5 of 10" in result.rows[2].reason
    assert result.rows[1].mpoint_s is None
    assert result.rows[3].difference == 0.0
    assert result.rows[3].ratio is not None


def test_a_peer_that_fails_is_a_row_not_the_end() -> None:
    def fail() -> Any:
        raise RuntimeError("no\nsuch thing")

    result = measure(
        _case(_contender("broken", np.zeros((10, 2)), fail), Missing("gone", "why")), 2
    )
    assert result.rows[1].reason == "failed: RuntimeError: no such thing"
    assert result.rows[2].reason == "why"
    assert result.rows[0].mpoint_s is not None


def test_a_target_is_met_by_the_best_repetition() -> None:
    case = _case()
    assert measure(case, 1).met is None
    assert measure(replace(case, target_mpoint_s=1e-9), 1).met is True
    assert measure(replace(case, target_mpoint_s=1e9), 1).met is False


def test_peak_memory_sees_what_was_allocated_and_freed() -> None:
    with PeakMemory() as peak:
        block = np.ones(8_000_000)
        del block
    if peak.bytes is None:
        pytest.skip("the system does not tell the peak of resident memory")
    assert peak.bytes == pytest.approx(64e6, rel=0.2)


def test_bad_arguments_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["--only", "nothing"]) == 2
    assert "some of rigorous" in capsys.readouterr().err
    assert bench.main(["--data", str(tmp_path / "absent")]) == 2
    assert "folder of real products" in capsys.readouterr().err
