"""Matches of one pair of images as text: ASP's match files written out, or plain columns.

`parse_match_file.py` of the Ames Stereo Pipeline writes how many points there are, first of the
left image, then the same of the right one, a point a line, column and row first. The plain form
has a match a line: column and row in the left image, column and row in the right one.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import MissingFileError, ProductError, UnsupportedError

SUFFIXES: Final = (".match", ".txt", ".matches")
_PLAIN: Final = 4


def is_match_file(path: Path) -> bool:
    """Whether `path` holds matches of a pair without a header, by its first line with words."""
    if path.suffix.lower() not in SUFFIXES or not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(4096)
    if b"\0" in head:
        return path.suffix.lower() == ".match"
    for line in head.decode("utf-8", "replace").splitlines():
        words = _words(line)
        if words:
            return all(_is_number(word) for word in words)
    return False


def read_match_file(path: Path) -> tuple[FloatArray, FloatArray]:
    """Image points (n, 2) = (row, col) of the left and of the right image."""
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise UnsupportedError(
            path, "", "matches as text expected; ASP's parse_match_file.py writes a binary file out"
        )
    rows = [(number, _words(line)) for number, line in enumerate(text.splitlines(), 1)]
    rows = [(number, words) for number, words in rows if words]
    if not rows:
        raise ProductError(path, "", "matches expected, the file is empty")
    table = [_numbers(path, number, words) for number, words in rows]
    if len(table[0]) == 2 and len(table) > 1 and len(table[1]) > 2:
        return _halves(path, table)
    if any(len(values) < _PLAIN for values in table):
        number = next(n for (n, _), values in zip(rows, table, strict=True) if len(values) < _PLAIN)
        raise ProductError(path, f"line {number}", "col row col row of a pair expected")
    plain = np.array([values[:_PLAIN] for values in table])
    return plain[:, [1, 0]], plain[:, [3, 2]]


def _halves(path: Path, table: list[list[float]]) -> tuple[FloatArray, FloatArray]:
    left, right = int(table[0][0]), int(table[0][1])
    if left != right or len(table) != 1 + left + right:
        raise ProductError(
            path, "line 1", f"{left} and {right} points announced, {len(table) - 1} lines found"
        )
    points = np.array([values[:2] for values in table[1:]])[:, ::-1]
    return points[:left].copy(), points[left:].copy()


def _words(line: str) -> list[str]:
    return [word for word in re.split(r"[\s,;]+", line.partition("#")[0]) if word]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(path: Path, number: int, words: list[str]) -> list[float]:
    if not all(_is_number(word) for word in words):
        raise ProductError(path, f"line {number}", "numbers expected")
    return [float(word) for word in words]
