"""Synthetic orthophotos and the images a sensor model takes of them, for tests and planning.

The texture has three parts: a fractal whose power falls as that of real ground, parcels of even
brightness as fields and roofs have, and fine grain. It is band-limited to a few pixels, so that
a spline between its pixels is the ground itself and an image rendered from it has a known truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike, fspath
from typing import Final

import numpy as np
import rasterio
from rasterio.transform import Affine
from scipy import ndimage

from geoposition.arrays import FloatArray, read_only
from geoposition.calib_fields.synthetic import fractal_field
from geoposition.datum import to_crs
from geoposition.errors import ArgumentError, ProductError
from geoposition.flags import has_result
from geoposition.locate import locate
from geoposition.reimage.ortho import OrthoGrid
from geoposition.sensor_model import SensorModel
from geoposition.surface import to_map
from geoposition.terrain import Terrain

_SHORTEST_PX: Final = 3.0
_PARCEL_PX: Final = 24
_ROWS: Final = 256


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticDom:
    """Grey values (rows, cols), about 20 to 230, at the pixels of `grid`."""

    grey: FloatArray
    grid: OrthoGrid

    def __post_init__(self) -> None:
        object.__setattr__(self, "grey", read_only(self.grey))

    def write(self, path: str | PathLike[str], dtype: str = "float32") -> None:
        """Write a tiled GeoTIFF."""
        rows, cols = self.grid.shape
        res = self.grid.resolution
        values = np.rint(self.grey) if np.dtype(dtype).kind in "ui" else self.grey
        try:
            with rasterio.open(
                fspath(path),
                "w",
                driver="GTiff",
                width=cols,
                height=rows,
                count=1,
                dtype=dtype,
                crs=self.grid.crs,
                transform=Affine(res, 0.0, self.grid.left, 0.0, -res, self.grid.top),
                compress="deflate",
                tiled=True,
            ) as file:
                file.write(values.astype(dtype), 1)
        except rasterio.errors.RasterioError as error:
            raise ProductError(path, "", f"a writable place expected ({error})") from None


def synthetic_dom(grid: OrthoGrid, seed: int = 0) -> SyntheticDom:
    """Make the texture of `grid`; the same seed gives the same to the last bit."""
    rows, cols = grid.shape
    if min(rows, cols) < 32 or rows * cols > 200_000_000:
        raise ArgumentError(f"synthetic orthophoto: 32 to some thousand pixels a side, got {grid}")
    rng = np.random.default_rng(seed)
    step = 1.0, 1.0
    rough = fractal_field(grid.shape, step, _SHORTEST_PX, 2.4, rng)
    grain = fractal_field(grid.shape, step, _SHORTEST_PX, 0.6, rng)
    parcels = _parcels(grid.shape, rng)
    mixed = sum(
        weight * (part - part.mean()) / part.std()
        for weight, part in ((1.0, rough), (0.8, parcels), (0.5, grain))
    )
    level: FloatArray = np.clip(125.0 + 30.0 * np.asarray(mixed), 0.0, 255.0)
    return SyntheticDom(level, grid)


def _parcels(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Areas of even brightness around scattered points, edges softened to the band's limit."""
    count = max(4, shape[0] * shape[1] // _PARCEL_PX**2)
    seeds = np.zeros(shape, dtype=np.bool_)
    seeds[rng.integers(0, shape[0], count), rng.integers(0, shape[1], count)] = True
    nearest = ndimage.distance_transform_edt(~seeds, return_distances=False, return_indices=True)
    value = rng.standard_normal(shape)
    soft: FloatArray = ndimage.gaussian_filter(value[nearest[0], nearest[1]], 1.1)
    return soft


def synthetic_image(
    model: SensorModel,
    terrain: Terrain,
    dom: SyntheticDom,
    *,
    noise: float = 0.0,
    gain: float = 1.0,
    offset: float = 0.0,
    seed: int = 0,
) -> FloatArray:
    """Take the image (lines, samples) that `model` sees of `dom` on `terrain`; NaN off it.

    Each pixel is one look at the orthophoto's spline: right where its pixels are not much finer
    than the image's. `noise` is the standard deviation in grey values.
    """
    lines, samples = model.shape
    grid = dom.grid
    spline = ndimage.spline_filter(dom.grey, 3, mode="mirror")
    geographic = _degrees(grid)
    out = np.empty((lines, samples))
    for start in range(0, lines, _ROWS):
        stop = min(start + _ROWS, lines)
        image = np.stack(
            np.meshgrid(
                np.arange(start, stop, dtype=np.float64),
                np.arange(samples, dtype=np.float64),
                indexing="ij",
            ),
            axis=-1,
        ).reshape(-1, 2)
        ground = locate(model, image, terrain)
        points = np.where(has_result(ground.flag)[:, None], ground.geodetic, np.nan)
        place = to_map(grid.crs, points, geographic)
        row = (grid.top - place[:, 1]) / grid.resolution - 0.5
        col = (place[:, 0] - grid.left) / grid.resolution - 0.5
        inside = (
            (row >= 0.0)
            & (row <= grid.shape[0] - 1.0)
            & (col >= 0.0)
            & (col <= grid.shape[1] - 1.0)
        )
        at = np.stack([np.where(inside, row, 0.0), np.where(inside, col, 0.0)])
        grey = ndimage.map_coordinates(spline, at, order=3, mode="mirror", prefilter=False)
        out[start:stop] = np.where(inside, grey, np.nan).reshape(stop - start, samples)
    rng = np.random.default_rng(seed)
    result: FloatArray = offset + gain * out + noise * rng.standard_normal(out.shape)
    return result


def _degrees(grid: OrthoGrid) -> bool:
    """Whether the lattice is in degrees: one north of a place is one more of its latitude."""
    place = to_crs(grid.crs, np.array([[0.1, 0.1, 0.0]]))[0]
    return bool(abs(place[0] - np.degrees(0.1)) < 0.1 and abs(place[1] - np.degrees(0.1)) < 0.1)
