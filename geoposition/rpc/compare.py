"""How far two models of one image are apart: OTHER − REFERENCE in pixels on a 3-D grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, read_only
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import has_result
from geoposition.sensor_model import SensorModel


@dataclass(frozen=True, slots=True)
class AxisStatistics:
    """Differences along one axis, px: `mean`, `std` about it, `max` of the absolute values.

    `max_without_mean` is the largest absolute value after the mean has been removed.
    """

    mean: float
    std: float
    max: float
    max_without_mean: float

    def as_dict(self) -> dict[str, float]:
        """Return the statistics by name."""
        return {
            "mean": self.mean,
            "std": self.std,
            "max": self.max,
            "max_without_mean": self.max_without_mean,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Differences OTHER − REFERENCE of a grid of `points` points that both models answer.

    The grid's axes are `height_m` (k), `line_px` (n) and `sample_px` (m); `difference_px`
    (k, n, m, 2) as (line, sample) is NaN where `flag` (k, n, m) has no result. `missed` counts
    those. `profile_px` (n, 2) is the mean difference of each line of the grid, over samples
    and heights: what depends on time.
    """

    points: int
    missed: int
    row: AxisStatistics
    col: AxisStatistics
    height_m: FloatArray
    line_px: FloatArray
    sample_px: FloatArray
    difference_px: FloatArray
    flag: FlagArray
    profile_px: FloatArray

    @property
    def residual_px(self) -> FloatArray:
        """Differences (k, n, m, 2) after the constant has been removed."""
        return self.difference_px - (self.row.mean, self.col.mean)

    def as_dict(self) -> dict[str, object]:
        """Return the summary as the command line prints it: `points`, `missed`, `row`, `col`."""
        return {
            "points": self.points,
            "missed": self.missed,
            "row": self.row.as_dict(),
            "col": self.col.as_dict(),
        }


def compare(
    reference: SensorModel,
    other: SensorModel,
    heights_m: ArrayLike | None = None,
    grid: tuple[int, int, int] = (21, 21, 5),
) -> Comparison:
    """Locate a grid of pixels with `reference`, project the ground with `other`, subtract.

    Parameters
    ----------
    reference, other
        Models of the same image, in the same pixels.
    heights_m
        Ellipsoidal heights (k) of the grid's layers; by default spread evenly over the height
        range of `other`.
    grid
        Lines, samples and heights of the grid, which covers the image of `reference` from its
        first to its last pixel's centre. The third number is not used with `heights_m`.

    Raises
    ------
    ArgumentError
        The grid or the heights are unusable.
    GeometryError
        No point of the grid is answered by both models.
    """
    lines, samples = reference.shape
    if min(grid) < 1:
        raise ArgumentError(f"grid: positive numbers of lines, samples, heights expected: {grid}")
    if heights_m is None:
        heights = _spread(*other.height_range_m, grid[2])
    else:
        heights = np.atleast_1d(np.asarray(heights_m, dtype=np.float64))
        if heights.ndim != 1 or heights.size == 0 or not np.all(np.isfinite(heights)):
            raise ArgumentError("heights_m: a list of finite heights expected")
    line_px = _spread(0.0, lines - 1.0, grid[0])
    sample_px = _spread(0.0, samples - 1.0, grid[1])
    image = np.stack(np.meshgrid(line_px, sample_px, indexing="ij"), axis=-1)
    image = np.broadcast_to(image, (heights.size, *image.shape))

    ground = reference.image_to_ground(image, heights[:, None, None])
    projected = other.ground_to_image(ground.geodetic)
    flag = np.where(has_result(ground.flag), projected.flag, ground.flag)
    good = has_result(flag)
    if not good.any():
        raise GeometryError("compare: no point of the grid is answered by both models")
    difference = np.where(good[..., None], projected.image_px - image, np.nan)
    count = good.sum(axis=(0, 2))
    profile = np.full((line_px.size, 2), np.nan)
    total = np.where(good[..., None], difference, 0.0).sum(axis=(0, 2))
    np.divide(total, count[:, None], out=profile, where=count[:, None] > 0)
    flag.setflags(write=False)
    return Comparison(
        points=int(good.sum()),
        missed=int(good.size - good.sum()),
        row=_statistics(difference[good][:, 0]),
        col=_statistics(difference[good][:, 1]),
        height_m=read_only(heights),
        line_px=read_only(line_px),
        sample_px=read_only(sample_px),
        difference_px=read_only(difference),
        flag=flag,
        profile_px=read_only(profile),
    )


def _spread(low: float, high: float, count: int) -> FloatArray:
    """`count` numbers from `low` to `high`, or the middle alone."""
    return np.linspace(low, high, count) if count > 1 else np.array([(low + high) / 2.0])


def _statistics(values: FloatArray) -> AxisStatistics:
    mean = float(values.mean())
    return AxisStatistics(
        mean=mean,
        std=float(values.std()),
        max=float(np.abs(values).max()),
        max_without_mean=float(np.abs(values - mean).max()),
    )
