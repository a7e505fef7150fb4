"""Tables to files, CSV (gzipped by extension) or Parquet, that appear whole or not at all."""

from __future__ import annotations

import gzip
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from numpy.typing import NDArray

from geoposition.sensors.readers.table_file import PARQUET_SUFFIXES

Column: TypeAlias = NDArray[np.str_] | NDArray[np.float64] | NDArray[np.int64]


def write_table(path: Path, columns: Mapping[str, Column]) -> None:
    """Write `columns` to `path` as CSV or Parquet; NaN becomes an empty cell."""
    table = arrow_table(columns)
    with whole_file(path) as temporary:
        if path.suffix.lower() in PARQUET_SUFFIXES:
            pa_parquet.write_table(table, temporary)
            return
        zipped = path.suffix.lower() == ".gz"
        with gzip.open(temporary, "wb") if zipped else temporary.open("wb") as file:
            file.write((",".join(table.column_names) + "\n").encode())
            style = "needed" if _needs_quotes(columns) else "none"
            pa_csv.write_csv(
                table, file, pa_csv.WriteOptions(include_header=False, quoting_style=style)
            )


def arrow_table(columns: Mapping[str, Column]) -> pa.Table:
    """Return `columns` as an Arrow table; NaN becomes null."""
    arrays = {}
    for name, values in columns.items():
        if values.dtype.kind == "f":
            arrays[name] = pa.array(values, from_pandas=True)
        elif values.dtype.kind == "U":
            arrays[name] = pa.array(values.tolist(), pa.string())
        else:
            arrays[name] = pa.array(values)
    return pa.table(arrays)


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


def _needs_quotes(columns: Mapping[str, Column]) -> bool:
    """Tell whether some text holds what separates cells; Arrow would quote every text."""
    texts = [values.astype(np.str_) for values in columns.values() if values.dtype.kind == "U"]
    return any(np.any(np.strings.find(values, mark) >= 0) for values in texts for mark in ',"\r\n')
