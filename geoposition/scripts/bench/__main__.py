"""Run the benchmarks: one table, ours beside the peers, and a JSON file if asked for."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from geoposition.errors import ArgumentError, GeopositionError
from geoposition.scripts.bench import cases, dom_match, fusion, reimage, report, rpc_fit, scenes
from geoposition.scripts.bench.adjustment_cases import adjustment_cases
from geoposition.scripts.bench.machine import copy_gb_s, cores, environment, threading_layer
from geoposition.scripts.bench.measure import CaseResult, Spread, best_rate, measure
from geoposition.scripts.tables import check_output, whole_file
from geoposition.sensors.readers import open_product

_GROUPS = ("rigorous", "rpc", "fusion", "adjustment", "dom_match", "reimage", "growth", "times")


def bench(
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of real products; else GEOPOSITION_REAL_DATA, else a made-up scene."
        ),
    ] = None,
    json_path: Annotated[
        Path | None, typer.Option("--json", help="Also write the figures to this file.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Interleaved repetitions.")] = 9,
    quick: Annotated[bool, typer.Option("--quick", help="Tiny sizes: does all run?")] = False,
    only: Annotated[str, typer.Option(help=f"Some of {', '.join(_GROUPS)}.")] = "",
) -> None:
    """Measure geoposition beside its peers on this machine: same work, same data, one run."""
    if json_path is not None:
        check_output(json_path)
    groups = tuple(only.split(",")) if only else _GROUPS
    if not set(groups) <= set(_GROUPS):
        raise ArgumentError(f"--only: some of {', '.join(_GROUPS)} expected, got {only}")
    console = Console(width=None if sys.stdout.isatty() else 200)
    found, results = run(_real(data), quick, 2 if quick else repeats, groups)
    report.show(found, results, console)
    if json_path is not None:
        with whole_file(json_path) as temporary:
            text = json.dumps(report.as_json(found, results), indent=1)
            temporary.write_text(text + "\n", encoding="utf-8")


def run(
    data: Path | None, quick: bool, repeats: int, groups: tuple[str, ...] = _GROUPS
) -> tuple[dict[str, Any], list[CaseResult]]:
    """Measure the `groups`; the facts about the run, and the cases' results."""
    logging.disable(logging.WARNING)  # the peers talk
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _run(data, quick, repeats, groups)
    finally:
        logging.disable(logging.NOTSET)


def _run(
    data: Path | None, quick: bool, repeats: int, groups: tuple[str, ...]
) -> tuple[dict[str, Any], list[CaseResult]]:
    sizes = cases.QUICK if quick else cases.FULL
    results: list[CaseResult] = []
    found: dict[str, Any] = {
        "environment": environment(),
        "data": "real" if data else "synthetic",
        "copy_gb_s": {},
        "growth": {},
        "times_s": {},
    }
    rigorous = scenes.rigorous_scenes(data)
    with tempfile.TemporaryDirectory(prefix="geoposition_bench_") as name:
        folder = Path(name)
        if "rigorous" in groups:
            for case in cases.rigorous_cases(rigorous[0], folder, sizes):
                results.append(measure(case, repeats))
        if "rpc" in groups:
            rpc_scene = scenes.rpc_scene(data, folder)
            for case in cases.rpc_cases(rpc_scene, sizes):
                results.append(measure(case, repeats))
            nodes = rpc_fit.QUICK_NODES if quick else rpc_fit.NODES
            fit_case = rpc_fit.rpc_fit_case(rpc_scene.left, rpc_scene.name, nodes)
            results.append(measure(fit_case, repeats))
    if "fusion" in groups:
        results += [measure(case, repeats) for case in fusion.fusion_cases(quick)]
    if "dom_match" in groups:
        results += [measure(case, repeats) for case in dom_match.dom_match_cases(quick)]
    if "adjustment" in groups:
        results += [measure(case, min(repeats, 3)) for case in adjustment_cases(quick)]
    if "reimage" in groups:
        found["reimage"] = reimage.measured(1024 if quick else 8192)
    if "growth" in groups:
        found["growth"] = _growth(rigorous, quick)
    if "times" in groups:
        found["times_s"] = _times(data, 2 if quick else 5)
    size = (8 if quick else 256) * 1024 * 1024
    for threads in sorted({1, cores()}):
        found["copy_gb_s"][str(threads)] = copy_gb_s(threads, 3 if quick else 7, size)
    found["environment"]["threading_layer"] = threading_layer()
    return found, results


def _real(data: Path | None) -> Path | None:
    if data is None and os.environ.get("GEOPOSITION_REAL_DATA"):
        data = Path(os.environ["GEOPOSITION_REAL_DATA"])
    if data is not None and not data.is_dir():
        raise ArgumentError(f"{data}: a folder of real products expected")
    return data


def _growth(found: list[scenes.RigorousScene], quick: bool) -> dict[str, dict[str, float]]:
    growth: dict[str, dict[str, float]] = {}
    for scene in found:
        growth[scene.name] = {}
        for exponent in range(3, 5 if quick else 8):
            image = scenes.image_grid(scene.model.shape, 10**exponent)

            def direct(scene: scenes.RigorousScene = scene, image: Any = image) -> Any:
                return scene.model.image_to_ground(image, 100.0)

            repeats = 2 if quick else max(5, 10 ** (6 - exponent))
            growth[scene.name][str(10**exponent)] = best_rate(direct, len(image), repeats)
    return growth


def _times(data: Path | None, repeats: int) -> dict[str, dict[str, float]]:
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
        spread = Spread.of(taken)
        spreads[name] = {"low": spread.low, "median": spread.median, "high": spread.high}
    return spreads


def main(arguments: list[str] | None = None) -> int:
    """Run from the command line; the exit status."""
    try:
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        app.command()(bench)
        app(args=arguments, prog_name="python -m geoposition.scripts.bench", standalone_mode=True)
    except GeopositionError as error:
        print(f"geoposition: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
