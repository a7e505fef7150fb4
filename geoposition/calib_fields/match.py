"""Matching an image with a reference orthophoto: coarse to fine, every loss counted.

On each level patches of the orthophoto are looked for in the image, which was brought to the
orthophoto's lattice; what is found, in image pixels, gives a smooth correction with which the
next finer level starts within a few pixels. On the finest level the patches cover the overlap
evenly, and blunders leave by a polynomial of the residuals.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np

from geoposition.arrays import IntArray
from geoposition.calib_fields.dom import Dom
from geoposition.calib_fields.geometry import OrthoImage
from geoposition.calib_fields.match_block import Level, Patches, match_block, on_height
from geoposition.calib_fields.matches import Cause, DomMatches, DomMatchOptions
from geoposition.calib_fields.overlap import Overlap, find_overlap
from geoposition.calib_fields.smooth import ImageCorrection, robust_polynomial
from geoposition.errors import GeometryError
from geoposition.matching import ImageSource
from geoposition.reimage.ortho import OrthoGrid
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

__all__ = ["Cause", "DomMatchOptions", "DomMatches", "match_dom"]

Progress: TypeAlias = Callable[[int, int], None]

_COARSE_RADIUS_PX: Final = 12
_FINE_RADIUS_PX: Final = 5
_COARSE_POINTS: Final = 400
_LEAST_PATCHES: Final = 4
"""Patches across the shorter side of the overlap that the coarsest level keeps."""
_BLOCK_PX: Final = 512
_LEAST_POINTS: Final = 12


def match_dom(
    source: ImageSource,
    model: SensorModel,
    dom: Dom,
    terrain: Terrain,
    options: DomMatchOptions | None = None,
    progress: Progress | None = None,
) -> DomMatches:
    """Match the image `source` of `model` with `dom` on `terrain`.

    `GeometryError`, one line that says why, where nothing can be matched at all.
    """
    options = options or DomMatchOptions()
    overlap = find_overlap(model, terrain, dom, options.search_m)
    levels = _levels(overlap, options)
    image = OrthoImage(source, model, terrain, ImageCorrection.none())
    for coarse in levels[:-1]:
        found = _match_level(image, dom, overlap, coarse, options, None)
        image = replace(image, correction=_correction(found, coarse, image.correction))
    found = _match_level(image, dom, overlap, levels[-1], options, progress)
    _require(found, dom, source)
    return _without_outliers(found, options)


def _levels(overlap: Overlap, options: DomMatchOptions) -> list[Level]:
    """Levels from coarse to fine; the coarsest reaches `search_m` within few pixels."""
    base, pixel_m = overlap.factor, overlap.pixel_m
    size = min(overlap.shape)
    halvings = 0
    while (
        options.search_m / (pixel_m * 2**halvings) > _COARSE_RADIUS_PX
        and size / 2 ** (halvings + 1) > _LEAST_PATCHES * options.window_px
    ):
        halvings += 1
    levels = []
    for k in range(halvings, -1, -1):
        scale = 2**k
        area = overlap.image_area_m2 / (pixel_m * scale) ** 2
        points = options.most_points if k == 0 else _COARSE_POINTS
        spacing = max(options.window_px // 2, math.ceil(math.sqrt(area / points)))
        if k == 0 and options.spacing_px is not None:
            spacing = options.spacing_px
        first = k == halvings
        radius = math.ceil(options.search_m / (pixel_m * scale)) if first else _FINE_RADIUS_PX
        degree = 1 if first else 3
        levels.append(Level(base * scale, pixel_m * scale, max(radius, 2), spacing, degree))
    if halvings == 0 and levels[0].radius > _FINE_RADIUS_PX:
        # find the shift first, then match closely: edges and covariances want a small search
        coarse = max(levels[0].spacing, math.ceil(math.sqrt(np.prod(overlap.shape) / 400)))
        levels = [
            replace(levels[0], spacing=coarse),
            replace(levels[0], radius=_FINE_RADIUS_PX),
        ]
    return levels


def _match_level(
    image: OrthoImage,
    dom: Dom,
    overlap: Overlap,
    level: Level,
    options: DomMatchOptions,
    progress: Progress | None,
) -> DomMatches:
    lattice = dom.coarser(level.factor)
    top, left, bottom, right = (n * overlap.factor // level.factor for n in overlap.bounds)
    bottom, right = min(bottom, lattice.shape[0]), min(right, lattice.shape[1])
    rows = _spread(top, bottom, options.window_px, level.spacing)
    cols = _spread(left, right, options.window_px, level.spacing)
    parts = []
    per = max(1, _BLOCK_PX // level.spacing)
    blocks = [(i, j) for i in range(0, len(rows), per) for j in range(0, len(cols), per)]
    for done, (i, j) in enumerate(blocks):
        corners = np.stack(
            np.meshgrid(rows[i : i + per], cols[j : j + per], indexing="ij"), axis=-1
        ).reshape(-1, 2)
        parts.append(match_block(image, dom, lattice, overlap, level, corners, options))
        if progress is not None:
            progress(done + 1, len(blocks))
    if not parts:
        raise GeometryError(
            f"the overlap of image and orthophoto is {overlap.shape[0]} x {overlap.shape[1]} "
            f"pixels of {overlap.pixel_m:g} m: too small for patches of {options.window_px}"
        )
    columns = Patches(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return DomMatches(
        ground=columns.ground,
        model_px=columns.model_px,
        image_px=columns.image_px,
        covariance_px2=columns.covariance_px2,
        shift_en_m=columns.shift_en_m,
        covariance_m2=columns.covariance_m2,
        correlation=columns.correlation,
        cause=columns.cause.astype(np.uint8),
        pixel_m=level.pixel_m,
        ground_sample_m=overlap.ground_sample_m,
        window_px=options.window_px,
        spacing_px=level.spacing,
        lines_per_pixel=_lines_per_pixel(image.model, lattice, (top, left, bottom, right), overlap),
    )


def _lines_per_pixel(
    model: SensorModel, lattice: OrthoGrid, bounds: tuple[int, ...], overlap: Overlap
) -> tuple[float, float]:
    top, left, bottom, right = bounds
    middle = np.array([0.5 * (top + bottom), 0.5 * (left + right)])
    place = middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    ground = on_height(lattice, place, np.full(3, overlap.height_m))
    line = model.ground_to_image(ground).image_px[:, 0]
    return float(line[1] - line[0]), float(line[2] - line[0])


def _spread(first: int, last: int, window: int, spacing: int) -> IntArray:
    """First pixels of patches, evenly from edge to edge."""
    room = last - first - window
    if room < 0:
        return np.empty(0, dtype=np.int64)
    count = room // spacing + 1
    start = first + (room - (count - 1) * spacing) // 2
    return start + spacing * np.arange(count, dtype=np.int64)


def _correction(found: DomMatches, level: Level, before: ImageCorrection) -> ImageCorrection:
    """Smooth correction from a level's matches; as before where they do not agree."""
    used = found.used & np.isfinite(found.error_px).all(axis=1)
    if used.sum() < 3:
        return before
    pixel = level.pixel_m / min(found.ground_sample_m)
    fit = robust_polynomial(
        found.model_px[used], found.error_px[used], level.degree, least_scale_px=0.25 * pixel
    )
    if fit.good.sum() < max(3, 0.1 * used.sum()):
        return before
    return fit.correction


