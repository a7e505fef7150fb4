"""Matching an image with a reference orthophoto: coarse to fine, every loss counted.

On each level patches of the orthophoto are looked for in the image, which was brought to the
orthophoto's lattice; what is found, in image pixels, gives a smooth correction with which the
next finer level starts within a few pixels. On the finest level the patches cover the overlap
evenly, and blunders leave by a polynomial of the residuals.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from geoposition.accuracy import enu_errors_m
from geoposition.arrays import BoolArray, FlagArray, FloatArray, IntArray
from geoposition.calib_fields.correlate import correlate
from geoposition.calib_fields.geometry import Dom, OrthoImage, OrthoWindow
from geoposition.calib_fields.overlap import Overlap, find_overlap
from geoposition.calib_fields.refine import Searched, Template, refine
from geoposition.calib_fields.smooth import ImageCorrection, robust_polynomial
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import has_result
from geoposition.matching import ImageSource
from geoposition.reimage.ortho import OrthoGrid
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

Progress: TypeAlias = Callable[[int, int], None]

_COARSE_RADIUS_PX: Final = 12
_FINE_RADIUS_PX: Final = 5
_COARSE_POINTS: Final = 400
_LEAST_PATCHES: Final = 4
"""Patches across the shorter side of the overlap that the coarsest level keeps."""
_BLOCK_PX: Final = 512
_LEAST_POINTS: Final = 12
_EDGE_PX: Final = 4
_FEATURELESS: Final = 0.02
"""Contrast of a patch below this part of the scene's is none."""


class Cause(IntEnum):
    """What became of a patch: used, or why not."""

    USED = 0
    NO_TEXTURE = 1
    LOW_CORRELATION = 2
    OUTSIDE = 3
    """Outside the image or the orthophoto."""
    NODATA = 4
    """Too many pixels without a value (cloud mask, holes), or terrain without a height."""
    NOT_CONVERGED = 5
    OUTLIER = 6


@dataclass(frozen=True, slots=True)
class DomMatchOptions:
    """How to match.

    `search_m` is how far off the model may be on the ground; `spacing_px` the distance of patches
    in pixels of the lattice, by default half of `window_px` or what gives `most_points`.
    `outlier_limit` counts robust standard deviations from a polynomial of `outlier_degree`.
    """

    window_px: int = 64
    spacing_px: int | None = None
    search_m: float = 100.0
    least_correlation: float = 0.4
    least_known: float = 0.8
    most_points: int = 4000
    outlier_degree: int = 3
    outlier_limit: float = 4.5

    def __post_init__(self) -> None:
        if not 16 <= self.window_px <= 512:
            raise ArgumentError(f"window: 16 to 512 pixels expected, got {self.window_px}")
        if self.spacing_px is not None and self.spacing_px < 4:
            raise ArgumentError(f"spacing: at least 4 pixels expected, got {self.spacing_px}")
        if not 0.0 <= self.search_m <= 20e3:
            raise ArgumentError(f"search: 0 to 20000 m expected, got {self.search_m:g}")
        if not 0.0 < self.least_correlation < 1.0 or not 0.1 <= self.least_known <= 1.0:
            raise ArgumentError("least correlation and known share: parts of 1 expected")


@dataclass(frozen=True, slots=True, eq=False)
class DomMatches:
    """Patches tried, n of them, and where the image shows them.

    `ground` (n, 3) is the reference: orthophoto and terrain. `model_px` (n, 2) is where the model
    puts it, `image_px` (n, 2) where the image shows it, with `covariance_px2` (n, 2, 2) of the
    matching. `shift_en_m` (n, 2) is what brings the image's ground position onto the reference,
    reference less located, east and north, with `covariance_m2`. NaN where `cause` (n,) is not
    `USED`, but for outliers.
    `pixel_m` is the size of the lattice's pixels, `ground_sample_m` (line, sample) the image's.
    """

    ground: FloatArray
    model_px: FloatArray
    image_px: FloatArray
    covariance_px2: FloatArray
    shift_en_m: FloatArray
    covariance_m2: FloatArray
    correlation: FloatArray
    cause: FlagArray
    pixel_m: float
    ground_sample_m: tuple[float, float]
    window_px: int
    spacing_px: int
    lines_per_pixel: tuple[float, float]
    """Image lines that a pixel of the lattice down, and to the right, is worth."""

    @property
    def used(self) -> BoolArray:
        """Which patches count (n,)."""
        result: BoolArray = self.cause == Cause.USED
        return result

    @property
    def error_px(self) -> FloatArray:
        """Observed less modelled place (n, 2), line and sample."""
        return self.image_px - self.model_px

    @property
    def counts(self) -> dict[str, int]:
        """How many patches each cause has."""
        return {cause.name.lower(): int(np.sum(self.cause == cause)) for cause in Cause}


