"""Control and tie tables with named columns: CSV and Parquet, and the attributes of layers."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import BoolArray, FloatArray
from geoposition.errors import ProductError
from geoposition.scripts.control_files.parts import (
    WGS84,
    ControlFile,
    GroundTable,
    ImageTable,
    ground_of_rows,
)
from geoposition.sensors.readers.table_file import load_table

ALIASES: Final = {
    "id": ("id", "name", "point", "point_id", "gcp", "gcp_id", "label", "fid"),
    "lon": ("lon", "longitude", "lon_deg", "long"),
    "lat": ("lat", "latitude", "lat_deg"),
    "x": ("x", "easting", "east", "mapx", "x_m"),
    "y": ("y", "northing", "north", "mapy", "y_m"),
    "height": ("height", "h", "z", "alt", "altitude", "elevation", "elev", "height_m", "hae"),
    "product": ("product", "image", "image_id", "filename", "file", "scene", "photo"),
    "row": ("row", "line", "image_row", "row_px", "line_px"),
    "col": ("col", "column", "sample", "samp", "image_col", "col_px", "sample_px"),
    "sigma_e": ("sigma_e", "sigma_east", "sigma_e_m", "sigma_x", "sigma_lon"),
    "sigma_n": ("sigma_n", "sigma_north", "sigma_n_m", "sigma_y", "sigma_lat"),
    "sigma_u": ("sigma_u", "sigma_up", "sigma_u_m", "sigma_z", "sigma_h", "sigma_height"),
    "sigma_m": ("sigma_m", "sigma", "accuracy_m"),
    "sigma_px": ("sigma_px", "image_sigma_px"),
    "sigma_row": ("sigma_row", "sigma_line", "sigma_row_px"),
    "sigma_col": ("sigma_col", "sigma_sample", "sigma_col_px"),
    "role": ("role", "type", "use"),
}
"""Names under which a column is looked for, in lower case."""
_CHECK_WORDS: Final = ("check", "checkpoint", "check point", "cp", "icp", "chk")


class Columns(Protocol):
    """Named columns of one length."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns."""
        ...

    def __len__(self) -> int: ...

    def text(self, name: str) -> NDArray[np.str_]:
        """One column as text."""
        ...

    def numbers(self, name: str) -> FloatArray:
        """One column as numbers, NaN where there is none."""
        ...


@dataclass(frozen=True, slots=True)
class Named:
    """Columns by what they mean."""

    columns: Columns
    place: dict[str, str]

    @classmethod
    def of(cls, columns: Columns) -> Named:
        """Find each meaning's column; two columns of one meaning are refused."""
        lower: dict[str, str] = {}
        for name in columns.names:
            lower.setdefault(name.strip().lower(), name)
        place = {}
        for meaning, aliases in ALIASES.items():
            found = [lower[alias] for alias in aliases if alias in lower]
            if found:
                place[meaning] = found[0]
        return cls(columns, place)

    def __contains__(self, meaning: str) -> bool:
        return meaning in self.place

    def text(self, meaning: str, default: str = "") -> NDArray[np.str_]:
        """Text of a column, `default` where there is none."""
        if meaning not in self.place:
            return np.full(len(self.columns), default, dtype=f"U{max(len(default), 1)}")
        return np.strings.strip(self.columns.text(self.place[meaning]))

    def numbers(self, meaning: str) -> FloatArray:
        """Numbers of a column, NaN where there is none."""
        if meaning not in self.place:
            return np.full(len(self.columns), np.nan)
        return self.columns.numbers(self.place[meaning])

    def require(self, meanings: Sequence[str]) -> None:
        """Refuse columns that are missing, each with the nearest there is."""
        missing = [name for name in meanings if name not in self.place]
        if not missing:
            return
        taken = set(self.place.values())
        free = [name for name in self.columns.names if name not in taken]
        near = [close[0] for name in missing if (close := difflib.get_close_matches(name, free, 1))]
        hint = f" (is it {', '.join(map(repr, near))}?)" if near else ""
        raise ProductError(
            self.columns.path,
            "header",
            f"column(s) {', '.join(missing)} missing; {', '.join(meanings)} expected{hint}",
        )


def read_columns(path: Path, crs: str | None) -> ControlFile:
    """Read a CSV or Parquet table: ground positions, image points, or both."""
    table = load_table(path)
    named = Named.of(table)
    remark = table.remark("crs")
    ground = None
    if any(name in named for name in ("lon", "lat", "x", "y", "height")):
        ground = _ground(named, crs or remark)
    image = None
    if ("row" in named or "col" in named) and len(table):
        named.require(("id", "row", "col"))
        image = image_points(named)
    if ground is None and image is None:
        named.require(("id", "lon", "lat", "height"))
    wide = wide_image_points(table, named)
    return ControlFile(ground, image if wide is None else wide)


def _ground(named: Named, crs: str | None) -> GroundTable:
    projected = "x" in named and "lon" not in named
    axes = ("x", "y") if projected else ("lon", "lat")
    named.require(("id", *axes))
    if not len(named.columns):
        raise ProductError(named.columns.path, "", "no points: the table has a header only")
    if projected and crs is None:
        raise ProductError(
            named.columns.path, "columns x, y", "the coordinate system expected beside (crs)"
        )
    xyz = np.stack([named.numbers(name) for name in (*axes, "height")], axis=1)
    system = WGS84 if crs is None else crs
    return ground_of_rows(
        named.columns.path,
        named.text("id"),
        xyz,
        system,
        sigmas_m(named),
        is_check=check_marks(named),
    )


def sigmas_m(named: Named) -> FloatArray:
    """Return sigmas east, north, up (n, 3), NaN where the table has none."""
    every = named.numbers("sigma_m")
    parts = [named.numbers(f"sigma_{axis}") for axis in "enu"]
    return np.stack([np.where(np.isfinite(part), part, every) for part in parts], axis=1)


def check_marks(named: Named) -> BoolArray:
    """Rows whose role says that they are check points."""
    return np.isin(np.strings.lower(named.text("role")), _CHECK_WORDS)


def image_points(named: Named) -> ImageTable:
    """Image points of rows with id, row, col and, where there, product."""
    px = np.stack([named.numbers("row"), named.numbers("col")], axis=1)
    both = named.numbers("sigma_px")
    sigma = [named.numbers("sigma_row"), named.numbers("sigma_col")]
    spread = np.stack([np.where(np.isfinite(one), one, both) for one in sigma], axis=1)
    return ImageTable(named.columns.path, named.text("id"), named.text("product"), px, spread)


def wide_image_points(table: Columns, named: Named) -> ImageTable | None:
    """Image points in columns row_NAME, col_NAME of each image; an empty cell is no point."""
    lower = {name.strip().lower(): name for name in table.names}
    images = [
        name.strip()[4:]
        for name in table.names
        if name.strip().lower().startswith("row_")
        and f"col_{name.strip()[4:].lower()}" in lower
        and name.strip().lower() not in ALIASES["row"]
    ]
    if not images:
        return None
    named.require(("id",))
    ids = named.text("id")
    parts = []
    for image in images:
        px = np.stack(
            [table.numbers(lower[f"{axis}_{image.lower()}"]) for axis in ("row", "col")], axis=1
        )
        there = ~np.isnan(px).all(axis=1)
        parts.append((ids[there], np.full(int(there.sum()), image), px[there]))
    px = np.concatenate([part[2] for part in parts])
    return ImageTable(
        table.path,
        np.concatenate([part[0] for part in parts]),
        np.concatenate([part[1] for part in parts]),
        px,
        np.full(px.shape, np.nan),
    )
