"""Tables as files: CSV, gzipped CSV or Parquet, loaded as columns of text or numbers.

Lines before the table that begin with `#` are remarks; a table whose header is the last of them
is understood. Cells are converted on request, either softly (no number becomes NaN) or strictly
(refused, with the file, the line and the column).
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from numpy.typing import NDArray

from geoposition.arrays import FloatArray
from geoposition.errors import MissingFileError, ProductError

PARQUET_SUFFIXES = {".parquet", ".pq"}
_MAX_HEADER_BYTES = 1 << 20
_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?$"


@dataclass(frozen=True, slots=True)
class TableFile:
    """A loaded table; `remarks` are the texts after `#`, `first_line` the file's of row 0."""

    path: Path
    columns: pa.Table
    remarks: tuple[str, ...] = ()
    first_line: int = 2

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self.columns.column_names)

    def __len__(self) -> int:
        return int(self.columns.num_rows)

    def place(self, row: int, column: str) -> str:
        """Where a cell stands, for messages: the line of a CSV file, the row of a Parquet one."""
        if self.path.suffix.lower() in PARQUET_SUFFIXES:
            return f"row {row + 1}, column {column}"
        return f"line {row + self.first_line}, column {column}"

    def refuse(self, row: int, column: str, expected: str) -> NoReturn:
        """Raise a `ProductError` about one cell."""
        raise ProductError(self.path, self.place(row, column), expected)

    def require(self, names: Sequence[str], optional: Sequence[str] = ()) -> None:
        """Refuse a table without all columns `names`, or without rows."""
        missing = [name for name in names if name not in self.names]
        if missing:
            known = ", ".join([*names, *(f"[{name}]" for name in optional)])
            raise ProductError(
                self.path, "header", f"column(s) {', '.join(missing)} missing; {known} expected"
            )
        if not len(self):
            raise ProductError(self.path, "", "no points: the table has a header only")

    def text(self, name: str) -> NDArray[np.str_]:
        """Cells of one column as text."""
        text = pc.fill_null(self.columns[name].cast(pa.string()), "")
        return np.asarray(text.to_numpy(zero_copy_only=False), dtype=np.str_)

    def numbers(self, name: str) -> FloatArray:
        """Cells of one column as numbers; what is empty or no number is NaN."""
        return _numbers(self.columns[name])

    def strict(self, name: str) -> FloatArray:
        """Cells of one column as finite numbers; anything else is refused."""
        values = self.numbers(name)
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            row = int(bad[0])
            cell = str(self.columns[name][row].as_py() or "")
            self.refuse(row, name, f"a finite number expected, got {cell[:30]!r}")
        return values

    def remark(self, key: str) -> str | None:
        """Value of a remark such as `# frame: itrs` or `frame=itrs`, where there is one."""
        for line in self.remarks:
            found = re.search(rf"(?:^|[\s,;]){re.escape(key)}\s*[:=]\s*([^\s,;]+)", line, re.I)
            if found:
                return found[1]
        return None


def load_table(path: Path) -> TableFile:
    """Load the table at `path`; anything that is none is a `ProductError`."""
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    if not path.stat().st_size:
        raise ProductError(path, "", "a table expected, the file is empty")
    try:
        if path.suffix.lower() in PARQUET_SUFFIXES:
            return TableFile(path, pa_parquet.read_table(path))
        return _load_csv(path)
    except UnicodeDecodeError:
        raise ProductError(path, "header", "a text table in UTF-8 expected") from None
    except (gzip.BadGzipFile, EOFError):
        raise ProductError(path, "", "a whole gzip file expected") from None
    except pa.ArrowInvalid as error:
        if "Empty CSV" in str(error):
            raise ProductError(path, "", "no points: the table has a header only") from None
        raise ProductError(path, "", f"a readable table expected ({error})") from None


def _load_csv(path: Path) -> TableFile:
    zipped = path.suffix.lower() == ".gz"
    remarks: list[str] = []
    with gzip.open(path, "rb") if zipped else path.open("rb") as file:
        before = file.readline(_MAX_HEADER_BYTES).decode("utf-8-sig")
        skipped = 1
        while before.startswith("#"):
            remarks.append(before[1:].strip())
            before = file.readline(_MAX_HEADER_BYTES).decode("utf-8")
            skipped += 1
    names = _cells(before)
    if remarks and re.match(_NUMBER, names[0]) and len(_cells(remarks[-1])) == len(names):
        names = _cells(remarks.pop())
        skipped -= 1
    if len(set(names)) != len(names):
        raise ProductError(path, "header", "each column once expected")
    # All cells as text: a stray word must not decide the type of a column.
    read = pa_csv.ReadOptions(column_names=names, skip_rows=skipped)
    convert = pa_csv.ConvertOptions(
        column_types={name: pa.string() for name in names}, strings_can_be_null=False
    )
    # Arrow unzips .gz by name.
    columns = pa_csv.read_csv(path, read_options=read, convert_options=convert)
    return TableFile(path, columns, tuple(remarks), skipped + 1)


def _cells(line: str) -> list[str]:
    return [name.strip().strip('"') for name in line.rstrip("\r\n").split(",")]


def _numbers(column: pa.ChunkedArray) -> FloatArray:
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        text = pc.utf8_trim_whitespace(column)
        good = pc.match_substring_regex(text, _NUMBER)
        text = pc.replace_substring_regex(text, r"^\+", "")
        column = pc.if_else(good, text, pa.scalar(None, pa.string())).cast(pa.float64())
    elif pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        column = column.cast(pa.float64())
    else:
        return np.full(len(column), np.nan)
    values = pc.fill_null(column, np.nan).to_numpy(zero_copy_only=False)
    return np.asarray(values, dtype=np.float64)
