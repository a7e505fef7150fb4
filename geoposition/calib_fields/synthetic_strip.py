"""Long strips of synthetic ground: the orthophoto where images lie, and the images themselves.

The orthophoto is a lattice over all strips of a field, filled only near them. An image is the
texture's spline where its model sees each pixel: every line by itself, as jitter asks for, and
between nodes along the line within a proved bound. Neither is ever wholly in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any, Final

import numpy as np
import rasterio
import shapely
from numpy.typing import ArrayLike
from rasterio.transform import Affine
from rasterio.windows import Window

from geoposition.arrays import FloatArray, as_components
from geoposition.calib_fields.synthetic_texture import EndlessTexture, Float32Array
from geoposition.datum import to_crs
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import GeometryError, ProductError
from geoposition.flags import Flag, has_result
from geoposition.locate import locate
from geoposition.rays import Rays
from geoposition.reimage.mapping import map_models
from geoposition.reimage.ortho import OrthoGrid
from geoposition.sensor_model import GroundPoints, ImagePoints, SensorModel
from geoposition.surface import to_map
from geoposition.terrain import Terrain

_BORDER: Final = 65
_TILE: Final = 256
_ROWS: Final = 1024
_UP_M: Final = 1000.0


@dataclass(frozen=True, slots=True)
class MapModel:
    """A map's lattice as a `SensorModel`: seen from straight above, whatever the height."""

    grid: OrthoGrid
    height_range_m: tuple[float, float] = (-500.0, 9000.0)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the lattice."""
        return self.grid.shape

    def image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> GroundPoints:
        """Place of fractional pixels (..., 2) of the lattice, at `height_m` (...)."""
        image = as_components(image_px, 2, "map pixels")
        ground = self.grid.geodetic(image[..., 0], image[..., 1], 0.0)
        ground[..., 2] = height_m
        return GroundPoints(ground, _flags(np.isfinite(ground).all(axis=-1)))

    def ground_to_image(self, geodetic: ArrayLike) -> ImagePoints:
        """Fractional pixels of ground points (..., 3), within the lattice or not."""
        points = as_components(geodetic, 3, "geodetic")
        place = to_map(self.grid.crs, points.reshape(-1, 3)).reshape(points.shape)
        row = (self.grid.top - place[..., 1]) / self.grid.resolution - 0.5
        col = (place[..., 0] - self.grid.left) / self.grid.resolution - 0.5
        image = np.stack([row, col], axis=-1)
        return ImagePoints(image, _flags(np.isfinite(image).all(axis=-1)))

    def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
        """Verticals."""
        found = self.image_to_ground(image_px, height_m)
        origin = geodetic_to_ecef(found.geodetic + np.array([0.0, 0.0, _UP_M]))
        return Rays(origin, (geodetic_to_ecef(found.geodetic) - origin) / _UP_M, found.flag)


def _flags(known: Any) -> Any:
    return np.where(known, Flag.OK, Flag.BAD_INPUT).astype(np.uint8)


def footprint(model: SensorModel, terrain: Terrain) -> FloatArray:
    """Outline (n, 3) of what `model` sees of `terrain`, around the image's edge."""
    lines, samples = model.shape
    along = np.linspace(-0.5, lines - 0.5, _BORDER)
    across = np.linspace(-0.5, samples - 0.5, _BORDER)
    first, last = np.full(_BORDER, across[0]), np.full(_BORDER, across[-1])
    top, bottom = np.full(_BORDER, along[0]), np.full(_BORDER, along[-1])
    sides = ((top, across), (along, last), (bottom, across[::-1]), (along[::-1], first))
    image = np.concatenate([np.stack(side, axis=-1) for side in sides])
    found = locate(model, image, terrain)
    if not has_result(found.flag).all():
        raise GeometryError("synthetic field: the terrain does not reach around the image")
    return found.geodetic


def lattice_around(
    outlines: Sequence[FloatArray], crs: str, resolution: float, margin_m: float
) -> OrthoGrid:
    """Lattice in `crs` around footprints (n, 3), on whole multiples of its `resolution`."""
    place = np.concatenate([to_crs(crs, outline)[:, :2] for outline in outlines])
    low = np.floor((place.min(axis=0) - margin_m) / resolution)
    high = np.ceil((place.max(axis=0) + margin_m) / resolution)
    cols, rows = (int(n) for n in high - low)
    left, top = float(low[0] * resolution), float(high[1] * resolution)
    return OrthoGrid(crs, left, top, resolution, (rows, cols))


def write_strip_dom(
    path: str | PathLike[str],
    grid: OrthoGrid,
    texture: EndlessTexture,
    outlines: Sequence[FloatArray],
    margin_m: float,
    *,
    factor: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write an 8-bit orthophoto, 0 for no data, filled within `margin_m` of `outlines` (n, 3).

    Its pixels are means of `factor` × `factor` pixels of `grid`, on which the texture lies.
    """
    shapes = [shapely.Polygon(to_crs(grid.crs, outline)[:, :2]) for outline in outlines]
    wanted = shapely.union_all(shapes).buffer(margin_m)
    shapely.prepare(wanted)
    rows, cols = (n // factor for n in grid.shape)
    res = factor * grid.resolution
    try:
        with rasterio.open(
            fspath(path), "w", driver="GTiff", width=cols, height=rows, count=1, dtype="uint8",
            crs=grid.crs, transform=Affine(res, 0.0, grid.left, 0.0, -res, grid.top), nodata=0,
            tiled=True, blockxsize=_TILE, blockysize=_TILE, compress="deflate", zlevel=1,
            num_threads="all_cpus", sparse_ok=True, bigtiff="if_safer",
        ) as file:  # fmt: skip
            for row in range(0, rows, _TILE):
                count = min(_TILE, rows - row)
                for col in range(0, cols, _TILE):
                    size = min(_TILE, cols - col)
                    left, top = grid.left + col * res, grid.top - row * res
                    tile = shapely.box(left, top - count * res, left + size * res, top)
                    if not wanted.intersects(tile):
                        continue
                    corner, fine = (factor * row, factor * col), (factor * count, factor * size)
                    grey = texture.pixels(*corner, *fine)
                    mean = grey.reshape(count, factor, size, factor).mean(axis=(1, 3))
                    values = np.clip(np.rint(255.0 * mean), 1.0, 255.0).astype(np.uint8)
                    file.write(values, 1, window=Window(col, row, size, count))
                if progress is not None:
                    progress(row + count, rows)
    except rasterio.errors.RasterioError as error:
        raise ProductError(path, "", f"a writable place expected ({error})") from None


def strip_image(
    model: SensorModel, terrain: Terrain, grid: OrthoGrid, texture: EndlessTexture
) -> Iterator[tuple[int, Float32Array]]:
    """Brightness that `model` sees of `texture` on `terrain`: first line and (lines, samples).

    The texture lies on the pixels of `grid`, and beyond. Each pixel is one look at its spline.
    """
    mapping = map_models(model, MapModel(grid), terrain)
    lines, samples = model.shape
    col = np.arange(samples, dtype=np.float64)
    for start in range(0, lines, _ROWS):
        stop = min(start + _ROWS, lines)
        place = mapping.rows(start, stop).displacement_px(col)
        place[..., 0] += np.arange(start, stop, dtype=np.float64)[:, None]
        place[..., 1] += col
        yield (
            start,
            texture.at(np.ascontiguousarray(place[..., 0]), np.ascontiguousarray(place[..., 1])),
        )
