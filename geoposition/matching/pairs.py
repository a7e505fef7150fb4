"""Sparse matching of images whose models are known; the only door to OpenCV.

SIFT features of a tile of the first image are compared with those features of the second that
lie in a band around the chord where the models put the tile's ground. A first look at some
tiles, with a band as wide as `MatchOptions.max_bias_px`, finds the offset that the models
share; then all tiles are matched within a narrow band around it. Matches must be nearest in
both directions, clearly nearer than the second nearest, beside their chords by the common
offset, and like their neighbours in parallax. Least-squares matching then brings their places
from about 0.25 px to below 0.1 px.

*Source*: Lowe 2004, Int. J. Computer Vision 60(2), for the features and the ratio test.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.errors import ArgumentError, GeometryError
from geoposition.matching import candidates
from geoposition.matching.filter import (
    common_offset,
    first_of_place,
    like_neighbours,
    near_offset,
)
from geoposition.matching.image import ImageSource, Window, open_image, stretched
from geoposition.matching.refine import refine
from geoposition.matching.tiles import APRON_PX, MatchOptions, Tile, common_tiles, spread
from geoposition.observations import TiePoints
from geoposition.sensor_model import SensorModel

__all__ = ["ImageSource", "MatchOptions", "match_images", "match_pair", "open_image"]

Progress = Callable[[int, int], None]

_CONTRAST: Final = 0.02
_CELLS: Final = 8
_FIRST_LOOK_TILES: Final = 9
_FIRST_LOOK_FEATURES: Final = 4000
_FIRST_LOOK_ENOUGH: Final = 1500
_FEWEST_MATCHES: Final = 6
_NARROW_PX: Final = 3.0
_NARROW_SIGMAS: Final = 5.0
_FARTHEST_PX: Final = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """Grey values of a window and the features in it, places (n, 2) in the model's frame."""

    grey: FloatArray
    first_pixel: FloatArray
    image_px: FloatArray
    descriptors: NDArray[np.uint8]

    def every(self, step: int) -> _View:
        """Return the view with every `step`-th feature."""
        return _View(
            self.grey,
            self.first_pixel,
            np.ascontiguousarray(self.image_px[::step]),
            np.ascontiguousarray(self.descriptors[::step]),
        )


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
        names = [item.name for item in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def where(self, keep: BoolArray) -> _Matches:
        """Return the matches of the mask `keep`."""
        return _Matches(*(getattr(self, item.name)[keep] for item in fields(self)))


def match_pair(
    first: ImageSource,
    first_model: SensorModel,
    second: ImageSource,
    second_model: SensorModel,
    options: MatchOptions | None = None,
    progress: Progress | None = None,
) -> TiePoints:
    """Tie points of two images: products 0 and 1, points numbered from 0, in the models' frames.

    The places in the first image are those of the features, the ones in the second are refined.
    `GeometryError` where the images do not overlap, or have too little in common to match.
    """
    options = options or MatchOptions()
    tiles = common_tiles(first, first_model, second, second_model, options)
    sift = _detector()
    looks = spread(len(tiles), _FIRST_LOOK_TILES)
    seen: dict[int, tuple[_View, _View]] = {}
    wide = (-options.max_bias_px, options.max_bias_px)
    parts: list[_Matches] = []
    for index in looks:
        tile = tiles[index]
        a, b = seen[index] = _views(sift, first, second, tile, options)
        step = max(1, len(a.image_px) // _FIRST_LOOK_FEATURES)
        parts.append(_compare(a.every(step), b, tile, wide, options))
        if sum(len(part.across_px) for part in parts) > _FIRST_LOOK_ENOUGH:
            break
    offset = common_offset(_Matches.joined(parts).across_px, options.max_bias_px)
    half = max(_NARROW_PX, _NARROW_SIGMAS * offset.scatter_px)
    narrow = (offset.across_px - half, offset.across_px + half)
    parts = []
    for index, tile in enumerate(tiles):
        kept = seen.pop(index, None)
        a, b = _views(sift, first, second, tile, options) if kept is None else kept
        parts.append(_refined(a, b, tile, _compare(a, b, tile, narrow, options), options))
        if progress is not None:
            progress(index + 1, len(tiles))
    matches = _believed(_Matches.joined(parts))
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
    ids: list[IntArray] = []
    product: list[IntArray] = []
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


def _detector() -> Any:
    # Without the precise upscaling OpenCV's places are a quarter of a pixel off.
    return cv2.SIFT_create(  # type: ignore[attr-defined]
        contrastThreshold=_CONTRAST, enable_precise_upscale=True
    )


def _views(
    sift: Any, first: ImageSource, second: ImageSource, tile: Tile, options: MatchOptions
) -> tuple[_View, _View]:
    return (
        _view(sift, first, tile.window, options.tile_features),
        _view(sift, second, tile.search, None),
    )


def _view(sift: Any, source: ImageSource, window: Window, most: int | None) -> _View:
    """Features in `window`, at most `most` spread over it; around it an apron is read too."""
    apron = Window(
        window.line - APRON_PX,
        window.sample - APRON_PX,
        window.lines + 2 * APRON_PX,
        window.samples + 2 * APRON_PX,
    ).within(source.extent)
    assert apron is not None
    grey = source.read(apron)
    first_pixel = np.array([apron.line, apron.sample], dtype=np.float64)
    keypoints, descriptors = sift.detectAndCompute(*stretched(grey))
    if descriptors is None or len(keypoints) == 0:
        return _View(grey, first_pixel, np.empty((0, 2)), np.empty((0, 128), dtype=np.uint8))
    # OpenCV gives (column, row), the first pixel's centre at (0, 0).
    image = np.array([point.pt for point in keypoints])[:, ::-1] + first_pixel
    place = image - (window.line, window.sample) + 0.5
    size = np.array([window.lines, window.samples])
    keep = np.all((place >= 0.0) & (place < size), axis=1)
    if most is not None and keep.sum() > most:
        response = np.array([point.response for point in keypoints])
        cell = np.clip((place / size * _CELLS).astype(int), 0, _CELLS - 1) @ (_CELLS, 1)
        keep &= _strongest(np.where(keep, cell, -1), response, most // _CELLS**2)
    return _View(
        grey, first_pixel, np.ascontiguousarray(image[keep]), descriptors[keep].astype(np.uint8)
    )


def _strongest(cell: IntArray, response: FloatArray, most: int) -> BoolArray:
    """Mask of the `most` strongest of each cell."""
    order = np.lexsort((-response, cell))
    first = np.searchsorted(cell[order], cell[order], side="left")
    keep = np.zeros(len(cell), dtype=np.bool_)
    keep[order] = np.arange(len(cell)) - first < most
    return keep


def _compare(
    a: _View, b: _View, tile: Tile, band_px: tuple[float, float], options: MatchOptions
) -> _Matches:
    """Match the features of two views whose places across the chords lie in `band_px`."""
    chords = tile.chart.chords(a.image_px)
    best = np.full(len(a.image_px), -1, dtype=np.int64)
    best2 = np.zeros(len(a.image_px), dtype=np.int64)
    if len(a.image_px) and len(b.image_px):
        way = (chords.low_px, chords.along, chords.length_px)
        reach = (options.max_bias_px, *band_px)
        candidates.match_candidates(
            a.descriptors, *way, b.descriptors, b.image_px, *reach, options.ratio, best, best2
        )
        candidates.keep_mutual(
            a.descriptors, *way, a.image_px, b.descriptors, b.image_px, *reach, best, best2
        )
    kept = best >= 0
    second_px = np.zeros_like(a.image_px)
    second_px[kept] = b.image_px[best[kept]]
    across, along = chords.across_px(second_px), chords.along_px(second_px)
    return _Matches(a.image_px, second_px, across, along, best2.astype(np.float64)).where(kept)


def _refined(a: _View, b: _View, tile: Tile, matches: _Matches, options: MatchOptions) -> _Matches:
    """Return the matches that least-squares matching confirms, with its places."""
    n = len(matches.across_px)
    place = matches.second_px - b.first_pixel
    correlation, converged = np.empty(n), np.empty(n, dtype=np.bool_)
    refine(
        a.grey,
        b.grey,
        matches.first_px - a.first_pixel,
        tile.chart.affine(matches.first_px, matches.along_px),
        _FARTHEST_PX,
        place,
        correlation,
        converged,
    )
    second_px = place + b.first_pixel
    chords = tile.chart.chords(matches.first_px)
    return _Matches(
        matches.first_px,
        second_px,
        chords.across_px(second_px),
        chords.along_px(second_px),
        matches.distance2,
    ).where(converged & (correlation >= options.correlation))


def _believed(matches: _Matches) -> _Matches:
    if len(matches.across_px) == 0:
        return matches
    matches = matches.where(first_of_place(matches.first_px, matches.second_px, matches.distance2))
    matches = matches.where(near_offset(matches.across_px))
    return matches.where(like_neighbours(matches.first_px, matches.along_px))
