"""Run the benchmarks: one table, ours beside the peers, and files if asked for."""

from __future__ import annotations

import json
import os
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from geoposition.errors import ArgumentError, GeopositionError
from geoposition.scripts.bench import markdown, report
from geoposition.scripts.bench.runs import GROUPS, run
from geoposition.scripts.tables import check_output, whole_file

_PROGRAM = "python -m geoposition.scripts.bench"
_ABOUT = "; ".join(f"{name}: {about}" for name, about in GROUPS.items())


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
    markdown_path: Annotated[
        Path | None,
        typer.Option(
            "--markdown",
            help="Also write the tables to this page, between its marks if it has any.",
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Interleaved repetitions.")] = 9,
    quick: Annotated[bool, typer.Option("--quick", help="Tiny sizes: does all run?")] = False,
    only: Annotated[str, typer.Option(help=f"Some groups, with commas. {_ABOUT}.")] = "",
) -> None:
    """Measure geoposition beside its peers on this machine: same work, same data, one run.

    Example: python -m geoposition.scripts.bench --only rpc,remap --json bench.json
    """
    for path in (json_path, markdown_path):
        if path is not None:
            check_output(path)
    groups = tuple(only.split(",")) if only else tuple(GROUPS)
    if not set(groups) <= set(GROUPS):
        raise ArgumentError(f"--only: some of {', '.join(GROUPS)} expected, got {only}")
    console = Console(width=None if sys.stdout.isatty() else 220)
    found = run(_real(data), quick, 2 if quick else repeats, groups)
    report.show(found, console)
    if json_path is not None:
        with whole_file(json_path) as temporary:
            text = json.dumps(report.as_json(found), indent=1)
            temporary.write_text(text + "\n", encoding="utf-8")
    if markdown_path is not None:
        command = _command(data, quick, repeats, only)
        text = markdown.placed(markdown.as_markdown(found, command), markdown_path)
        with whole_file(markdown_path) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _command(data: Path | None, quick: bool, repeats: int, only: str) -> str:
    """Return what a reader types for the same run; where its data is, is the reader's matter."""
    words = [_PROGRAM]
    words += ["--data DATA"] if data is not None else []
    words += ["--quick"] if quick else [f"--repeats {repeats}"]
    words += [f"--only {shlex.quote(only)}"] if only else []
    return " ".join(words)


def _real(data: Path | None) -> Path | None:
    if data is None and os.environ.get("GEOPOSITION_REAL_DATA"):
        data = Path(os.environ["GEOPOSITION_REAL_DATA"])
    if data is not None and not data.is_dir():
        raise ArgumentError(f"{data}: a folder of real products expected")
    return data


def main(arguments: list[str] | None = None) -> int:
    """Run from the command line; the exit status."""
    try:
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        app.command()(bench)
        app(args=arguments, prog_name=_PROGRAM, standalone_mode=True)
    except GeopositionError as error:
        print(f"geoposition: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
