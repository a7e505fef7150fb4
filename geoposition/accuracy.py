"""How far points are from where they should be: statistics by axis, CE90 and LE90.

Errors are "found less true". Percentiles are empirical, of the errors as they are, a bias
included: CE90 is the radius that holds 90 % of the horizontal errors hypot(e, n), LE90 the
height that holds 90 % of |u|, both interpolated linearly between the sorted values. No normal
distribution is assumed; for unbiased normal errors of sigma per axis CE90 = 2.1460 sigma and
LE90 = 1.6449 sigma. NMAD is 1.4826 times the median distance from the median: the standard
deviation of normal errors, deaf to blunders.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.errors import ArgumentError

NMAD_FACTOR: Final = 1.4826022185056018
"""1 / quantile(0.75) of the standard normal distribution."""


@dataclass(frozen=True, slots=True)
class AxisStatistics:
    """Errors along one axis, all in the errors' own unit; `std` about the mean (n − 1).

    `minimum` and `maximum` are signed, `least` and `most` the smallest and largest size.
    `std` of a single error is NaN.
    """

    count: int
    mean: float
    std: float
    rmse: float
    minimum: float
    maximum: float
    median: float
    nmad: float
    least: float
    most: float

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name."""
        names = ("count", "mean", "std", "rmse", "minimum", "maximum", "median", "nmad", "least")
        return {name: getattr(self, name) for name in (*names, "most")}


@dataclass(frozen=True, slots=True)
class PointStatistics:
    """Errors of ground points in metres: east, north, up and ECEF X, Y, Z.

    `horizontal_rmse_m` is that of hypot(e, n), `rmse_3d_m` of the distance.
    """

    e: AxisStatistics
    n: AxisStatistics
    u: AxisStatistics
    x: AxisStatistics
    y: AxisStatistics
    z: AxisStatistics
    horizontal_rmse_m: float
    rmse_3d_m: float
    ce90_m: float
    le90_m: float

    @property
    def axes(self) -> Mapping[str, AxisStatistics]:
        """The six axes by name: e, n, u, x, y, z."""
        return {name: getattr(self, name) for name in ("e", "n", "u", "x", "y", "z")}

    def as_dict(self) -> dict[str, object]:
        """Return the numbers by name; axes are dictionaries themselves."""
        axes: dict[str, object] = {name: axis.as_dict() for name, axis in self.axes.items()}
        names = ("horizontal_rmse_m", "rmse_3d_m", "ce90_m", "le90_m")
        return axes | {name: getattr(self, name) for name in names}


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoids:
    """Error ellipsoids of points (n), one standard deviation.

    `semi_axis_m` (n, 3), longest first; `direction_enu` (n, 3, 3) their unit directions as
    columns, east, north, up, each with up >= 0.
    """

    semi_axis_m: FloatArray
    direction_enu: FloatArray

    @property
    def azimuth_deg(self) -> FloatArray:
        """Azimuths (n, 3) of the axes from north over east, 0 .. 360."""
        east, north = self.direction_enu[:, 0], self.direction_enu[:, 1]
        return np.asarray(np.degrees(np.arctan2(east, north)) % 360.0)

    @property
    def elevation_deg(self) -> FloatArray:
        """Elevations (n, 3) of the axes above the horizon, 0 .. 90."""
        return np.asarray(np.degrees(np.arcsin(np.clip(self.direction_enu[:, 2], -1.0, 1.0))))


def error_ellipsoids(covariance_enu_m2: ArrayLike) -> Ellipsoids:
    """Axes of covariances (n, 3, 3); NaN where these are.

    The ellipsoid that holds the share p of normal errors is larger by the root of the p-quantile
    of chi-squared with three degrees of freedom: 2.50 for 90 %.
    """
    covariance = np.asarray(covariance_enu_m2, dtype=np.float64).reshape(-1, 3, 3)
    known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    values, vectors = np.linalg.eigh(np.where(known[:, None, None], covariance, np.eye(3)))
    axes = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    directions = vectors[:, :, ::-1]
    directions = directions * np.where(directions[:, 2:] < 0.0, -1.0, 1.0)
    axes[~known], directions[~known] = np.nan, np.nan
    return Ellipsoids(axes, directions)


