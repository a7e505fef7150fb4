"""What RUN.toml may say: tables and keys, their other names, and what each expects.

Every key that is not known is refused with the nearest that is: a misspelt sigma must not fall
back to a default in silence.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn

from geoposition.errors import ProductError

TABLES: Final = {
    "image": ("images", "product", "products"),
    "control": ("gcp", "gcps"),
    "ties": ("tie", "matches", "tie_points"),
    "check": ("checks", "check_points"),
    "unknown": ("unknowns", "parameter", "parameters"),
    "heights": ("height", "terrain"),
    "robust": ("robustness",),
    "plan": ("planning",),
    "output": ("outputs",),
}
"""Tables of the file, with the names under which they are taken too."""


@dataclass(frozen=True, slots=True)
class Node:
    """One table of the file: its values by key, and where it stands for messages."""

    path: Path
    place: str
    values: Mapping[str, Any]

    def refuse(self, key: str, expected: str) -> NoReturn:
        """Raise a `ProductError` about one key."""
        where = f"{self.place} {key}".strip() if key else self.place
        raise ProductError(self.path, where, expected)

    def known(self, keys: Mapping[str, Sequence[str]]) -> Node:
        """Return the table with other names replaced; an unknown key is refused."""
        proper = {other: key for key, others in keys.items() for other in (key, *others)}
        found: dict[str, Any] = {}
        for given, value in self.values.items():
            key = proper.get(given.lower())
            if key is None:
                near = difflib.get_close_matches(given.lower(), list(proper), 1, 0.5)
                hint = f"did you mean {proper[near[0]]}? " if near else ""
                self.refuse(given, f"no such key; {hint}known: {', '.join(keys)}")
            if key in found:
                self.refuse(given, f"given twice: it is another name of {key}")
            found[key] = value
        return Node(self.path, self.place, found)

    def has(self, key: str) -> bool:
        """Whether the key is there."""
        return key in self.values

    def file(self, key: str) -> Path | None:
        """Path of a file that exists, relative to the RUN.toml; None where the key is absent."""
        value = self.text(key)
        if value is None:
            return None
        path = self.path.parent / Path(value).expanduser()
        if not path.exists():
            self.refuse(key, f"an existing file expected, there is no {path}")
        return path

    def text(self, key: str) -> str | None:
        """One text."""
        value = self.values.get(key)
        if value is not None and (not isinstance(value, str) or not value.strip()):
            self.refuse(key, f"a text expected, got {value!r}")
        return value

    def texts(self, key: str) -> tuple[str, ...] | None:
        """One text or a list of texts; numbers are taken as texts."""
        value = self.values.get(key)
        if value is None:
            return None
        several = value if isinstance(value, list) else [value]
        if not all(isinstance(v, str) or (type(v) is int) for v in several):
            self.refuse(key, f"a text or a list of texts expected, got {value!r}")
        return tuple(str(v) for v in several)

    def flag(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self.values.get(key, default)
        if not isinstance(value, bool):
            self.refuse(key, f"true or false expected, got {value!r}")
        return value

    def number(self, key: str, default: float | None = None) -> float | None:
        """One positive number."""
        value = self.values.get(key, default)
        if value is None:
            return None
        return self._number(key, value)

    def numbers(self, key: str, count: int) -> tuple[float, ...] | None:
        """One positive number or `count` of them."""
        value = self.values.get(key)
        if value is None:
            return None
        several = value if isinstance(value, list) else [value]
        if len(several) not in (1, count):
            self.refuse(key, f"one number or a list of {count} expected, got {len(several)}")
        found = tuple(self._number(key, v) for v in several)
        return found if len(found) == count else found * count

    def _number(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self.refuse(key, f"a number expected, got {value!r}")
        if not 0.0 < value < float("inf"):
            self.refuse(key, f"a positive number expected, got {value!r}")
        return float(value)

    def integer(self, key: str, default: int | None, low: int, high: int) -> int | None:
        """One integer from `low` to `high`."""
        value = self.values.get(key, default)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            self.refuse(key, f"an integer from {low} to {high} expected, got {value!r}")
        return value

    def choice(self, key: str, choices: Mapping[str, Sequence[str]], default: str) -> str:
        """One of some words, each with other spellings."""
        value = self.values.get(key, default)
        for word, others in choices.items():
            if isinstance(value, str) and value.lower().replace("-", "_") in (word, *others):
                return word
        self.refuse(key, f"one of {', '.join(choices)} expected, got {value!r}")

    def tables(self, key: str, read: Callable[[Node], Any]) -> list[Any]:
        """Read each table of a list of tables; one table alone counts as a list."""
        value = self.values.get(key, [])
        several = value if isinstance(value, list) else [value]
        if not all(isinstance(item, dict) for item in several):
            self.refuse(key, f"tables [[{key}]] expected")
        return [
            read(Node(self.path, f"[[{key}]] {i + 1}:", item)) for i, item in enumerate(several)
        ]

    def table(self, key: str) -> Node:
        """One table, empty where it is absent."""
        value = self.values.get(key, {})
        if not isinstance(value, dict):
            self.refuse(key, f"a table [{key}] expected")
        return Node(self.path, f"[{key}]", value)
