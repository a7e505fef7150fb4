"""Patches near each other: found in the image, measured in its pixels and on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from geoposition.accuracy import enu_errors_m
from geoposition.arrays import BoolArray, FlagArray, FloatArray, IntArray
from geoposition.calib_fields.correlate import correlate
from geoposition.calib_fields.dom import Dom
from geoposition.calib_fields.geometry import OrthoImage, OrthoWindow
from geoposition.calib_fields.matches import Cause, DomMatchOptions
from geoposition.calib_fields.overlap import Overlap
from geoposition.calib_fields.refine import Searched, Template, refine
from geoposition.flags import has_result
from geoposition.reimage.ortho import OrthoGrid
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

_EDGE_PX: Final = 4
_FEATURELESS: Final = 0.02
"""Contrast of a patch below this part of the scene's is none."""


@dataclass(frozen=True, slots=True)
class Level:
    """A lattice `factor` times coarser than the orthophoto's; patches every `spacing` pixels."""

    factor: int
    pixel_m: float
    radius: int
    spacing: int
    degree: int


class Patches(NamedTuple):
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
    def lost(cls, n: int, cause: Cause) -> Patches:
        """Of `n` patches that came to nothing for one `cause`."""

        def empty(*shape: int) -> FloatArray:
            return np.full((n, *shape), np.nan)

        return cls(
            empty(3), empty(2), empty(2), empty(2, 2), empty(2), empty(2, 2), empty(),
            np.full(n, float(cause)),
        )  # fmt: skip


def match_block(
    image: OrthoImage,
    dom: Dom,
    lattice: OrthoGrid,
    overlap: Overlap,
    level: Level,
    corners: IntArray,
    options: DomMatchOptions,
) -> Patches:
    """Match patches near each other."""
    window, margin = options.window_px, level.radius + _EDGE_PX
    low = corners.min(axis=0) - margin
    size = corners.max(axis=0) + window + margin - low
    grid = lattice.window(int(low[0]), int(low[1]), int(size[0]), int(size[1]))
    n = len(corners)
    reference = dom.read(grid)
    if not np.isfinite(reference).any():
        return Patches.lost(n, Cause.NODATA)
    ortho = image.on(grid, overlap.mean_sample_m, level.pixel_m)
    if not np.isfinite(ortho.grey).any():
        hole = bool(ortho.without_height.any())
        return Patches.lost(n, Cause.NODATA if hole else Cause.OUTSIDE)
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
) -> Patches:
    """Places, residuals and covariances of patches around `middle` (n, 2); NaN where not good."""
    out = Patches.lost(len(middle), Cause.USED)
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
        image.model.ground_to_image(on_height(grid, middle[rows] + move, height)).image_px
        for move in np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    ]
    jacobian = np.stack([step[1] - step[0], step[2] - step[0]], axis=-1)
    out.covariance_px2[rows] = jacobian @ covariance_px2[rows] @ np.swapaxes(jacobian, -1, -2)
    out.shift_en_m[rows], out.covariance_m2[rows] = on_ground(
        image.model,
        out.ground[rows],
        out.image_px[rows],
        out.covariance_px2[rows],
        out.model_px[rows],
    )
    return out


def on_ground(
    model: SensorModel,
    ground: FloatArray,
    image_px: FloatArray,
    covariance_px2: FloatArray,
    model_px: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """East and north from where the model locates the image points to the reference, metres.

    At the reference's height: the error of the image's plane coordinates, not of the terrain.
    """
    height = ground[:, 2]
    located = model.image_to_ground(image_px, height)
    en = -enu_errors_m(located.geodetic, ground)[:, :2]
    steps = []
    at = model.image_to_ground(model_px, height).geodetic
    for move in ((1.0, 0.0), (0.0, 1.0)):
        moved = model.image_to_ground(model_px + move, height).geodetic
        steps.append(enu_errors_m(moved, at)[:, :2])
    jacobian = np.stack(steps, axis=-1)
    return en, jacobian @ covariance_px2 @ np.swapaxes(jacobian, -1, -2)


def _on_terrain(terrain: Terrain, grid: OrthoGrid, place: FloatArray) -> FloatArray:
    ground = grid.geodetic(place[:, 0], place[:, 1], 0.0)
    ground[:, 2] = terrain.height_at(ground[:, :2]).height_m
    return ground


def on_height(grid: OrthoGrid, place: FloatArray, height_m: FloatArray) -> FloatArray:
    """Ground points (n, 3) of pixels `place` (n, 2) of `grid`, `height_m` high."""
    ground = grid.geodetic(place[:, 0], place[:, 1], 0.0)
    ground[:, 2] = height_m
    return ground
