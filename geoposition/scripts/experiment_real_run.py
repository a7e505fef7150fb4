"""`experiment real`: run the chains beside their folder, put it in its place, print the figures."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from geoposition.errors import ArgumentError, ProductError
from geoposition.scripts.experiments.real.outcome import Outcome
from geoposition.scripts.experiments.real.report import build
from geoposition.scripts.experiments.real.run import run as run_chains
from geoposition.scripts.experiments.real.size import Size
from geoposition.scripts.experiments.real.sources import SOURCES, find
from geoposition.scripts.report import render
from geoposition.scripts.results import plain, print_json, progress_bar, rounded
from geoposition.scripts.scratch import publish_folder, scratch_beside

MARK: Final = "real.json"
"""Written last: a folder with it holds a run that came to its end."""
_TEXTS: Final = ("*.json", "*.html")


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
    with _folder(wanted.output) as folder:
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


@contextmanager
def _folder(output: Path | None) -> Iterator[Path]:
    """Give a folder to fill that becomes `output`, or a fleeting one.

    An existing folder must be empty or a former run's.
    """
    if output is None:
        with TemporaryDirectory(prefix="geoposition-real-") as name:
            yield Path(name)
        return
    if output.exists() and not output.is_dir():
        raise ProductError(output, "", "a folder for the results expected, this is a file")
    if output.is_dir() and any(output.iterdir()) and not (output / MARK).is_file():
        raise ArgumentError(f"{output}: a new folder, an empty one or a former run's expected")
    with scratch_beside(output) as folder:
        yield folder
        _renamed(folder, output)
        publish_folder(folder, output, last=MARK)


def _renamed(folder: Path, output: Path) -> None:
    """Let files that name others in `folder` name them in `output`."""
    for path in (path for pattern in _TEXTS for path in folder.rglob(pattern)):
        text = path.read_text(encoding="utf-8")
        if str(folder) in text:
            path.write_text(text.replace(str(folder), str(output)), encoding="utf-8")


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
