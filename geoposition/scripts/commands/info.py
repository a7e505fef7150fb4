"""`geoposition info`: what a product is and how it will be treated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    product: Annotated[Path, typer.Argument(help="Product: metadata file, folder, RPC, model.")],
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Show sensor, times, footprint, ground sample, frames and corrections in force.

    Example: geoposition info DIM_PHR1A.XML
    """
    from geoposition.scripts.describe import describe
    from geoposition.scripts.results import print_facts, print_json
    from geoposition.sensors.readers import open_product

    facts = describe(open_product(product))
    if json:
        print_json(facts)
    else:
        print_facts(str(product), facts)
