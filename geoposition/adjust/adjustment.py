"""The result of an adjustment: unknowns, how well they are known, what each point said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from geoposition.adjust.solve import Iteration
from geoposition.adjust.unknowns import Block
from geoposition.arrays import FlagArray, FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.observations import Ids
from geoposition.sensor_model import SensorModel


class Status(IntEnum):
    """What became of a point in the adjustment."""

    USED = 0
    REJECTED = 1
    """A blunder: its residual is far outside what noise explains."""
    CHECK = 2
    """Kept out on purpose, to compare with."""
    UNUSABLE = 3
    """No image sees it, too few do, or its lines of sight do not meet."""


@dataclass(frozen=True, slots=True, eq=False)
class PointResults:
    """Points (n) of one role, and their observations (m rows, in the order of the given table).

    Per point: `ids`, `status`, the chi-square `statistic` of its residuals with `freedom`
    degrees of freedom beside the `limit` that made it a blunder, its share `redundancy`; the
    ground intersected from the images alone (a point in one image keeps its height) `geodetic`
    with the adjusted models, and for control and check points its error, east, north, up:
    `error_enu_m` and, with the models as they came, `error_before_enu_m` (n, 3).
    `covariance_enu_m2` (n, 3, 3) is that of the intersected point, unknowns' and image points'
    errors together; for check points it predicts the error, the given position's own aside.

    Per row: `point` (m), `product`, `image_px`, and the residuals, observed − projected,
    `residual_px` and `residual_before_px` (m, 2): of the given position for control and check
    points, of the intersected one for ties.
    """

    ids: Ids
    status: FlagArray
    statistic: FloatArray
    freedom: IntArray
    limit: FloatArray
    redundancy: FloatArray
    geodetic: FloatArray
    error_enu_m: FloatArray
    error_before_enu_m: FloatArray
    covariance_enu_m2: FloatArray
    point: IntArray
    product: IntArray
    image_px: FloatArray
    residual_px: FloatArray
    residual_before_px: FloatArray

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def sigma_enu_m(self) -> FloatArray:
        """Predicted standard deviations east, north, up (n, 3)."""
        return np.sqrt(np.diagonal(self.covariance_enu_m2, axis1=1, axis2=2))

    def with_status(self, status: Status) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Points of one status, as a mask."""
        return np.asarray(self.status == status)

    def rmse_enu_m(self, *, before: bool = False) -> FloatArray:
        """Root mean square errors east, north, up (3) of points that were not rejected."""
        errors = self.error_before_enu_m if before else self.error_enu_m
        good = (self.status == Status.USED) | (self.status == Status.CHECK)
        kept = errors[good & np.isfinite(errors[:, 0])]
        if not len(kept):
            return np.full(3, np.nan)
        return np.asarray(np.sqrt(np.mean(kept**2, axis=0)))

    def rmse_m(self, *, before: bool = False) -> float:
        """Root mean square distance in space, metres."""
        return float(np.sqrt(np.sum(self.rmse_enu_m(before=before) ** 2)))


@dataclass(frozen=True, slots=True)
class Rejection:
    """A point found to be a blunder, and why: `statistic` against `limit`, and a likely cause."""

    id: str
    role: str
    statistic: float
    limit: float
    residual_px: float
    reason: str


@dataclass(frozen=True, slots=True)
class WeakCombination:
    """A combination of unknowns the measurements hardly determine.

    `parts` are its coefficients by name, in units of the prior sigmas, largest first;
    `gain` is 1 − posterior variance / prior variance, 0 where nothing was learnt.
    """

    parts: tuple[tuple[str, float], ...]
    gain: float

    def __str__(self) -> str:
        terms = " ".join(f"{value:+.2f} {name}" for name, value in self.parts)
        return f"{terms}: {100.0 * self.gain:.0f} % determined by the measurements"


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """One adjustment, finished: unknowns (p) by name, points by role, adjusted models.

    `values`, `covariance` are in the unknowns' own `units`; `gain` (p) is
    1 − posterior / prior variance. `sigma0` is 1 where residuals are as large as stated;
    `redundancy` counts the equations beyond what unknowns and points need. `scale` by role is
    how many times the stated noise the bulk of a role's points shows, where that is more than
    chance. `weak` combinations of unknowns rest on their priors; `correlated` names pairs with
    correlations beyond 0.95. `models` are sensor models like any other.
    """

    blocks: tuple[Block, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    prior_sigma: FloatArray
    models: tuple[SensorModel, ...]
    base_models: tuple[SensorModel, ...]
    control: PointResults
    check: PointResults
    ties: PointResults
    rejected: tuple[Rejection, ...]
    sigma0: float
    redundancy: float
    scale: Mapping[str, float]
    weak: tuple[WeakCombination, ...]
    correlated: tuple[tuple[str, str, float], ...]
    history: tuple[Iteration, ...]

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (p) of the unknowns."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def gain(self) -> FloatArray:
        """1 − posterior variance / prior variance (p)."""
        return 1.0 - (self.sigma / self.prior_sigma) ** 2

    def value_of(self, name: str) -> float:
        """One unknown by name; an unknown name is an `ArgumentError`."""
        if name not in self.names:
            raise ArgumentError(f"adjustment: no unknown {name}")
        return float(self.values[self.names.index(name)])

    def block_values(self, name: str) -> FloatArray:
        """Values of one block by name; an unknown name is an `ArgumentError`."""
        at = 0
        for block in self.blocks:
            if block.name == name:
                return self.values[at : at + len(block)]
            at += len(block)
        raise ArgumentError(f"adjustment: no block {name}")
