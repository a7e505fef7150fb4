"""`geoposition rpc convert`: one dialect of RPC file to another, moved with its image."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    rpc: Annotated[Path, typer.Argument(help="RPC file of any dialect, or image carrying one.")],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help=".RPB, _RPC.TXT, .XML (DIMAP), .geom, .json or .tif."),
    ],
    bias: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Add a bias (row, col), observed − RPC, pixels."),
    ] = None,
    crop: Annotated[
        tuple[int, int, int, int] | None,
        typer.Option(help="To a window: first row, first col, rows, cols. Negative: a mosaic."),
    ] = None,
    overview: Annotated[
        float | None, typer.Option(help="To an image with pixels so many times as large.")
    ] = None,
    turn: Annotated[
        int | None, typer.Option(help="To an image turned by quarters, counter-clockwise.")
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="Read the file again with GDAL and compare.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Rewrite an RPC in the dialect that the output's name asks for.

    Moves, in this order: bias, crop, overview, turn; all are exact.

    Example: geoposition rpc convert RPC_PHR1A.XML -o image_RPC.TXT
    """
    from geoposition.errors import ArgumentError
    from geoposition.rpc.formats import read_rpc, sniff, write_rpc
    from geoposition.rpc.formats.verify import write_verified
    from geoposition.rpc.transform import ImageAffine, bias_compensated, transformed
    from geoposition.scripts.results import print_facts, print_json
    from geoposition.scripts.tables import check_output

    check_output(output)
    dialect = sniff(rpc)
    model = read_rpc(rpc)
    if bias is not None:
        model = bias_compensated(model, bias).model
    if crop is not None:
        if min(crop[2:]) < 1:
            raise ArgumentError("--crop: positive numbers of rows and cols expected")
        model = model.cropped(crop[0], crop[1], (crop[2], crop[3]))
    if overview is not None:
        smaller = ImageAffine.overview(overview)
        # As GDAL sizes overviews: the last pixel may hang over the edge.
        lines, samples = (max(1, -int(-n // overview)) for n in model.shape)
        shape = (lines, samples) if model.shape_known else None
        model = transformed(model, smaller, shape).model
    if turn is not None:
        shape = model.shape[::-1] if turn % 2 else model.shape
        quarter = ImageAffine.quarter_turns(turn, model.shape)
        model = transformed(model, quarter, (shape[0], shape[1])).model
    verified = write_verified(model, output) if verify else None
    if verified is None:
        write_rpc(model, output)
    result: dict[str, object] = {
        "input": str(rpc),
        "from": dialect,
        "to": sniff(output),
        "output": str(output),
    }
    if verified is not None:
        result["verified"] = verified.as_dict()
    if json:
        print_json(result)
    else:
        print_facts(str(output), result)
