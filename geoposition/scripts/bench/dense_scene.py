"""A pair of images of any size with known heights, written strip by strip: for dense matching.

Both models are RPCs with straight, parallel lines of sight. The first looks straight down; in
the second, ground at height h lies `PARALLAX_PX_PER_M` · h lines further on, so that the pair
has a base-to-height ratio of that times the pixel size.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from numba import njit, prange
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning
from rasterio.windows import Window
from scipy.ndimage import gaussian_filter

from geoposition.arrays import FloatArray
from geoposition.constants import WGS84_A_M
from geoposition.matching import ImageSource, open_image
from geoposition.rpc.model import RpcModel

PARALLAX_PX_PER_M: Final = 0.8
PIXEL_M: Final = 0.5
LON_DEG: Final = 7.0
LAT_DEG: Final = 44.0
MIDDLE_M: Final = 500.0

_RELIEF_M: Final = 120.0
_TEXTURE: Final = 2048
_STRIP: Final = 512


@dataclass(frozen=True, slots=True)
class DenseScene:
    """Two images and their models; `height_m` tells the truth at the second's pixels."""

    sources: tuple[ImageSource, ImageSource]
    models: tuple[RpcModel, RpcModel]


def dense_scene(folder: Path, size: int, seed: int = 1) -> DenseScene:
    """Write both images, `size` × `size` pixels of 12 bits, and return them with their models."""
    texture = _texture(seed)
    noise = np.random.default_rng(seed + 1)
    paths = folder / "first.tif", folder / "second.tif"
    for path, shown in zip(paths, (False, True), strict=True):
        profile = {
            "driver": "GTiff", "dtype": "uint16", "count": 1, "width": size, "height": size,
            "tiled": True, "blockxsize": 512, "blockysize": 512,
        }  # fmt: skip
        with _plain(), rasterio.open(path, "w", **profile) as out:
            for line, lines in _strips(size):
                height = true_height_m(line, lines, size) if shown else np.full((1, 1), MIDDLE_M)
                grey = np.empty((lines, size), dtype=np.float32)
                _render(texture, float(line), PARALLAX_PX_PER_M, height - MIDDLE_M, grey)
                grey += noise.normal(0.0, 4.0, grey.shape).astype(np.float32)
                band = np.clip(np.rint(grey), 0, 4095).astype(np.uint16)
                out.write(band, 1, window=Window(0, line, size, lines))
    sources = (open_image(paths[0], first_pixel=(0, 0)), open_image(paths[1], first_pixel=(0, 0)))
    return DenseScene(sources, (rpc(size, 0.0), rpc(size, PARALLAX_PX_PER_M)))


def true_height_m(line: int, lines: int, size: int) -> FloatArray:
    """Heights (lines, size) that the second image's pixels show: waves of many lengths."""
    v = np.arange(line, line + lines, dtype=np.float64)[:, None]
    u = np.arange(size, dtype=np.float64)[None, :]
    height = 0.55 * np.sin(v / 900.0 + 0.4) * np.cos(u / 1100.0)
    height += 0.3 * np.sin(u / 310.0 + v / 470.0) + 0.05 * np.sin(v / 61.0) * np.sin(u / 53.0)
    out: FloatArray = MIDDLE_M + 0.5 * _RELIEF_M * height
    return out


def rpc(size: int, parallax_px_per_m: float) -> RpcModel:
    """RPC of an image of PIXEL_M pixels about (`LON_DEG`, `LAT_DEG`), north up."""
    half = 0.5 * (size - 1.0)
    lat_scale = np.degrees(half * PIXEL_M / WGS84_A_M)
    lon_scale = lat_scale / np.cos(np.radians(LAT_DEG))
    height_scale = 500.0
    one, line, samp = np.zeros(20), np.zeros(20), np.zeros(20)
    one[0] = 1.0
    line[2], line[3] = -1.0, parallax_px_per_m * height_scale / half
    samp[1] = 1.0
    return RpcModel(
        half, half, half, half, LON_DEG, float(lon_scale), LAT_DEG, float(lat_scale),
        MIDDLE_M, height_scale, line, one, samp, one, (size, size),
    )  # fmt: skip


@contextmanager
def _plain() -> Iterator[None]:
    """Images have no map coordinates, which is as it should be."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def _strips(size: int) -> Iterator[tuple[int, int]]:
    for line in range(0, size, _STRIP):
        yield line, min(_STRIP, size - line)


def _texture(seed: int) -> NDArray[np.float32]:
    """Grey values that repeat: detail of one to eight pixels."""
    rng = np.random.default_rng(seed)
    grey = np.zeros((_TEXTURE, _TEXTURE), dtype=np.float32)
    for sigma, share in ((1.1, 110.0), (3.0, 90.0), (8.0, 90.0)):
        layer = gaussian_filter(rng.normal(size=grey.shape).astype(np.float32), sigma, mode="wrap")
        grey += np.float32(share / layer.std()) * layer
    return grey + np.float32(900.0)


@njit(cache=True, parallel=True, error_model="numpy")
def _render(
    texture: NDArray[np.float32],
    first_line: float,
    px_per_m: float,
    height: FloatArray,
    out: NDArray[np.float32],
) -> None:
    """Fill in what each pixel shows: the texture, `px_per_m` · height lines before it."""
    n = texture.shape[0]
    flat = height.shape[0] == 1
    for i in prange(out.shape[0]):
        for j in range(out.shape[1]):
            off = 0.0 if flat else px_per_m * height[i, j]
            x = first_line + i - off
            k = int(np.floor(x))
            t = x - k
            g0, g1 = texture[(k - 1) % n, j % n], texture[k % n, j % n]
            g2, g3 = texture[(k + 1) % n, j % n], texture[(k + 2) % n, j % n]
            c1 = 0.5 * (g2 - g0)
            c2 = g0 - 2.5 * g1 + 2.0 * g2 - 0.5 * g3
            c3 = 0.5 * (g3 - g0) + 1.5 * (g1 - g2)
            out[i, j] = g1 + t * (c1 + t * (c2 + t * c3))
