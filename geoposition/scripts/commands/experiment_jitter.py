"""`geoposition experiment jitter`: P's five scenes over calibration fields, tables 1 and 2."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    quick: Annotated[
        bool, typer.Option("--quick", help="Shorter, narrower images: a minute or two.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 1,
    scenes: Annotated[
        str | None, typer.Option(help="Which of P's scenes, such as 1,3; all five.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for every file and the report.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Repeat P's jitter compensation from telemetry to its tables 1 and 2, on known ground.

    Star samples and 10 kHz angular displacement are fused; an image, rendered through the true,
    jittered attitude, is made steady with the on-board attitude and with the fused one; both are
    matched with the field's orthophoto and compared with the truth. Without -o nothing is kept;
    with it all files stay (about 2.3 GB, quick 0.3 GB), and each is what the other commands take.

    Example: geoposition experiment jitter --quick -o jitter
    """
    from geoposition.errors import ArgumentError
    from geoposition.scripts import experiment_jitter_run

    try:
        numbers = [int(part) for part in scenes.split(",")] if scenes else []
    except ValueError:
        raise ArgumentError(f"--scenes: numbers such as 1,3 expected, got {scenes!r}") from None
    experiment_jitter_run.run(numbers, seed, quick, output, json)
