"""Synthetic ground: a smooth fractal landscape, the same for the same seed, as a raster.

Spectral synthesis: a random field whose power falls with the wave number to a power, up to a
shortest wavelength, stretched to a stated range of heights. *Source*: Saupe in Peitgen & Saupe
(eds) 1988, The Science of Fractal Images, section 2.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike, fspath

import numpy as np
import rasterio
from rasterio.transform import Affine
from scipy import fft

from geoposition.arrays import FloatArray, read_only
from geoposition.ellipsoid import meridian_radius_m, normal_radius_m
from geoposition.errors import ArgumentError, ProductError


@dataclass(frozen=True, slots=True)
class SyntheticTerrain:
    """Ellipsoidal heights (rows, cols) at pixel centres of a longitude-latitude raster.

    Row 0 is the northernmost; the centre of its first pixel is at `west_rad`, `north_rad`, the
    pixels are `step_rad` wide and high.
    """

    height_m: FloatArray
    west_rad: float
    north_rad: float
    step_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "height_m", read_only(self.height_m))

    def write(self, path: str | PathLike[str]) -> None:
        """Write a GeoTIFF of 32-bit heights; its system, EPSG:4979, says they are ellipsoidal."""
        step = float(np.degrees(self.step_rad))
        west, north = np.degrees(self.west_rad), np.degrees(self.north_rad)
        rows, cols = self.height_m.shape
        try:
            with rasterio.open(
                fspath(path),
                "w",
                driver="GTiff",
                width=cols,
                height=rows,
                count=1,
                dtype="float32",
                crs="EPSG:4979",
                transform=Affine(step, 0.0, west - 0.5 * step, 0.0, -step, north + 0.5 * step),
                compress="deflate",
                predictor=3,
                tiled=True,
            ) as file:
                file.write(self.height_m.astype(np.float32), 1)
                file.update_tags(AREA_OR_POINT="Area")
                file.set_band_description(1, "synthetic ellipsoidal height, metres")
        except rasterio.errors.RasterioError as error:
            raise ProductError(path, "", f"a writable place expected ({error})") from None


def synthetic_terrain(
    centre_lon_rad: float,
    centre_lat_rad: float,
    width_m: float,
    height_m: float,
    *,
    seed: int = 0,
    lowest_m: float = 500.0,
    highest_m: float = 2500.0,
    step_rad: float = float(np.radians(2.0 / 3600.0)),
    shortest_m: float = 800.0,
    roughness: float = 4.0,
) -> SyntheticTerrain:
    """Landscape of about `width_m` by `height_m` around a place, from `lowest_m` to `highest_m`.

    `shortest_m` is the shortest wavelength; `roughness` the exponent with which power falls
    (2 rugged, 4 gently rolling).
    """
    if not (0.0 < step_rad < 0.1 and abs(centre_lat_rad) < 1.4 and lowest_m < highest_m):
        raise ArgumentError(
            "synthetic terrain: a small step, latitudes below 80 deg, lowest < highest"
        )
    step_north_m = float(step_rad * meridian_radius_m(centre_lat_rad))
    step_east_m = float(step_rad * normal_radius_m(centre_lat_rad) * np.cos(centre_lat_rad))
    rows, cols = round(height_m / step_north_m) + 1, round(width_m / step_east_m) + 1
    if min(rows, cols) < 8 or rows * cols > 50_000_000:
        raise ArgumentError(
            f"synthetic terrain: 8 to some thousand pixels each way, got {rows}, {cols}"
        )
    step_m = step_north_m, step_east_m
    rng = np.random.default_rng(seed)
    field = fractal_field((rows, cols), step_m, shortest_m, roughness, rng)
    # float32 as written, so that what is in memory is what a reader finds
    heights = (lowest_m + (highest_m - lowest_m) * field).astype(np.float32)
    return SyntheticTerrain(
        heights.astype(np.float64),
        centre_lon_rad - 0.5 * (cols - 1) * step_rad,
        centre_lat_rad + 0.5 * (rows - 1) * step_rad,
        step_rad,
    )


def fractal_field(
    shape: tuple[int, int],
    step_m: tuple[float, float],
    shortest_m: float,
    roughness: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Random field (rows, cols) from 0 to 1, smooth below `shortest_m`, not periodic.

    The power falls as wave number to −`roughness`, flat below one cycle over the field.
    """
    # More is made than kept: the whole one repeats itself at its edges.
    rows, cols = (fft.next_fast_len(int(1.3 * size), real=True) for size in shape)
    k_rows = fft.fftfreq(rows, step_m[0])[:, None]
    k_cols = fft.rfftfreq(cols, step_m[1])[None, :]
    k = np.hypot(k_rows, k_cols)
    longest = 1.0 / max(shape[0] * step_m[0], shape[1] * step_m[1])
    amplitude = np.maximum(k, longest) ** (-0.5 * roughness)
    amplitude *= np.exp(-((k * shortest_m) ** 4))
    amplitude[0, 0] = 0.0
    noise = fft.rfft2(rng.standard_normal((rows, cols)))
    field = fft.irfft2(noise * amplitude, s=(rows, cols))[: shape[0], : shape[1]]
    low, high = field.min(), field.max()
    result: FloatArray = (field - low) / (high - low)
    return result
