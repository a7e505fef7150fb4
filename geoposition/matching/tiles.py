"""Which part of one image to compare with which part of another, and how."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import gcd

import numpy as np

from geoposition.errors import ArgumentError, GeometryError
from geoposition.matching.guide import Guide, guide, search_window
from geoposition.matching.image import ImageSource, Window
from geoposition.sensor_model import SensorModel
from geoposition.triangulate.start import height_range_m

APRON_PX = 32
"""How far beyond its window a tile is read, so that features at the edge are found."""

_FEWEST_PX = 32
_CELLS = 8


@dataclass(frozen=True, slots=True)
class MatchOptions:
    """How to match.

    `max_bias_px`: by how much the models may disagree, in pixels of the second image.
    `heights_m`: where the ground may lie, ellipsoidal; the models' common range unless given.
    `ratio`: the nearest descriptor must be nearer than this times the second nearest.
    `correlation`: what the refined patches of a match must reach.
    `tile_px`, `max_tiles`, `tile_features`: at most so many tiles of this size, spread evenly
    over what both images see, with at most so many features each.
    """

    max_bias_px: float = 100.0
    heights_m: tuple[float, float] | None = None
    ratio: float = 0.8
    correlation: float = 0.8
    tile_px: int = 1024
    max_tiles: int = 64
    tile_features: int = 24000

    def __post_init__(self) -> None:
        if not (self.max_bias_px > 0.0 and 0.0 < self.ratio <= 1.0 and self.correlation < 1.0):
            raise ArgumentError(
                "matching: a positive max_bias_px, a ratio and a correlation up to 1 expected"
            )
        if self.tile_px < 2 * _FEWEST_PX or self.max_tiles < 1 or self.tile_features < _CELLS**2:
            raise ArgumentError("matching: larger tiles, or more tiles or features, expected")
        if self.heights_m is not None and not self.heights_m[0] < self.heights_m[1]:
            raise ArgumentError(f"matching: heights low to high expected, got {self.heights_m}")


@dataclass(frozen=True, slots=True)
class Tile:
    """A window of the first image, where its ground appears in the second, where to search."""

    window: Window
    chart: Guide
    search: Window


def common_tiles(
    first: ImageSource,
    first_model: SensorModel,
    second: ImageSource,
    second_model: SensorModel,
    options: MatchOptions,
) -> list[Tile]:
    """Tiles of the first image that the second may show, at most `max_tiles`, evenly spread.

    `GeometryError` where there is none.
    """
    heights = options.heights_m or height_range_m([first_model, second_model])
    tiles: list[Tile] = []
    for window in _windows(first, options.tile_px):
        chart = guide(first_model, second_model, window, heights)
        if chart is None:
            continue
        search = search_window(chart, window, options.max_bias_px + APRON_PX, second.extent)
        if search is not None and min(search.lines, search.samples) >= _FEWEST_PX:
            tiles.append(Tile(window, chart, search))
    if not tiles:
        raise GeometryError(
            f"matching: {first.path.name} and {second.path.name} do not overlap, "
            f"as their models see the ground between {heights[0]:.0f} and {heights[1]:.0f} m"
        )
    return [tiles[index] for index in spread(len(tiles), options.max_tiles)]


def spread(count: int, wanted: int) -> list[int]:
    """At most `wanted` of `count` indices, scattered evenly.

    By steps of the golden section, so that not every one lies in the same column of a grid.
    """
    if count <= wanted:
        return list(range(count))
    step = next(s for s in range(round(0.618 * count), count + 2) if gcd(s, count) == 1)
    return sorted((k * step) % count for k in range(wanted))


def _windows(source: ImageSource, size: int) -> list[Window]:
    rows, columns = (max(1, round(n / size)) for n in source.shape)
    lines = np.linspace(0, source.shape[0], rows + 1).astype(int) + source.first_line
    samples = np.linspace(0, source.shape[1], columns + 1).astype(int) + source.first_sample
    return [
        Window(int(top), int(left), int(bottom - top), int(right - left))
        for top, bottom in pairwise(lines)
        for left, right in pairwise(samples)
    ]
