"""Tables of points, in and out: CSV, or Parquet by extension; vectors as GeoJSON, GeoPackage.

Outputs appear whole or not at all: they are written beside their place, then moved there.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from numpy.typing import NDArray

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, MissingFileError, ProductError

PARQUET_SUFFIXES = {".parquet", ".pq"}
VECTOR_DRIVERS = {".geojson": "GeoJSON", ".json": "GeoJSON", ".gpkg": "GPKG"}

Column = NDArray[np.str_] | NDArray[np.float64] | NDArray[np.int64]


def read_table(
    path: Path, numbers: Sequence[str], optional: Sequence[str] = (), texts: Sequence[str] = ("id",)
) -> dict[str, Column]:
    """Read the columns `texts`, `numbers` and, where there, `optional` numbers of a table.

    A cell that is empty or no number becomes NaN, so that its point is flagged and the others
    live; a missing column, or a row of the wrong length, is a `ProductError`.
    """
    table = _load(path)
    missing = [name for name in (*texts, *numbers) if name not in table.column_names]
    if missing:
        raise ProductError(
            path,
            "header",
            f"column(s) {', '.join(missing)} missing; "
            f"{', '.join([*texts, *numbers, *(f'[{name}]' for name in optional)])} expected",
        )
    if not table.num_rows:
        raise ProductError(path, "", "no points: the table has a header only")
    columns: dict[str, Column] = {}
    for name in texts:
        text = pc.fill_null(table[name].cast(pa.string()), "")
        columns[name] = np.asarray(text.to_numpy(zero_copy_only=False), dtype=np.str_)
    for name in (*numbers, *(name for name in optional if name in table.column_names)):
        columns[name] = _numbers(table[name])
    return columns


def _load(path: Path) -> pa.Table:
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    if not path.stat().st_size:
        raise ProductError(path, "", "a table expected, the file is empty")
    try:
        if path.suffix.lower() in PARQUET_SUFFIXES:
            return pa_parquet.read_table(path)
        with path.open("rb") as file:
            header = file.readline(1 << 20).decode("utf-8-sig")
        names = [name.strip().strip('"') for name in header.rstrip("\r\n").split(",")]
        if len(set(names)) != len(names):
            raise ProductError(path, "header", "each column once expected")
        # All cells as text: a stray word must not decide the type of a column.
        return pa_csv.read_csv(
            path,
            read_options=pa_csv.ReadOptions(column_names=names, skip_rows=1),
            convert_options=pa_csv.ConvertOptions(
                column_types={name: pa.string() for name in names}, strings_can_be_null=False
            ),
        )
    except UnicodeDecodeError:
        raise ProductError(path, "header", "a text table in UTF-8 expected") from None
    except pa.ArrowInvalid as error:
        if "Empty CSV" in str(error):
            raise ProductError(path, "", "no points: the table has a header only") from None
        raise ProductError(path, "", f"a readable table expected ({error})") from None


def _numbers(column: pa.ChunkedArray) -> FloatArray:
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        text = pc.utf8_trim_whitespace(column)
        number = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?$"
        good = pc.match_substring_regex(text, number)
        text = pc.replace_substring_regex(text, r"^\+", "")
        column = pc.if_else(good, text, pa.scalar(None, pa.string())).cast(pa.float64())
    elif pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        column = column.cast(pa.float64())
    else:
        return np.full(len(column), np.nan)
    values = pc.fill_null(column, np.nan).to_numpy(zero_copy_only=False)
    return np.asarray(values, dtype=np.float64)


def write_table(path: Path, columns: Mapping[str, Column]) -> None:
    """Write `columns` to `path` as CSV or Parquet; NaN becomes an empty cell."""
    table = _arrow(columns)
    with whole_file(path) as temporary:
        if path.suffix.lower() in PARQUET_SUFFIXES:
            pa_parquet.write_table(table, temporary)
        else:
            with temporary.open("wb") as file:
                file.write((",".join(table.column_names) + "\n").encode())
                style = "needed" if _needs_quotes(columns) else "none"
                pa_csv.write_csv(
                    table, file, pa_csv.WriteOptions(include_header=False, quoting_style=style)
                )


def _needs_quotes(columns: Mapping[str, Column]) -> bool:
    """Tell whether some text holds what separates cells; Arrow would quote every text."""
    texts = [values.astype(np.str_) for values in columns.values() if values.dtype.kind == "U"]
    return any(np.any(np.strings.find(values, mark) >= 0) for values in texts for mark in ',"\r\n')


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
    table = _arrow({name: values[kept] for name, values in columns.items()})
    geometry = pa.array(shapely.to_wkb(shapely.points(xyz)), pa.binary())
    table = table.append_column("geometry", geometry)
    with whole_file(path) as temporary:
        pyogrio.write_arrow(
            table,
            temporary,
            driver=driver,
            geometry_name="geometry",
            geometry_type="Point Z",
            crs="EPSG:4979",
            layer=path.stem,
        )


def _arrow(columns: Mapping[str, Column]) -> pa.Table:
    arrays = {}
    for name, values in columns.items():
        if values.dtype.kind == "f":
            arrays[name] = pa.array(values, from_pandas=True)
        elif values.dtype.kind == "U":
            arrays[name] = pa.array(values.tolist(), pa.string())
        else:
            arrays[name] = pa.array(values)
    return pa.table(arrays)


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


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it takes the place of `path`."""
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    temporary.unlink()
    try:
        yield temporary
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
