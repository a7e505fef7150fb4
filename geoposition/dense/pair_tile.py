"""One core of the first image matched with another image: read, resample, match, intersect."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.dense import resample
from geoposition.dense.epipolar import EpipolarTile, epipolar_tile, residual_px
from geoposition.dense.filters import Grey
from geoposition.dense.ground_fit import ground_fit
from geoposition.dense.height_field import HeightField
from geoposition.dense.refine import refine_rows
from geoposition.dense.sgm import SgmOptions, match_rows
from geoposition.matching.image import ImageSource, Window
from geoposition.sensor_model import SensorModel
from geoposition.triangulate import triangulate_pairs

MOST_RESIDUAL_PX: Final = 0.1
"""Models that lie farther beside a tile's rows make it a smaller tile."""

_SMALLEST_PX: Final = 128
_FEWEST_PX: Final = 16
_MOST_DISPARITIES: Final = 512.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """An image and its models.

    `matching` agrees with the first image's and says where to look; `model` makes the points.
    They differ where a relative bias was found and is not to be removed.
    """

    source: ImageSource
    model: SensorModel
    matching: SensorModel


@dataclass(frozen=True, slots=True, eq=False)
class CoreMatches:
    """Matches of the reduced pixels of a core.

    `second_px` (n, m, 2); `geodetic` (n, m, 3) where their lines of sight meet; `sigma_m` (n, m)
    of the height. `residual_px` is the largest epipolar residual of its `tiles`.
    """

    second_px: FloatArray
    geodetic: FloatArray
    sigma_m: Grey
    residual_px: float = 0.0
    tiles: list[EpipolarTile] = field(default_factory=list)


def match_core(
    first: View,
    second: View,
    core: Window,
    surface: HeightField,
    reduction: int = 1,
    options: SgmOptions | None = None,
    least_correlation: float = 0.5,
) -> CoreMatches | None:
    """Match the pixels of `core` in the second image, or None where it shows nothing of them.

    The core is quartered where rows would be off the models' epipolar lines by more than
    `MOST_RESIDUAL_PX`, or where it spans more heights than fit into one search.
    """
    tile = epipolar_tile(first.matching, second.matching, core, surface, reduction)
    if tile is None:
        return None
    beside = residual_px(tile, first.matching, second.matching)
    if not np.isfinite(beside):
        return None
    span = tile.disparities_px[1] - tile.disparities_px[0]
    small = min(core.lines, core.samples) < 2 * _SMALLEST_PX * reduction
    if (beside > MOST_RESIDUAL_PX or span > _MOST_DISPARITIES) and not small:
        return _quartered(first, second, core, surface, reduction, options, least_correlation)
    matched = _matched(first, second, tile, options, least_correlation)
    if matched is None:
        return None
    second_px, sigma_m = matched
    pixels = pixel_centres(core, reduction)
    flat = second_px.reshape(-1, 2)
    fit = ground_fit(tile, first.model, second.model)
    if fit is not None:
        ground = fit.at(pixels, flat)
    else:
        ground = triangulate_pairs(first.model, second.model, pixels, flat).geodetic
    geodetic = ground.reshape(*sigma_m.shape, 3)
    return CoreMatches(second_px, geodetic, sigma_m, beside, [tile])


def pixel_centres(core: Window, reduction: int) -> FloatArray:
    """Centres (n, 2) of the reduced pixels of `core`, row by row."""
    f = reduction
    out = np.empty((core.lines // f, core.samples // f, 2))
    middle = 0.5 * (f - 1.0)
    out[..., 0] = (core.line + middle + f * np.arange(out.shape[0]))[:, None]
    out[..., 1] = core.sample + middle + f * np.arange(out.shape[1])
    return out.reshape(-1, 2)


def _quartered(
    first: View,
    second: View,
    core: Window,
    surface: HeightField,
    reduction: int,
    options: SgmOptions | None,
    least_correlation: float,
) -> CoreMatches | None:
    f = reduction
    size = (core.lines // f, core.samples // f)
    second_px, geodetic = np.full((*size, 2), np.nan), np.full((*size, 3), np.nan)
    sigma_m = np.full(size, np.nan, dtype=np.float32)
    tiles: list[EpipolarTile] = []
    beside = 0.0
    lines, samples = ((n // f // 2) * f for n in (core.lines, core.samples))
    for top, n in ((0, lines), (lines, core.lines - lines)):
        for left, m in ((0, samples), (samples, core.samples - samples)):
            part = Window(core.line + top, core.sample + left, n, m)
            found = match_core(first, second, part, surface, f, options, least_correlation)
            if found is None:
                continue
            rows = slice(top // f, top // f + found.sigma_m.shape[0])
            columns = slice(left // f, left // f + found.sigma_m.shape[1])
            second_px[rows, columns], sigma_m[rows, columns] = found.second_px, found.sigma_m
            geodetic[rows, columns] = found.geodetic
            tiles += found.tiles
            beside = max(beside, found.residual_px)
    return CoreMatches(second_px, geodetic, sigma_m, beside, tiles) if tiles else None


def _matched(
    first: View,
    second: View,
    tile: EpipolarTile,
    options: SgmOptions | None,
    least_correlation: float,
) -> tuple[FloatArray, Grey] | None:
    read = [
        resample.read_reduced(view.source, window, tile.reduction)
        for view, window in ((first, tile.first_window), (second, tile.second_window()))
    ]
    if read[0] is None or read[1] is None or min(read[1][0].shape) < _FEWEST_PX:
        return None
    a, b = tile.view_first(*read[0]), tile.view_second(*read[1])
    found = match_rows(a, b, tile.disparities_px, options)
    if not found.believed.any():
        return None
    disparity, sigma = refine_rows(a, b, found.disparity_px, found.believed, least_correlation)
    size = (tile.core.lines // tile.reduction, tile.core.samples // tile.reduction)
    second_px, sigma_px = np.empty((*size, 2)), np.empty(size, dtype=np.float32)
    major = int(np.argmax(np.abs(tile.e_u)))
    first_px = np.array([tile.core.line, tile.core.sample]) + 0.5 * (tile.reduction - 1.0)
    offset = (first_px - tile.origin_px) / tile.reduction
    column = offset[major]
    row = offset[1 - major] - tile.e_u[1 - major] * column
    resample.to_second(
        disparity,
        sigma,
        np.array([row, np.rint(column)]),
        major,
        first_px,
        tile.e_u,
        float(tile.reduction),
        *tile.kernel_parts(),
        second_px,
        sigma_px,
    )
    return second_px, sigma_px / np.float32(abs(tile.px_per_m))
