"""Simulated star and gyro telemetry of many runs of one scene, and its batched estimation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.sensors.attitude_determination.timeline import Timeline, merge
from geoposition.sensors.gyro import simulate_increments
from geoposition.sensors.kinematics import RateCurve, attitude_of_rate, integrated_rate_rad
from geoposition.sensors.star_sensor import noisy_quat_xyzw
from geoposition.sensors.telemetry import (
    GyroNoise,
    GyroParameters,
    GyroSeries,
    Mounting,
    StarSeries,
)

ARCSEC_RAD = np.pi / 648000.0
DEG_H_RAD_S = np.pi / 648000.0

_CHUNK = 100
"""Runs made and estimated at once: bounds the memory."""

_START_XYZW = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Scene:
    """A body that turns at `rate`, seen by one star head and a gyro of increments.

    Both start at the same time. `sigma_rad` is the star noise about each axis.
    """

    rate: RateCurve
    gyro_times_s: FloatArray
    star_times_s: FloatArray
    noise: GyroNoise
    sigma_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Data of several runs: what `batch.run_batch` takes, and the series of each.

    `truth_quat_xyzw` (k, 4) at the knots of the `timelines`; `bias_rad_s` (r, n, 3) at the gyro
    epochs.
    """

    timelines: tuple[Timeline, ...]
    truth_quat_xyzw: FloatArray
    bias_rad_s: FloatArray
    series: tuple[tuple[StarSeries, GyroSeries], ...]


def simulate(
    scene: Scene, parameters: GyroParameters, runs: int, rng: np.random.Generator
) -> Iterator[Runs]:
    """Make `runs` runs, in chunks; gyro errors (3,) are all runs', (runs, 3) each one's own."""
    increments = integrated_rate_rad(scene.rate, scene.gyro_times_s)
    knots = np.union1d(scene.gyro_times_s, scene.star_times_s)
    truth = attitude_of_rate(scene.rate, knots, _START_XYZW)
    at_star = truth[np.searchsorted(knots, scene.star_times_s)]
    for low in range(0, runs, _CHUNK):
        count = min(_CHUNK, runs - low)
        gyro = simulate_increments(
            scene.gyro_times_s,
            increments,
            scene.noise,
            rng,
            _rows(parameters, slice(low, low + count)),
            count,
        )
        quats = noisy_quat_xyzw(at_star, scene.sigma_rad, rng, count)
        series = tuple(
            (StarSeries.of(scene.star_times_s, quats[run], scene.sigma_rad), gyro.series(run))
            for run in range(count)
        )
        lines = tuple(merge(star, single, Mounting()) for star, single in series)
        yield Runs(lines, truth, gyro.bias_rad_s, series)


def without_noise(scene: Scene, parameters: GyroParameters) -> Timeline:
    """Return the scene's timeline with perfect instruments but for the gyro's `parameters`."""
    times = scene.gyro_times_s
    increments = integrated_rate_rad(scene.rate, times) @ (np.eye(3) + parameters.matrix).T
    increments = increments + parameters.bias_rad_s * np.diff(times)[:, None]
    gyro = GyroSeries.of(times, np.concatenate([increments[:1], increments]), "increment")
    knots = np.union1d(times, scene.star_times_s)
    truth = attitude_of_rate(scene.rate, knots, _START_XYZW)
    at_star = truth[np.searchsorted(knots, scene.star_times_s)]
    star = StarSeries.of(scene.star_times_s, at_star, scene.sigma_rad)
    return merge(star, gyro, Mounting())


def backward(runs: Runs) -> Runs:
    """Return the same runs with time reversed: turns and bias change sign, constants do not."""
    return Runs(
        tuple(backward_timeline(line) for line in runs.timelines),
        runs.truth_quat_xyzw[::-1].copy(),
        -runs.bias_rad_s[:, ::-1],
        (),
    )


def backward_timeline(line: Timeline) -> Timeline:
    """Return a timeline read from its end."""
    counts = np.diff(line.star_start)[::-1]
    return replace(
        line,
        times_s=line.times_s[-1] - line.times_s[::-1],
        step_s=line.step_s[::-1].copy(),
        turn_rad=-line.turn_rad[::-1],
        extra_rad2=line.extra_rad2[::-1].copy(),
        is_gyro=line.is_gyro[::-1].copy(),
        star_start=np.concatenate([[0], np.cumsum(counts)]),
        star_index=line.star_index[::-1].copy(),
        quat_inertial_body=line.quat_inertial_body[::-1].copy(),
        covariance_rad2=line.covariance_rad2[::-1].copy(),
    )


def _rows(parameters: GyroParameters, rows: slice) -> GyroParameters:
    parts = (parameters.bias_rad_s, parameters.scale, parameters.upper, parameters.lower)
    return GyroParameters.of(*(part if part.ndim == 1 else part[rows] for part in parts))
