"""`geoposition batch`: many scenes through the same steps, here or on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    run: Annotated[
        Path | None, typer.Argument(metavar="RUN.toml", help="Steps and scenes; see --example.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder of the results; the file's.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Local processes; as many as there are cores.")
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of each; the cores shared among them.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Dask scheduler, as tcp://host:8786, instead of local processes."),
    ] = None,
    example: Annotated[
        bool, typer.Option("--example", help="Print a RUN.toml with every key, and stop.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Run many scenes through the same commands, retry what fails, resume what was stopped.

    Each scene has a folder with its results, each command's JSON and log, and `scene.json`, which
    marks it done; `manifest.json` says how all of them stand. A run that was stopped goes on
    where it was when called again: a scene whose commands and files have not changed is kept.

    Example: geoposition batch RUN.toml -o out --workers 2
    """
    from geoposition.errors import ArgumentError, GeopositionError
    from geoposition.scripts.batch import plan as plans
    from geoposition.scripts.batch.run import failures
    from geoposition.scripts.batch.run import run as run_batch
    from geoposition.scripts.cli import command_words
    from geoposition.scripts.results import print_facts, print_json, progress_bar

    if example:
        typer.echo(plans.EXAMPLE, nl=False)
        return
    if run is None:
        raise ArgumentError("batch: a RUN.toml expected; --example prints one")
    plan = plans.read_plan(run, command_words() - {("batch",)}, output)
    with progress_bar("scenes", json) as progress:
        manifest = run_batch(plan, workers, threads, scheduler, progress)
    facts = manifest.facts()
    if json:
        print_json(facts)
    else:
        shown = ("scenes", "done", "kept", "failed", "output")
        print_facts("batch", {name: facts[name] for name in shown})
    bad = failures(manifest)
    if bad:
        raise GeopositionError(bad)
