"""`geoposition experiment thesis-ch3`: the thesis's 6-state filters, chapter 3."""

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
    """Repeat the thesis's tables 3.2 to 3.4: EKF, complementary + UKF, UKF; beside the bound.

    Example: geoposition experiment thesis-ch3 --runs 200 -o ch3
    """
    from geoposition.scripts import experiment_run

    experiment_run.run("thesis-ch3", runs, seed, output, json)
