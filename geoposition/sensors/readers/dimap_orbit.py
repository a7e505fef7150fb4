"""Orbit points of Airbus and CNES products: ephemeris, and the orbital axes SPOT 1-5 refer to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.ephemeris import Ephemeris, velocity_kind
from geoposition.errors import ProductError
from geoposition.interpolation import Curve, LagrangeCurve
from geoposition.sensors.readers.dimap_xml import blamed_on, epoch_at, unit_factor
from geoposition.timescale import Epoch
from geoposition.xmlfile import XmlNode

LAGRANGE_POINTS: Final = 8
_LEAST_POINTS: Final = 4
_LEAST_POINTS_COARSE: Final = 6
_COARSE_STEP_S: Final = 5.0
_RADIUS_RANGE_M: Final = (6.4e6, 9e6)


@dataclass(frozen=True, slots=True)
class Orbit:
    """Points of an orbit: `times_s` (n,) from `epoch`, Earth-fixed `position_m` (n, 3).

    `velocity_m_s` (n, 3) is as in the file: Earth-fixed, or inertial on Earth-fixed axes.
    """

    epoch: Epoch
    times_s: FloatArray
    position_m: FloatArray
    velocity_m_s: FloatArray

    @property
    def lagrange_points(self) -> int:
        """Neighbours that the interpolation uses."""
        return min(LAGRANGE_POINTS, len(self.times_s))

    @property
    def velocity_kind(self) -> str:
        """What the file's velocities are; they may be of no use for a Hermite curve."""
        if len(self.times_s) < LAGRANGE_POINTS:
            return "unknown (too few points)"
        return velocity_kind(self.times_s, self.position_m, self.velocity_m_s)

    @property
    def positions(self) -> LagrangeCurve:
        """Interpolated positions."""
        return LagrangeCurve(self.times_s, self.position_m, self.lagrange_points)

    @property
    def velocities(self) -> LagrangeCurve:
        """Interpolated velocities, of the file's kind."""
        return LagrangeCurve(self.times_s, self.velocity_m_s, self.lagrange_points)

    def ephemeris(self) -> Ephemeris:
        """Earth-fixed ephemeris; from the positions alone, whatever the velocities are."""
        return Ephemeris(self.epoch, self.positions)

    def prolonged(self, first_s: float, last_s: float, most_s: float) -> Orbit:
        """Add points at `first_s` and `last_s` where the orbit misses them by <= `most_s`.

        An added point lies on the polynomial through the last ones, so nothing changes inside.
        """
        m = self.lagrange_points
        orbit = self
        for end, at_s in ((slice(0, m), first_s), (slice(-m, None), last_s)):
            beyond = max(self.times_s[0] - at_s, at_s - self.times_s[-1])
            if not 0 < beyond <= most_s:
                continue
            nodes = self.times_s[end] - at_s
            index = 0 if at_s < self.times_s[0] else len(orbit.times_s)
            position = BarycentricInterpolator(nodes, self.position_m[end])(0.0)
            velocity = BarycentricInterpolator(nodes, self.velocity_m_s[end])(0.0)
            orbit = Orbit(
                self.epoch,
                np.insert(orbit.times_s, index, at_s),
                np.insert(orbit.position_m, index, position, axis=0),
                np.insert(orbit.velocity_m_s, index, velocity, axis=0),
            )
        return orbit


def read_orbit(
    points: XmlNode, epoch: Epoch, location: str, velocity: str, time: str, tag: str = "Point"
) -> Orbit:
    """Orbit from the elements `tag` under `points`, whose children have the names given.

    `location` and `velocity` hold three numbers, or are elements with children X, Y, Z.
    """
    nodes = points.some(tag)
    times = np.array([epoch_at(node, time) - epoch for node in nodes])
    position = np.array([_vector(node.need(location), "m") for node in nodes])
    speed = np.array([_vector(node.need(velocity), "m/s") for node in nodes])
    needed = _LEAST_POINTS
    if len(times) > 1 and np.median(np.diff(times)) > _COARSE_STEP_S:
        needed = _LEAST_POINTS_COARSE
    if len(times) < needed:
        raise ProductError(
            points.path, points.place, f"{needed} or more points expected, got {len(times)}"
        )
    orbit = Orbit(epoch, times, position, speed)
    with blamed_on(points):
        _ = orbit.positions  # refuses unsorted and repeated times
        radius = np.linalg.norm(position, axis=1)
    low, high = _RADIUS_RANGE_M
    bad = ~((radius >= low) & (radius <= high))
    if np.any(bad):
        worst = int(np.argmax(bad))
        raise ProductError(
            points.path,
            nodes[worst].place,
            f"a low orbit expected, this is {radius[worst]:.0f} m from the Earth's centre",
        )
    return orbit


def _vector(node: XmlNode, si: str) -> FloatArray:
    factor = unit_factor(node, si, si)
    if node.find("X") is not None:
        return np.array([node.number(axis) for axis in "XYZ"]) * factor
    return node.numbers(3) * factor


@dataclass(frozen=True, slots=True)
class OrbitAxesCurve:
    """Orbital axes over time: Z outward, X = unit(V x Z), Y = Z x X; a `RotationCurve`.

    R_ecef_orbit has X, Y, Z as its columns. V is the velocity that the product gives.

    *Source*: SPOT Satellite Geometry Handbook (S-NT-73-12-SI, 2002), section 4.
    """

    position_m: Curve
    velocity_m_s: Curve

    @property
    def span_s(self) -> tuple[float, float]:
        """The span both curves share."""
        (a, b), (c, d) = self.position_m.span_s, self.velocity_m_s.span_s
        return max(a, c), min(b, d)

    @property
    def knots_s(self) -> FloatArray:
        """Knots of both curves."""
        return np.union1d(self.position_m.knots_s, self.velocity_m_s.knots_s)

    def rotation(self, times_s: FloatArray) -> Rotation:
        """R_ecef_orbit at `times_s` (n,)."""
        z = self.position_m.value(times_s)
        z = z / np.linalg.norm(z, axis=-1, keepdims=True)
        x = np.cross(self.velocity_m_s.value(times_s), z)
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        return Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=-1))
