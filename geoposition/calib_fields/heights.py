"""Height accuracy of intersected points against a field's DEM: bias, RMSE and LE90."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.accuracy import enu_errors_m, linear_error_m
from geoposition.arrays import FloatArray
from geoposition.calib_fields.estimates import LEAST_POINTS
from geoposition.calib_fields.intervals import Cells, Estimate
from geoposition.errors import GeometryError
from geoposition.terrain import Terrain

_LE: Final = 0.9
_DENSITY: Final = 0.06
_CELLS: Final = 60
"""Cells over the area that errors are summed over, about."""
_BLUNDER: Final = 8.0
"""Robust deviations beyond which a height is no measurement."""


@dataclass(frozen=True, slots=True)
class HeightAccuracy:
    """Numbers by name, each with its interval; how many points count, and how many were blunders.

    `bias_u_m` is reference less located, as the plane's biases are.
    """

    points: int
    blunders: int
    estimates: dict[str, Estimate]

    def as_dict(self) -> dict[str, object]:
        """Return the numbers as JSON has them."""
        out: dict[str, object] = {"height_points": self.points, "height_blunders": self.blunders}
        for name, estimate in self.estimates.items():
            out[name] = estimate.value
            out[f"{name}_interval"] = list(estimate.interval)
        return out


def evaluate_heights(
    geodetic: FloatArray, terrain: Terrain, reference_sigma_m: float = 0.0
) -> HeightAccuracy:
    """Compare intersected points (n, 3) with the terrain under them.

    `reference_sigma_m` is the deviation of the DEM's datum, a constant error of unknown size.
    `GeometryError` where fewer than 12 points lie on the terrain.
    """
    known = geodetic[np.isfinite(geodetic).all(axis=1)]
    up = terrain.height_at(known[:, :2]).height_m - known[:, 2]
    there = np.isfinite(up)
    known, up = known[there], up[there]
    off = np.abs(up - np.median(up)) if len(up) else up
    good = off <= _BLUNDER * max(1.4826 * float(np.median(off)), 0.1) if len(up) else off > 0.0
    if good.sum() < LEAST_POINTS:
        raise GeometryError(
            f"heights: at least {LEAST_POINTS} points over the DEM needed, got {good.sum()}"
        )
    place = enu_errors_m(known[good], np.broadcast_to(known[good][0], known[good].shape))[:, :2]
    side = float(np.sqrt(np.prod(np.maximum(np.ptp(place, axis=0), 1.0)) / _CELLS))
    cells, up = Cells.of(place, side), up[good]
    mean, square = cells.mean(up), cells.mean(up**2)
    moved = float(np.hypot(2.0 * mean.mean * reference_sigma_m, 2.0**0.5 * reference_sigma_m**2))
    size = np.abs(up)
    radius = linear_error_m(up, _LE)
    below = cells.mean((size <= radius).astype(np.float64))
    low, high = np.quantile(size, [_LE - _DENSITY, _LE + _DENSITY])
    sampled = below.sigma * float(high - low) / (2.0 * _DENSITY)
    le90 = Estimate(radius, float(np.hypot(sampled, mean.sigma)), below.freedom)
    return HeightAccuracy(
        points=int(good.sum()),
        blunders=int((~good).sum()),
        estimates={
            "bias_u_m": mean.widened(reference_sigma_m),
            "rmse_u_m": Estimate(square.mean, square.sigma, square.freedom, squared=True).widened(
                moved
            ),
            "le90_m": le90.widened(reference_sigma_m),
        },
    )
