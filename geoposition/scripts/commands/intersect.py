"""`geoposition intersect`: image points of two or more products to ground points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


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
    keep_ties: Annotated[
        Path | None,
        typer.Option(help="Table of the ties found to write, for --ties of later runs (.csv)."),
    ] = None,
    image: Annotated[
        list[Path] | None,
        typer.Option(help="Image of each product in turn, where it is not known (with --match)."),
    ] = None,
    gcps: Annotated[
        Path | None,
        typer.Option(
            help="Table id,lon,lat,height (.csv .geojson .gpkg .gcp) to check the points."
        ),
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(help="Standard deviation of image points, px; from their scatter."),
    ] = None,
    attitude_sigma: Annotated[
        float | None,
        typer.Option(help="Of the attitude about each axis, arcsec; from the product, or none."),
    ] = None,
    orbit_sigma: Annotated[
        float | None,
        typer.Option(
            help="Of the satellite's place along each axis, m; from the product, or none."
        ),
    ] = None,
    rpc_sigma: Annotated[
        float | None,
        typer.Option(help="Of an RPC, px; from its errBias, or none."),
    ] = None,
    image_noise_only: Annotated[
        bool, typer.Option("--image-noise-only", help="Leave the models' own errors out.")
    ] = False,
    min_convergence: Annotated[
        float, typer.Option(help="Rays that converge by less, degrees, give no point.")
    ] = 0.0573,
    remove_bias: Annotated[
        bool, typer.Option("--remove-bias", help="Take the relative bias out of the models.")
    ] = False,
    reference: Annotated[
        Path | None, typer.Option(help="DEM or DSM to compare the points' heights with.")
    ] = None,
    geoid: Annotated[
        Path | None, typer.Option(help="Geoid grid that makes its heights ellipsoidal.")
    ] = None,
    covariance: Annotated[
        bool, typer.Option("--covariance", help="Add covariances and error ellipsoids.")
    ] = False,
    report: Annotated[Path | None, typer.Option(help="Report to write: .html.")] = None,
    json: JsonOption = False,
) -> None:
    """Intersect lines of sight of the same ground points (forward intersection).

    Writes id,lon,lat,height,sigma_e,sigma_n,sigma_u,residual_px,rays,flag and more. The ties come
    from a table, where `product` is the product's name or its place on the command line counted
    from 0, or from matching the images. Ground control only checks the points. The sigmas hold
    the image points' noise and, where product or user state them, the models' own errors, which
    neighbouring points share. The images' relative bias is always found and reported; with
    --remove-bias all images follow the first: an RPC by a shift, a rigorous model by a constant
    turn of its attitude. Of three rays or more a wrong one is found and left out.

    Example: geoposition intersect left.tif right.tif --match -o points.gpkg --report stereo.html
    """
    from geoposition.errors import ArgumentError
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.stereo import report as stereo_report
    from geoposition.scripts.stereo import run as stereo_run
    from geoposition.scripts.stereo.errors import StatedSigmas
    from geoposition.scripts.tables import check_output
    from geoposition.scripts.tie_tables import (
        TIE_SUFFIXES,
        names_for,
        read_checks,
        read_ties,
        write_ties,
    )
    from geoposition.sensors.readers import open_product

    if len(products) < 2:
        raise ArgumentError("intersect: two or more products expected")
    if match == (ties is not None):
        raise ArgumentError("intersect: one of --ties and --match expected")
    if image and not match:
        raise ArgumentError("--image: for --match only")
    if keep_ties is not None and not match:
        raise ArgumentError("--keep-ties: for --match only, the ties are in a table already")
    for table, suffixes in ((output, stereo_run.SUFFIXES), (keep_ties, TIE_SUFFIXES)):
        if table is not None:
            check_output(table, suffixes)
    if report is not None:
        check_output(report, (".html", ".htm"))
    options = stereo_run.Options(
        sigma_px=sigma,
        min_convergence_deg=min_convergence,
        stated=StatedSigmas(attitude_sigma, orbit_sigma, rpc_sigma, image_noise_only),
        remove_bias=remove_bias,
        checks=None if gcps is None else read_checks(gcps),
        reference=reference,
        geoid=geoid,
    )
    opened = [open_product(product) for product in products]
    with progress_bar("matching" if match else "intersecting", json) as progress:
        if ties is not None:
            found_ties = read_ties(ties, products)
        else:
            found_ties = stereo_run.match_products(opened, image or [], progress)
    with progress_bar("intersecting", json) as progress:
        run = stereo_run.intersect(opened, found_ties, options, progress)
    source = "images matched" if ties is None else str(ties)
    page = None if report is None else stereo_report.page(run, options, source)
    stereo_run.write(output, run, covariance)
    facts = run.summary | {"output": str(output)}
    if keep_ties is not None:
        write_ties(keep_ties, [found_ties], names_for(products))
        facts["ties"] = str(keep_ties)
    if report is not None and page is not None:
        stereo_report.write(report, page)
        facts["report"] = str(report)
    if json:
        print_json(facts)
    else:
        print_facts(str(output), facts)
