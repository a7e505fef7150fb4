"""The image on the reference orthophoto's lattice, window by window.

The lattice is the orthophoto's own, made coarser by a whole factor until its pixels are about as
large as the image's. The image is brought there through its model and the terrain, so that what
remains between the two is the model's error; a correction found so far is put on top, in image
pixels, because a shift in the image is not a constant shift on uneven ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.windows import Window

from geoposition.arrays import FlagArray, FloatArray
from geoposition.calib_fields.dom import Dom, opened
from geoposition.calib_fields.places import image_places
from geoposition.calib_fields.smooth import ImageCorrection
from geoposition.errors import ProductError
from geoposition.flags import Flag
from geoposition.matching import ImageSource
from geoposition.reimage.ortho import OrthoGrid, block_means
from geoposition.reimage.resample import Resampler
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

__all__ = ["Dom", "OrthoImage", "OrthoWindow"]

_RESAMPLER: Final = Resampler("lanczos", nodata=None)


@dataclass(frozen=True, slots=True, eq=False)
class OrthoImage:
    """An image, its model and the terrain: grey values on any upright lattice.

    `correction` is added to where the model says a ground point lies. Cells of `node_px` of the
    lattice that lie beyond the image in part are left out.
    """

    source: ImageSource
    model: SensorModel
    terrain: Terrain
    correction: ImageCorrection
    node_px: int = 32

    def on(self, grid: OrthoGrid, ground_sample_m: float, pixel_m: float) -> OrthoWindow:
        """Bring the image to `grid`, whose pixels are `pixel_m` wide, the image's own as given.

        Coarser pixels are means of the image's, so that no detail folds over.
        """
        decimation = max(1, int(pixel_m / ground_sample_m + 0.2))
        finer = 2 if pixel_m / (ground_sample_m * decimation) > 1.2 else 1
        fine = grid.finer(finer)
        image_px, flag = image_places(self.model, self.terrain, fine, first_step=self.node_px)
        image_px += self.correction.at(image_px)
        grey = _grey_at(self.source, image_px, decimation)
        if finer > 1:
            valid = np.isfinite(grey).astype(np.uint8)
            means, seen = block_means(np.nan_to_num(grey)[None], valid, finer)
            full = valid.reshape(grid.shape[0], finer, grid.shape[1], finer).all(axis=(1, 3))
            grey = np.where((seen != 0) & full, means[0], np.nan)
            flag = flag[::finer, ::finer]
        return OrthoWindow(grey, flag)


@dataclass(frozen=True, slots=True, eq=False)
class OrthoWindow:
    """Grey values (rows, cols) of an image on a lattice, NaN where `flag` says why not."""

    grey: FloatArray
    flag: FlagArray

    @property
    def without_height(self) -> FlagArray:
        """1 where the terrain has no height."""
        holes: FlagArray = np.isin(self.flag, (Flag.NODATA, Flag.OUTSIDE_TERRAIN)).astype(np.uint8)
        return holes


def _grey_at(source: ImageSource, image_px: FloatArray, decimation: int) -> FloatArray:
    """Grey values (rows, cols) at places (rows, cols, 2) in the model's frame; NaN outside."""
    out: FloatArray = np.full(image_px.shape[:-1], np.nan)
    # in the file, then in its coarse pixels
    place = image_px - (source.first_line, source.first_sample)
    inside = np.all((place >= -0.5) & (place <= np.array(source.shape) - 0.5), axis=-1)
    if not inside.any():
        return out
    place = (place + 0.5) / decimation - 0.5
    reach = _RESAMPLER.reach + 1
    coarse = np.array([max(n // decimation, 1) for n in source.shape])
    low = np.floor(place[inside].min(axis=0)).astype(int) - reach
    high = np.ceil(place[inside].max(axis=0)).astype(int) + reach + 1
    low, high = np.clip(low, 0, coarse - 1), np.clip(high, 1, coarse)
    values = _decimated(source, low, high, decimation)
    line, sample = (np.where(inside, place[..., k], np.nan) for k in (0, 1))
    grey, valid = _RESAMPLER.at(values, line, sample, (int(low[0]), int(low[1])))
    found: FloatArray = np.where(valid != 0, grey[0].astype(np.float64), np.nan)
    return found


def _decimated(
    source: ImageSource, low: NDArray[np.int_], high: NDArray[np.int_], factor: int
) -> NDArray[np.float32]:
    """Means (1, rows, cols) of `factor` × `factor` pixels of the file, NaN for nodata."""
    rows, cols = (int(n) for n in high - low)
    window = Window(int(low[1]) * factor, int(low[0]) * factor, cols * factor, rows * factor)
    try:
        with opened(source.path) as file:
            grey = file.read(
                source.band,
                window=window,
                out_shape=(rows, cols),
                resampling=Resampling.average if factor > 1 else Resampling.nearest,
                masked=True,
                out_dtype="float32",
            )
    except RasterioError as error:
        raise ProductError(source.path, "pixels", f"cannot be read ({error})") from None
    values: NDArray[np.float32] = np.ma.filled(grey.astype(np.float32), np.nan)[None]
    return np.ascontiguousarray(values)
