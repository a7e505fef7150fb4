"""What the demo is asked for and what it finds, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from geoposition.accuracy import PointStatistics
from geoposition.arrays import FloatArray, IntArray
from geoposition.calib_fields.synthetic import SyntheticTerrain
from geoposition.observations import Ids, TiePoints
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.simulate import SceneOptions, SimulatedScene
from geoposition.triangulate import IntersectedPoints

Models: TypeAlias = Mapping[str, PushbroomModel]


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """Size and noise of the demo; `scene` says how the satellite flies and is measured."""

    seed: int = 1
    image_sigma_px: float = 0.3
    check_points: int = 300
    grid: int = 200
    scene: SceneOptions = field(default_factory=SceneOptions)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Ground points (n, 3) whose truth is known, and where the images show them, with noise."""

    ids: Ids
    geodetic: FloatArray
    image_px: Mapping[str, FloatArray]

    def ties(self) -> TiePoints:
        """Return the image points alone, as a user would have them; products by position."""
        n = len(self.ids)
        return TiePoints(
            ids=np.concatenate([self.ids] * len(self.image_px)),
            product=np.repeat(np.arange(len(self.image_px)), n),
            image_px=np.concatenate(list(self.image_px.values())),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Intersection:
    """Check points intersected with one set of models, against the truth."""

    found: IntersectedPoints
    statistics: PointStatistics
    normalised_rms: Mapping[str, float]
    """Errors over the stated sigma, root mean square, for e, n, u."""

    @property
    def mean_sigma_m(self) -> FloatArray:
        """Root mean square of the stated sigmas, east, north, up (3,)."""
        return np.asarray(np.sqrt(np.nanmean(self.found.sigma_enu_m**2, axis=0)))


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """What one arcsecond does: `measured_m` by the models, `expected_m` by range × angle."""

    what: str
    measured_m: float
    expected_m: float


@dataclass(frozen=True, slots=True, eq=False)
class DemoResult:
    """Everything that the files and the report are made of."""

    options: DemoOptions
    scene: SimulatedScene
    terrain: SyntheticTerrain
    outlines: Mapping[str, FloatArray]
    check: Measured
    grid: Measured
    grid_index: IntArray
    """Place (row × columns + column) of each grid point in the lattice `grid_shape`."""
    grid_shape: tuple[int, int]
    grid_extent_deg: tuple[float, float, float, float]
    true: Intersection
    measured: Intersection
    budget: Mapping[str, PointStatistics]
    residuals_px: Mapping[str, FloatArray]
    height_true: IntersectedPoints
    height_measured: IntersectedPoints
    height_error_true_m: FloatArray
    height_error_measured_m: FloatArray
    single: Mapping[str, PointStatistics]
    sensitivity: tuple[Sensitivity, ...]
