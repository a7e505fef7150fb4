"""`geoposition info`: what a product is and how it will be treated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[Path, typer.Argument(help="Product: metadata file, folder, RPC, model.")],
    budget: Annotated[
        bool, typer.Option("--budget", help="What a unit of each error does on the ground.")
    ] = False,
    pair: Annotated[
        list[Path] | None,
        typer.Option(help="Another product (again for more): the budget of intersected points."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Show sensor, times, footprint, ground sample, frames and corrections in force.

    With --budget also how far located points move, at constant height, for 1″ about each axis
    of body and orbit, 1 m of the satellite's place, 1 ms, 1 px and 1 m of the surface's height.
    An RPC has pixels and height alone. With --pair the same for points intersected from both.

    Example: geoposition info DIM_PHR1A.XML --budget
    """
    from geoposition.errors import ArgumentError
    from geoposition.scripts.budget import budgets, print_budget
    from geoposition.scripts.describe import describe, outline
    from geoposition.scripts.results import print_facts, print_json
    from geoposition.sensors.readers import open_product

    if pair and not budget:
        raise ArgumentError("--pair: with --budget only")
    opened = open_product(product)
    facts = describe(opened)
    found = budgets(opened, [open_product(other) for other in pair or []]) if budget else {}
    if json:
        print_json(facts | found)
        return
    print_facts(str(product), facts | {"footprint": outline(facts)})
    for name in ("budget", "pair_budget"):
        lines = found.get(name)
        if isinstance(lines, dict):
            title = "located points" if name == "budget" else "intersected points"
            print_budget(f"error budget of {title}", lines)
