"""JSON of CSM descriptions: untrusted, asked for by key; a miss names the file and the key."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import MissingFileError, ProductError

LINE_SCANNER = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
MAX_JSON_BYTES = 512 * 2**20


@dataclass(frozen=True, slots=True)
class JsonNode:
    """One JSON object of a file; `place` is the path of its keys, for messages."""

    path: Path
    place: str
    data: dict[str, Any]

    def refuse(self, key: str, expected: str) -> NoReturn:
        """Raise a `ProductError` about `key`."""
        raise ProductError(self.path, self._at(key), expected)

    def _at(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key

    def has(self, key: str) -> bool:
        """Whether `key` is there and not null."""
        return self.data.get(key) is not None

    def need(self, key: str) -> Any:
        """Value of `key`, of any type."""
        if key not in self.data:
            self.refuse(key, "this key is missing")
        return self.data[key]

    def child(self, key: str) -> JsonNode:
        """Object under `key`."""
        value = self.need(key)
        if not isinstance(value, dict):
            self.refuse(key, f"an object expected, got {_shown(value)}")
        return JsonNode(self.path, self._at(key), value)

    def text(self, key: str, default: str | None = None) -> str:
        """Text under `key`; `default` where it is absent."""
        if default is not None and not self.has(key):
            return default
        value = self.need(key)
        if not isinstance(value, str):
            self.refuse(key, f"a string expected, got {_shown(value)}")
        return str(value)

    def number(self, key: str, default: float | None = None) -> float:
        """Finite number under `key`; `default` where it is absent."""
        if default is not None and not self.has(key):
            return default
        value = self.need(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(key, f"a number expected, got {_shown(value)}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.refuse(key, f"a finite number expected, got {_shown(value)}")
        return number

    def count(self, key: str) -> int:
        """Positive whole number under `key`."""
        value = self.number(key)
        if value != int(value) or not 1 <= value < 2**31:
            self.refuse(key, f"a positive whole number expected, got {value:g}")
        return int(value)

    def array(self, key: str, columns: int | None = None, rows: int | None = None) -> FloatArray:
        """Finite numbers under `key`: (n,), or (n, `columns`) where `columns` is given.

        `rows` prescribes n. A flat list is no table and a table no flat list.
        """
        value = self.need(key)
        shape = "a list of numbers" if columns is None else f"rows of {columns} numbers"
        if not isinstance(value, list):
            self.refuse(key, f"{shape} expected, got {_shown(value)}")
        flat = value
        if columns is not None:
            for i, row in enumerate(value):
                if not isinstance(row, list) or len(row) != columns:
                    self.refuse(f"{key}[{i}]", f"{columns} numbers expected, got {_shown(row)}")
            flat = [item for row in value for item in row]
        for i, item in enumerate(flat):
            if isinstance(item, bool) or not isinstance(item, int | float):
                at = f"[{i}]" if columns is None else f"[{i // columns}][{i % columns}]"
                self.refuse(f"{key}{at}", f"a number expected, got {_shown(item)}")
        try:
            table = np.array(flat, dtype=np.float64)
        except OverflowError:
            self.refuse(key, "finite numbers expected")
        if not np.all(np.isfinite(table)):
            self.refuse(
                key, f"finite numbers expected, entry {np.argmin(np.isfinite(table))} is not"
            )
        if columns is not None:
            table = table.reshape(-1, columns)
        if rows is not None and len(table) != rows:
            self.refuse(key, f"{rows} entries expected, got {len(table)}")
        return table


def _shown(value: object) -> str:
    """Short form of a wrong value for a one-line message."""
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")


def read_json(path: Path) -> tuple[str, JsonNode]:
    """First line before the object (a CSM model name, or "") and the object itself."""
    try:
        if path.stat().st_size > MAX_JSON_BYTES:
            raise ProductError(path, "", f"a file below {MAX_JSON_BYTES} bytes expected")
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise MissingFileError(path, "", "there is no such file") from None
    except UnicodeDecodeError:
        raise ProductError(path, "", "JSON in UTF-8 expected") from None
    except OSError as error:
        raise ProductError(path, "", f"a readable file expected ({error.strerror})") from None
    name = ""
    if not text.lstrip().startswith("{"):
        name, _, text = text.lstrip().partition("\n")
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except RecursionError:
        raise ProductError(path, "", "JSON nested too deeply") from None
    except ValueError as error:
        raise ProductError(path, "", f"whole and well-formed JSON expected ({error})") from None
    if not isinstance(data, dict):
        raise ProductError(path, "", "a JSON object expected")
    return name.strip(), JsonNode(path, "", data)