def _without_outliers(found: DomMatches, options: DomMatchOptions) -> DomMatches:
    used = np.flatnonzero(found.used & np.isfinite(found.error_px).all(axis=1))
    if len(used) < _LEAST_POINTS:
        return found
    error, place = found.error_px[used], found.model_px[used]
    least = 0.02 * found.pixel_m / max(found.ground_sample_m)
    fit = robust_polynomial(
        place, error, options.outlier_degree, limit=options.outlier_limit, least_scale_px=least
    )
    cause = found.cause.copy()
    cause[used[~fit.good]] = Cause.OUTLIER
    return replace(found, cause=cause)


def _require(found: DomMatches, dom: Dom, source: ImageSource) -> None:
    """Refuse, with the reason, what gave hardly any match."""
    counts = found.counts
    tried = len(found.cause)
    if counts["used"] >= _LEAST_POINTS:
        return
    if counts["nodata"] >= 0.9 * tried:
        raise GeometryError(
            f"{dom.paths[0]}: the orthophoto, the image or the terrain has no data "
            f"in {counts['nodata']} of {tried} patches of the overlap"
        )
    if counts["no_texture"] >= 0.5 * tried:
        raise GeometryError(
            f"{source.path}: the image or the orthophoto is featureless "
            f"in {counts['no_texture']} of {tried} patches"
        )
    lost = ", ".join(
        f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n and name != "used"
    )
    raise GeometryError(
        f"{source.path}: {counts['used']} of {tried} patches match {dom.paths[0]}, at least "
        f"{_LEAST_POINTS} are needed ({lost}): wrong model, DEM, date or coordinate system?"
    )
