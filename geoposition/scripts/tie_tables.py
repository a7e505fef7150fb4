"""Tie points as tables or matches, and ground control that checks: by products' names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.errors import ArgumentError, ProductError
from geoposition.observations import TiePoints
from geoposition.scripts.control_files import (
    Heights,
    geodetic_of,
    is_match_file,
    read_control_file,
    read_match_file,
)
from geoposition.scripts.image_names import ImageNames
from geoposition.scripts.tables import PARQUET_SUFFIXES, Column, read_table, write_table

TIE_SUFFIXES: Final = (".csv", *sorted(PARQUET_SUFFIXES))
"""Endings of tables of ties that are written."""
_PIXEL_DIGITS: Final = 4
"""Decimals of written image points: far below what any measurement of them reaches."""


def read_ties(path: Path, products: Sequence[Path]) -> TiePoints:
    """Read id,product,row,col: one row per image point; or matches of a pair.

    `product` names a product as on the command line, by its file name or stem, or by its place
    there, counted from 0.
    """
    return read_named_ties(path, ImageNames.of_products(products))


def read_named_ties(
    path: Path, names: ImageNames, pair: tuple[int, int] | None = None
) -> TiePoints:
    """Read ties of images with these names; matches without names are those of `pair`."""
    if is_match_file(path):
        return TiePoints.of_pair(*read_match_file(path), products=pair or _pair_of(path, names))
    table = read_table(path, ("row", "col"), texts=("id", "product"))
    image = np.stack([table["row"], table["col"]], axis=1).astype(np.float64)
    try:
        return TiePoints(
            np.asarray(table["id"], dtype=np.str_),
            names.numbers_of(path, table["product"]),
            image,
        )
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from None


def _pair_of(path: Path, names: ImageNames) -> tuple[int, int]:
    """Images of a match file: those in its name, `run-LEFT__RIGHT.match`, or the only two."""
    known = names.numbers()
    left, mark, right = path.stem.partition("__")
    left_names = [name for name in known if name and left.endswith(name)]
    right_names = [name for name in known if name and right.startswith(name)]
    if mark and left_names and right_names:
        pair = known[max(left_names, key=len)], known[max(right_names, key=len)]
        if pair[0] != pair[1]:
            return pair
    if len(names.files) == 2:
        return 0, 1
    raise ProductError(path, "name", "two images, or a name LEFT__RIGHT that tells them, expected")


def write_ties(path: Path, tables: Sequence[TiePoints], names: Sequence[str]) -> None:
    """Write id,product,row,col of all `tables`; `names` are those of the images in order."""
    ids = [ties.ids.astype(np.str_) for ties in tables]
    products = [np.array(names, dtype=np.str_)[ties.product] for ties in tables]
    image = np.round(np.concatenate([ties.image_px for ties in tables]), _PIXEL_DIGITS)
    write_table(
        path,
        {
            "id": np.concatenate(ids),
            "product": np.concatenate(products),
            "row": image[:, 0],
            "col": image[:, 1],
        },
    )


def names_for(products: Sequence[Path]) -> list[str]:
    """Names for a table that tell `products` apart: stems, else file names, else places."""
    for spelled in ([path.stem for path in products], [path.name for path in products]):
        if len(set(spelled)) == len(products):
            return spelled
    return [str(k) for k in range(len(products))]


@dataclass(frozen=True, slots=True)
class Checks:
    """Known ground points: `ids` (n,), `geodetic` (n, 3)."""

    ids: Column
    geodetic: FloatArray


def read_checks(path: Path) -> Checks:
    """Read ground points of any control file; each id once, all numbers good."""
    ground = read_control_file(path).ground
    if ground is None:
        raise ProductError(path, "header", "column(s) lon, lat, height missing; they are expected")
    return Checks(ground.ids, geodetic_of(ground, Heights()))


def common(ids: Column, checks: Checks) -> tuple[IntArray, IntArray]:
    """Return the rows of `ids` and of `checks` that name the same points."""
    _, rows, check_rows = np.intersect1d(
        np.asarray(ids).astype(np.str_), checks.ids, return_indices=True
    )
    return rows, check_rows
