"""Tables of points, in and out: CSV, or Parquet by extension; vectors as GeoJSON, GeoPackage.

Outputs appear whole or not at all: they are written beside their place, then moved there. The
files themselves are the affair of `sensors.readers.table_file` and `sensors.writers.table_file`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from geoposition.errors import ArgumentError, MissingFileError, ProductError
from geoposition.sensors.readers.table_file import PARQUET_SUFFIXES, load_table
from geoposition.sensors.writers.table_file import Column, arrow_table, whole_file, write_table

__all__ = [
    "PARQUET_SUFFIXES",
    "VECTOR_DRIVERS",
    "Column",
    "check_output",
    "read_table",
    "whole_file",
    "write_points",
    "write_table",
]

_DATE: Final = "OGR_CURRENT_DATE"
VECTOR_DRIVERS = {".geojson": "GeoJSON", ".json": "GeoJSON", ".gpkg": "GPKG"}


def read_table(
    path: Path, numbers: Sequence[str], optional: Sequence[str] = (), texts: Sequence[str] = ("id",)
) -> dict[str, Column]:
    """Read the columns `texts`, `numbers` and, where there, `optional` numbers of a table.

    A cell that is empty or no number becomes NaN, so that its point is flagged and the others
    live; a missing column, or a row of the wrong length, is a `ProductError`.
    """
    table = load_table(path)
    table.require((*texts, *numbers), optional)
    columns: dict[str, Column] = {name: table.text(name) for name in texts}
    for name in (*numbers, *(name for name in optional if name in table.names)):
        columns[name] = table.numbers(name)
    return columns


def write_points(path: Path, columns: Mapping[str, Column]) -> None:
    """Write a table with columns lon, lat, height; as vector points where the suffix says so."""
    driver = VECTOR_DRIVERS.get(path.suffix.lower())
    if driver is None:
        write_table(path, columns)
        return
    import pyogrio
    import shapely

    kept = np.isfinite(columns["lon"])
    xyz = np.stack([np.asarray(columns[name])[kept] for name in ("lon", "lat", "height")], axis=1)
    table = arrow_table({name: values[kept] for name, values in columns.items()})
    geometry = pa.array(shapely.to_wkb(shapely.points(xyz)), pa.binary())
    table = table.append_column("geometry", geometry)
    with whole_file(path) as temporary, _undated():
        pyogrio.write_arrow(
            table,
            temporary,
            driver=driver,
            geometry_name="geometry",
            geometry_type="Point Z",
            crs="EPSG:4979",
            layer=path.stem,
        )


@contextmanager
def _undated() -> Iterator[None]:
    """Let GeoPackages carry no time of writing: the same table is the same bytes."""
    import pyogrio

    before = pyogrio.get_gdal_config_option(_DATE)
    pyogrio.set_gdal_config_options({_DATE: before or "1970-01-01T00:00:00Z"})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({_DATE: before})


def check_output(path: Path, suffixes: Sequence[str] = ()) -> None:
    """Refuse an output path that cannot be written, before any work is done."""
    if path.is_dir():
        raise ProductError(path, "", "a file name for the output expected, this is a folder")
    if not path.parent.is_dir():
        raise MissingFileError(path.parent, "", "the output's folder does not exist")
    if not os.access(path.parent, os.W_OK):
        raise ProductError(path.parent, "", "the output's folder is not writable")
    if suffixes and path.suffix.lower() not in suffixes:
        raise ArgumentError(f"{path}: one of {', '.join(sorted(suffixes))} expected as its ending")
