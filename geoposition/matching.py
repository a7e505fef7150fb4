"""Sparse matching of two images whose models are known; the only door to OpenCV.

SIFT features of a tile of the first image are compared with those features of the second that
lie in a band around the chord where the models put the tile's ground. A first look at some
tiles, with a band as wide as `MatchOptions.max_bias_px`, finds the offset that the models
share; then all tiles are matched within a narrow band around it. Matches must be nearest in
both directions, clearly nearer than the second nearest, beside their chords by the common
offset, and like their neighbours in parallax.

*Source*: Lowe 2004, Int. J. Computer Vision 60(2), for the features and the ratio test.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from geoposition import matching_candidates as candidates
from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError
from geoposition.matching_filter import (
    common_offset,
    first_of_place,
    like_neighbours,
    near_offset,
)
from geoposition.matching_guide import Guide, guide, search_window
from geoposition.matching_image import ImageSource, Window, open_image, stretched
from geoposition.observations import TiePoints
from geoposition.sensor_model import SensorModel
from geoposition.triangulate_start import height_range_m

__all__ = ["ImageSource", "MatchOptions", "match_images", "match_pair", "open_image"]

Progress = Callable[[int, int], None]

_APRON_PX: Final = 32
_FEWEST_PX: Final = 32
_FIRST_LOOK_TILES: Final = 9
_ENOUGH_FOR_OFFSET: Final = 400
_CONTRAST: Final = 0.02
_CELLS: Final = 8
_FEWEST_MATCHES: Final = 6
_NARROW_PX: Final = 3.0
_NARROW_SIGMAS: Final = 5.0


@dataclass(frozen=True, slots=True)
class MatchOptions:
    """How to match.

    `max_bias_px`: by how much the models may disagree, in pixels of the second image.
    `heights_m`: where the ground may lie, ellipsoidal; the models' common range unless given.
    `ratio`: the nearest descriptor must be nearer than this times the second nearest.
    `tile_px`, `max_tiles`, `tile_features`: at most so many tiles of this size, spread evenly
    over what both images see, with at most so many features each.
    """

    max_bias_px: float = 100.0
    heights_m: tuple[float, float] | None = None
    ratio: float = 0.8
    tile_px: int = 1024
    max_tiles: int = 64
    tile_features: int = 24000

    def __post_init__(self) -> None:
        if not (self.max_bias_px > 0.0 and 0.0 < self.ratio <= 1.0):
            raise ArgumentError("matching: a positive max_bias_px and a ratio up to 1 expected")
        if self.tile_px < 2 * _FEWEST_PX or self.max_tiles < 1 or self.tile_features < _CELLS**2:
            raise ArgumentError("matching: larger tiles, or more tiles or features, expected")
        if self.heights_m is not None and not self.heights_m[0] < self.heights_m[1]:
            raise ArgumentError(f"matching: heights low to high expected, got {self.heights_m}")


@dataclass(frozen=True, slots=True, eq=False)
class _Features:
    """Features of a window: places (n, 2) in the model's frame, SIFT descriptors (n, 128)."""

    image_px: FloatArray
    descriptors: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Matched places, how far beside and along their chords, and squared descriptor distance."""

    first_px: FloatArray
    second_px: FloatArray
    across_px: FloatArray
    along_px: FloatArray
    distance2: FloatArray

    @classmethod
    def joined(cls, parts: Sequence[_Matches]) -> _Matches:
        """Return all of `parts` as one."""
        names = ("first_px", "second_px", "across_px", "along_px", "distance2")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def where(self, keep: NDArray[np.bool_]) -> _Matches:
        """Return the matches of the mask `keep`."""
        return _Matches(
            self.first_px[keep],
            self.second_px[keep],
            self.across_px[keep],
            self.along_px[keep],
            self.distance2[keep],
        )


@dataclass(frozen=True, slots=True)
class _Tile:
    """A window of the first image, its guide, and the window of the second to search."""

    window: Window
    chart: Guide
    search: Window


def match_pair(
    first: ImageSource,
    first_model: SensorModel,
    second: ImageSource,
    second_model: SensorModel,
    options: MatchOptions | None = None,
    progress: Progress | None = None,
) -> TiePoints:
    """Tie points of two images: products 0 and 1, points numbered from 0, in the models' frames.

    `GeometryError` where the images do not overlap, or have too little in common to match.
    """
    options = options or MatchOptions()
    tiles = _tiles(first, first_model, second, second_model, options)
    sift = _detector()
    chosen = _spread(len(tiles), _FIRST_LOOK_TILES)
    total = len(chosen) + len(tiles)
    looks: list[_Matches] = []
    done = 0
    for index in chosen:
        band = (-options.max_bias_px, options.max_bias_px)
        looks.append(_match_tile(sift, first, second, tiles[index], band, options))
        done += 1
        if progress is not None:
            progress(done, total)
        if sum(len(look.across_px) for look in looks) > _ENOUGH_FOR_OFFSET * len(chosen):
            break
    offset = common_offset(_Matches.joined(looks).across_px, options.max_bias_px)
    half = max(_NARROW_PX, _NARROW_SIGMAS * offset.scatter_px)
    band = (offset.across_px - half, offset.across_px + half)
    found: list[_Matches] = []
    for index, tile in enumerate(tiles):
        found.append(_match_tile(sift, first, second, tile, band, options))
        if progress is not None:
            progress(len(chosen) + index + 1, total)
    matches = _believed(_Matches.joined(found))
    if len(matches.across_px) < _FEWEST_MATCHES:
        raise GeometryError(
            f"matching {first.path.name} and {second.path.name}: only "
            f"{len(matches.across_px)} matches are consistent"
        )
    return TiePoints.of_pair(matches.first_px, matches.second_px)


def match_images(
    sources: Sequence[ImageSource],
    models: Sequence[SensorModel],
    options: MatchOptions | None = None,
    progress: Progress | None = None,
) -> TiePoints:
    """Tie points of several images: each matched with the first; product i is image i.

    Features of the first image that were matched in several others become one point with as
    many rays. `GeometryError` as in `match_pair`, if one of the images cannot be matched.
    """
    if len(sources) != len(models) or len(sources) < 2:
        raise ArgumentError("matching: two images or more, with a model each, expected")
    ids: list[NDArray[np.int64]] = []
    product: list[NDArray[np.int64]] = []
    image: list[FloatArray] = []
    number: dict[tuple[float, float], int] = {}
    for k in range(1, len(sources)):
        pair = match_pair(sources[0], models[0], sources[k], models[k], options, progress)
        n = len(pair) // 2
        places = [(float(line), float(sample)) for line, sample in pair.image_px[:n]]
        fresh = np.array([place not in number for place in places])
        names = np.array([number.setdefault(place, len(number)) for place in places])
        ids += [names[fresh], names]
        product += [np.zeros(int(fresh.sum()), dtype=np.int64), np.full(n, k, dtype=np.int64)]
        image += [pair.image_px[:n][fresh], pair.image_px[n:]]
    return TiePoints(np.concatenate(ids), np.concatenate(product), np.concatenate(image))


def _tiles(
    first: ImageSource,
    first_model: SensorModel,
    second: ImageSource,
    second_model: SensorModel,
    options: MatchOptions,
) -> list[_Tile]:
    """Tiles of the first image that the second may show, at most `max_tiles`, evenly spread."""
    heights = options.heights_m or height_range_m([first_model, second_model])
    size = options.tile_px
    rows, columns = (max(1, round(n / size)) for n in first.shape)
    line = np.linspace(0, first.shape[0], rows + 1).astype(int) + first.first_line
    sample = np.linspace(0, first.shape[1], columns + 1).astype(int) + first.first_sample
    windows = [
        Window(
            int(line[i]), int(sample[j]), int(line[i + 1] - line[i]), int(sample[j + 1] - sample[j])
        )
        for i in range(rows)
        for j in range(columns)
    ]
    tiles: list[_Tile] = []
    for window in windows:
        chart = guide(first_model, second_model, window, heights)
        if chart is None:
            continue
        search = search_window(chart, window, options.max_bias_px + _APRON_PX, second.extent)
        if search is not None and min(search.lines, search.samples) >= _FEWEST_PX:
            tiles.append(_Tile(window, chart, search))
    if not tiles:
        raise GeometryError(
            f"matching: {first.path.name} and {second.path.name} do not overlap, "
            f"as their models see the ground between {heights[0]:.0f} and {heights[1]:.0f} m"
        )
    return [tiles[index] for index in _spread(len(tiles), options.max_tiles)]


def _spread(count: int, wanted: int) -> list[int]:
    """At most `wanted` of `count` indices, scattered evenly.

    Golden-section steps: neighbours in the list, row after row, are not taken together.
    """
    if count <= wanted:
        return list(range(count))
    step = next(s for s in range(round(0.618 * count), count + 1) if np.gcd(s, count) == 1)
    return sorted((k * step) % count for k in range(wanted))


def _detector() -> cv2.SIFT:
    # Without the precise upscaling OpenCV's places are a quarter of a pixel off.
    return cv2.SIFT_create(contrastThreshold=_CONTRAST, enable_precise_upscale=True)


def _features(
    sift: cv2.SIFT, source: ImageSource, window: Window, most: int | None
) -> _Features:
    """Features whose places lie in `window`; an apron around it is read where there is one."""
    apron = Window(
        window.line - _APRON_PX,
        window.sample - _APRON_PX,
        window.lines + 2 * _APRON_PX,
        window.samples + 2 * _APRON_PX,
    ).within(source.extent)
    assert apron is not None
    grey, mask = stretched(source.read(apron))
    keypoints, descriptors = sift.detectAndCompute(grey, mask)
    if descriptors is None or len(keypoints) == 0:
        return _Features(np.empty((0, 2)), np.empty((0, 128), dtype=np.uint8))
    # OpenCV gives (column, row), the first pixel's centre at (0, 0).
    image = np.array([point.pt for point in keypoints])[:, ::-1] + (apron.line, apron.sample)
    place = image - (window.line, window.sample) + 0.5
    size = np.array([window.lines, window.samples])
    inside = np.all((place >= 0.0) & (place < size), axis=1)
    if most is not None and inside.sum() > most:
        response = np.array([point.response for point in keypoints])
        cell = np.clip((place / size * _CELLS).astype(int), 0, _CELLS - 1) @ (_CELLS, 1)
        inside &= _strongest(np.where(inside, cell, -1), response, most // _CELLS**2)
    return _Features(
        np.ascontiguousarray(image[inside]), descriptors[inside].astype(np.uint8)
    )


def _strongest(
    cell: NDArray[np.int64], response: FloatArray, most: int
) -> NDArray[np.bool_]:
    """Mask of the `most` strongest of each cell."""
    order = np.lexsort((-response, cell))
    first = np.searchsorted(cell[order], cell[order], side="left")
    keep = np.zeros(len(cell), dtype=np.bool_)
    keep[order] = np.arange(len(cell)) - first < most
    return keep


def _match_tile(
    sift: cv2.SIFT,
    first: ImageSource,
    second: ImageSource,
    tile: _Tile,
    band_px: tuple[float, float],
    options: MatchOptions,
) -> _Matches:
    a = _features(sift, first, tile.window, options.tile_features)
    b = _features(sift, second, tile.search, None)
    chords = tile.chart.chords(a.image_px)
    best = np.full(len(a.image_px), -1, dtype=np.int64)
    best2 = np.zeros(len(a.image_px), dtype=np.int64)
    if len(best) and len(b.image_px):
        candidates.match_candidates(
            a.descriptors,
            chords.low_px,
            chords.along,
            chords.length_px,
            b.descriptors,
            b.image_px,
            options.max_bias_px,
            *band_px,
            options.ratio,
            best,
            best2,
        )
        candidates.keep_mutual(
            a.descriptors,
            chords.low_px,
            chords.along,
            chords.length_px,
            a.image_px,
            b.descriptors,
            b.image_px,
            options.max_bias_px,
            *band_px,
            best,
            best2,
        )
    kept = best >= 0
    second_px = np.zeros_like(a.image_px)
    second_px[kept] = b.image_px[best[kept]]
    return _Matches(
        a.image_px,
        second_px,
        chords.across_px(second_px),
        chords.along_px(second_px),
        best2.astype(np.float64),
    ).where(kept)


def _believed(matches: _Matches) -> _Matches:
    if len(matches.across_px) == 0:
        return matches
    matches = matches.where(
        first_of_place(matches.first_px, matches.second_px, matches.distance2)
    )
    matches = matches.where(near_offset(matches.across_px))
    return matches.where(like_neighbours(matches.first_px, matches.along_px))