class _Patches(NamedTuple):
    """The columns of `DomMatches` for some patches; `cause` as numbers."""

    ground: FloatArray
    model_px: FloatArray
    image_px: FloatArray
    covariance_px2: FloatArray
    shift_en_m: FloatArray
    covariance_m2: FloatArray
    correlation: FloatArray
    cause: FloatArray

    @classmethod
    def lost(cls, n: int, cause: Cause) -> _Patches:
        """Of `n` patches that came to nothing for one `cause`."""

        def empty(*shape: int) -> FloatArray:
            return np.full((n, *shape), np.nan)

        return cls(
            empty(3), empty(2), empty(2), empty(2, 2), empty(2), empty(2, 2), empty(),
            np.full(n, float(cause)),
        )  # fmt: skip


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


@dataclass(frozen=True, slots=True)
class _Level:
    """A lattice `factor` times coarser than the orthophoto's; patches every `spacing` pixels."""

    factor: int
    pixel_m: float
    radius: int
    spacing: int
    degree: int


def _levels(overlap: Overlap, options: DomMatchOptions) -> list[_Level]:
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
        levels.append(_Level(base * scale, pixel_m * scale, max(radius, 2), spacing, degree))
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
    level: _Level,
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
        parts.append(_match_block(image, dom, lattice, overlap, level, corners, options))
        if progress is not None:
            progress(done + 1, len(blocks))
    if not parts:
        raise GeometryError(
            f"the overlap of image and orthophoto is {overlap.shape[0]} x {overlap.shape[1]} "
            f"pixels of {overlap.pixel_m:g} m: too small for patches of {options.window_px}"
        )
    columns = _Patches(*(np.concatenate(column) for column in zip(*parts, strict=True)))
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
    ground = _on_height(lattice, place, np.full(3, overlap.height_m))
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


def _match_block(
    image: OrthoImage,
    dom: Dom,
    lattice: OrthoGrid,
    overlap: Overlap,
    level: _Level,
    corners: IntArray,
    options: DomMatchOptions,
) -> _Patches:
    """Match patches near each other."""
    window, margin = options.window_px, level.radius + _EDGE_PX
    low = corners.min(axis=0) - margin
    size = corners.max(axis=0) + window + margin - low
    grid = lattice.window(int(low[0]), int(low[1]), int(size[0]), int(size[1]))
    n = len(corners)
    reference = dom.read(grid)
    if not np.isfinite(reference).any():
        return _Patches.lost(n, Cause.NODATA)
    ortho = image.on(grid, overlap.mean_sample_m, level.pixel_m)
    if not np.isfinite(ortho.grey).any():
        hole = bool(ortho.without_height.any())
        return _Patches.lost(n, Cause.NODATA if hole else Cause.OUTSIDE)
    template, searched = Template.of(reference), Searched.of(ortho.grey)
    own = corners - low
    whole, score, contrast = correlate(
        template, searched, own, window, level.radius, options.least_known
    )
    spread = np.array([np.nanstd(reference), np.nanstd(ortho.grey)])
    fit = refine(template, searched, own, whole.astype(np.float64), window)
    known = np.isfinite(score)
    flat = known & ~np.all(contrast > _FEATURELESS * spread, axis=1)
    low_score = known & ~flat & ~(np.fmax(score, fit.correlation) >= options.least_correlation)
    at_edge = np.max(np.abs(whole), axis=1) >= level.radius
    lost = known & ~flat & ~low_score & (~fit.converged | at_edge)
    cause: FlagArray = np.full(n, Cause.USED, dtype=np.uint8)
    cause[~known] = _unknown_cause(reference, ortho, own[~known], window)
    cause[flat], cause[low_score] = Cause.NO_TEXTURE, Cause.LOW_CORRELATION
    cause[lost] = Cause.NOT_CONVERGED
    good = known & ~flat & ~low_score & ~lost
    middle = own + fit.middle_px
    patches = _measured(image, grid, middle, fit.shift_px, fit.covariance_px2, good)
    return patches._replace(correlation=fit.correlation, cause=cause.astype(np.float64))


