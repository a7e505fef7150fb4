"""`geoposition reimage`: jitter out of an image, its model and its RPC."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[Path, typer.Argument(help="Product with a rigorous model.")],
    image: Annotated[Path, typer.Argument(help="Its image, or a crop of it.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write.")],
    attitude: Annotated[
        Path | None,
        typer.Option(help="Fused attitude t_s,q_x,q_y,q_z,q_w, body to inertial; the product's."),
    ] = None,
    columns: Annotated[
        Path | None, typer.Option(help="TOML file: which column of the attitude is what.")
    ] = None,
    attitude_frame: Annotated[
        Literal["inertial", "itrs"], typer.Option(help="What the attitude is relative to.")
    ] = "inertial",
    epoch: Annotated[
        str | None,
        typer.Option(help="UTC of the attitude's t_s = 0; that of the product's own attitude."),
    ] = None,
    dem: Annotated[Path | None, typer.Option(help="Ground to map through; a mean height.")] = None,
    geoid: Annotated[
        Path | None, typer.Option(help="Geoid grid: the DEM's heights are orthometric.")
    ] = None,
    height: Annotated[
        float | None, typer.Option(help="Ellipsoidal height in place of a DEM, metres.")
    ] = None,
    cutoff: Annotated[
        float | None, typer.Option(help="Hz: motion slower than this stays in the image.")
    ] = None,
    smoothing: Annotated[
        Literal["polynomial", "low-pass", "spline"] | None,
        typer.Option(help="Of the attitude; low-pass with --cutoff, else polynomial."),
    ] = None,
    degree: Annotated[int, typer.Option(min=0, max=9, help="Of the polynomial in time.")] = 3,
    camera: Annotated[
        Literal["same", "ideal"],
        typer.Option(help="ideal: one straight undistorted line from all CCDs."),
    ] = "same",
    method: Annotated[
        Literal["nearest", "bilinear", "cubic", "lanczos"], typer.Option(help="Resampling.")
    ] = "cubic",
    bound: Annotated[
        float, typer.Option(help="Largest error of interpolation between nodes, pixels.")
    ] = 0.005,
    nodata: Annotated[
        float | None, typer.Option(help="Value of missing pixels; the image's own.")
    ] = None,
    evaluation: Annotated[
        Path | None,
        typer.Option(help="evaluation.json of the image as taken, to lay its jitter beside."),
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
    """Re-image as a perfectly steady camera would have it (steady-state re-imaging).

    DIR gets the steady image (COG with RPC tags), its rigorous model (own file and CSM), RPC
    files, a validity mask, the displacements, the attitude that was removed, reimage.json and
    report.html. Without --cutoff the steady attitude is a cubic in time, which an RPC follows.

    Example: geoposition reimage scene.XML scene.tif -o steady --attitude fused.csv --dem dem.tif
    """
    from geoposition.errors import ArgumentError
    from geoposition.reimage.steady import SteadyOptions
    from geoposition.scripts.reimage import run as reimage_run
    from geoposition.scripts.reimage.input import AttitudeInput
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.row_windows import Split
    from geoposition.sensors.readers import open_product

    if geoid is not None and dem is None:
        raise ArgumentError("--geoid: it belongs to a --dem, and none is given")
    if height is not None and dem is not None:
        raise ArgumentError("--height and --dem: one of them expected, not both")
    if attitude is None and (columns is not None or epoch is not None):
        raise ArgumentError("--columns, --epoch: they belong to an --attitude, and none is given")
    kind = smoothing or ("polynomial" if cutoff is None else "low-pass")
    request = reimage_run.Request(
        image=image,
        output=output,
        attitude=None
        if attitude is None
        else AttitudeInput(attitude, columns, attitude_frame, epoch),
        dem=dem,
        geoid=geoid,
        height_m=height,
        steady=SteadyOptions(kind, degree, cutoff),
        ideal=camera == "ideal",
        method=method,
        bound_px=bound,
        nodata=nodata,
        compress=compress,
        evaluation=evaluation,
        split=Split.of(window, windows or ()),
    )
    opened = open_product(product)
    with progress_bar("re-imaging", json) as progress:
        summary = reimage_run.run(opened, request, progress)
    if json:
        print_json(summary)
    else:
        print_facts(str(output), summary)
