"""Which reader takes which control file: by its ending."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from geoposition.errors import UnsupportedError
from geoposition.scripts.control_files.asp import read_asp
from geoposition.scripts.control_files.columns import read_columns
from geoposition.scripts.control_files.parts import ControlFile
from geoposition.scripts.control_files.qgis import read_points
from geoposition.scripts.control_files.vector import SUFFIXES as VECTORS
from geoposition.scripts.control_files.vector import read_vector
from geoposition.sensors.readers.table_file import PARQUET_SUFFIXES

_TABLES: Final = (".csv", ".txt", ".gz", *sorted(PARQUET_SUFFIXES))
SUFFIXES: Final = (*_TABLES, *VECTORS, ".gcp", ".points")


def read_control_file(path: Path, crs: str | None = None) -> ControlFile:
    """Read control from `path`; `crs` overrides what the file says of its system."""
    suffix = path.suffix.lower()
    if suffix == ".gcp":
        return read_asp(path, crs)
    if suffix == ".points":
        return read_points(path, crs)
    if suffix in VECTORS:
        return read_vector(path, crs)
    if suffix in _TABLES:
        return read_columns(path, crs)
    raise UnsupportedError(path, "name", f"one of {', '.join(SUFFIXES)} expected as its ending")