def _unknown_cause(
    reference: FloatArray, ortho: OrthoWindow, corners: IntArray, window: int
) -> FlagArray:
    """Outside, or without data: what more pixels of a patch suffer from."""
    out = np.empty(len(corners), dtype=np.uint8)
    holes = (ortho.without_height != 0) | ~np.isfinite(reference)
    masked = ~np.isfinite(ortho.grey) & (ortho.flag == 0)
    for k, (row, col) in enumerate(corners):
        part = np.s_[row : row + window, col : col + window]
        empty = np.sum(holes[part] | masked[part])
        beyond = np.sum(~np.isfinite(ortho.grey[part]) & ~holes[part] & ~masked[part])
        out[k] = Cause.NODATA if empty >= beyond else Cause.OUTSIDE
    return out


def _measured(
    image: OrthoImage,
    grid: OrthoGrid,
    middle: FloatArray,
    shift_px: FloatArray,
    covariance_px2: FloatArray,
    good: BoolArray,
) -> _Patches:
    """Places, residuals and covariances of patches around `middle` (n, 2); NaN where not good."""
    out = _Patches.lost(len(middle), Cause.USED)
    # the reference is kept for all, so that a map can show what was lost
    out.ground[:] = _on_terrain(image.terrain, grid, middle)
    projected = image.model.ground_to_image(out.ground)
    out.model_px[:] = np.where(has_result(projected.flag)[:, None], projected.image_px, np.nan)
    rows = np.flatnonzero(good)
    if not rows.size:
        return out
    there = _on_terrain(image.terrain, grid, middle[rows] + shift_px[rows])
    found = image.model.ground_to_image(there)
    seen = np.where(has_result(found.flag)[:, None], found.image_px, np.nan)
    out.image_px[rows] = seen + image.correction.at(seen)
    # the image's own scale and turn: how a pixel of the lattice moves the image's
    height = out.ground[rows, 2]
    step = [
        image.model.ground_to_image(_on_height(grid, middle[rows] + move, height)).image_px
        for move in np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    ]
    jacobian = np.stack([step[1] - step[0], step[2] - step[0]], axis=-1)
    out.covariance_px2[rows] = jacobian @ covariance_px2[rows] @ np.swapaxes(jacobian, -1, -2)
    out.shift_en_m[rows], out.covariance_m2[rows] = _on_ground(
        image, out.ground[rows], out.image_px[rows], out.covariance_px2[rows], out.model_px[rows]
    )
    return out


def _on_ground(
    image: OrthoImage,
    ground: FloatArray,
    image_px: FloatArray,
    covariance_px2: FloatArray,
    model_px: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """East and north from where the model locates the image points to the reference, metres.

    At the reference's height: the error of the image's plane coordinates, not of the terrain.
    """
    height = ground[:, 2]
    located = image.model.image_to_ground(image_px, height)
    en = -enu_errors_m(located.geodetic, ground)[:, :2]
    steps = []
    at = image.model.image_to_ground(model_px, height).geodetic
    for move in ((1.0, 0.0), (0.0, 1.0)):
        moved = image.model.image_to_ground(model_px + move, height).geodetic
        steps.append(enu_errors_m(moved, at)[:, :2])
    jacobian = np.stack(steps, axis=-1)
    return en, jacobian @ covariance_px2 @ np.swapaxes(jacobian, -1, -2)


def _on_terrain(terrain: Terrain, grid: OrthoGrid, place: FloatArray) -> FloatArray:
    ground = grid.geodetic(place[:, 0], place[:, 1], 0.0)
    ground[:, 2] = terrain.height_at(ground[:, :2]).height_m
    return ground


def _on_height(grid: OrthoGrid, place: FloatArray, height_m: FloatArray) -> FloatArray:
    ground = grid.geodetic(place[:, 0], place[:, 1], 0.0)
    ground[:, 2] = height_m
    return ground


def _correction(found: DomMatches, level: _Level, before: ImageCorrection) -> ImageCorrection:
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
