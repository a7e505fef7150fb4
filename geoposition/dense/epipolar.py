"""Epipolar tiles: two images resampled so that the same ground lies in the same row of both.

A tile's column u and row v are places in the first image,
    x = origin + f (v e_v + u e_u),
f the reduction, e_u the epipolar direction at the tile's middle: along it the match of a point
moves when its height does. e_v is a unit step along the image axis that e_u is farther from, and
e_u has unit length along the other, so that the pixels of the first image lie on whole columns.

The second image is resampled as if the ground were a known surface s: at (v, u) it shows
G(x, s(x)), G the models' quadratic guide. Ground on the surface has disparity 0 whatever the
models; ground off it, disparity d, appears at column u − d of its row up to what the epipolar
direction changes over the tile, times |d|, and what the quadratic misses. `residual_px` measures
that with the models themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.dense import resample
from geoposition.dense.height_field import Grid32, HeightField
from geoposition.flags import has_result
from geoposition.matching.guide import Guide, guide
from geoposition.matching.image import Window
from geoposition.sensor_model import SensorModel

LEAST_PX_PER_M: Final = 1e-3
"""Parallax below this tells no heights: 1 px is a kilometre."""

_CHECKS: Final = 5
_STEPS: Final = 4
_COARSE: Final = 16
_APRON_PX: Final = 4
_LEAST_HEIGHTS_M: Final = 20.0
_LEAST_AREA: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarTile:
    """Geometry of one tile.

    `core` is the part of the first image that the tile answers for. `origin_px` (2,) is where
    (v, u) = (0, 0) lies; `e_v`, `e_u` (2,) as above; `shape` (rows, columns); `reduction` f.
    `disparities_px` are the least and most to look for, in columns; `px_per_m` is how many
    columns a point moves per metre of height, signed.
    """

    core: Window
    chart: Guide
    field: HeightField
    origin_px: FloatArray
    e_v: FloatArray
    e_u: FloatArray
    shape: tuple[int, int]
    reduction: int
    disparities_px: tuple[float, float]
    px_per_m: float

    @property
    def first_window(self) -> Window:
        """The part of the first image that the tile shows, unbounded by its extent."""
        corners = self._first_px(*self._mesh(np.array([0, 1]), np.array([0, 1]), whole=True))
        return _around(corners, self.reduction)

    def second_window(self) -> Window:
        """Return the part of the second image that the tile shows, unbounded by its extent."""
        rows, columns = self.shape
        v = np.linspace(0, rows - 1, max(2, rows // _COARSE))
        u = np.linspace(0, columns - 1, max(2, columns // _COARSE))
        return _around(self.second_px(self._first_px(*self._mesh(v, u)), 0.0), self.reduction)

    def _mesh(self, v: FloatArray, u: FloatArray, whole: bool = False) -> list[FloatArray]:
        if whole:
            v, u = v * (self.shape[0] - 1), u * (self.shape[1] - 1)
        return [axis.reshape(-1) for axis in np.meshgrid(v, u, indexing="ij")]

    def _first_px(self, v: FloatArray, u: FloatArray) -> FloatArray:
        step = v[:, None] * self.e_v + u[:, None] * self.e_u
        return self.origin_px + self.reduction * step

    def second_px(self, first_px: FloatArray, disparity_px: FloatArray | float) -> FloatArray:
        """Where in the second image `first_px` (n, 2) appears, if it has `disparity_px` (n,)."""
        moved = (
            first_px - np.multiply.outer(disparity_px, self.reduction * self.e_u)
            if np.ndim(disparity_px)
            else first_px - float(disparity_px) * self.reduction * self.e_u
        )
        return self.chart.at(moved, self.field.at(moved))

    def view_first(self, grey: resample.Grey, window: Window) -> resample.Grey:
        """Resample `grey`, the reduced pixels of `window`; NaN outside."""
        out = np.empty(self.shape, dtype=np.float32)
        resample.view_first(grey, self._affine(window), out)
        return out

    def view_second(self, grey: resample.Grey, window: Window) -> resample.Grey:
        """Resample `grey`, the reduced pixels of `window` of the second image; NaN outside."""
        out = np.empty(self.shape, dtype=np.float32)
        f = self.reduction
        resample.view_second(
            grey,
            self._affine(Window(0, 0, 1, 1), full=True),
            *self.kernel_parts(),
            resample.pixel_of(window, f),
            out,
        )
        return out

    def kernel_parts(self) -> tuple[Grid32, FloatArray, FloatArray, FloatArray]:
        """Return nodes and place of the surface, the quadratic's coefficients, normalisation."""
        normal = np.concatenate([self.chart.centre, 1.0 / self.chart.extent])
        return self.field.height_m, self.field.place, self.chart.coefficients, normal

    def _affine(self, window: Window, full: bool = False) -> FloatArray:
        """(2, 3): (1, v, u) to the pixels of a window's reduced array, or to the image's."""
        f = float(self.reduction)
        affine = np.column_stack([self.origin_px, f * self.e_v, f * self.e_u])
        if full:
            return affine
        first, scale = resample.pixel_of(window, self.reduction).reshape(2, 2)
        affine[:, 0] -= first
        return affine * scale[:, None]


