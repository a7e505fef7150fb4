"""Untrusted TOML, and the tables it names: read by key, and no key may stay unread.

Every miss is a `ProductError` that names the file and the key.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import MissingFileError, ProductError
from geoposition.named_files import is_there
from geoposition.timescale import Epoch

MAX_TOML_BYTES = 16 * 2**20
MAX_TABLE_BYTES = 1024 * 2**20


@dataclass(frozen=True, slots=True)
class TomlNode:
    """One table of the file; `place` is the path of its keys. `asked` collects the keys read."""

    path: Path
    place: str
    data: dict[str, Any]
    asked: set[str] = field(default_factory=set)

    def at(self, key: str) -> str:
        """Full path of `key`, for messages."""
        return f"{self.place}.{key}" if self.place else key

    def refuse(self, key: str, expected: str) -> NoReturn:
        """Raise a `ProductError` about `key`."""
        raise ProductError(self.path, self.at(key), expected)

    def has(self, key: str) -> bool:
        """Whether `key` is there."""
        return key in self.data

    def need(self, key: str) -> Any:
        """Value of `key`, of any type."""
        self.asked.add(key)
        if key not in self.data:
            self.refuse(key, "this key is missing")
        return self.data[key]

    def finish(self) -> None:
        """Refuse keys that nobody asked for: they are misspelt, or from a later version."""
        unknown = sorted(set(self.data) - self.asked)
        if unknown:
            known = ", ".join(sorted(self.asked))
            self.refuse(unknown[0], f"there is no such key; known here: {known}")

    def child(self, key: str) -> TomlNode:
        """Table under `key`."""
        value = self.need(key)
        if not isinstance(value, dict):
            self.refuse(key, "a table expected")
        return TomlNode(self.path, self.at(key), value)

    def children(self, key: str) -> list[TomlNode]:
        """Tables of the array of tables `key`, at least one."""
        value = self.need(key)
        if not (isinstance(value, list) and value and all(isinstance(v, dict) for v in value)):
            self.refuse(key, f"one or more tables [[{self.at(key)}]] expected")
        return [TomlNode(self.path, f"{self.at(key)}[{i}]", v) for i, v in enumerate(value)]

    def text(self, key: str, default: str | None = None) -> str:
        """Text under `key`."""
        if default is not None and not self.has(key):
            self.asked.add(key)
            return default
        value = self.need(key)
        if not isinstance(value, str):
            self.refuse(key, "a string expected")
        return str(value)

    def choice(self, key: str, *allowed: str) -> str:
        """One of the strings `allowed` under `key`."""
        value = self.text(key)
        if value not in allowed:
            self.refuse(key, f"one of {', '.join(allowed)} expected, got {value[:40]!r}")
        return value

    def flag(self, key: str, default: bool = False) -> bool:
        """Boolean under `key`."""
        self.asked.add(key)
        value = self.data.get(key, default)
        if not isinstance(value, bool):
            self.refuse(key, "true or false expected")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Finite number under `key`."""
        if default is not None and not self.has(key):
            self.asked.add(key)
            return default
        return self._finite(key, self.need(key))

    def _finite(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(key, "a number expected")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.refuse(key, "a finite number expected")
        return number

    def whole(self, key: str, low: int, high: int = 2**31 - 1) -> int:
        """Whole number from `low` to `high` under `key`."""
        value = self.need(key)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            self.refuse(key, f"a whole number from {low} to {high} expected")
        return int(value)

    def numbers(self, key: str, count: int | None = None) -> FloatArray:
        """List of finite numbers under `key`, `count` of them or at least one."""
        value = self.need(key)
        wanted = "a list of numbers" if count is None else f"a list of {count} numbers"
        if not isinstance(value, list) or not value or count not in (None, len(value)):
            self.refuse(key, f"{wanted} expected")
        return np.array([self._finite(f"{key}[{i}]", item) for i, item in enumerate(value)])

    def epoch(self) -> Epoch:
        """Epoch: `epoch_utc`, or exactly `epoch_tai_s` with `epoch_fraction`."""
        if self.has("epoch_utc"):
            try:
                return Epoch.from_utc(self.text("epoch_utc"))
            except ValueError as error:
                self.refuse("epoch_utc", str(error))
        if not self.has("epoch_tai_s"):
            self.refuse("epoch_utc", "this key, or epoch_tai_s, is missing")
        whole = self.whole("epoch_tai_s", -(2**40), 2**40)
        fraction = self.number("epoch_fraction", 0.0)
        if not 0.0 <= fraction < 1.0:
            self.refuse("epoch_fraction", "a number from 0 to below 1 expected")
        return Epoch(whole, fraction)

    def table(self, key: str, *columns: str, rows: int = 1) -> FloatArray:
        """Numbers (n, columns) of the CSV table named under `key`, with that header."""
        return read_table(self.inside(key), columns, rows)

    def inside(self, key: str) -> Path:
        """File named under `key`, which must lie in the folder of this one."""
        name = self.text(key)
        pure = PurePosixPath(name)
        bad = not name or "\\" in name or ":" in name or "\0" in name
        if bad or pure.is_absolute() or ".." in pure.parts:
            self.refuse(key, "a path within this file's folder expected")
        folder = self.path.parent.resolve()
        try:
            path = (folder / pure).resolve()
        except (OSError, RuntimeError):
            self.refuse(key, "a path within this file's folder expected")
        if not path.is_relative_to(folder):
            self.refuse(key, "a path within this file's folder expected")
        if not is_there(path):
            raise MissingFileError(self.path, self.at(key), f"there is no file {name}")
        return path


def read_toml(path: Path) -> TomlNode:
    """Read the file's root table; `ProductError` (`MissingFileError`) where it cannot be."""
    try:
        if path.stat().st_size > MAX_TOML_BYTES:
            raise ProductError(path, "", f"a file below {MAX_TOML_BYTES} bytes expected")
        return TomlNode(path, "", tomllib.loads(path.read_bytes().decode("utf-8-sig")))
    except FileNotFoundError:
        raise MissingFileError(path, "", "there is no such file") from None
    except OSError as error:
        raise ProductError(path, "", f"a readable file expected ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ProductError(path, "", "TOML in UTF-8 expected") from None
    except RecursionError:
        raise ProductError(path, "", "TOML nested too deeply") from None
    except ValueError as error:
        raise ProductError(path, "", f"well-formed TOML expected ({error})") from None


def read_table(path: Path, columns: tuple[str, ...], rows: int = 1) -> FloatArray:
    """Numbers (n, columns) of a CSV file with the header `columns`, n >= `rows`."""
    if path.stat().st_size > MAX_TABLE_BYTES:
        raise ProductError(path, "", f"a file below {MAX_TABLE_BYTES} bytes expected")
    try:
        lines = path.read_bytes().decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ProductError(path, "", "CSV in UTF-8 expected") from None
    header = tuple(name.strip() for name in lines[0].split(",")) if lines else ()
    if header != columns:
        raise ProductError(
            path,
            "line 1",
            f"the header {','.join(columns)} expected, got {','.join(header)[:60]!r}",
        )
    table = np.empty((len(lines) - 1, len(columns)))
    count = 0
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(columns):
            raise ProductError(
                path, f"line {number}", f"{len(columns)} numbers expected, got {len(cells)}"
            )
        try:
            table[count] = [float(cell) for cell in cells]
        except ValueError:
            raise ProductError(path, f"line {number}", "numbers expected") from None
        if not np.all(np.isfinite(table[count])):
            raise ProductError(path, f"line {number}", "finite numbers expected")
        count += 1
    if count < rows:
        raise ProductError(path, "", f"{rows} rows or more expected, got {count}")
    return table[:count]
