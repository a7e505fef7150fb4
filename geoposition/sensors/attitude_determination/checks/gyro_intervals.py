"""Turns of star and gyro side by side: what is left, and how gyro errors would show in it.

With G(t) the attitude integrated from the gyro, the star's attitude is R0 G(t) exp(error). Over an
interval the error grows, in the body at its start, by the sums of −(bias + drift t + S w) dt,
and a star clock that is late by `lag` adds −lag times the change of the rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.sensors.attitude_determination.checks.axis_angle import interpolate_rotations
from geoposition.sensors.attitude_determination.timeline import measured_turns
from geoposition.sensors.kinematics import accumulated
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

PARAMETERS: Final = 16
"""Bias 3, drift 3, S 9 (by rows), lag 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Intervals (m,) between star samples of one head, end to end where `chained`.

    `first` and `last` are the samples' places in the star series. `difference_rad` (m, 3) is the
    star's turn after the gyro's has been taken off, in the body at the start; `design`
    (m, 3, 16) its derivatives by the gyro's errors; `whiten` (3, 3) makes unit noise of a star
    sample's in the body.
    """

    head: int
    first: IntArray
    last: IntArray
    start_s: FloatArray
    end_s: FloatArray
    difference_rad: FloatArray
    design: FloatArray
    whiten: FloatArray

    @property
    def chained(self) -> BoolArray:
        """Whether interval k + 1 starts with the sample that k ends with (m − 1,)."""
        return np.asarray(self.first[1:] == self.last[:-1])


@dataclass(frozen=True, slots=True, eq=False)
class GyroTrack:
    """Attitude `turned` (n,) since the first gyro epoch, and the running sums of the design."""

    times_s: FloatArray
    turned: Rotation
    sums: FloatArray
    rate: FloatArray

    @classmethod
    def of(cls, gyro: GyroSeries) -> GyroTrack:
        """Integrate a gyro series; drift is counted from the middle of its span."""
        turns, _ = measured_turns(gyro)
        steps = np.diff(gyro.times_s)
        turned = Rotation.from_quat(accumulated([0.0, 0.0, 0.0, 1.0], turns))
        middle = (turned[:-1] * Rotation.from_rotvec(0.5 * turns)).as_matrix()
        when = 0.5 * (gyro.times_s[1:] + gyro.times_s[:-1])
        when = when - 0.5 * (gyro.times_s[0] + gyro.times_s[-1])
        columns = np.empty((len(steps), 3, 15))
        columns[..., :3] = -middle * steps[:, None, None]
        columns[..., 3:6] = columns[..., :3] * when[:, None, None]
        columns[..., 6:] = -np.einsum("nij,nk->nijk", middle, turns).reshape(len(steps), 3, 9)
        sums = np.concatenate([np.zeros((1, 3, 15)), np.cumsum(columns, axis=0)])
        # Rates at the epochs, from the turns on both sides.
        slope = turns / steps[:, None]
        rate = np.concatenate([slope[:1], 0.5 * (slope[1:] + slope[:-1]), slope[-1:]])
        return cls(gyro.times_s, turned, sums, rate)

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Give sums (m, 3, 15) and rates (m, 3) between the epochs, by straight lines."""
        k = np.clip(np.searchsorted(self.times_s, times_s) - 1, 0, len(self.times_s) - 2)
        part = (times_s - self.times_s[k]) / (self.times_s[k + 1] - self.times_s[k])
        sums = self.sums[k] + part[:, None, None] * (self.sums[k + 1] - self.sums[k])
        return sums, self.rate[k] + part[:, None] * (self.rate[k + 1] - self.rate[k])


def intervals_of_head(
    star: StarSeries, track: GyroTrack, mounting: Mounting, head: int, interval_s: float
) -> Intervals | None:
    """Intervals of about `interval_s` where star and gyro both are; None if there are none."""
    index = np.flatnonzero(star.head == head)
    R_body_sensor = mounting.rotation(star.heads[head])
    known, turned = interpolate_rotations(track.times_s, track.turned, star.times_s[index])
    index = index[known]
    times = star.times_s[index]
    if len(index) < 2:
        return None
    # The first sample of each interval's length of time.
    bins = np.floor((times - times[0]) / interval_s * (1.0 + 1e-9))
    picked = np.flatnonzero(np.concatenate([[True], np.diff(bins) > 0]))
    length = times[picked[1:]] - times[picked[:-1]]
    keep = length <= 3.0 * interval_s
    a, b = picked[:-1][keep], picked[1:][keep]
    if len(a) == 0:
        return None
    quats = np.array(star.quat_xyzw)
    R_inertial_body = Rotation.from_quat(quats[index]) * R_body_sensor.inv()
    offset = R_inertial_body * turned.inv()
    back = turned[a].inv().as_matrix()
    # Both offsets would be R0; their quotient, seen from the body at the start.
    difference = turned[a].inv().apply((offset[a].inv() * offset[b]).as_rotvec())
    sums, rate = track.at(times)
    design = np.empty((len(a), 3, PARAMETERS))
    design[..., :15] = back @ (sums[b] - sums[a])
    carried = np.einsum("nij,nj->ni", back @ turned[b].as_matrix(), rate[b])
    design[..., 15] = -(carried - rate[a])
    cross = float(np.median(star.sigma_cross_rad[index]))
    bore = float(np.median(star.sigma_bore_rad[index]))
    whiten = np.diag([1.0 / cross, 1.0 / cross, 1.0 / bore]) @ R_body_sensor.inv().as_matrix()
    return Intervals(
        head, index[a], index[b], times[a], times[b], difference, design, np.asarray(whiten)
    )