def axis_statistics(errors: ArrayLike) -> AxisStatistics:
    """Statistics of `errors` (n,), those that are NaN left out; none left is an `ArgumentError`."""
    values = np.asarray(errors, dtype=np.float64).ravel()
    values = values[np.isfinite(values)]
    if not values.size:
        raise ArgumentError("error statistics: at least one finite error expected")
    median = float(np.median(values))
    return AxisStatistics(
        count=len(values),
        mean=float(np.mean(values)),
        std=float(np.std(values, ddof=1)) if len(values) > 1 else float("nan"),
        rmse=_rms(values),
        minimum=float(np.min(values)),
        maximum=float(np.max(values)),
        median=median,
        nmad=NMAD_FACTOR * float(np.median(np.abs(values - median))),
        least=float(np.min(np.abs(values))),
        most=float(np.max(np.abs(values))),
    )


def enu_errors_m(geodetic: ArrayLike, true_geodetic: ArrayLike) -> FloatArray:
    """East, north, up (..., 3) at `true_geodetic` (..., 3) of `geodetic` less it, metres."""
    true = as_components(true_geodetic, 3, "true points")
    difference = xyz_errors_m(geodetic, true)
    result: FloatArray = np.einsum("...ji,...j->...i", enu_axes(true), difference)
    return result


def xyz_errors_m(geodetic: ArrayLike, true_geodetic: ArrayLike) -> FloatArray:
    """ECEF X, Y, Z (..., 3) of `geodetic` (..., 3) less `true_geodetic`."""
    result: FloatArray = geodetic_to_ecef(geodetic) - geodetic_to_ecef(true_geodetic)
    return result


def point_statistics(geodetic: ArrayLike, true_geodetic: ArrayLike) -> PointStatistics:
    """Statistics of points (n, 3) against the true ones; points that are NaN are left out.

    *Source*: T tables 5.2–5.4, which give RMSE by axis; here with both systems of axes named.
    """
    found = as_components(geodetic, 3, "points").reshape(-1, 3)
    true = as_components(true_geodetic, 3, "true points").reshape(-1, 3)
    if found.shape != true.shape:
        raise ArgumentError(
            f"error statistics: one true point per point expected, got {len(true)} for {len(found)}"
        )
    good = np.isfinite(found).all(axis=1) & np.isfinite(true).all(axis=1)
    enu = enu_errors_m(found[good], true[good])
    xyz = xyz_errors_m(found[good], true[good])
    e, n, u = (axis_statistics(enu[:, k]) for k in range(3))
    x, y, z = (axis_statistics(xyz[:, k]) for k in range(3))
    return PointStatistics(
        e=e,
        n=n,
        u=u,
        x=x,
        y=y,
        z=z,
        horizontal_rmse_m=_rms(np.hypot(enu[:, 0], enu[:, 1])),
        rmse_3d_m=_rms(np.linalg.norm(enu, axis=1)),
        ce90_m=circular_error_m(enu[:, :2]),
        le90_m=linear_error_m(enu[:, 2]),
    )


def circular_error_m(en_m: ArrayLike, probability: float = 0.9) -> float:
    """Radius that holds the share `probability` of horizontal errors `en_m` (n, 2)."""
    errors = as_components(en_m, 2, "horizontal errors")
    return _percentile(np.hypot(errors[..., 0], errors[..., 1]), probability)


def linear_error_m(up_m: ArrayLike, probability: float = 0.9) -> float:
    """Size that the share `probability` of errors `up_m` (n,) does not exceed."""
    return _percentile(np.abs(np.asarray(up_m, dtype=np.float64)), probability)


def normalised_rms(errors: ArrayLike, sigma: ArrayLike) -> float:
    """Root mean square of errors (n,) over their stated `sigma` (n,): 1 where these are right."""
    ratio = np.asarray(errors, dtype=np.float64) / np.asarray(sigma, dtype=np.float64)
    ratio = ratio[np.isfinite(ratio)]
    if not ratio.size:
        raise ArgumentError("error statistics: at least one finite error and sigma expected")
    return _rms(ratio)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values)))


def _percentile(sizes: FloatArray, probability: float) -> float:
    finite = sizes[np.isfinite(sizes)]
    if not (finite.size and 0.0 < probability < 1.0):
        raise ArgumentError("error statistics: finite errors and a probability in 0..1 expected")
    return float(np.quantile(finite, probability))
