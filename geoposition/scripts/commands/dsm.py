"""`geoposition dsm`: two or more images to a surface and a point cloud."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    products: Annotated[
        list[Path], typer.Argument(help="Two or more products of the same ground.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="GeoTIFF to write.")],
    image: Annotated[
        list[Path] | None,
        typer.Option(help="Image of each product in turn, where it is not known."),
    ] = None,
    ties: Annotated[
        Path | None,
        typer.Option(help="Table id,product,row,col of matches; found in the images."),
    ] = None,
    points: Annotated[Path | None, typer.Option(help="Point cloud to write: .las, .laz.")] = None,
    resolution: Annotated[
        float | None, typer.Option(help="Cell size in units of the CRS; the image's own.")
    ] = None,
    crs: Annotated[
        str | None, typer.Option(help="EPSG number or name; the UTM zone of the scene.")
    ] = None,
    heights: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Lowest and highest ground, m above the ellipsoid; from the ties."),
    ] = None,
    dem: Annotated[
        Path | None, typer.Option(help="DEM to start from: the ground lies near it.")
    ] = None,
    dem_geoid: Annotated[
        Path | None, typer.Option(help="Geoid grid of the DEM; --geoid unless given.")
    ] = None,
    remove_bias: Annotated[
        bool, typer.Option("--remove-bias", help="Take the relative bias out of the models.")
    ] = False,
    fill: Annotated[bool, typer.Option("--fill", help="Fill holes inside the surface.")] = False,
    reference: Annotated[
        Path | None, typer.Option(help="DEM or DSM to compare the surface with.")
    ] = None,
    geoid: Annotated[
        Path | None, typer.Option(help="Geoid grid that makes its heights ellipsoidal.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Match images densely and grid the points to a surface (DSM).

    Every image is matched with the first one. The GeoTIFF has the bands height (metres above
    the WGS 84 ellipsoid), count and error (standard deviation from matching, m); no data is
    NaN. The relative bias between the images is always found and reported; matching follows it,
    the points do only with --remove-bias.

    Example: geoposition dsm left.tif right.tif -o dsm.tif --points dsm.laz --remove-bias
    """
    from geoposition.errors import ArgumentError
    from geoposition.scripts import dsm_run
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.tables import check_output
    from geoposition.scripts.tie_tables import read_ties
    from geoposition.sensors.readers import open_product

    if len(products) < 2:
        raise ArgumentError("dsm: two or more products expected")
    if geoid is not None and reference is None and dem is None:
        raise ArgumentError("--geoid: for --reference and --dem only")
    if heights is not None and dem is not None:
        raise ArgumentError("dsm: one of --heights and --dem expected")
    check_output(output, (".tif", ".tiff"))
    if points is not None:
        check_output(points, (".las", ".laz"))
    request = dsm_run.Request(
        output=output,
        points=points,
        resolution=resolution,
        crs=crs,
        heights_m=heights,
        dem=dem,
        dem_geoid=dem_geoid or geoid,
        remove_bias=remove_bias,
        fill=fill,
        reference=reference,
        geoid=geoid,
    )
    opened = [open_product(product) for product in products]
    known = None if ties is None else read_ties(ties, products)
    with progress_bar("matching", json) as progress:
        summary = dsm_run.run(opened, image or [], request, progress, known)
    if json:
        print_json(summary)
    else:
        print_facts(str(output), summary)
