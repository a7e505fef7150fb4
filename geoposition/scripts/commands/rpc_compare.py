"""`geoposition rpc compare`: two models of one image, in pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[Path, typer.Argument(help="The reference: any product.")],
    other: Annotated[
        Path | None, typer.Argument(help="The other model; the RPC that came with the product.")
    ] = None,
    heights: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Lowest and highest ellipsoidal height, metres; the other's range."),
    ] = None,
    grid: Annotated[
        tuple[int, int, int], typer.Option(help="Nodes in lines, samples and heights.")
    ] = (21, 21, 5),
    json: JsonOption = False,
) -> None:
    """Compare OTHER with PRODUCT, in pixels: OTHER − PRODUCT on a 3-D grid.

    Pixels of the grid are located with PRODUCT at each height and projected with OTHER.

    Example: geoposition rpc compare DIM_PHR1A.XML
    """
    from geoposition.scripts import rpc_compare_run
    from geoposition.scripts.results import print_facts, print_json

    _, result = rpc_compare_run.run(product, other, heights, grid)
    if json:
        print_json(result)
    else:
        print_facts(f"{result['other']} − {product}, pixels", result)
