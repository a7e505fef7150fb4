"""`geoposition experiment thesis`: the thesis's chapter 5, from telemetry to stereo accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    runs: Annotated[
        int | None, typer.Option(min=2, help="Monte Carlo runs; 200, or 16 with --quick.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 5,
    quick: Annotated[bool, typer.Option("--quick", help="Few runs, small images.")] = False,
    numbers_only: Annotated[
        bool, typer.Option("--numbers-only", help="Without the chain of files and images.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for report and all products.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Repeat tables 5.2 to 5.4: star sensor, gyro and GPS to images, control, stereo points.

    A Monte Carlo with raw, fused and true attitude, and once the whole chain through files that
    the other commands read: telemetry, fused attitude, images, matches, adjustment, surface.

    Example: geoposition experiment thesis --quick -o thesis
    """
    from geoposition.scripts import experiment_thesis_run as work

    wanted = work.Request(
        runs=runs or (work.QUICK_RUNS if quick else work.FULL_RUNS),
        seed=seed,
        quick=quick,
        images=not numbers_only,
        output=output,
    )
    work.run(wanted, json)
