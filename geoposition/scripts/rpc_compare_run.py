"""Two models of one image compared: products opened, heights checked, facts by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geoposition.errors import ProductError
from geoposition.rpc.compare import Comparison, compare
from geoposition.rpc.model import RpcModel
from geoposition.sensors.readers import open_product

GRID = (21, 21, 5)
"""Nodes in lines, samples and heights, unless asked for others."""


def run(
    product: Path,
    other: Path | None = None,
    heights_m: tuple[float, float] | None = None,
    grid: tuple[int, int, int] = GRID,
) -> tuple[Comparison, dict[str, object]]:
    """Compare `other`, or the RPC that came with it, with the model of `product`.

    Returns the comparison and its facts, fit for JSON.
    """
    reference = open_product(product)
    if other is not None:
        model = open_product(other).model
    elif reference.vendor_rpc is None:
        raise ProductError(product, "", "no RPC came with this product: name the OTHER model")
    elif not reference.is_rigorous:
        raise ProductError(product, "", "the product is an RPC itself: name the OTHER model")
    else:
        model = reference.vendor_rpc
    levels = None if heights_m is None else np.linspace(*heights_m, grid[2])
    found = compare(reference.model, model, heights_m=levels, grid=grid)
    facts: dict[str, object] = found.as_dict() | {
        "product": str(product),
        "other": str(other or "vendor RPC"),
    }
    low, high = model.height_range_m if isinstance(model, RpcModel) else (-np.inf, np.inf)
    if any(not low - 1.0 <= height <= high + 1.0 for height in heights_m or ()):
        facts["warning"] = f"heights outside {low:g} .. {high:g} m, which the RPC was fitted to"
    return found, facts
