"""Tie points and ground control as tables: id,product,row,col and id,lon,lat,height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.errors import ArgumentError, ProductError
from geoposition.observations import TiePoints
from geoposition.scripts.point_tables import geodetic_of
from geoposition.scripts.tables import Column, read_table


def read_ties(path: Path, products: Sequence[Path]) -> TiePoints:
    """Read id,product,row,col: one row per image point.

    `product` names a product as on the command line, by its file name or stem, or by its place
    there, counted from 0.
    """
    table = read_table(path, ("row", "col"), texts=("id", "product"))
    image = np.stack([table["row"], table["col"]], axis=1).astype(np.float64)
    try:
        return TiePoints(
            np.asarray(table["id"], dtype=np.str_),
            _product_numbers(path, table["product"], products),
            image,
        )
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from None


def _product_numbers(path: Path, names: Column, products: Sequence[Path]) -> IntArray:
    numbers: dict[str, int] = {}
    for spelled in (lambda p: p.stem, lambda p: p.name, str):
        seen: dict[str, list[int]] = {}
        for i, product in enumerate(products):
            seen.setdefault(spelled(product), []).append(i)
        numbers |= {name: where[0] for name, where in seen.items() if len(where) == 1}
    numbers = {str(i): i for i in range(len(products))} | numbers
    unique, inverse = np.unique(
        np.char.strip(np.asarray(names, dtype=np.str_)), return_inverse=True
    )
    unknown = [name for name in unique if name not in numbers]
    if unknown:
        known = ", ".join(dict.fromkeys([*map(str, range(len(products))), *map(str, products)]))
        raise ProductError(path, f"product {str(unknown[0])!r}", f"one of these expected: {known}")
    found: IntArray = np.array([numbers[name] for name in unique], dtype=np.int64)[inverse]
    return found


@dataclass(frozen=True, slots=True)
class Checks:
    """Known ground points: `ids` (n,), `geodetic` (n, 3)."""

    ids: Column
    geodetic: FloatArray


def read_checks(path: Path) -> Checks:
    """Read id,lon,lat,height; each id once, all numbers good."""
    table = read_table(path, ("lon", "lat", "height"))
    geodetic = geodetic_of(table)
    bad = np.flatnonzero(~np.isfinite(geodetic).all(axis=1))
    if len(bad):
        raise ProductError(path, f"point {table['id'][bad[0]]}", "lon, lat, height expected")
    ids, counts = np.unique(table["id"], return_counts=True)
    if counts.max() > 1:
        raise ProductError(path, f"point {ids[np.argmax(counts)]}", "each point once expected")
    return Checks(table["id"], geodetic)


def common(ids: Column, checks: Checks) -> tuple[IntArray, IntArray]:
    """Return the rows of `ids` and of `checks` that name the same points."""
    _, rows, check_rows = np.intersect1d(
        np.asarray(ids).astype(np.str_), checks.ids, return_indices=True
    )
    return rows, check_rows
