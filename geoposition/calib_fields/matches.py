"""What matching an image with a reference orthophoto gives, and how it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from geoposition.arrays import BoolArray, FlagArray, FloatArray
from geoposition.errors import ArgumentError


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
    def dependence(self) -> float:
        """How many patches count as one, because they share pixels."""
        return max(1.0, (self.window_px / self.spacing_px) ** 2)

    @property
    def counts(self) -> dict[str, int]:
        """How many patches each cause has."""
        return {cause.name.lower(): int(np.sum(self.cause == cause)) for cause in Cause}
