"""Calibration fields: what a folder with a `field.toml` says of its ground, and what lies in it.

name = "Songshan"
epoch = "2014-05"
licence = "..."
plane_datum = "EPSG:32649"
height_datum = "ellipsoid"            # else the geoid's name, and its grid below

[extent]                              # degrees
west = 112.6
...

[dom]
files = ["dom/*.tif"]
sigma_m = 0.5                         # per axis, of the orthophoto's place

[dem]
files = ["dem.tif"]
geoid = "egm96.gtx"
sigma_m = 1.0

[gcps]
file = "gcps.csv"                     # id,lon,lat,height
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from geoposition.errors import MissingFileError, ProductError
from geoposition.named_files import is_there
from geoposition.tomlfile import read_toml

FIELD_FILE = "field.toml"


@dataclass(frozen=True, slots=True)
class Extent:
    """Where a field lies, degrees."""

    west_deg: float
    south_deg: float
    east_deg: float
    north_deg: float

    def contains(self, lon_deg: float, lat_deg: float) -> bool:
        """Whether a place lies in it."""
        return (
            self.west_deg <= lon_deg <= self.east_deg
            and self.south_deg <= lat_deg <= self.north_deg
        )


@dataclass(frozen=True, slots=True)
class Field:
    """A calibration field; `None` where nothing is stated, no files where there are none.

    `dom_sigma_m` is the standard deviation per axis of the orthophoto's place, `dem_sigma_m` that
    of the heights. `remarks` say where figures come from.
    """

    name: str
    extent: Extent | None = None
    plane_datum: str = ""
    height_datum: str = ""
    epoch: str = ""
    licence: str = ""
    remarks: str = ""
    dom_resolution_m: float | None = None
    dem_resolution_m: float | None = None
    dom_sigma_m: float | None = None
    dem_sigma_m: float | None = None
    dom: tuple[Path, ...] = ()
    dem: tuple[Path, ...] = ()
    geoid: Path | None = None
    gcps: Path | None = None


def load_field(path: str | PathLike[str]) -> Field:
    """Read a field from its folder, or its `field.toml`.

    Files are named relative to it, with * and ? if need be. `MissingFileError` where one is not
    there, `ProductError` where an entry is not what is expected.
    """
    file = Path(path)
    if file.is_dir():
        file = file / FIELD_FILE
    if not file.is_file():
        raise MissingFileError(file, "", "a calibration field's field.toml expected")
    root = read_toml(file).data
    dom, dem, gcps = (_table(file, root, name) for name in ("dom", "dem", "gcps"))
    return Field(
        name=_text(file, root, "name", file.parent.name),
        extent=_extent(file, root),
        plane_datum=_text(file, root, "plane_datum"),
        height_datum=_text(file, root, "height_datum"),
        epoch=_text(file, root, "epoch"),
        licence=_text(file, root, "licence"),
        remarks=_text(file, root, "remarks"),
        dom_resolution_m=_number(file, dom, "dom", "resolution_m"),
        dem_resolution_m=_number(file, dem, "dem", "resolution_m"),
        dom_sigma_m=_number(file, dom, "dom", "sigma_m"),
        dem_sigma_m=_number(file, dem, "dem", "sigma_m"),
        dom=_files(file, dom, "dom"),
        dem=_files(file, dem, "dem"),
        geoid=_file(file, dem, "dem", "geoid"),
        gcps=_file(file, gcps, "gcps", "file"),
    )


def _table(file: Path, root: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    value = root.get(name, {})
    if not isinstance(value, dict):
        raise ProductError(file, name, "a table expected")
    return value


def _text(file: Path, root: Mapping[str, Any], key: str, default: str = "") -> str:
    value = root.get(key, default)
    if not isinstance(value, str):
        raise ProductError(file, key, "a text expected")
    return value


def _number(file: Path, table: Mapping[str, Any], name: str, key: str) -> float | None:
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1e6:
        raise ProductError(file, f"{name}.{key}", "metres, a number of 0 or more, expected")
    return float(value)


def _extent(file: Path, root: Mapping[str, Any]) -> Extent | None:
    table = root.get("extent")
    if table is None:
        return None
    names = ("west", "south", "east", "north")
    if not isinstance(table, dict) or not all(
        isinstance(table.get(name), int | float) for name in names
    ):
        raise ProductError(file, "extent", "west, south, east and north in degrees expected")
    west, south, east, north = (float(table[name]) for name in names)
    if not (-180.0 <= west < east <= 360.0 and -90.0 <= south < north <= 90.0):
        raise ProductError(file, "extent", "west < east and south < north expected, degrees")
    return Extent(west, south, east, north)


def _files(file: Path, table: Mapping[str, Any], name: str) -> tuple[Path, ...]:
    named = table.get("files", [])
    named = [named] if isinstance(named, str) else named
    if not isinstance(named, list) or not all(isinstance(item, str) for item in named):
        raise ProductError(file, f"{name}.files", "a list of file names expected")
    found: list[Path] = []
    for item in named:
        matches = sorted(file.parent.glob(item)) if any(c in item for c in "*?[") else []
        if not matches:
            matches = [file.parent / item]
        found += matches
    for path in found:
        if not is_there(path):
            raise MissingFileError(path, "", f"{file} names this raster, there is no such file")
    return tuple(found)


def _file(file: Path, table: Mapping[str, Any], name: str, key: str) -> Path | None:
    value = table.get(key)
    if value is None:
        return None
    if not isinstance(value, str):
        raise ProductError(file, f"{name}.{key}", "a file name expected")
    path = file.parent / value
    if not is_there(path):
        raise MissingFileError(path, "", f"{file} names this file, it is not there")
    return path
