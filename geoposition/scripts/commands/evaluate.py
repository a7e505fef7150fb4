"""`geoposition evaluate`: an image's accuracy from a reference orthophoto."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.known_ground_options import (
    CorrelationOption,
    DemOption,
    DomBandOption,
    DomOption,
    FieldOption,
    GeoidOption,
    ReferenceSigmaOption,
    SearchOption,
    SpacingOption,
    WindowOption,
)
from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[
        Path, typer.Argument(help="Image with an RPC, any product, or a list RUN.toml of scenes.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")],
    dom: DomOption = None,
    dem: DemOption = None,
    geoid: GeoidOption = None,
    field: FieldOption = None,
    image: Annotated[
        Path | None, typer.Option(help="The image, where it is not known from the product.")
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(help="Camera file (see calibrate) in place of the product's.")
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(help="Intersected points (lon,lat,height), as intersect writes: for LE90."),
    ] = None,
    relative: Annotated[
        str, typer.Option(help="Removed before the relative numbers: shift, affine, attitude.")
    ] = "shift",
    reference_sigma: ReferenceSigmaOption = None,
    height_sigma: Annotated[
        float | None, typer.Option(help="Standard deviation of the DEM's datum, m.")
    ] = None,
    search: SearchOption = 100.0,
    window: WindowOption = 64,
    spacing: SpacingOption = None,
    correlation: CorrelationOption = 0.4,
    line_period: Annotated[
        float | None, typer.Option(help="Seconds per line, where the model tells no time.")
    ] = None,
    dom_band: DomBandOption = None,
    json: JsonOption = False,
) -> None:
    r"""Match an image with a reference orthophoto and say how accurate it is.

    Writes evaluation.json, report.html and matches.gpkg into the folder. The bias is what brings
    the image onto the reference (reference less located); x runs along the track, y across it.
    Without --geoid the DEM's heights are taken as ellipsoidal, and refused where the DEM says
    otherwise. With --points the heights of a stereo intersection are compared with the DEM: bias,
    RMSE and LE90. A list RUN.toml holds [\[scene]]
    tables with product, image, date, region, side_swing_deg and any of the options above, and a
    table \[defaults] with what they share.

    Example: geoposition evaluate image.tif --dom dom.tif --dem dem.tif --geoid egm96.gtx -o out
    """
    from geoposition.scripts.evaluate import run as evaluate_run
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.scratch import require_folder

    given = evaluate_run.Settings(
        dom=tuple(dom or ()),
        dem=tuple(dem or ()),
        geoid=geoid,
        field=field,
        image=image,
        camera=camera,
        points=points,
        relative=relative,
        reference_sigma_m=reference_sigma,
        height_sigma_m=height_sigma,
        search_m=search,
        window_px=window,
        spacing_px=spacing,
        least_correlation=correlation,
        line_period_s=line_period,
        dom_band=dom_band,
    )
    require_folder(output)
    with progress_bar("matching", json) as progress:
        summary = evaluate_run.run(product, given, output, progress)
    if json:
        print_json(summary)
    else:
        print_facts(str(output), {k: v for k, v in summary.items() if k != "inputs"})
