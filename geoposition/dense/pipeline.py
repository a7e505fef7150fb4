"""Dense matching of two or more images, coarse to fine, tile by tile in bounded memory.

Each image is matched with the first one. At a reduced scale heights over the whole range give a
coarse surface (a grid over the first image); at the next scale only what lies near it is looked
for, and so on. At full scale each tile ends as ground points, which are handed out and
forgotten: what stays in memory is the coarse surface and one tile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.dense import resample
from geoposition.dense.disparity_to_points import DensePoints, ground_points
from geoposition.dense.epipolar import epipolar_tile
from geoposition.dense.height_field import Grid32, HeightField, field_of_heights
from geoposition.dense.pair_tile import CoreMatches, View, match_core, pixel_centres
from geoposition.dense.sgm import SgmOptions
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError, GeometryError
from geoposition.matching.image import Window

Progress: TypeAlias = Callable[[int, int], None]

_STEP: Final = 4
_MOST_COARSE_PX: Final = 96.0
_COARSE_SLACK_PX: Final = 2.0
_COARSE_CORRELATION: Final = 0.4
_NODE: Final = 2
_SMALLEST_CORE_PX: Final = 16


@dataclass(frozen=True, slots=True)
class DenseOptions:
    """How to match densely.

    `tile_px`: the size of a tile's core, in pixels of the scale at hand. `least_correlation`:
    what windows must reach. `most_miss_px`: how far lines of sight may pass their common point,
    in pixels of the first image on the ground, beside what a known bias explains.
    """

    tile_px: int = 1024
    sgm: SgmOptions = field(default_factory=SgmOptions)
    least_correlation: float = 0.5
    most_miss_px: float = 1.0

    def __post_init__(self) -> None:
        if self.tile_px < 128 or not 0.0 <= self.least_correlation < 1.0:
            raise ArgumentError("dense matching: tiles of 128 px or more, a correlation below 1")


@dataclass(slots=True)
class Tally:
    """What a run counts: pixels of the first image tried, points, the epipolar residual."""

    tried: int = 0
    points: int = 0
    epipolar_residual_px: float = 0.0
    disparities: list[float] = field(default_factory=list)

    def add(self, found: CoreMatches) -> None:
        """Count the tiles of `found`."""
        self.epipolar_residual_px = max(self.epipolar_residual_px, found.residual_px)
        self.disparities += [t.disparities_px[1] - t.disparities_px[0] + 1.0 for t in found.tiles]


def coarse_surface(
    views: Sequence[View],
    start: HeightField,
    somewhere_px: FloatArray,
    options: DenseOptions | None = None,
    progress: Progress | None = None,
) -> HeightField:
    """Refine the surface `start` by matching at reduced scales, the coarsest first.

    `somewhere_px` (2,) is a place of the first image that the others show. `GeometryError`
    where nothing matches.
    """
    options = options or DenseOptions()
    surface = start
    factors = reductions(views, start, somewhere_px)
    for done, factor in enumerate(factors):
        surface = _level(views, surface, factor, options)
        if progress is not None:
            progress(done + 1, len(factors))
    return surface


def reductions(
    views: Sequence[View], start: HeightField, somewhere_px: FloatArray
) -> tuple[int, ...]:
    """Scales to match at before the full one: powers of four, coarsest first."""
    extent = views[0].source.extent
    place = np.rint(somewhere_px).astype(int)
    around = Window(int(place[0]) - 64, int(place[1]) - 64, 128, 128).within(extent)
    spans = []
    for view in views[1:]:
        tile = around and epipolar_tile(views[0].matching, view.matching, around, start)
        if tile:
            spans.append(tile.disparities_px[1] - tile.disparities_px[0])
    if not spans:
        raise GeometryError(
            "dense matching: the images show no parallax, they are of one direction of view"
        )
    factor = _STEP
    while (
        max(spans) / factor > _MOST_COARSE_PX and min(extent.lines, extent.samples) > 256 * factor
    ):
        factor *= _STEP
    return tuple(factor // _STEP**k for k in range(int(np.log2(factor) / np.log2(_STEP) + 0.5)))


def dense_points(
    views: Sequence[View],
    surface: HeightField,
    options: DenseOptions | None = None,
    tally: Tally | None = None,
    progress: Progress | None = None,
) -> Iterator[DensePoints]:
    """Yield the ground points of the first image's pixels, tile by tile, near `surface`.

    Each pixel has at most one point. Pixels are matched within `surface`'s range of heights.
    """
    options, tally = options or DenseOptions(), tally or Tally()
    extent = views[0].source.extent
    cores = _cores(extent, options.tile_px)
    for done, core in enumerate(cores):
        found = [_core(views, k, core, surface, 1, options) for k in range(1, len(views))]
        if any(match is not None for match in found):
            points = _points(views, core, found, options)
            for match in found:
                if match is not None:
                    tally.add(match)
            tally.tried += core.lines * core.samples
            tally.points += len(points)
            if len(points):
                yield points
        if progress is not None:
            progress(done + 1, len(cores))


def _core(
    views: Sequence[View],
    k: int,
    core: Window,
    surface: HeightField,
    reduction: int,
    options: DenseOptions,
) -> CoreMatches | None:
    least = options.least_correlation if reduction == 1 else _COARSE_CORRELATION
    return match_core(views[0], views[k], core, surface, reduction, options.sgm, least)


def _points(
    views: Sequence[View],
    core: Window,
    found: Sequence[CoreMatches | None],
    options: DenseOptions,
    reduction: int = 1,
) -> DensePoints:
    models = [view.model for view in views]
    first_px = pixel_centres(core, reduction)
    read = resample.read_reduced(views[0].source, core, reduction)
    assert read is not None  # the core lies in the image
    sample_m = _ground_sample_m(views[0], core, found)
    miss_m = sample_m * (options.most_miss_px * reduction + _bias_px(views))
    return ground_points(models, first_px, read[0].reshape(-1), found, miss_m)


def _level(
    views: Sequence[View], surface: HeightField, factor: int, options: DenseOptions
) -> HeightField:
    """One coarse scale: heights at reduced pixels, averaged to nodes, filled and smoothed."""
    extent = views[0].source.extent
    step = _NODE * factor
    rows, columns = (-(-n // step) for n in (extent.lines, extent.samples))
    total = np.zeros((rows, columns))
    count = np.zeros((rows, columns))
    slack_m = 0.0
    for core in _cores(extent, options.tile_px * factor, factor):
        found = [_core(views, k, core, surface, factor, options) for k in range(1, len(views))]
        if all(match is None for match in found):
            continue
        points = _points(views, core, found, options, factor)
        node = ((points.first_px - (extent.line, extent.sample)) // step).astype(np.int64)
        np.add.at(total, (node[:, 0], node[:, 1]), points.geodetic[:, 2])
        np.add.at(count, (node[:, 0], node[:, 1]), 1.0)
        rates = [abs(tile.px_per_m) for match in found if match for tile in match.tiles]
        slack_m = max(slack_m, _COARSE_SLACK_PX / min(rates))
    with np.errstate(invalid="ignore"):
        heights: Grid32 = (total / count).astype(np.float32)
    first = np.array([extent.line, extent.sample]) + 0.5 * (step - 1.0)
    return field_of_heights(first, float(step), heights, -slack_m, slack_m)


def _cores(extent: Window, size: int, multiple: int = 1) -> list[Window]:
    """Cores of about `size` that fill `extent`, whole multiples of `multiple` pixels.

    What is left at the far edges, less than a multiple, is no core's.
    """
    edges = []
    for n in (extent.lines, extent.samples):
        whole = n // multiple
        parts = max(1, round(whole * multiple / size))
        edges.append(np.linspace(0, whole, parts + 1).astype(int) * multiple)
    return [
        Window(extent.line + int(top), extent.sample + int(left), int(n), int(m))
        for top, n in zip(edges[0], np.diff(edges[0]), strict=False)
        for left, m in zip(edges[1], np.diff(edges[1]), strict=False)
        if min(n, m) >= min(_SMALLEST_CORE_PX * multiple, extent.lines, extent.samples)
    ]


def _bias_px(views: Sequence[View]) -> float:
    """By how much lines of sight pass each other because a known bias is left in."""
    probe = np.array([views[0].source.extent.line, views[0].source.extent.sample], dtype=np.float64)
    biases = [0.0]
    for view in views[1:]:
        if view.model is not view.matching:
            height = float(np.mean(view.model.height_range_m))
            ground = views[0].model.image_to_ground(probe, height).geodetic
            apart = [m.ground_to_image(ground).image_px for m in (view.model, view.matching)]
            biases.append(float(np.hypot(*(apart[0] - apart[1]))))
    return float(np.nanmax(biases))


def _ground_sample_m(first: View, core: Window, found: Sequence[CoreMatches | None]) -> float:
    """Size of a pixel of the first image on the ground, the longer side."""
    tile = next(match.tiles[0] for match in found if match is not None)
    middle = np.array([core.line + 0.5 * core.lines, core.sample + 0.5 * core.samples])
    corner = middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    height = float(np.mean(tile.chart.heights_m))
    place = geodetic_to_ecef(first.model.image_to_ground(corner, height).geodetic)
    return float(np.max(np.linalg.norm(place[1:] - place[0], axis=1)))
