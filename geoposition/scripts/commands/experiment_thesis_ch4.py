"""`geoposition experiment thesis-ch4`: the thesis's smoothers and gyro models, chapter 4."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    runs: Annotated[int, typer.Option(min=2, help="Monte Carlo runs.")] = 1000,
    seed: Annotated[int | None, typer.Option(help="Of the random numbers.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for results and report.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Repeat the tables 4.2 to 4.10: 15-state filter, RTS, two-filter, graph; beside the bound.

    Example: geoposition experiment thesis-ch4 --runs 200 -o ch4
    """
    from geoposition.scripts import experiment_run

    experiment_run.run("thesis-ch4", runs, seed, output, json)
