"""`geoposition experiment intervals`: how often accuracy intervals hold the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    runs: Annotated[int, typer.Option(min=2, help="Monte Carlo runs.")] = 500,
    seed: Annotated[int | None, typer.Option(help="Of the random numbers.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for results and report.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Count how often the 95 % intervals of `evaluate` hold the truth of simulated scenes.

    Example: geoposition experiment intervals --runs 500 -o intervals
    """
    from geoposition.scripts import experiment_run

    experiment_run.run("intervals", runs, seed, output, json)
