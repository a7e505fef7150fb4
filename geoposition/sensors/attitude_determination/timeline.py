"""One line of time for a gyro and star heads of any rates: knots, turns between, samples at them.

Knots are the gyro epochs and, between them, the star epochs. A gyro interval cut by a star epoch is
split for a rate that changes linearly, its change taken from the neighbouring samples. Turning axes
that move within an interval add the coning term of a linear rate.

A gyro interval more than `GAP` times the median one is a gap. An increment over a gap is taken at
its word, unless it says what one ordinary step would. Rates are bridged by the mean of both sides,
and the angle's variance grows as for a rate that wanders between them as far as the series does
in that time elsewhere (a Brownian bridge). Star samples outside the gyro's span cannot be met and
are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.errors import GeometryError
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

GAP: Final = 4.0
"""Longer than this many median steps, a gyro interval is a gap."""

_SAME_EPOCH = 1e-6
"""Star epochs nearer than this share of a step to a gyro epoch are taken at it."""

_BLIND_RAD2 = 1.0
"""Added variance at which the gyro says nothing: more would only spoil the arithmetic."""


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """Knots `times_s` (k,) and what lies between and at them.

    `step_s` (k − 1,), measured turn `turn_rad` (k − 1, 3) in the body frame and added variance
    `extra_rad2` (k − 1,) of each interval. `is_gyro` (k,) marks gyro epochs. Star samples
    `star_start[k] .. star_start[k + 1]` are at knot k; of each, `quat_inertial_body` (m, 4), its
    `covariance_rad2` (m, 3, 3) about the body axes, and its place `star_index` (m,) in the series.
    """

    times_s: FloatArray
    step_s: FloatArray
    turn_rad: FloatArray
    extra_rad2: FloatArray
    is_gyro: BoolArray
    star_start: IntArray
    star_index: IntArray
    quat_inertial_body: FloatArray
    covariance_rad2: FloatArray

    @property
    def first(self) -> int:
        """Knot of the first star sample."""
        return int(np.argmax(self.star_start[1:] > 0))


def merge(star: StarSeries, gyro: GyroSeries, mounting: Mounting) -> Timeline:
    """Lay both series on one line of time; no overlap is a `GeometryError`."""
    epochs = gyro.times_s
    turns, extra = measured_turns(gyro)
    star_times, star_index = _within(star, gyro)
    quats, covariance = body_samples(star, mounting, star_index)
    if np.array_equal(epochs[np.searchsorted(epochs, star_times)], star_times):
        knots = epochs
        is_gyro = np.ones(len(knots), dtype=np.bool_)
    else:
        knots = np.union1d(epochs, star_times)
        is_gyro = np.isin(knots, epochs, assume_unique=True)
        turns, extra = _split(gyro, turns, extra, knots)
    star_start = np.append(np.searchsorted(star_times, knots), len(star_times)).astype(np.int64)
    parts = (
        knots,
        np.diff(knots),
        turns,
        extra,
        is_gyro,
        star_start,
        star_index,
        quats,
        covariance,
    )
    for part in parts:
        part.setflags(write=False)
    return Timeline(*parts)


def _within(star: StarSeries, gyro: GyroSeries) -> tuple[FloatArray, IntArray]:
    """Find times and indices of the star samples that the gyro spans, on its epochs if there."""
    epochs = gyro.times_s
    tolerance = _SAME_EPOCH * float(np.median(np.diff(epochs)))
    above = np.searchsorted(epochs, star.times_s).clip(1, len(epochs) - 1)
    nearest = np.where(
        star.times_s - epochs[above - 1] < epochs[above] - star.times_s, above - 1, above
    )
    same = np.abs(epochs[nearest] - star.times_s) <= tolerance
    times = np.where(same, epochs[nearest], star.times_s)
    inside = np.flatnonzero((times >= epochs[0]) & (times <= epochs[-1]))
    if len(inside) == 0:
        raise GeometryError(
            f"star data {star.times_s[0]:.3f} .. {star.times_s[-1]:.3f} s never overlaps "
            f"the gyro's {epochs[0]:.3f} .. {epochs[-1]:.3f} s"
        )
    return times[inside], inside.astype(np.int64)


def body_samples(
    star: StarSeries, mounting: Mounting, index: IntArray
) -> tuple[FloatArray, FloatArray]:
    """R_inertial_body quaternions (m, 4) of samples `index`, covariance (m, 3, 3) in the body."""
    quats = np.empty((len(index), 4))
    covariance = np.empty((len(index), 3, 3))
    rotations = star.R_inertial_sensor
    for number, name in enumerate(star.heads):
        rows = np.flatnonzero(star.head[index] == number)
        if len(rows) == 0:
            continue
        R_body_sensor = mounting.rotation(name)
        quats[rows] = (rotations[index[rows]] * R_body_sensor.inv()).as_quat()
        cross2 = star.sigma_cross_rad[index[rows], None, None] ** 2
        bore2 = star.sigma_bore_rad[index[rows], None, None] ** 2
        bore = R_body_sensor.as_matrix()[:, 2]
        covariance[rows] = cross2 * np.eye(3) + (bore2 - cross2) * np.outer(bore, bore)
    return quats, covariance


def measured_turns(gyro: GyroSeries) -> tuple[FloatArray, FloatArray]:
    """Rotation vectors (n − 1, 3) between gyro epochs, coning included, and added variance.

    Sampled rates are integrated with the trapezoid's end correction, step² / 12 of the change
    of the slope: exact for a rate of the third degree.
    """
    step = np.diff(gyro.times_s)
    turn = np.array(gyro.increments_rad())
    extra = np.zeros(len(step))
    ordinary = float(np.median(step))
    gaps = np.flatnonzero(step > GAP * ordinary)
    if gyro.kind == "rate" and len(step) > 1:
        slope = np.gradient(gyro.values, gyro.times_s, axis=0)
        turn -= np.diff(slope, axis=0) * step[:, None] ** 2 / 12.0
    if len(gaps):
        _bridge(gyro, step, ordinary, gaps, turn, extra)
    _add_coning(gyro.values, step, gyro.kind == "rate", GAP * ordinary, turn)
    return turn, extra


@njit(cache=True, error_model="numpy")
def _add_coning(
    rates: FloatArray, step: FloatArray, sampled: bool, gap_s: float, turn: FloatArray
) -> None:
    """Add to `turn` (n − 1, 3) what a linearly changing rate turns beyond its integral.

    Half the integral of (angle so far) x rate: step² w0 x w1 / 12 for rates `sampled` at the ends,
    the same from the means of this interval and the one before it where only those are known.
    """
    ax, ay, az, before = 0.0, 0.0, 0.0, 0.0
    for k in range(len(step)):
        t = step[k]
        x, y, z = turn[k, 0] / t, turn[k, 1] / t, turn[k, 2] / t
        factor = 0.0
        if sampled:
            ax, ay, az = rates[k, 0], rates[k, 1], rates[k, 2]
            bx, by, bz = rates[k + 1, 0], rates[k + 1, 1], rates[k + 1, 2]
            factor = t * t / 12.0
        else:
            bx, by, bz = x, y, z
            if before > 0.0:
                factor = t**3 / (6.0 * (t + before))
        if t <= gap_s:
            turn[k, 0] += factor * (ay * bz - az * by)
            turn[k, 1] += factor * (az * bx - ax * bz)
            turn[k, 2] += factor * (ax * by - ay * bx)
        ax, ay, az, before = x, y, z, t


def _bridge(
    gyro: GyroSeries,
    step: FloatArray,
    ordinary: float,
    gaps: IntArray,
    turn: FloatArray,
    extra: FloatArray,
) -> None:
    rates = turn / step[:, None] if gyro.kind == "increment" else np.array(gyro.values)
    if gyro.kind == "increment":
        for k in gaps[gaps > 0]:
            one, whole = turn[k] / ordinary, turn[k] / step[k]
            before = rates[k - 1]
            if np.linalg.norm(one - before) < np.linalg.norm(whole - before):
                turn[k] = 0.5 * (before + one) * step[k]
                extra[k] = 1.0
    else:
        turn[gaps] = 0.5 * (rates[gaps] + rates[gaps + 1]) * step[gaps, None]
        extra[gaps] = 1.0
    for k in np.flatnonzero(extra):
        change2 = _rate_change2(
            gyro.times_s[-len(rates) :], np.delete(rates, gaps, axis=0), step[k]
        )
        extra[k] = min(change2 * step[k] ** 2 / 12.0, _BLIND_RAD2)


def _rate_change2(times_s: FloatArray, rates: FloatArray, lag_s: float) -> float:
    """Mean squared change of the rate over `lag_s`, on the axis where it is largest.

    Where the series is too short for the lag, that of half the series, as if it went on.
    """
    ordinary = float(np.median(np.diff(times_s)))
    lag = max(min(round(lag_s / ordinary), len(rates) // 2), 1)
    changes = rates[lag:] - rates[:-lag]
    growth = max(lag_s / (lag * ordinary), 1.0)
    return float(np.mean(changes**2, axis=0).max()) * growth**2 if len(changes) else 0.0


def _split(
    gyro: GyroSeries, turn: FloatArray, extra: FloatArray, knots: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Give turns and added variance between `knots`, a superset of the gyro's epochs."""
    epochs = gyro.times_s
    step = np.diff(epochs)
    if gyro.kind == "rate":
        change = np.diff(gyro.values, axis=0) / step[:, None]
    elif len(step) > 2:
        change = np.gradient(turn / step[:, None], 0.5 * (epochs[1:] + epochs[:-1]), axis=0)
    else:
        change = np.zeros_like(turn)
    change[extra > 0.0] = 0.0
    place = (np.searchsorted(epochs, knots, side="right") - 1).clip(0, len(step) - 1)
    since = knots - epochs[place]
    done = turn[place] * (since / step[place])[:, None]
    done -= 0.5 * change[place] * (since * (step[place] - since))[:, None]
    start = np.where((since[:-1] > 0.0)[:, None], done[:-1], 0.0)
    ends_at_epoch = place[1:] != place[:-1]
    end = np.where(ends_at_epoch[:, None], turn[place[:-1]], done[1:])
    share = np.diff(knots) / step[place[:-1]]
    return end - start, extra[place[:-1]] * share
