"""Control points of the QGIS georeferencer: `.points`, in its old and new form.

Columns mapX, mapY, then sourceX, sourceY (pixelX, pixelY up to 3.24), enable and residuals; the
system of the map stands before them as `#CRS: WKT`. Source coordinates of an image without
georeference count from the outer corner of the first pixel, y upwards, hence negative. There are
no heights and no ids: points are numbered from 0, disabled ones keep their numbers.
"""

from __future__ import annotations

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

_NEW: Final = ("mapX", "mapY", "sourceX", "sourceY")
_OLD: Final = ("mapX", "mapY", "pixelX", "pixelY")
_CORNER_PX: Final = 0.5


def read_points(path: Path, crs: str | None) -> ControlFile:
    """Read a `.points` file; the image's name is that of the file without its ending."""
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ProductError(path, "", "a text file of the QGIS georeferencer expected") from None
    at, own = 0, None
    while at < len(lines) and (not lines[at].strip() or lines[at].startswith("#")):
        if lines[at].upper().startswith("#CRS:"):
            own = lines[at][5:].strip() or None
        at += 1
    header = [name.strip() for name in lines[at].split(",")] if at < len(lines) else []
    wanted = _OLD if "pixelX" in header else _NEW
    missing = [name for name in wanted if name not in header]
    if missing:
        raise ProductError(
            path, "header",
            f"column(s) {', '.join(missing)} missing; mapX,mapY,sourceX,sourceY,enable expected",
        )  # fmt: skip
    place = [header.index(name) for name in wanted]
    enable = header.index("enable") if "enable" in header else None
    ids, values = [], []
    number = -1
    for line, text in enumerate(lines[at + 1 :], at + 2):
        if not text.strip():
            continue
        number += 1
        cells = [cell.strip() for cell in text.split(",")]
        if len(cells) != len(header):
            raise ProductError(path, f"line {line}", f"{len(header)} cells expected")
        if enable is not None and cells[enable] == "0":
            continue
        try:
            values.append([float(cells[k]) for k in place])
        except ValueError:
            raise ProductError(path, f"line {line}", "numbers expected") from None
        ids.append(str(number))
    if not ids:
        raise ProductError(path, "", "enabled control points expected, there are none")
    table = np.array(values)
    px = np.column_stack([-table[:, 3] - _CORNER_PX, table[:, 2] - _CORNER_PX])
    if np.median(px[:, 0]) < -1.0:
        raise ProductError(
            path, "sourceY",
            "pixels expected, y negative downwards; these are the map coordinates of an image "
            "with a georeference, or of an image turned over",
        )  # fmt: skip
    xyz = np.column_stack([table[:, :2], np.full(len(table), np.nan)])
    nothing = np.full(xyz.shape, np.nan)
    ground = ground_of_rows(path, np.array(ids), xyz, crs or own or WGS84, nothing)
    names = np.full(len(ids), path.stem)
    return ControlFile(ground, ImageTable(path, ground.ids, names, px, nothing[:, :2]))
