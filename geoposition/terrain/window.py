"""Which nodes of a lattice lie under a set of places: windows of rows and columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.constants import WGS84_A_M
from geoposition.datum import from_crs, to_crs
from geoposition.terrain.patch import from_plane, plane_axes, to_plane
from geoposition.terrain.source import Lattice

_SAMPLES: Final = 17
_MARGIN_RAD: Final = 100.0 / WGS84_A_M
"""Covers the difference between the normal at a height and the one used for windows."""
_MARGIN_PX: Final = 3


@dataclass(frozen=True, slots=True)
class Box:
    """A box on the gnomonic plane `axes` (3, 3), from `low` to `high` (2,)."""

    axes: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def extent_rad(self) -> float:
        """Its longer side."""
        return float(np.max(self.high - self.low))


@dataclass(frozen=True, slots=True)
class Span:
    """Nodes `row` .. `row + rows - 1`, `col` .. `col + cols - 1`, columns without a seam."""

    row: int
    col: int
    rows: int
    cols: int

    @property
    def nodes(self) -> int:
        """How many."""
        return self.rows * self.cols

    def contains(self, other: Span) -> bool:
        """Whether `other` lies within."""
        return (
            self.row <= other.row
            and self.col <= other.col
            and self.row + self.rows >= other.row + other.rows
            and self.col + self.cols >= other.col + other.cols
        )


def box_around(normal: FloatArray) -> Box | None:
    """Box of directions (n, 3), of any length; none where they fill more than a plane holds."""
    middle = np.mean(normal, axis=0)
    length = np.linalg.norm(middle)
    if not length > 0.3 * np.max(np.linalg.norm(normal, axis=1), initial=0.0):
        return None
    axes = plane_axes(middle / length)
    uv = to_plane(axes, normal)
    if not np.all(np.isfinite(uv)):
        return None
    return Box(axes, uv.min(axis=0) - _MARGIN_RAD, uv.max(axis=0) + _MARGIN_RAD)


def span_of_box(lattice: Lattice, box: Box) -> Span | None:
    """Window of `lattice` that covers `box` with a margin; none where they do not meet.

    The border and inside of the box are sampled; between samples a map bends by less than the
    margin of 2 % of the window. A box at a pole takes all columns.
    """
    row0, col0, row1, col1 = lattice.bounds
    along = np.linspace(0.0, 1.0, _SAMPLES)
    u = box.low[0] + (box.high[0] - box.low[0]) * along
    v = box.low[1] + (box.high[1] - box.low[1]) * along
    lon, lat = from_plane(box.axes, *np.meshgrid(u, v))
    if lattice.geographic:
        poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        at_pole = to_plane(box.axes, poles)
        reach = 0.5 * (box.high - box.low)
        inside = np.all((at_pole > box.low - reach) & (at_pole < box.high + reach), axis=1)
        for pole_lat in np.array([0.5, -0.5])[inside] * np.pi:
            turn = np.linspace(-np.pi, np.pi, 73)
            lon = np.append(lon, turn)
            lat = np.append(lat, np.full(turn.shape, pole_lat))
    else:
        inside = np.zeros(2, dtype=bool)
    rows, cols = positions(lattice, lon.ravel(), lat.ravel(), box)
    known = np.isfinite(rows + cols)
    if not known.any():
        return None
    low = np.array([rows[known].min(), cols[known].min()])
    high = np.array([rows[known].max(), cols[known].max()])
    margin = 0.02 * (high - low) + _MARGIN_PX
    low, high = np.floor(low - margin), np.ceil(high + margin)
    if inside.any():
        low[1], high[1] = col0, col1 - 1
    first_row, last_row = max(int(low[0]), row0), min(int(high[0]), row1 - 1)
    if lattice.closed:
        first_col, last_col = int(low[1]), int(high[1])
        if last_col - first_col >= lattice.period:
            last_col = first_col + lattice.period
    else:
        first_col, last_col = max(int(low[1]), col0), min(int(high[1]), col1 - 1)
    if last_row - first_row < 1 or last_col - first_col < 1:
        return None
    return Span(first_row, first_col, last_row - first_row + 1, last_col - first_col + 1)


def positions(
    lattice: Lattice, lon_rad: FloatArray, lat_rad: FloatArray, box: Box | None = None
) -> tuple[FloatArray, FloatArray]:
    """(row, col) of places; longitudes near the box's middle, and it near the lattice's."""
    points = np.stack([lon_rad, lat_rad, np.zeros_like(lon_rad)], axis=-1)
    xy = to_crs(lattice.crs_wkt, points)[..., :2]
    if lattice.geographic:
        middle = float(np.nanmedian(xy[..., 0]))
        if box is not None:
            lon = np.arctan2(box.axes[0, 1], box.axes[0, 0])
            middle = float(np.degrees(lon))
        row0, col0, row1, col1 = lattice.bounds
        nodes = np.array([1.0, 0.5 * (row0 + row1 - 1), 0.5 * (col0 + col1 - 1)])
        target = float(lattice.from_grid[0] @ nodes)
        middle += 360.0 * round((target - middle) / 360.0)
        xy[..., 0] += 360.0 * np.round((middle - xy[..., 0]) / 360.0)
    linear = np.linalg.inv(lattice.from_grid[:, 1:])
    grid = (xy - lattice.from_grid[:, 0]) @ linear.T
    return grid[..., 0], grid[..., 1]


def places(lattice: Lattice, row: FloatArray, col: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(lon_rad, lat_rad) of (row, col)."""
    f = lattice.from_grid
    x = f[0, 0] + f[0, 1] * row + f[0, 2] * col
    y = f[1, 0] + f[1, 1] * row + f[1, 2] * col
    geodetic = from_crs(lattice.crs_wkt, np.stack([x, y, np.zeros_like(x)], axis=-1))
    return geodetic[..., 0], geodetic[..., 1]


def is_wgs84_degrees(lattice: Lattice) -> bool:
    """Whether (x, y) are longitude and latitude in degrees on WGS 84, to 1e-11 rad."""
    if not lattice.geographic:
        return False
    row0, col0, row1, col1 = lattice.bounds
    row, col = np.meshgrid(np.linspace(row0, row1 - 1, 5), np.linspace(col0, col1 - 1, 5))
    f = lattice.from_grid
    lon_deg = f[0, 0] + f[0, 1] * row + f[0, 2] * col
    lat_deg = np.clip(f[1, 0] + f[1, 1] * row + f[1, 2] * col, -89.0, 89.0)
    xyz = np.stack([lon_deg, lat_deg, np.zeros_like(row)], axis=-1)
    geodetic = from_crs(lattice.crs_wkt, xyz)
    turn = (geodetic[..., 0] - np.radians(lon_deg)) / (2.0 * np.pi)
    same_lon = np.abs(turn - np.round(turn)) < 1e-11
    return bool(np.all(same_lon & (np.abs(geodetic[..., 1] - np.radians(lat_deg)) < 1e-11)))
