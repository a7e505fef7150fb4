"""How well a mean over matched points is known.

Errors at points near each other are alike: their windows overlap, terrain and light are the same.
Points are therefore summed over square cells of the image, and the scatter of these sums tells
the variance of the mean. What varies smoothly over the image is no chance but part of what is
measured, evenly as the points lie; it is taken out first.

*Source*: Liang & Zeger 1986, Biometrika 73, for the variance from clusters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.calib_fields.smooth import polynomial_powers, polynomial_terms

CONFIDENCE: Final = 0.95
_DEGREE: Final = 4
_POINTS_PER_TERM: Final = 8


@dataclass(frozen=True, slots=True)
class Estimate:
    """A mean, its standard deviation, and how many degrees of freedom this rests on.

    With `squared` the mean is one of squares, and what is told is its root.
    """

    mean: float
    sigma: float
    freedom: float
    squared: bool = False

    @property
    def value(self) -> float:
        """The mean, or its root."""
        return float(np.sqrt(max(self.mean, 0.0))) if self.squared else self.mean

    @property
    def interval(self) -> tuple[float, float]:
        """Where the truth lies with a confidence of 95 %."""
        reach = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(self.freedom, 1.0))) * self.sigma
        low, high = self.mean - reach, self.mean + reach
        if self.squared:
            return float(np.sqrt(max(low, 0.0))), float(np.sqrt(max(high, 0.0)))
        return low, high

    def widened(self, sigma: float) -> Estimate:
        """Return it with one more, independent and well known, deviation."""
        if sigma == 0.0:
            return self
        both = float(np.hypot(self.sigma, sigma))
        # Welch and Satterthwaite: what is well known brings freedom
        freedom = self.freedom * (both / max(self.sigma, 1e-12)) ** 4
        return Estimate(self.mean, both, float(min(freedom, 1e6)), self.squared)


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Square cells over the image: number of each point's cell (n,), and its place (n, 2)."""

    index: IntArray
    place: FloatArray

    @classmethod
    def of(cls, image_px: FloatArray, side_px: float) -> Cells:
        """Cells of `side_px` over points (n, 2), fewer but at least about ten if points are few."""
        low, size = image_px.min(axis=0), np.maximum(np.ptp(image_px, axis=0), 1.0)
        side = min(side_px, float(np.sqrt(np.prod(size) / 10.0)))
        cell = np.floor((image_px - low) / max(side, 1.0)).astype(np.int64)
        _, index = np.unique(cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1], return_inverse=True)
        return cls(index.astype(np.int64), (image_px - low) / size * 2.0 - 1.0)

    def mean(
        self, values: FloatArray, keep: BoolArray | None = None, degree: int = _DEGREE
    ) -> Estimate:
        """Mean of `values` (n,), of those in `keep` (n,) if given.

        What a polynomial of `degree` over the image follows is no chance; with 0 all scatter is.
        """
        kept = np.ones(len(values), dtype=np.bool_) if keep is None else keep
        used, index = values[kept], self.index[kept]
        n = len(used)
        while degree and n < _POINTS_PER_TERM * len(polynomial_powers(degree)):
            degree -= 1
        terms = polynomial_terms(self.place[kept], polynomial_powers(degree))
        left = used - terms @ np.linalg.lstsq(terms, used, rcond=None)[0]
        sums = np.bincount(index, left)
        cells = len(np.unique(index))
        freedom = max(cells - 1.0, 1.0)
        # a polynomial takes out of the scatter what it has of it
        lost = 1.0 / max(1.0 - terms.shape[1] / n, 0.1)
        variance = float(np.sum(sums**2)) / n**2 * lost * cells / freedom
        return Estimate(float(used.mean()), float(np.sqrt(variance)), freedom)
