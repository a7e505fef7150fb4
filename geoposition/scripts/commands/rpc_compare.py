"""`geoposition rpc compare`: two models of one image, in pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


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
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Compare OTHER with PRODUCT, in pixels: OTHER − PRODUCT on a 3-D grid.

    Pixels of the grid are located with PRODUCT at each height and projected with OTHER.

    Example: geoposition rpc compare DIM_PHR1A.XML
    """
    import numpy as np

    from geoposition.errors import ProductError
    from geoposition.rpc.compare import compare
    from geoposition.rpc.model import RpcModel
    from geoposition.scripts.results import print_facts, print_json
    from geoposition.sensors.readers import open_product

    reference = open_product(product)
    if other is not None:
        model = open_product(other).model
    elif reference.vendor_rpc is None:
        raise ProductError(product, "", "no RPC came with this product: name the OTHER model")
    elif not reference.is_rigorous:
        raise ProductError(product, "", "the product is an RPC itself: name the OTHER model")
    else:
        model = reference.vendor_rpc
    levels = None if heights is None else np.linspace(*heights, grid[2])
    fitted = model.height_range_m if isinstance(model, RpcModel) else (-np.inf, np.inf)
    beyond = [h for h in heights or () if not fitted[0] - 1.0 <= h <= fitted[1] + 1.0]
    found = compare(reference.model, model, heights_m=levels, grid=grid)
    result: dict[str, object] = found.as_dict() | {
        "product": str(product),
        "other": str(other or "vendor RPC"),
    }
    if beyond:
        low, high = fitted
        result["warning"] = f"heights outside {low:g} .. {high:g} m, which the RPC was fitted to"
    if json:
        print_json(result)
    else:
        print_facts(f"{result['other']} − {product}, pixels", result)
