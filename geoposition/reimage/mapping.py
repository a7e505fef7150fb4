"""From the pixels of one image to those of another of the same ground: object-space consistency.

A pixel of the target is located on the ground with the target's model, and the ground is
projected into the source with the source's (P 2.2). This is done at every row, since jitter
lives in rows, and at columns so close together that between them a straight line is good enough:
a bisection finds how close, and the error at the middle of every cell, where a straight line is
worst, is checked again while the image is made.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import has_result
from geoposition.locate import locate
from geoposition.sensor_model import SensorModel
from geoposition.terrain import ConstantTerrain, Terrain

DEFAULT_BOUND_PX: Final = 0.005

_SEARCH_ROWS: Final = 65
_CHECK_EVERY: Final = 16
_LEAST_STEP: Final = 1
_STEP_AT_HOLES: Final = 32
"""A node without a place costs the cells on both sides: they are small where there are some."""
_HEIGHT_STEP_M: Final = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class RowMap:
    """Places in the source of the rows `first_row` ... of the target.

    `places` (rows, nodes, 2) are (line, sample) at the columns 0, `node_step`, 2 `node_step`,
    ...; NaN where there is none. Between the nodes places are linear. `error_px` is the largest
    deviation from that found at the middles of cells.
    """

    first_row: int
    node_step: int
    places: FloatArray
    error_px: float

    def displacement_px(self, cols: FloatArray) -> FloatArray:
        """Places less the target's own (line, sample), (rows, k, 2) at columns `cols` (k,)."""
        at = np.clip(cols / self.node_step, 0.0, self.places.shape[1] - 1.0)
        left = np.minimum(at.astype(np.int64), self.places.shape[1] - 2)
        share = (at - left)[:, None]
        moved = self.places[:, left] + share * (self.places[:, left + 1] - self.places[:, left])
        moved[..., 0] -= (self.first_row + np.arange(len(moved)))[:, None]
        moved[..., 1] -= cols
        return np.asarray(moved)

    def part(self, first: int, end: int) -> RowMap:
        """Map of the rows `first` ... `end` − 1 of the target alone."""
        places = self.places[first - self.first_row : end - self.first_row]
        return RowMap(first, self.node_step, places, self.error_px)

    def source_lines(self) -> tuple[float, float] | None:
        """First and last line of the source that the rows point to; none if they do not."""
        lines = self.places[..., 0]
        if not np.isfinite(lines).any():
            return None
        return float(np.nanmin(lines)), float(np.nanmax(lines))


@dataclass(frozen=True, slots=True, eq=False)
class SourceMapping:
    """How to get from `target` pixels to `source` pixels over `terrain`.

    `node_step` columns lie between nodes, so that the interpolation error is at most
    `bound_px`; `parallax_px_m` (2,) is how far a metre of height moves the place, at worst: what
    a height error costs.
    """

    target: SensorModel
    source: SensorModel
    terrain: Terrain
    node_step: int
    bound_px: float
    parallax_px_m: FloatArray

    def rows(self, first: int, end: int) -> RowMap:
        """Map the rows `first` ... `end` − 1 of the target."""
        cols = _columns(self.target.shape[1], self.node_step)
        places = self.places(np.arange(first, end, dtype=np.float64), cols)
        check = np.arange(0, end - first, _CHECK_EVERY)
        exact = self.places(first + check.astype(np.float64), _middles(cols))
        straight = 0.5 * (places[check, 1:] + places[check, :-1])
        # the last cell is cut off by the image's edge: its straight line goes on
        stretch = self.node_step / (cols[-1] - cols[-2])
        places[:, -1] = places[:, -2] + stretch * (places[:, -1] - places[:, -2])
        return RowMap(first, self.node_step, places, _largest(exact - straight))

    def places(self, rows: FloatArray, cols: FloatArray) -> FloatArray:
        """Exact places (rows, cols, 2) of the target's pixels; NaN where there is none."""
        return _places(self.target, self.source, self.terrain, rows, cols)


def map_models(
    target: SensorModel,
    source: SensorModel,
    terrain: Terrain | float,
    bound_px: float = DEFAULT_BOUND_PX,
) -> SourceMapping:
    """Prepare the way from `target` to `source` over `terrain`, or one ellipsoidal height.

    Raises
    ------
    GeometryError
        No pixel of the target is seen by the source, or the map is too rough for `bound_px`.
    """
    if not bound_px > 0.0:
        raise ArgumentError(f"mapping: a positive bound in pixels expected, got {bound_px}")
    ground = ConstantTerrain(terrain) if isinstance(terrain, int | float) else terrain
    lines, samples = target.shape
    rows = np.linspace(0.0, lines - 1.0, min(_SEARCH_ROWS, lines))
    step = 1 << max(int(np.ceil(np.log2(max(samples - 1, 2)))), 2)
    while True:
        cols = _columns(samples, step)
        places = _places(target, source, ground, rows, cols)
        exact = _places(target, source, ground, rows, _middles(cols))
        missed = _largest(exact - 0.5 * (places[:, 1:] + places[:, :-1]))
        holes = not np.isfinite(places).all()
        # half the bound: the rows not looked at may be a little worse
        if missed <= 0.5 * bound_px and (not holes or step <= _STEP_AT_HOLES):
            break
        if step <= _LEAST_STEP:
            break
        step //= 2
    if not (np.isfinite(places).any() or np.isfinite(exact).any()):
        raise GeometryError("mapping: the source sees no pixel of the target")
    if missed > bound_px:
        raise GeometryError(
            f"mapping: between columns {step} px apart it still bends by {missed:.3g} px, "
            f"{bound_px:g} px is the bound"
        )
    parallax = _parallax(target, source, rows, cols)
    return SourceMapping(target, source, ground, step, bound_px, read_only(parallax))


def _columns(cols: int, step: int) -> FloatArray:
    """Columns of the nodes, the last of them at the image's edge."""
    nodes = step * np.arange(max(-(-(cols - 1) // step), 1) + 1, dtype=np.float64)
    nodes[-1] = max(cols - 1.0, nodes[-2] + 1.0)
    return nodes


def _middles(cols: FloatArray) -> FloatArray:
    middles: FloatArray = 0.5 * (cols[1:] + cols[:-1])
    return middles


def _places(
    target: SensorModel, source: SensorModel, terrain: Terrain, rows: FloatArray, cols: FloatArray
) -> FloatArray:
    image = np.empty((len(rows), len(cols), 2))
    image[..., 0] = rows[:, None]
    image[..., 1] = cols
    found = source.ground_to_image(locate(target, image, terrain).geodetic)
    return np.where(has_result(found.flag)[..., None], found.image_px, np.nan)


def _largest(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.abs(finite).max()) if finite.size else 0.0


def _parallax(
    target: SensorModel, source: SensorModel, rows: FloatArray, cols: FloatArray
) -> FloatArray:
    low, high = target.height_range_m
    middle = 0.5 * (low + high)
    few = rows[:: max(len(rows) // 9, 1)]
    above, below = (
        _places(target, source, ConstantTerrain(middle + sign * _HEIGHT_STEP_M), few, cols[:2])
        for sign in (0.5, -0.5)
    )
    return np.array([_largest((above - below)[..., k]) / _HEIGHT_STEP_M for k in range(2)])
