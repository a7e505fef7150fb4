"""What of an orthophoto an image shows, and the size of pixels that suits both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.accuracy import enu_errors_m
from geoposition.arrays import FloatArray
from geoposition.calib_fields.geometry import Dom
from geoposition.datum import to_crs
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import has_result
from geoposition.locate import locate
from geoposition.reimage.ortho import OrthoGrid
from geoposition.sensor_model import SensorModel
from geoposition.surface import is_geographic, near_degrees
from geoposition.terrain import Terrain

_BORDER: Final = 33


@dataclass(frozen=True, slots=True)
class Overlap:
    """Rows and columns of the orthophoto's lattice, `factor` times coarser, that the image shows.

    `bounds` top, left, bottom, right; `pixel_m` the size of a pixel there, `ground_sample_m` the
    image's, along its lines and samples; `height_m` the median of the ground's heights.
    """

    factor: int
    bounds: tuple[int, int, int, int]
    pixel_m: float
    ground_sample_m: tuple[float, float]
    height_m: float
    image_lines_samples: tuple[int, int]

    @property
    def image_area_m2(self) -> float:
        """Ground that the image shows, or the overlap if that is less."""
        lines, samples = self.image_lines_samples
        image = lines * samples * self.ground_sample_m[0] * self.ground_sample_m[1]
        return min(image, float(self.shape[0] * self.shape[1]) * self.pixel_m**2)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.bounds[2] - self.bounds[0], self.bounds[3] - self.bounds[1]

    @property
    def mean_sample_m(self) -> float:
        """Geometric mean of the image's ground sample."""
        return float(np.sqrt(self.ground_sample_m[0] * self.ground_sample_m[1]))


def find_overlap(model: SensorModel, terrain: Terrain, dom: Dom, margin_m: float) -> Overlap:
    """Overlap of an image and an orthophoto; the image's place is trusted to `margin_m`.

    `GeometryError` that names both places where there is none.
    """
    ground = _outline(model, terrain)
    height_m = float(np.median(ground[:, 2]))
    sample_m = ground_sample_m(model, height_m)
    mean_m = float(np.sqrt(sample_m[0] * sample_m[1]))
    try:
        place = to_crs(dom.grid.crs, ground)[:, :2]
    except ArgumentError as error:
        raise GeometryError(f"{dom.paths[0]}: coordinate system: {error}") from None
    place = place[np.isfinite(place).all(axis=1)]
    if is_geographic(dom.grid.crs):
        place = near_degrees(place, dom.grid.left)
    pixel_m = pixel_size_m(dom.grid)
    factor = max(1, round(mean_m / pixel_m))
    lattice = dom.coarser(factor)
    if not len(place):
        raise _apart(dom, ground)
    cols = (place[:, 0] - lattice.left) / lattice.resolution
    rows = (lattice.top - place[:, 1]) / lattice.resolution
    low, high = np.array([rows.min(), cols.min()]), np.array([rows.max(), cols.max()])
    limit = np.array(lattice.shape, dtype=np.float64)
    if np.any(high + margin_m / (pixel_m * factor) < 1.0) or np.any(
        low - margin_m / (pixel_m * factor) > limit - 1.0
    ):
        raise _apart(dom, ground)
    low, high = np.clip(np.floor(low), 0, limit), np.clip(np.ceil(high), 0, limit)
    top, left, bottom, right = int(low[0]), int(low[1]), int(high[0]), int(high[1])
    middle = dom.coarser(factor).window(max((top + bottom) // 2 - 1, 0), (left + right) // 2, 2, 2)
    bounds = top, left, bottom, right
    return Overlap(factor, bounds, pixel_size_m(middle), sample_m, height_m, model.shape)


def _outline(model: SensorModel, terrain: Terrain) -> FloatArray:
    """Ground points (n, 3) of a lattice of image points, those that the terrain carries."""
    lines, samples = model.shape
    rows = np.linspace(-0.5, lines - 0.5, _BORDER)
    cols = np.linspace(-0.5, samples - 0.5, _BORDER)
    image = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = locate(model, image, terrain)
    seen = has_result(ground.flag)
    if not seen.any():
        middle = np.array([0.5 * (lines - 1), 0.5 * (samples - 1)])
        height = float(np.mean(model.height_range_m))
        where = np.degrees(model.image_to_ground(middle, height).geodetic)
        raise GeometryError(
            f"terrain: no heights where the image is, about longitude {where[0]:.4f}, "
            f"latitude {where[1]:.4f}"
        )
    return ground.geodetic[seen]


def ground_sample_m(model: SensorModel, height_m: float) -> tuple[float, float]:
    """Ground sample along lines and samples at the middle of the image, metres."""
    lines, samples = model.shape
    middle = np.array([0.5 * (lines - 1), 0.5 * (samples - 1)])
    image = middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    ground = model.image_to_ground(image, height_m).geodetic
    moved = enu_errors_m(ground[1:], ground[:1])
    sizes = np.linalg.norm(moved, axis=1)
    if not np.all(np.isfinite(sizes)):
        raise GeometryError("the model has no ground at the middle of the image")
    return float(sizes[0]), float(sizes[1])


def pixel_size_m(grid: OrthoGrid) -> float:
    """Geometric mean of a pixel's height and width at the middle of `grid`, metres."""
    row, col = 0.5 * grid.shape[0], 0.5 * grid.shape[1]
    ground = grid.geodetic(row + np.array([0.0, 1.0, 0.0]), col + np.array([0.0, 0.0, 1.0]), 0.0)
    sizes = np.linalg.norm(enu_errors_m(ground[1:], ground[:1]), axis=1)
    return float(np.sqrt(sizes[0] * sizes[1]))


def _apart(dom: Dom, ground: FloatArray) -> GeometryError:
    grid = dom.grid
    corners = grid.geodetic(
        np.array([0.0, grid.shape[0] - 1.0]), np.array([0.0, grid.shape[1] - 1.0]), 0.0
    )
    places = []
    for points in (ground, corners):
        low, high = np.degrees(points[:, :2].min(axis=0)), np.degrees(points[:, :2].max(axis=0))
        places.append(f"{low[0]:.4f} .. {high[0]:.4f}, {low[1]:.4f} .. {high[1]:.4f}")
    return GeometryError(
        f"{dom.paths[0]}: no overlap: the image is at longitude, latitude {places[0]}, "
        f"the orthophoto at {places[1]}"
    )
