"""`geoposition ortho`: an image on a map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[Path, typer.Argument(help="Product: metadata file, RPC, model.")],
    image: Annotated[Path, typer.Argument(help="Its image, or a crop of it.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="GeoTIFF (COG) to write.")],
    dem: Annotated[Path, typer.Option(help="Raster of heights.")],
    geoid: Annotated[
        Path | None, typer.Option(help="Geoid grid: the DEM's heights are orthometric.")
    ] = None,
    crs: Annotated[
        str | None, typer.Option(help="EPSG number or name; the UTM zone of the scene.")
    ] = None,
    res: Annotated[
        float | None, typer.Option("--res", help="Pixel size in units of the CRS; the image's own.")
    ] = None,
    extent: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(help="Left, bottom, right, top in the CRS; what the image sees."),
    ] = None,
    method: Annotated[
        Literal["nearest", "bilinear", "cubic", "lanczos", "area"],
        typer.Option(help="Resampling; area: means over the new pixels, to make them larger."),
    ] = "cubic",
    occlusion: Annotated[
        bool, typer.Option("--occlusion", help="Leave out ground that is hidden from the camera.")
    ] = False,
    bound: Annotated[
        float, typer.Option(help="Largest error of interpolation between nodes, pixels.")
    ] = 0.005,
    nodata: Annotated[
        float | None, typer.Option(help="Value of missing pixels; the image's own, or 0.")
    ] = None,
    compress: Annotated[
        Literal["none", "deflate", "lzw", "zstd"],
        typer.Option(help="Without loss; none is fastest, deflate and lzw for older readers."),
    ] = "zstd",
    window: Annotated[
        str | None,
        typer.Option(help="K/N: make only the K-th of N windows of rows, into --windows."),
    ] = None,
    windows: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of a window; without --window join these, one option each."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Bring an image to a map with its model and a DEM (orthorectification).

    Beside OUT, OUT's name with _flags has for every pixel 0: seen, 2: outside the image, 4:
    hidden from the camera (with --occlusion), 6: outside the DEM, 7: a hole in it.

    Example: geoposition ortho image.tif image.tif -o ortho.tif --dem dem.tif --geoid egm96.gtx
    """
    from geoposition.scripts import ortho_run
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.row_windows import Split
    from geoposition.scripts.tables import check_output
    from geoposition.sensors.readers import open_product

    check_output(output, (".tif", ".tiff"))
    request = ortho_run.Request(
        image=image,
        output=output,
        dem=dem,
        geoid=geoid,
        crs=crs,
        resolution=res,
        extent=extent,
        method=method,
        occlusion=occlusion,
        bound_px=bound,
        nodata=nodata,
        compress=compress,
        split=Split.of(window, windows or ()),
    )
    opened = open_product(product)
    with progress_bar("ortho", json) as progress:
        summary = ortho_run.run(opened, request, progress)
    if json:
        print_json(summary)
    else:
        print_facts(str(output), summary)
