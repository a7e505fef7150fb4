"""A first height for image points of two models, from how far apart they are.

A line of sight is exact only near the height for which it was made, and a height known to some
metres saves making it twice. On a grid of image points of the first model, at several heights,
both models tell where the ground appears in the second image. With (l, s) the place in the
first image and t the place in the second one along the mean direction of parallax, less its
plane over (l, s), the height is a cubic in (l, s, t).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FloatArray
from geoposition.flags import has_result
from geoposition.pushbroom.model import cubic_terms
from geoposition.sensor_model import SensorModel

_GRID: Final = 12
_LEVELS: Final = 4
_FEWEST: Final = 60
_MARGIN_M: Final = 2000.0
_LEAST_RANGE_M: Final = 200.0


@dataclass(frozen=True, slots=True, eq=False)
class HeightStart:
    """Cubic height over (line, sample) of the first image and parallax in the second.

    `centre` and `scale` (3,) normalise line, sample, t; t = `along` · image point of the second
    − `plane` · (1, line, sample). `coefficients` (20,) give metres. Heights are kept within
    `low_m` .. `high_m`. `error_m` is the largest misfit at the grid.
    """

    centre: FloatArray
    scale: FloatArray
    along: FloatArray
    plane: FloatArray
    coefficients: FloatArray
    low_m: float
    high_m: float
    error_m: float

    def heights_m(self, first_px: FloatArray, second_px: FloatArray) -> FloatArray:
        """Heights (n,) of image points (n, 2) of the first and the second model."""
        out = np.empty(len(first_px))
        _heights(
            np.ascontiguousarray(first_px),
            np.ascontiguousarray(second_px),
            self.centre,
            self.scale,
            self.along,
            self.plane,
            self.coefficients,
            self.low_m,
            self.high_m,
            out,
        )
        return out


def height_range_m(models: list[SensorModel]) -> tuple[float, float]:
    """Heights that all `models` are meant for; where there are none, those any is meant for."""
    lows, highs = zip(*(model.height_range_m for model in models), strict=True)
    low, high = max(lows), min(highs)
    return (low, high) if low < high else (min(lows), max(highs))


def height_start(first: SensorModel, second: SensorModel) -> HeightStart | None:
    """Fit the cubic, or None where the images do not overlap or show no parallax."""
    low, high = height_range_m([first, second])
    if high - low < _LEAST_RANGE_M:
        middle = 0.5 * (low + high)
        low, high = middle - 0.5 * _LEAST_RANGE_M, middle + 0.5 * _LEAST_RANGE_M
    lines, samples = first.shape
    grid = np.meshgrid(
        np.linspace(0.0, lines - 1.0, _GRID),
        np.linspace(0.0, samples - 1.0, _GRID),
        np.linspace(low, high, _LEVELS),
        indexing="ij",
    )
    image = np.stack(grid[:2], axis=-1).reshape(-1, 2)
    height = grid[2].reshape(-1)
    ground = first.image_to_ground(image, height)
    seen = second.ground_to_image(ground.geodetic)
    good = (has_result(ground.flag) & has_result(seen.flag)).reshape(-1, _LEVELS)
    good &= good.all(axis=1, keepdims=True)
    if good.sum() < _FEWEST:
        return None
    other = seen.image_px.reshape(-1, _LEVELS, 2)
    parallax = (other[:, -1] - other[:, 0])[good[:, 0]].mean(axis=0)
    if not float(np.hypot(*parallax)) > 1e-3 * (high - low) / _LEAST_RANGE_M:
        return None
    along = parallax / np.hypot(*parallax)
    use = good.reshape(-1)
    image, other, height = image[use], seen.image_px[use], height[use]
    flat = np.column_stack([np.ones(len(image)), image])
    position = other @ along
    plane = np.linalg.lstsq(flat, position, rcond=None)[0]
    place = np.column_stack([image, position - flat @ plane])
    centre = 0.5 * (place.max(axis=0) + place.min(axis=0))
    scale = np.maximum(0.5 * np.ptp(place, axis=0), 1.0)
    terms = cubic_terms((place - centre) / scale)
    coefficients = np.asarray(np.linalg.lstsq(terms, height, rcond=1e-12)[0], dtype=np.float64)
    return HeightStart(
        centre=centre,
        scale=scale,
        along=along,
        plane=plane,
        coefficients=coefficients,
        low_m=low - _MARGIN_M,
        high_m=high + _MARGIN_M,
        error_m=float(np.max(np.abs(terms @ coefficients - height))),
    )


@njit(
    cache=True, parallel=True, error_model="numpy", fastmath={"contract", "arcp", "nsz", "reassoc"}
)
def _heights(
    first_px: FloatArray,
    second_px: FloatArray,
    centre: FloatArray,
    scale: FloatArray,
    along: FloatArray,
    plane: FloatArray,
    c: FloatArray,
    low_m: float,
    high_m: float,
    out: FloatArray,
) -> None:
    c0, c1, c2 = centre[0], centre[1], centre[2]
    s0, s1, s2 = 1.0 / scale[0], 1.0 / scale[1], 1.0 / scale[2]
    for i in prange(len(out)):
        line, sample = first_px[i, 0], first_px[i, 1]
        t = second_px[i, 0] * along[0] + second_px[i, 1] * along[1]
        t -= plane[0] + plane[1] * line + plane[2] * sample
        e, n, u = (line - c0) * s0, (sample - c1) * s1, (t - c2) * s2
        # The order of the terms is that of `pushbroom.cubic_terms`.
        height = (
            c[0]
            + e * (c[1] + e * (c[4] + e * c[10] + n * c[11] + u * c[12]))
            + n * (c[2] + n * (c[5] + n * c[13] + e * c[14] + u * c[15]))
            + u * (c[3] + u * (c[6] + u * c[16] + e * c[17] + n * c[18]))
            + e * n * (c[7] + u * c[19])
            + e * u * c[8]
            + n * u * c[9]
        )
        # A wild parallax says nothing of the height; NaN takes the middle.
        if not low_m <= height <= high_m:
            height = (
                low_m if height < low_m else (high_m if height > high_m else 0.5 * (low_m + high_m))
            )
        out[i] = height
