"""Control as vector layers: GeoJSON, GeoPackage, shapefile; points with their attributes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyogrio
import shapely
from numpy.typing import NDArray
from pyogrio.errors import DataLayerError, DataSourceError

from geoposition.arrays import FloatArray
from geoposition.errors import MissingFileError, ProductError
from geoposition.scripts.control_files.columns import (
    Named,
    check_marks,
    image_points,
    sigmas_m,
    wide_image_points,
)
from geoposition.scripts.control_files.parts import (
    WGS84,
    ControlFile,
    ImageTable,
    ground_of_rows,
)

SUFFIXES: Final = (".geojson", ".json", ".gpkg", ".shp", ".fgb")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


@dataclass(frozen=True, slots=True, eq=False)
class _Attributes:
    """Attributes of a layer as columns."""

    path: Path
    table: dict[str, NDArray[Any]]
    count: int

    @property
    def names(self) -> list[str]:
        """Names of the attributes."""
        return list(self.table)

    def __len__(self) -> int:
        return self.count

    def text(self, name: str) -> NDArray[np.str_]:
        """One attribute as text; what is missing is empty."""
        return np.array([_word(value) for value in self.table[name]], dtype=np.str_)

    def numbers(self, name: str) -> FloatArray:
        """One attribute as numbers; what is none is NaN."""
        return np.array([_number(value) for value in self.table[name]], dtype=np.float64)


def read_vector(path: Path, crs: str | None) -> ControlFile:
    """Read the first layer of points; heights are those of the points, or an attribute."""
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    try:
        meta, ids, geometry, fields = pyogrio.raw.read(path, return_fids=True)
    except (DataSourceError, DataLayerError) as error:
        raise ProductError(path, "", f"a vector layer of points expected ({error})") from None
    except UnicodeDecodeError:
        raise ProductError(path, "", "names and texts in UTF-8 expected") from None
    table = dict(zip(meta["fields"], fields, strict=True))
    if geometry is None or not len(geometry):
        raise ProductError(path, "", "a layer with points expected, it has none")
    points = shapely.from_wkb(geometry)
    wrong = np.flatnonzero(shapely.get_type_id(points) != 0)
    if len(wrong):
        raise ProductError(path, f"feature {wrong[0] + 1}", "a point expected, not another shape")
    columns = _Attributes(path, table, len(points))
    named = Named.of(columns)
    if "id" not in named:
        table["id"] = np.asarray(ids if ids is not None else np.arange(len(points)))
        named = Named.of(columns)
    height = shapely.get_z(points)
    own = named.numbers("height")
    xyz = np.column_stack([
        shapely.get_x(points), shapely.get_y(points), np.where(np.isfinite(height), height, own),
    ])  # fmt: skip
    system = crs or meta.get("crs") or WGS84
    ground = ground_of_rows(
        path, named.text("id"), xyz, str(system), sigmas_m(named), is_check=check_marks(named)
    )
    return ControlFile(ground, _image(columns, named))


def _image(columns: _Attributes, named: Named) -> ImageTable | None:
    if "row" in named and "col" in named:
        return image_points(named)
    if "ji" not in columns.names:
        return wide_image_points(columns, named)
    # Orthority's attribute: column and row of the first pixel's centre at (0, 0).
    px = np.full((len(columns), 2), np.nan)
    for i, value in enumerate(columns.table["ji"]):
        words = _NUMBER.findall(value) if isinstance(value, str) else list(value)
        if len(words) == 2:
            px[i] = float(words[1]), float(words[0])
    return ImageTable(
        columns.path, named.text("id"), named.text("product"), px, np.full(px.shape, np.nan)
    )


def _word(value: object) -> str:
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return ""
    if isinstance(value, (float, np.floating)) and float(value).is_integer():
        return str(int(value))
    return str(value)


def _number(value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return float("nan")
