"""Where the satellite was: positions and velocities over a span, in a stated frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components
from geoposition.constants import EARTH_RATE_RAD_S
from geoposition.errors import ArgumentError
from geoposition.interpolation import Curve, LagrangeCurve, PolynomialCurve, SplineCurve
from geoposition.timescale import Epoch

Frame = Literal["itrs", "gcrs"]
"""Reference frames of ephemeris and attitude: Earth-fixed (WGS 84) or inertial."""

VelocityKind = Literal["earth-fixed", "inertial-on-itrs-axes", "inconsistent"]

_EARTH_RATE_ECEF = np.array([0.0, 0.0, EARTH_RATE_RAD_S])


@dataclass(frozen=True, slots=True, eq=False)
class Ephemeris:
    """Positions of the satellite over a span.

    `curve` gives metres in `frame` at seconds from `epoch`; its derivative is the velocity, so
    that position and velocity never disagree. Outside the span a `SpanError` is raised.
    """

    epoch: Epoch
    curve: Curve
    frame: Frame = "itrs"

    @classmethod
    def lagrange(
        cls,
        epoch: Epoch,
        times_s: ArrayLike,
        position_m: ArrayLike,
        frame: Frame = "itrs",
        points: int = 8,
    ) -> Ephemeris:
        """Lagrange interpolation of `position_m` (n, 3) with `points` neighbours."""
        position = as_components(position_m, 3, "positions")
        return cls(epoch, LagrangeCurve(times_s, position, points), frame)  # type: ignore[arg-type]

    @classmethod
    def hermite(
        cls,
        epoch: Epoch,
        times_s: ArrayLike,
        position_m: ArrayLike,
        velocity_m_s: ArrayLike,
        frame: Frame = "itrs",
    ) -> Ephemeris:
        """Hermite interpolation; refused where the velocities are not the positions' rate.

        Some products give the inertial velocity on Earth-fixed axes (Pleiades): a Hermite curve
        through it is kilometres wrong. See `velocity_kind` and `earth_fixed_velocity`.
        """
        kind = velocity_kind(times_s, position_m, velocity_m_s)
        if kind != "earth-fixed":
            raise ArgumentError(
                f"Hermite ephemeris: velocities must be the rate of the positions, these are {kind}"
            )
        return cls(epoch, SplineCurve.hermite(times_s, position_m, velocity_m_s), frame)

    @classmethod
    def spline(
        cls, epoch: Epoch, times_s: ArrayLike, position_m: ArrayLike, frame: Frame = "itrs"
    ) -> Ephemeris:
        """Cubic spline through `position_m` (n, 3)."""
        position = as_components(position_m, 3, "positions")
        return cls(epoch, SplineCurve.through(times_s, position), frame)

    @classmethod
    def polynomial(
        cls,
        epoch: Epoch,
        times_s: ArrayLike,
        position_m: ArrayLike,
        degree: int = 2,
        frame: Frame = "itrs",
    ) -> Ephemeris:
        """Least-squares polynomial of `degree` through `position_m` (n, 3). Source: T 2.7."""
        position = as_components(position_m, 3, "positions")
        return cls(epoch, PolynomialCurve.fit(times_s, position, degree), frame)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds from `epoch`."""
        return self.curve.span_s

    def position_m(self, times_s: ArrayLike) -> FloatArray:
        """Positions (..., 3) in `frame`, metres, at `times_s` (...) from `epoch`."""
        return self.curve.value(times_s)

    def velocity_m_s(self, times_s: ArrayLike) -> FloatArray:
        """Velocities (..., 3) relative to `frame`, at `times_s` (...) from `epoch`."""
        return self.curve.rate(times_s)


def velocity_kind(
    times_s: ArrayLike,
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    tolerance_m_s: float = 0.5,
) -> VelocityKind:
    """Tell what the velocities (n, 3) beside Earth-fixed positions (n, 3) are.

    They are compared with the rate of the interpolated positions, once as they are and once
    with the Earth's rotation added (omega x r is some 500 m/s): `"earth-fixed"`,
    `"inertial-on-itrs-axes"` or `"inconsistent"`. The worst inner sample decides.
    """
    position = as_components(position_m, 3, "positions")
    velocity = as_components(velocity_m_s, 3, "velocities")
    if velocity.shape != position.shape:
        raise ArgumentError(f"velocities: shape {position.shape} expected, got {velocity.shape}")
    times = np.asarray(times_s, dtype=np.float64)
    rate = LagrangeCurve(times, position, 8).rate(times)
    inner = slice(1, -1) if len(times) > 4 else slice(None)
    rotation = np.cross(_EARTH_RATE_ECEF, position)
    for offset, kind in ((0.0, "earth-fixed"), (1.0, "inertial-on-itrs-axes")):
        error = np.linalg.norm(velocity - rate - offset * rotation, axis=-1)[inner]
        if np.max(error) <= tolerance_m_s:
            return kind  # type: ignore[return-value]
    return "inconsistent"


def earth_fixed_velocity(position_m: ArrayLike, inertial_velocity_m_s: ArrayLike) -> FloatArray:
    """Earth-fixed velocity (..., 3) from an inertial one given on Earth-fixed axes."""
    position = as_components(position_m, 3, "positions")
    velocity = as_components(inertial_velocity_m_s, 3, "velocities")
    result: FloatArray = velocity - np.cross(_EARTH_RATE_ECEF, position)
    return result
