"""`geoposition adjust`: attitude and image biases from control and tie points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    run_file: Annotated[
        Path | None, typer.Argument(metavar="RUN.toml", help="What to adjust, with what.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for the results.")
    ] = None,
    example: Annotated[
        bool, typer.Option("--example", help="Print a RUN.toml with every key explained.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Remove systematic errors of images with ground control and tie points.

    A rigorous model's attitude, orbit, times and camera, or an RPC's image points are corrected;
    what the measurements cannot tell apart, blunders and typical mistakes are said. RUN.toml
    names the images and the measurements, all paths relative to it:

    \b
      [\\[image]]
      id = "left"
      product = "left.XML"       # any product; rpc = true takes its RPC
      [\\[image]]
      id = "right"
      product = "right.XML"
      \\[control]
      file = "gcps.csv"          # id,lon,lat,height,product,row,col; also
      sigma_m = 0.05             #   .geojson .gpkg .gcp (ASP) .points (QGIS)
      image_sigma_px = 0.3
      \\[ties]
      match = true               # or file = "ties.csv": id,product,row,col
      \\[check]
      every = 4                  # or ids = \\["p3"], fraction, file
      [\\[unknown]]               # none: attitude bias, or shift of an RPC
      kind = "attitude_bias"     # attitude_spline mounting orbit image_bias
      degree = 0                 #   time_offset look_angles attitude_process
      \\[heights]
      dem = "dem.tif"            # heights of ties; geoid = "egm96.gtx"

    The folder gets adjustment.json, report.html, points.csv, image_points.csv and the adjusted
    models: ID.toml with tables and ID_csm.json, or ID_RPC.TXT. --example explains every key.

    Example: geoposition adjust run.toml -o adjusted/
    """  # noqa: D301  # click wants the character, not the two
    from geoposition.errors import ArgumentError
    from geoposition.scripts.results import print_facts, print_json, progress_bar

    if example:
        from geoposition.scripts.adjust.example import EXAMPLE

        print(EXAMPLE, end="")
        return
    if run_file is None:
        raise ArgumentError("adjust: a RUN.toml expected (--example prints one)")
    if output is None:
        raise ArgumentError("adjust: a folder for the results expected: -o DIR")
    from geoposition.scripts.adjust import run as adjust_run

    with progress_bar("adjusting", json) as progress:
        summary = adjust_run.run(run_file, output, progress)
    if json:
        print_json(summary)
    else:
        from geoposition.scripts.adjust.words import words

        print_facts(str(output), words(summary))
