"""`geoposition rpc fit`: an RPC from any product, with the proof of how well it fits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[
        Path,
        typer.Argument(
            help="Product, location grid (GeoTIFF), or table with row,col,lon,lat,height."
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help=".RPB, _RPC.TXT, .XML (DIMAP), .geom, .json or .tif."),
    ],
    heights: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Lowest and highest ellipsoidal height, metres; the model's own range."),
    ] = None,
    dem: Annotated[
        Path | None, typer.Option(help="Raster whose heights under the image are the range.")
    ] = None,
    geoid: Annotated[
        Path | None, typer.Option(help="Geoid grid: the DEM's heights are orthometric.")
    ] = None,
    degree: Annotated[int, typer.Option(min=1, max=3, help="Of the polynomials.")] = 3,
    denominators: Annotated[
        Literal["separate", "equal"], typer.Option(help="Two denominators, or one for both axes.")
    ] = "separate",
    direct: Annotated[
        bool, typer.Option(help="Also fit image to ground (kept by DIMAP and JSON).")
    ] = True,
    limit: Annotated[
        float, typer.Option(help="Refuse a fit that misses the model by more pixels.")
    ] = 1.0,
    verify: Annotated[
        bool, typer.Option("--verify", help="Read the file again with GDAL and compare.")
    ] = False,
    report: Annotated[Path | None, typer.Option(help="HTML page about the fit to write.")] = None,
    json: JsonOption = False,
) -> None:
    """Fit an RPC to a product's model, check it between the nodes, and write it.

    A location grid is checked at nodes kept out of a first fit; a table of control points by
    leaving out each point in turn.

    Example: geoposition rpc fit DIM_PHR1A.XML -o image_RPC.TXT --verify --report fit.html
    """
    from geoposition.errors import ArgumentError
    from geoposition.rpc.formats import dialect_for, write_rpc
    from geoposition.rpc.formats.verify import write_verified
    from geoposition.scripts import rpc_sources
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.tables import check_output

    if heights is not None and dem is not None:
        raise ArgumentError("--heights and --dem: one of them expected, not both")
    if geoid is not None and dem is None:
        raise ArgumentError("--geoid: it belongs to a --dem, and none is given")
    check_output(output)
    dialect_for(output)
    if report is not None:
        check_output(report, (".html", ".htm"))
    options = rpc_sources.Options(heights, dem, geoid, degree, denominators, direct, limit)
    with progress_bar("fitting", json) as progress:
        fit = rpc_sources.fit(product, options, progress)
        verified = write_verified(fit.model, output) if verify else None
        if verified is None:
            write_rpc(fit.model, output)
        result: dict[str, object] = {
            "product": str(product),
            "output": str(output),
            **fit.facts,
        }
        if verified is not None:
            result["verified"] = verified.as_dict()
        if report is not None:
            from geoposition.scripts import rpc_report

            rpc_report.write(report, str(product), str(output), fit, result)
            result["report"] = str(report)
    if json:
        print_json(result)
    else:
        print_facts(str(output), result)
