"""The error budget as a table on the terminal and as JSON: `geoposition info --budget`."""

from __future__ import annotations

from collections.abc import Sequence

from geoposition.error_budget import image_budget, pair_budget
from geoposition.errors import GeometryError
from geoposition.product import Product


def budgets(product: Product, others: Sequence[Product]) -> dict[str, object]:
    """Budget of one image, and of its intersection with others where there are some."""
    facts: dict[str, object] = {"budget": image_budget(product.model).as_dict()}
    if others:
        every = [product, *others]
        names = ", ".join(item.path.name for item in every)
        try:
            pair = pair_budget([item.model for item in every])
        except GeometryError as error:
            raise GeometryError(f"{names}: {error}") from None
        facts["pair_products"] = [str(item.path) for item in every]
        facts["pair_budget"] = pair.as_dict()
    return facts


def print_budget(title: str, budget: dict[str, object]) -> None:
    """Print the lines of a budget."""
    from rich.console import Console
    from rich.table import Table

    lines = budget["lines"]
    assert isinstance(lines, list)
    several = budget["images"] != 1
    table = Table(title=title, title_justify="left", box=None)
    if several:
        table.add_column("image", no_wrap=True)
    table.add_column("error", no_wrap=True)
    table.add_column("of")
    for name in ("east m", "north m", "up m", "plan m", "most m"):
        table.add_column(name, justify="right")
    for line in lines:
        numbers = [*line["enu_m"], line["horizontal_m"], line["most_m"]]
        cells = [line["cause"], line["unit"], *(f"{value:+.4f}" for value in numbers)]
        table.add_row(*([str(line["image"])] if several else []), *cells)
    Console().print(table)
