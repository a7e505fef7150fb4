"""`geoposition intersect`: image points of two or more products to ground points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    products: Annotated[
        list[Path], typer.Argument(help="Two or more products of the same ground.")
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Points to write: .csv, .parquet, .geojson, .gpkg."),
    ],
    ties: Annotated[
        Path | None, typer.Option(help="Table id,product,row,col: which point is seen where.")
    ] = None,
    match: Annotated[bool, typer.Option("--match", help="Find the ties in the images.")] = False,
    image: Annotated[
        list[Path] | None,
        typer.Option(help="Image of each product in turn, where it is not known (with --match)."),
    ] = None,
    gcps: Annotated[
        Path | None, typer.Option(help="Table id,lon,lat,height to check the points of the ties.")
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(help="Standard deviation of image points, px; from their scatter."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Intersect lines of sight of the same ground points (forward intersection).

    Writes id,lon,lat,height,sigma_e,sigma_n,sigma_u,residual_px,rays,flag. The ties come from a
    table, where `product` is the product's name or its place on the command line counted from
    0, or from matching the images. Ground control only checks the points.

    Example: geoposition intersect left.tif right.tif --match -o points.gpkg
    """
    from geoposition.errors import ArgumentError
    from geoposition.scripts import stereo_run
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.tables import check_output
    from geoposition.scripts.tie_tables import read_checks, read_ties
    from geoposition.sensors.readers import open_product

    if len(products) < 2:
        raise ArgumentError("intersect: two or more products expected")
    if match == (ties is not None):
        raise ArgumentError("intersect: one of --ties and --match expected")
    if image and not match:
        raise ArgumentError("--image: for --match only")
    check_output(output, stereo_run.SUFFIXES)
    checks = None if gcps is None else read_checks(gcps)
    opened = [open_product(product) for product in products]
    with progress_bar("matching" if match else "intersecting", json) as progress:
        if ties is not None:
            found_ties = read_ties(ties, products)
        else:
            found_ties = stereo_run.match_products(opened, image or [], progress)
    with progress_bar("intersecting", json) as progress:
        run = stereo_run.intersect(opened, found_ties, sigma, checks, progress)
    stereo_run.write(output, run)
    if json:
        print_json(run.summary | {"output": str(output)})
    else:
        print_facts(str(output), run.summary)
