"""DigitalGlobe support data as one tree of groups, whether written as XML or as text.

The XML (`isd`) and the text files (.IMD, .EPH, .ATT, .GEO, .TIL) hold the same groups, keys and
lists. XML writes keys in capitals and a list as `<EPHEMLISTList>` of `<EPHEMLIST>` rows; text
writes `ephemList = ( (1, ...), (2, ...) );`, and numbers groups that can repeat (`IMAGE_1`).

Source: DigitalGlobe, Imagery Support Data (ISD) Documentation 1.1.2 (2014), file formats.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, MissingFileError, ProductError
from geoposition.timescale import Epoch
from geoposition.xmlfile import local_name, read_xml

MAX_TEXT_BYTES = 64 * 2**20
_MAX_DEPTH = 12
_ABSURD = 1e30

_STATEMENT = re.compile(
    r"""\s*(?:
      (?P<edge>BEGIN_GROUP|END_GROUP)\s*=\s*(?P<group>\w+)\s*;?
    | (?P<end>END)\s*(?:;|\Z)
    | (?P<key>[A-Za-z]\w*)\s*=\s*(?:
          "(?P<quoted>[^"\n]*)"\s*(?:;|$)
        | \((?P<list>[^;]*)\)\s*;
        | (?P<bare>[^;("\n]*)(?:;|$)
      )
    )""",
    re.VERBOSE | re.IGNORECASE | re.MULTILINE,
)
_ROW = re.compile(r"\(([^()]*)\)")


@dataclass(frozen=True, slots=True)
class Group:
    """One group: keys with their texts, lists with their rows, and groups inside it.

    Keys are held in capitals and asked for in the documentation's spelling (`numPoints`).
    """

    path: Path
    place: str
    is_xml: bool
    values: dict[str, list[str]] = field(default_factory=dict)
    lists: dict[str, list[str]] = field(default_factory=dict)
    groups: list[tuple[str, Group]] = field(default_factory=list)

    def place_of(self, name: str) -> str:
        """Where `name` is, or should be, as this file spells it."""
        spelled = name.upper() if self.is_xml else name
        return f"{self.place}/{spelled}" if self.place else spelled

    def error(self, name: str, expected: str) -> ProductError:
        """Make the error that blames `name` of this group."""
        return ProductError(self.path, self.place_of(name), expected)

    @contextmanager
    def blaming(self, name: str) -> Iterator[None]:
        """Turn an `ArgumentError` from inside into a `ProductError` that names `name`."""
        try:
            yield
        except ArgumentError as error:
            raise self.error(name, str(error)) from None

    def has(self, name: str) -> bool:
        """Whether a key `name` is there, with some text."""
        return any(self.values.get(name.upper(), []))

    def text(self, name: str) -> str:
        """Text of `name`; it must be there once and not be empty."""
        found = self.values.get(name.upper(), [])
        if not found:
            raise self.error(name, "this tag is missing")
        if len(found) > 1:
            raise self.error(name, f"one such tag expected, got {len(found)}")
        if not found[0]:
            raise self.error(name, "text expected, this tag is empty")
        return found[0]

    def number(self, name: str) -> float:
        """Finite number of `name`."""
        return float(self._numbers(name, self.text(name), None)[0])

    def integer(self, name: str) -> int:
        """Whole number of `name`."""
        value = self.number(name)
        if value != np.floor(value):
            raise self.error(name, f"a whole number expected, got {value!r}")
        return int(value)

    def epoch(self, name: str) -> Epoch:
        """UTC time of `name`."""
        with self.blaming(name):
            return Epoch.from_utc(self.text(name))

    def table(self, name: str, columns: int) -> FloatArray:
        """Rows of the list `name` as finite numbers (rows, columns)."""
        rows = self.lists.get(name.upper())
        if rows is None:
            raise self.error(name, "this list is missing")
        numbers = [self._numbers(name, text, i + 1, columns) for i, text in enumerate(rows)]
        return np.array(numbers, dtype=np.float64).reshape(len(rows), columns)

    def flat_list(self, name: str) -> FloatArray:
        """All numbers of the list `name`, rows or not; empty where there is no such list."""
        rows = self.lists.get(name.upper(), [])
        texts = [text for text in rows if text.strip(" \t\r\n,")]
        numbers = [self._numbers(name, text, i + 1) for i, text in enumerate(texts)]
        return np.array([value for row in numbers for value in row], dtype=np.float64)

    def _numbers(
        self, name: str, text: str, row: int | None, columns: int | None = None
    ) -> list[float]:
        words = text.replace(",", " ").split()
        where = "" if row is None else f"entry {row}: "
        count = 1 if row is None else columns
        if count is not None and len(words) != count:
            raise self.error(name, f"{where}{count} number(s) expected, got {len(words)}")
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise self.error(name, f"{where}number(s) expected, got {text[:40]!r}") from None
        if not all(abs(value) < _ABSURD for value in values):  # NaN fails, too
            raise self.error(name, f"{where}finite number(s) expected, got {text[:40]!r}")
        return values

    def named(self, name: str) -> list[Group]:
        """Return the groups inside called `name` or `name` with a number (`IMAGE_1`), in order."""
        pattern = re.compile(rf"{re.escape(name)}(_\d+)?", re.IGNORECASE)
        return [group for key, group in self.groups if pattern.fullmatch(key)]

    def find(self, name: str) -> Group | None:
        """First group inside called `name`, or None."""
        return next(iter(self.named(name)), None)

    def need(self, name: str) -> Group:
        """First group inside called `name`; a missing one is a `ProductError`."""
        group = self.find(name)
        if group is None:
            raise ProductError(
                self.path, f"{self.place}/{name}" if self.place else name, "this tag is missing"
            )
        return group


def read_xml_tree(path: Path) -> Group:
    """Parse an `isd` XML file; entities, truncated and foreign documents are refused."""
    root = read_xml(path)
    if root.tag.lower() != "isd":
        raise ProductError(path, root.tag, "a root element isd expected")
    return _from_element(path, root.tag, root.element, 0)


def _from_element(path: Path, place: str, element: Element, depth: int) -> Group:
    if depth > _MAX_DEPTH:
        raise ProductError(path, place[:80], "groups are nested too deeply")
    group = Group(path, place, True)
    for child in element:
        name = local_name(child)
        if name.endswith("List"):
            rows = [row.text or "" for row in child]
            group.lists.setdefault(name[:-4].upper(), []).extend(rows)
        elif len(child):
            inner = _from_element(path, f"{place}/{name}", child, depth + 1)
            group.groups.append((name.upper(), inner))
        else:
            text = (child.text or "").strip()
            group.values.setdefault(name.upper(), []).append(text)
            if not text:  # It may be meant as a group: let its missing tags be named.
                group.groups.append((name.upper(), Group(path, f"{place}/{name}", True)))
    return group


def read_text_tree(path: Path) -> Group:
    """Parse a text file (.IMD, .EPH, .ATT, .GEO, .TIL); it must be complete, down to `END;`."""
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    size = path.stat().st_size
    if size == 0:
        raise ProductError(path, "", "support data expected, the file is empty")
    if size > MAX_TEXT_BYTES:
        raise ProductError(path, "", f"larger than {MAX_TEXT_BYTES >> 20} MiB, refused")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ProductError(path, "encoding", "plain text expected") from None
    return _parse_text(path, text)


def _parse_text(path: Path, text: str) -> Group:
    def line(position: int) -> str:
        skipped = len(text[position:]) - len(text[position:].lstrip())
        return f"line {text.count(chr(10), 0, position + skipped) + 1}"

    stack = [Group(path, "", False)]
    names: list[str] = []
    position = 0
    while (match := _STATEMENT.match(text, position)) is not None:
        here = stack[-1]
        if match["end"]:
            if names:
                raise ProductError(path, line(position), f"END_GROUP = {names[-1]} expected")
            return stack[0]
        if match["edge"]:
            name = match["group"]
            if match["edge"].upper() == "BEGIN_GROUP":
                if len(stack) > _MAX_DEPTH:
                    raise ProductError(path, line(position), "groups are nested too deeply")
                inner = Group(path, f"{here.place}/{name}" if here.place else name, False)
                here.groups.append((name.upper(), inner))
                stack.append(inner)
                names.append(name)
            elif not names or names.pop().upper() != name.upper():
                raise ProductError(path, line(position), f"END_GROUP = {name} closes no group")
            else:
                stack.pop()
        elif match["list"] is not None:
            place = here.place_of(match["key"])
            here.lists.setdefault(match["key"].upper(), []).extend(
                _rows(path, place, match["list"])
            )
        else:
            value = match["quoted"] if match["quoted"] is not None else match["bare"]
            here.values.setdefault(match["key"].upper(), []).append(value.strip())
        position = match.end()
    if not text[position:].strip():
        raise ProductError(path, line(position), "END; expected, the file is truncated")
    raise ProductError(path, line(position), "`key = value;` or `key = ( ... );` expected")


def _rows(path: Path, place: str, inner: str) -> list[str]:
    """Rows of a list's text: those in parentheses, or else the whole text as one row."""
    if "(" not in inner and ")" not in inner:
        return [inner]
    between, rows = _ROW.sub(" ", inner), _ROW.findall(inner)
    if between.strip(" \t\r\n,"):
        raise ProductError(path, place, "rows in parentheses, and nothing between, expected")
    return rows
