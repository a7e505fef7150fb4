"""Control points of the Ames Stereo Pipeline: `.gcp` and the control network as CSV.

A line has id, latitude, longitude, height above the datum, three standard deviations along the
axes of ECEF, and for each image its name, column, row and their standard deviations, separated
by blanks or commas. Pixels count from 0 at the first pixel's centre. *Source*: ASP
documentation, bundle_adjust, "File format" of ground control points.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.errors import MissingFileError, ProductError
from geoposition.scripts.control_files.parts import (
    WGS84,
    ControlFile,
    ImageTable,
    ground_of_rows,
)

_GROUND: Final = 7
_IMAGE: Final = 5
_DATUMS: Final = ("WGS84", "WGS_1984", "WGS 84", "World Geodetic System 1984")


def read_asp(path: Path, crs: str | None) -> ControlFile:
    """Read a `.gcp` file; a line of another shape is refused with its number."""
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    ids, ground, sigma = [], [], []
    point_ids, names, px, px_sigma = [], [], [], []
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ProductError(path, "", "a text file of control points expected") from None
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if text.startswith("#"):
            _check_datum(path, number, text, crs)
            continue
        words = [word for word in re.split(r"[\s,]+", text) if word]
        if not words:
            continue
        place = f"line {number}"
        if len(words) < _GROUND or (len(words) - _GROUND) % _IMAGE:
            raise ProductError(
                path, place,
                "id lat lon height sigma_x sigma_y sigma_z and image col row sigma_col sigma_row "
                f"for each image expected, got {len(words)} words",
            )  # fmt: skip
        values = _numbers(path, place, words[1:_GROUND])
        ids.append(words[0])
        ground.append([values[1], values[0], values[2]])
        sigma.append(values[3:])
        for first in range(_GROUND, len(words), _IMAGE):
            column, row, *spread = _numbers(path, place, words[first + 1 : first + _IMAGE])
            point_ids.append(words[0])
            names.append(words[first])
            px.append([row, column])
            px_sigma.append(spread[::-1])
    if not ids:
        raise ProductError(path, "", "control points expected, there are none")
    if len(set(ids)) != len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise ProductError(path, f"point {twice}", "each point once expected")
    table = ground_of_rows(
        path, np.array(ids), np.array(ground), crs or WGS84, np.array(sigma), "ecef"
    )
    if not px:
        return ControlFile(table, None)
    image = ImageTable(path, np.array(point_ids), np.array(names), np.array(px), np.array(px_sigma))
    return ControlFile(table, image)


def _numbers(path: Path, place: str, words: list[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise ProductError(path, place, f"numbers expected, got {' '.join(words)}") from None


def _check_datum(path: Path, number: int, text: str, crs: str | None) -> None:
    """Refuse a header that names another datum, unless the user says which system it is."""
    if crs is None and re.match(r"#\s*WKT\s*:", text) and not any(d in text for d in _DATUMS):
        raise ProductError(
            path, f"line {number}", "WGS 84 expected, the header names another datum: give a crs"
        )
