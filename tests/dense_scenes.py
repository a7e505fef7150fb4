"""Small pairs of images with known heights, for the tests of dense matching."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from scipy.ndimage import gaussian_filter, map_coordinates

from geoposition.dense import View, level_field
from geoposition.dense.height_field import HeightField
from geoposition.matching import ImageSource, open_image
from geoposition.matching.image import Window
from geoposition.rpc.model import RpcModel

LON_DEG, LAT_DEG = 7.0, 44.0
HALF_LON_DEG, HALF_LAT_DEG = 0.0016, 0.00115
"""An image of 512 pixels of half a metre."""
MIDDLE_M = 500.0
SCALE_M = 500.0


def rpc(
    size: int, line_per_m: float, sample_per_m: float = 0.0, shift: tuple[float, float] = (0.0, 0.0)
) -> RpcModel:
    """Parallel lines of sight: ground a metre higher lies so many lines and samples further on."""
    half = 0.5 * (size - 1.0)
    one, line, samp = np.zeros(20), np.zeros(20), np.zeros(20)
    one[0] = 1.0
    line[2], line[3] = -1.0, line_per_m * SCALE_M / half
    samp[1], samp[3] = 1.0, sample_per_m * SCALE_M / half
    scale = size / 512.0
    return RpcModel(
        half + shift[0], half, half + shift[1], half,
        LON_DEG, HALF_LON_DEG * scale, LAT_DEG, HALF_LAT_DEG * scale, MIDDLE_M, SCALE_M,
        line, one, samp, one, (size, size),
    )  # fmt: skip


@dataclass(frozen=True)
class Pair:
    """Images, their models, and the height at every pixel of the first one."""

    paths: list[Path]
    models: list[RpcModel]
    height_m: np.ndarray

    @property
    def sources(self) -> list[ImageSource]:
        return [open_image(path, first_pixel=(0, 0)) for path in self.paths]

    def views(self) -> list[View]:
        return [View(s, m, m) for s, m in zip(self.sources, self.models, strict=True)]

    def start(self, below: float = 40.0, above: float = 40.0) -> HeightField:
        extent = Window(0, 0, *self.height_m.shape)
        return level_field(extent, MIDDLE_M, 64.0).within(-below, above)


def hills(size: int, amplitude_m: float = 12.0) -> np.ndarray:
    v, u = np.mgrid[0:size, 0:size].astype(float)
    return MIDDLE_M + amplitude_m * (np.sin(v / 70.0 + 0.3) * np.cos(u / 90.0) + 0.05 * u / 90.0)


def texture(size: int, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    grey = sum(
        share * (lambda a: a / a.std())(gaussian_filter(rng.normal(size=(size, size)), sigma))
        for sigma, share in ((1.2, 100.0), (3.0, 80.0), (9.0, 80.0))
    )
    return 900.0 + grey


def write(path: Path, grey: np.ndarray, model: RpcModel | None = None) -> Path:
    """Write 12-bit pixels, with the model's coefficients as tags if one is given."""
    profile = {
        "driver": "GTiff", "dtype": "uint16", "count": 1,
        "height": grey.shape[0], "width": grey.shape[1],
    }  # fmt: skip
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile) as out:
            out.write(np.clip(np.rint(grey), 0, 4095).astype(np.uint16), 1)
            if model is not None:
                out.rpcs = gdal_rpcs(model)
    return path


def gdal_rpcs(model: RpcModel) -> rasterio.rpc.RPC:
    return rasterio.rpc.RPC(
        height_off=model.height_off_m, height_scale=model.height_scale_m,
        lat_off=model.lat_off_deg, lat_scale=model.lat_scale_deg,
        line_den_coeff=list(model.line_den), line_num_coeff=list(model.line_num),
        line_off=model.line_off_px, line_scale=model.line_scale_px,
        long_off=model.lon_off_deg, long_scale=model.lon_scale_deg,
        samp_den_coeff=list(model.samp_den), samp_num_coeff=list(model.samp_num),
        samp_off=model.samp_off_px, samp_scale=model.samp_scale_px,
    )  # fmt: skip


def pair(
    folder: Path,
    size: int = 512,
    parallax: tuple[tuple[float, float], ...] = ((0.8, 0.0),),
    shifts: tuple[tuple[float, float], ...] = ((0.0, 0.0),),
    noise: float = 3.0,
    height_m: np.ndarray | None = None,
) -> Pair:
    """First image straight down; each further one with its own parallax (px/m), and shifted.

    A shifted image shows everything `shifts` px further on than its model says.
    """
    height = hills(size) if height_m is None else height_m
    grey = texture(size)
    rng = np.random.default_rng(8)
    models = [rpc(size, 0.0)]
    paths = [write(folder / "a.tif", grey + rng.normal(0, noise, grey.shape), models[0])]
    v, u = np.mgrid[0:size, 0:size].astype(float)
    for k, ((dl, ds), (sl, ss)) in enumerate(zip(parallax, shifts, strict=True)):
        # Which pixel of the first image shows what this one's pixel shows: by iteration.
        line, sample = v - sl, u - ss
        for _ in range(20):
            here = map_coordinates(height, [line, sample], order=1, mode="nearest") - MIDDLE_M
            line, sample = v - sl - dl * here, u - ss - ds * here
        seen = map_coordinates(grey, [line, sample], order=3, mode="mirror")
        model = rpc(size, dl, ds)
        models.append(model)
        path = folder / f"{'bcdef'[k]}.tif"
        paths.append(write(path, seen + rng.normal(0, noise, seen.shape), model))
    return Pair(paths, models, height)
