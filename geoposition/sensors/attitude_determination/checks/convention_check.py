"""Whether star quaternions and gyro samples speak the same convention, and if not, which would.

The mean rate between two samples of one star head is compared with the gyro's over the same time,
as given and under the usual confusions: quaternions that rotate the other way or carry the scalar
first; rates of the opposite sign, in inertial axes or in degrees; a mounting that is not given.
Only a disagreement of half the turn that another reading all but removes counts as one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.timeline import measured_turns
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

_WRONG = 0.5
"""Disagreement, as a share of the turn, above which the data contradict each other."""

_FITS = 0.2
"""A reading fits if it leaves less than this share of the disagreement, and of the turn."""

_TURN_RAD = 0.05
"""Pairs of samples are taken this far apart, if the series turns so far."""

_MAX_TURN_RAD = 0.5
"""Pairs further apart are left out: mean rates are compared as vectors."""

_PAIRS = 300
_NOISE = 10.0
"""The turn must exceed the star noise so many times to tell anything."""

_ONE_AXIS = 0.05
"""Rates whose second direction is weaker than this share of the first are about one axis."""

_AS_GIVEN: Final = "as given"

_STAR: Final = {
    _AS_GIVEN: ((0, 1, 2, 3), False),
    "star quaternions rotate inertial -> sensor": ((0, 1, 2, 3), True),
    "star quaternions are scalar first": ((1, 2, 3, 0), False),
    "star quaternions are scalar first and rotate inertial -> sensor": ((1, 2, 3, 0), True),
}
_GYRO: Final = {
    _AS_GIVEN: (1.0, False),
    "gyro values have the opposite sign": (-1.0, False),
    "gyro values are in inertial axes": (1.0, True),
    "gyro values are in degrees": (np.pi / 180.0, False),
    "gyro values are in arc seconds": (np.pi / 648000.0, False),
    "gyro values are in inertial axes with the opposite sign": (-1.0, True),
}


@dataclass(frozen=True, slots=True)
class ConventionCheck:
    """How star and gyro agree: RMS difference of mean rates over RMS rate.

    `as_given` and, if that is a contradiction, the `readings` that would fit instead with their
    disagreement, the best first. All are empty or NaN where the turn is too small to tell.
    """

    as_given: float
    readings: tuple[tuple[str, float], ...]

    @property
    def message(self) -> str:
        """What is wrong, for a user; empty if nothing is."""
        if not self.readings:
            return ""
        likely = " or ".join(name for name, _ in self.readings[:3])
        return (
            f"star and gyro contradict each other by {100 * self.as_given:.0f} % of the turn; "
            f"they agree to {100 * self.readings[0][1]:.1f} % if {likely}"
        )


def check_conventions(
    star: StarSeries,
    gyro: GyroSeries,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
) -> ConventionCheck:
    """Compare the series under all readings; see the module."""
    low, high = _pairs(star, gyro)
    undecided = ConventionCheck(float("nan"), ())
    if len(low) < 3:
        return undecided
    turned, _ = measured_turns(gyro)
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(turned, axis=0)])
    span = (star.times_s[high] - star.times_s[low])[:, None]

    def at(index: IntArray) -> FloatArray:
        times = star.times_s[index]
        return np.stack([np.interp(times, gyro.times_s, angle[:, i]) for i in range(3)], axis=1)

    gyro_rate = (at(high) - at(low)) / span
    found: list[tuple[int, float, str]] = []
    rates: list[FloatArray] = []
    for star_name, (order, inverse) in _STAR.items():
        before = _body(star, mounting, low, order, inverse)
        star_rate = (before.inv() * _body(star, mounting, high, order, inverse)).as_rotvec() / span
        rates.append(star_rate)
        size = _rms(star_rate)
        noise = np.median(np.maximum(star.sigma_cross_rad, star.sigma_bore_rad)[low])
        if star_name == _AS_GIVEN and size * np.median(span) < _NOISE * noise:
            return undecided
        for gyro_name, (factor, inertial) in _GYRO.items():
            read = factor * (before.inv().apply(gyro_rate) if inertial else gyro_rate)
            names = [name for name in (star_name, gyro_name) if name != _AS_GIVEN]
            text = " and ".join(names) or _AS_GIVEN
            found.append((len(names), _rms(star_rate - read) / size, text))
    as_given = found[0][1]
    if as_given < _WRONG:
        return ConventionCheck(as_given, ())
    bound = _FITS * min(as_given, 1.0)
    for changes in (1, 2):
        fits = sorted((off, name) for n, off, name in found if n == changes and off < bound)
        if fits:
            near = tuple((name, off) for off, name in fits if off < 2.0 * fits[0][0] + 0.01)
            return ConventionCheck(as_given, near)
    return _mounting(as_given, rates[0], gyro_rate, bound)


def refuse_wrong_convention(
    star: StarSeries,
    gyro: GyroSeries,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
) -> None:
    """Raise an `ArgumentError` that names the convention that would fit, if this one does not."""
    message = check_conventions(star, gyro, mounting).message
    if message:
        raise ArgumentError(message)


def _mounting(
    as_given: float, star_rate: FloatArray, gyro_rate: FloatArray, bound: float
) -> ConventionCheck:
    """Whether one constant rotation would bring the rates together."""
    u, strength, vt = np.linalg.svd(star_rate.T @ gyro_rate)
    if strength[1] < _ONE_AXIS * strength[0]:
        bound = _ONE_AXIS  # a steady turn can always be rotated; only its size is telling
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    off = _rms(star_rate - gyro_rate @ turn.T) / _rms(star_rate)
    if off >= bound:
        return ConventionCheck(as_given, ())
    degrees = np.degrees(Rotation.from_matrix(turn).magnitude())
    text = f"the mounting turned by {degrees:.1f} deg more (is one missing?)"
    return ConventionCheck(as_given, ((text, off),))


def _pairs(star: StarSeries, gyro: GyroSeries) -> tuple[IntArray, IntArray]:
    """Pair samples of one head, the one with most, some turn apart and inside the gyro's span."""
    inside = (star.times_s >= gyro.times_s[0]) & (star.times_s <= gyro.times_s[-1])
    head = int(np.argmax(np.bincount(star.head[inside], minlength=len(star.heads))))
    index = np.flatnonzero(inside & (star.head == head))
    rotations = star.R_inertial_sensor[index] if len(index) else Rotation.identity(0)
    lag = 1
    while True:
        if len(index) <= lag:
            return index[:0], index[:0]
        pick = np.unique(np.linspace(0, len(index) - 1 - lag, _PAIRS).astype(np.int64))
        angle = (rotations[pick].inv() * rotations[pick + lag]).magnitude()
        if np.median(angle) >= _TURN_RAD or 4 * lag > len(index):
            break
        lag *= 2
    apart = star.times_s[index[pick + lag]] - star.times_s[index[pick]]
    keep = (angle <= _MAX_TURN_RAD) & (apart > 0.0)
    return index[pick[keep]], index[pick[keep] + lag]


def _body(
    star: StarSeries, mounting: Mounting, index: IntArray, order: tuple[int, ...], inverse: bool
) -> Rotation:
    """R_inertial_body of samples of one head, their quaternions read in another way."""
    rotation = Rotation.from_quat(star.quat_xyzw[index][:, order])
    if inverse:
        rotation = rotation.inv()
    return rotation * mounting.rotation(star.heads[star.head[index[0]]]).inv()


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
