"""`geoposition experiment real`: public samples from product or image pair to their accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    samples: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder with the public samples, see above.")
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer repetitions, matches and reports: a minute.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the planted noise.")] = 1,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for report and all products.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Run three public samples from the product to the accuracy, beside published figures.

    FOLDER holds what is wanted of these public repositories; what is absent is skipped:

    \b
      linescan/worldview2_pair/wv_mvp_1.xml, wv_mvp_2.xml
          NeoGeographyToolkit/StereoPipeline, Apache-2.0
      stereo/pleiades_ventoux/left_image.tif .geom, right_image.tif .geom
      dem/N44E005.hgt, egm96_15.gtx
          CNES/shareloc, Apache-2.0
      stereo/pleiades_reunion/img_01.tif, img_02.tif, expected_dsm.tif
          centreborelli/s2p, AGPL-3.0

    WorldView-2: rigorous model, control from a kept-out reference, adjustment, intersection,
    RPC against the vendor's. Pléiades: matches, relative bias, points, surface against SRTM or
    another tool's. Every step is a file that the other commands take. Without -o nothing is kept.

    Example: geoposition experiment real samples --quick -o real
    """  # noqa: D301  # click wants the character, not the two
    from geoposition.scripts import experiment_real_run as work
    from geoposition.scripts.experiments.real.size import FULL, QUICK

    work.run(work.Request(samples, seed, QUICK if quick else FULL, output), json)