def epipolar_tile(
    first: SensorModel,
    second: SensorModel,
    core: Window,
    field: HeightField,
    reduction: int = 1,
    apron_px: tuple[int, int] = (16, 16),
    slack_px: float = 4.0,
) -> EpipolarTile | None:
    """Lay a tile over `core`, or None where the second model sees too little of its ground.

    None too where the models show no parallax there. Disparities cover what `field` says of the
    ground and `slack_px` more; `apron_px` is added around, (across, along) the epipolar lines.
    """
    lowest, highest, low, high = field.over(core, reach_px=64.0 * reduction)
    middle = 0.5 * (lowest + low + highest + high)
    half = max(0.5 * (highest + high - lowest - low), _LEAST_HEIGHTS_M)
    reach = reduction * 64
    around = Window(
        core.line - reach, core.sample - reach, core.lines + 2 * reach, core.samples + 2 * reach
    )
    chart = guide(first, second, around, (middle - half, middle + half))
    if chart is None:
        chart = guide(first, second, core, (middle - half, middle + half))
    if chart is None:
        return None
    f = float(reduction)
    centre = np.array([core.line, core.sample]) + 0.5 * np.array([core.lines, core.samples]) - 0.5
    step = _epipolar(chart, centre, middle)
    if not float(np.hypot(*step)) > LEAST_PX_PER_M:
        return None
    major = int(np.argmax(np.abs(step)))
    e_u, e_v = step / step[major], np.eye(2)[1 - major]
    # A match is at u − d: higher ground, further along, has a smaller disparity.
    px_per_m = -float(step[major]) / f
    span = sorted((low * px_per_m, high * px_per_m))
    least, most = float(np.floor(span[0] - slack_px)), float(np.ceil(span[1] + slack_px))
    # Whole columns are whole reduced pixels along the major axis.
    size = np.array([core.lines, core.samples]) / f
    pad_u = int(apron_px[1] + max(abs(least), abs(most)))
    columns = int(np.ceil(size[major])) + 2 * pad_u
    lean = e_u[1 - major] * (columns - 1)
    first_px = np.array([core.line, core.sample], dtype=np.float64) + 0.5 * (f - 1.0)
    origin = first_px.copy()
    origin[major] -= f * pad_u
    origin[1 - major] -= f * (apron_px[0] + np.ceil(max(lean, 0.0)))
    rows = int(np.ceil(size[1 - major])) + 2 * apron_px[0] + int(np.ceil(abs(lean))) + 1
    return EpipolarTile(
        core, chart, field, origin, e_v, e_u, (rows, columns), reduction, (least, most), px_per_m
    )


def residual_px(tile: EpipolarTile, first: SensorModel, second: SensorModel) -> float:
    """Farthest that the models' own projections lie beside the tile's rows, reduced pixels.

    Checked on a grid over the core, for disparities over the whole range; NaN where nothing of
    it is seen by both models.
    """
    core = tile.core
    mesh = np.meshgrid(
        np.linspace(core.line, core.line + core.lines - 1.0, _CHECKS),
        np.linspace(core.sample, core.sample + core.samples - 1.0, _CHECKS),
        np.linspace(*tile.disparities_px, _CHECKS),
        indexing="ij",
    )
    place = np.stack(mesh, axis=-1).reshape(-1, 3)
    image, disparity = place[:, :2], place[:, 2]
    # The surface a disparity away, and the height there: the true place is then projected.
    height = tile.field.at(image) + disparity / tile.px_per_m
    ground = first.image_to_ground(image, height)
    seen = second.ground_to_image(ground.geodetic)
    good = has_result(ground.flag) & has_result(seen.flag)
    if not good.any():
        return float("nan")
    image, disparity, target = image[good], disparity[good], seen.image_px[good]
    for _ in range(_STEPS):
        here = tile.second_px(image, disparity)
        slope = tile.second_px(image, disparity + 0.5) - tile.second_px(image, disparity - 0.5)
        length2 = np.maximum(np.sum(slope * slope, axis=1), 1e-12)
        disparity = disparity + np.sum((target - here) * slope, axis=1) / length2
    off = target - tile.second_px(image, disparity)
    across = (off[:, 0] * slope[:, 1] - off[:, 1] * slope[:, 0]) / np.sqrt(length2)
    return float(np.max(np.abs(across))) / tile.reduction


def _epipolar(chart: Guide, centre: FloatArray, height_m: float) -> FloatArray:
    """How a point of the first image must move (2,) to stay with its match, per metre of height.

    G(x + step, s) = G(x, s + 1): along the epipolar line, as long as a metre's parallax.
    """
    turn, lift = _slopes(chart, centre, height_m)
    if abs(float(np.linalg.det(turn))) < _LEAST_AREA:
        return np.zeros(2)
    return np.asarray(np.linalg.solve(turn, lift), dtype=np.float64)


def _slopes(chart: Guide, centre: FloatArray, height_m: float) -> tuple[FloatArray, FloatArray]:
    """d(second image)/d(first image) (2, 2) at a height, and d(second image)/d(height) (2,)."""
    sides = centre + np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    seen = chart.at(sides, height_m)
    turn = 0.5 * np.column_stack([seen[0] - seen[1], seen[2] - seen[3]])
    up, down = (chart.at(centre[None], height_m + step)[0] for step in (1.0, -1.0))
    return turn, 0.5 * (up - down)


def _around(points_px: FloatArray, reduction: int) -> Window:
    """Window around `points_px`, on whole reduced pixels, with a margin for interpolation."""
    f = reduction
    first = np.floor(points_px.min(axis=0) / f).astype(int) * f - _APRON_PX * f
    last = np.ceil(points_px.max(axis=0) / f).astype(int) * f + _APRON_PX * f
    return Window(int(first[0]), int(first[1]), *(int(n) for n in last - first))
