"""`experiment real`: run the chains beside their folder, put it in its place, print the figures."""

from __future__ import annotations

import time
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from typing import Any, Final

from geoposition.scripts.experiment_folder import experiment_folder
from geoposition.scripts.experiments.real.outcome import Outcome
from geoposition.scripts.experiments.real.report import build
from geoposition.scripts.experiments.real.run import run as run_chains
from geoposition.scripts.experiments.real.size import Size
from geoposition.scripts.experiments.real.sources import SOURCES, find
from geoposition.scripts.report import render
from geoposition.scripts.results import plain, print_json, progress_bar, rounded

MARK: Final = "real.json"


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of the experiment."""

    samples: Path
    seed: int
    size: Size
    output: Path | None


def run(wanted: Request, json: bool) -> None:
    """Do all of it; print the result, and fill the output folder if one is given."""
    begun = time.perf_counter()
    found = find(wanted.samples)
    with experiment_folder(wanted.output, MARK) as folder:
        with progress_bar("real chains", json) as progress:
            outcome = run_chains(found, folder, progress, wanted.seed, wanted.size)
        result: dict[str, Any] = rounded(plain(outcome.as_json()))
        page = render(build(outcome, found.paths, folder))
        (folder / "report.html").write_text(page, encoding="utf-8")
        text = dumps(result, indent=1, ensure_ascii=False, allow_nan=False)
        (folder / MARK).write_text(text + "\n", encoding="utf-8")
    if json:
        print_json(result)
        return
    _print(outcome)
    where = "" if wanted.output is None else f"{wanted.output}/report.html, "
    print(f"{where}{time.perf_counter() - begun:.0f} s")


def _print(outcome: Outcome) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    for name, figures in outcome.figures.items():
        table = Table(title=SOURCES[name].title, title_justify="left", box=None)
        for k, head in enumerate(("", "", "ours", "published", "attainable")):
            table.add_column(head, justify="left" if k < 2 else "right")
        for figure in figures:
            table.add_row(*figure.cells())
        console.print(table)
        console.print()
    for name, note in outcome.notes.items():
        console.print(f"{SOURCES[name].title}: {note}")
