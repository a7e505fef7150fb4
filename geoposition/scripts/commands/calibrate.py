"""`geoposition calibrate`: look angles and mounting of a camera from known ground."""

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
    products: Annotated[
        list[Path],
        typer.Argument(metavar="PRODUCT...", help="Scenes of one camera, or lists RUN.toml."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")],
    dom: DomOption = None,
    dem: DemOption = None,
    geoid: GeoidOption = None,
    field: FieldOption = None,
    hold_out: Annotated[
        list[Path] | None,
        typer.Option(help="Scene kept out, to check the result on; several times."),
    ] = None,
    image: Annotated[
        Path | None, typer.Option(help="The image of the only scene, where it is not known.")
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(help="Start from this camera file; without --dom: only put it into models."),
    ] = None,
    degree: Annotated[int, typer.Option(help="Degree of the look angles' polynomials.")] = 3,
    attitude_degree: Annotated[
        int, typer.Option(help="Attitude bias by scene: 0 constant, 1 with drift, 2 quadratic.")
    ] = 1,
    reference_sigma: ReferenceSigmaOption = None,
    height_sigma: Annotated[
        float | None, typer.Option(help="Standard deviation of the DEM's heights, m; 1.")
    ] = None,
    search: SearchOption = 100.0,
    window: WindowOption = 64,
    spacing: SpacingOption = None,
    correlation: CorrelationOption = 0.4,
    dom_band: DomBandOption = None,
    json: JsonOption = False,
) -> None:
    r"""Calibrate a camera's look angles and mounting on known ground.

    Writes camera.toml (look angles by CCD and mounting, for any scene of the camera), for each
    scene its model with this camera (model_01.toml) and with its own attitude bias compensated
    too, calibration.json, report.html and residuals. From one scene the mounting cannot be told
    from a bias of its attitude, several scenes tell them apart: the report says what is
    determined. A list RUN.toml holds [\[scene]] tables as for evaluate, with hold_out = true for
    scenes that only check. With --camera and without --dom the camera is put into the products'
    models, nothing is estimated.

    Example: geoposition calibrate a.toml b.toml --hold-out c.toml --dom dom.tif --dem dem.tif
    -o out
    """
    from geoposition.errors import ArgumentError
    from geoposition.scripts.calibrate import run as calibrate_run
    from geoposition.scripts.evaluate.settings import Settings
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.scratch import require_folder

    require_folder(output)
    if image is not None and (len(products) > 1 or hold_out):
        raise ArgumentError("--image: one scene expected; name the images of several in a RUN.toml")
    if camera is not None and not dom and field is None:
        summary = calibrate_run.apply_camera(products, camera, output)
    else:
        given = Settings(
            dom=tuple(dom or ()),
            dem=tuple(dem or ()),
            geoid=geoid,
            field=field,
            image=image,
            camera=camera,
            reference_sigma_m=reference_sigma,
            height_sigma_m=height_sigma,
            search_m=search,
            window_px=window,
            spacing_px=spacing,
            least_correlation=correlation,
            dom_band=dom_band,
        )
        with progress_bar("matching", json) as progress:
            summary = calibrate_run.run(
                products, hold_out or (), given, (degree, attitude_degree), output, progress
            )
    if json:
        print_json(summary)
    else:
        shown = ("scenes", "parameters", "curves", "inputs", "not_determined", "correlated")
        print_facts(str(output), {k: v for k, v in summary.items() if k not in shown})
