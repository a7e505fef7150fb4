"""What any control file says: ground positions in its own system, and image points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import BoolArray, FloatArray
from geoposition.errors import ProductError

WGS84: Final = "EPSG:4326"
SigmaAxes = Literal["enu", "ecef"]


@dataclass(frozen=True, slots=True, eq=False)
class GroundTable:
    """Positions (n, 3) in `crs`: x, y (longitude, latitude in degrees), height; each id once.

    A height that is not given is NaN. `sigma_m` (n, 3), NaN where not given, along east, north,
    up or along the axes of ECEF. `is_check` (n) marks points the file itself calls check points.
    """

    path: Path
    ids: NDArray[np.str_]
    xyz: FloatArray
    crs: str
    sigma_m: FloatArray
    sigma_axes: SigmaAxes
    is_check: BoolArray

    def refuse(self, row: int, expected: str) -> ProductError:
        """Return the error about one point."""
        return ProductError(self.path, f"point {self.ids[row]}", expected)


@dataclass(frozen=True, slots=True, eq=False)
class ImageTable:
    """Image points (m, 2) = (row, col) of points `ids` (m), in the images called `names` (m).

    An empty name is left to the reader to guess, where there is one image only. `sigma_px`
    (m, 2), NaN where not given.
    """

    path: Path
    ids: NDArray[np.str_]
    names: NDArray[np.str_]
    image_px: FloatArray
    sigma_px: FloatArray

    def __len__(self) -> int:
        return len(self.ids)

    def of(self, ids: NDArray[np.str_]) -> ImageTable:
        """Rows of the points `ids` alone."""
        rows = np.isin(self.ids, ids)
        return ImageTable(
            self.path, self.ids[rows], self.names[rows], self.image_px[rows], self.sigma_px[rows]
        )


@dataclass(frozen=True, slots=True, eq=False)
class ControlFile:
    """Ground and image part of one file, either of which may be missing."""

    ground: GroundTable | None
    image: ImageTable | None


def ground_of_rows(
    path: Path,
    ids: NDArray[np.str_],
    xyz: FloatArray,
    crs: str,
    sigma_m: FloatArray,
    sigma_axes: SigmaAxes = "enu",
    is_check: BoolArray | None = None,
) -> GroundTable:
    """Positions of rows (n); rows that repeat an id must repeat its position, or are refused."""
    blank = np.flatnonzero(np.strings.str_len(np.strings.strip(ids)) == 0)
    if len(blank):
        raise ProductError(path, f"row {blank[0] + 1}", "an id expected, it is empty")
    _, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    same = (xyz == xyz[first][inverse]) | (np.isnan(xyz) & np.isnan(xyz[first][inverse]))
    if not np.all(same):
        row = int(np.flatnonzero(~same.all(axis=1))[0])
        raise ProductError(
            path, f"point {ids[row]}", "each id once expected, or at one position; it has two"
        )
    kept = np.sort(first)
    check = np.zeros(len(ids), dtype=bool) if is_check is None else is_check
    return GroundTable(path, ids[kept], xyz[kept], crs, sigma_m[kept], sigma_axes, check[kept])
