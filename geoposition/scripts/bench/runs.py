"""One run of the benchmarks, group by group."""

from __future__ import annotations

import logging
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

from geoposition.scripts.bench import beside, cases, dom_match, fusion, growth, rpc_fit, scenes
from geoposition.scripts.bench.adjustment_cases import adjustment_cases
from geoposition.scripts.bench.machine import (
    copy_gb_s,
    cores,
    environment,
    gflop_s,
    threading_layer,
)
from geoposition.scripts.bench.measure import Case, Spread, measure
from geoposition.scripts.bench.remap import ortho_cases, remap_cases
from geoposition.scripts.bench.report import Report
from geoposition.sensors.readers import open_product

GROUPS: Final = {
    "rigorous": "direct and inverse location, on an ellipsoid and on a DEM, by a rigorous model",
    "rpc": "both directions of an RPC, on a DEM, pairs of rays, fitting",
    "fusion": "attitude filters, smoothers and a factor graph",
    "adjustment": "attitude biases from control and ties",
    "dom_match": "sub-pixel matching of patches",
    "remap": "resampling, re-imaging, orthoimages",
    "growth": "with points, rows, images and cores",
    "times": "start of the program and reading of products",
}
_SLOW: Final = 3
"""Repetitions of what takes seconds."""


def run(data: Path | None, quick: bool, repeats: int, groups: tuple[str, ...]) -> Report:
    """Measure the `groups`."""
    logging.disable(logging.WARNING)  # the peers talk
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _run(data, quick, repeats, groups)
    finally:
        logging.disable(logging.NOTSET)


def _run(data: Path | None, quick: bool, repeats: int, groups: tuple[str, ...]) -> Report:
    report = Report(environment(), "real" if data else "synthetic")
    with tempfile.TemporaryDirectory(prefix="geoposition_bench_") as name:
        folder = Path(name)
        for group in GROUPS:
            if group not in groups:
                continue
            if group == "growth":
                report.growth = _growth(data, folder, quick)
            elif group == "times":
                report.times_s = _times(data, 2 if quick else 5)
            else:
                times = min(repeats, _SLOW) if group == "adjustment" else repeats
                made = _cases(group, data, folder, quick)
                report.cases += [measure(case, times) for case in made]
    size = (8 if quick else 256) * 1024 * 1024
    for threads in sorted({1, cores()}):
        report.copy_gb_s[threads] = copy_gb_s(threads, 3 if quick else 7, size)
    report.gflop_s = gflop_s(3, 512) if quick else gflop_s()
    report.environment["threading_layer"] = threading_layer()
    return report


def _cases(group: str, data: Path | None, folder: Path, quick: bool) -> Iterator[Case]:
    sizes = cases.QUICK if quick else cases.FULL
    if group == "rigorous":
        yield from beside.rigorous_cases(scenes.rigorous_scenes(data)[0], folder, sizes)
    elif group == "rpc":
        scene = scenes.rpc_scene(data, folder)
        yield from beside.rpc_cases(scene, sizes)
        nodes = rpc_fit.QUICK_NODES if quick else rpc_fit.NODES
        yield rpc_fit.rpc_fit_case(scene.left, scene.name, nodes)
    elif group == "fusion":
        yield from fusion.fusion_cases(quick)
    elif group == "adjustment":
        yield from adjustment_cases(quick)
    elif group == "dom_match":
        yield from dom_match.dom_match_cases(quick)
    else:
        yield from remap_cases(quick)
        yield from ortho_cases(folder, quick)


def _growth(data: Path | None, folder: Path, quick: bool) -> dict[str, growth.Growth]:
    rigorous = scenes.rigorous_scenes(data)
    return {
        "points": growth.by_points(rigorous, quick),
        "rows": growth.by_rows(quick),
        "images": growth.by_images(quick),
        "cores": growth.by_cores(rigorous[0], scenes.rpc_scene(data, folder), quick),
    }


def _times(data: Path | None, repeats: int) -> dict[str, Spread]:
    times: dict[str, Callable[[], Any]] = {}
    for name, path in scenes.product_paths(data).items():
        times[f"read {name}"] = partial(open_product, path)
    python = [sys.executable, "-c"]
    commands = {
        "python alone": [*python, "pass"],
        "import geoposition": [*python, "import geoposition"],
        "import geoposition.pushbroom": [*python, "import geoposition.pushbroom"],
        "geoposition --help": [sys.executable, "-m", "geoposition.scripts", "--help"],
    }
    for name, command in commands.items():
        times[name] = partial(subprocess.run, command, check=True, capture_output=True)
    spreads = {}
    for name, call in times.items():
        call()
        taken = []
        for _ in range(repeats):
            begin = time.perf_counter()
            call()
            taken.append(time.perf_counter() - begin)
        spreads[name] = Spread.of(taken)
    return spreads
