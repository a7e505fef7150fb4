"""Noise levels from the data: star sensor, angle random walk, rate random walk.

The levels that make the filter's innovations most likely. A coarse grid in the logarithms finds
the hill, scoring its top, and the curvature there the uncertainty. Star noise and
angle random walk separate because one does not grow with the time between samples and the
other does; the rate random walk shows only where it moves the drift by more than the data's own
uncertainty of it, and its uncertainty says so. T leaves the levels open; they are part of
what a covariance means.

The noise of a *sampled* rate enters two neighbouring steps of the trapezoid, half each. To a model
of independent steps that looks like star noise of negative variance, −sigma_v² step / 4, where star
samples are at gyro epochs: it is given back to the star noise. *Source*: maximum likelihood;
`noise_likelihood`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.arrays import BoolArray, FloatArray, read_only
from geoposition.errors import GeometryError
from geoposition.sensors.attitude_determination.checks.convention_check import (
    refuse_wrong_convention,
)
from geoposition.sensors.attitude_determination.filters.forward import run_forward
from geoposition.sensors.attitude_determination.noise.noise_likelihood import (
    LikelihoodData,
    likelihood_data,
    minus_log_likelihood,
)
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.timeline import Timeline, merge
from geoposition.sensors.kinematics import accumulated
from geoposition.sensors.telemetry import GyroNoise, GyroSeries, Mounting, StarSeries

_LEAST_SAMPLES = 20
_QUICK_SAMPLES = 1500
"""Samples, evenly thinned, that choose among the hills; the search itself uses all."""

_HILLS = 3
_WALK_DECADES: Final = tuple(np.arange(-2.5, 2.6))
_DRIFT_DECADES: Final = tuple(np.arange(-3.0, 3.1))
_STAR_DECADES: Final = (-2.0, -1.0, -0.5, 0.0)
"""The grid about the first levels; the star noise starts from its upper bound."""

_REACH: Final = float(np.log(1e4))
"""Levels are sought within this factor of those given."""

_SLOPE_STEP = 1e-3
_MAX_STEPS = 60
_SETTLED = 1e-3
"""A gain in log L that is no gain."""

_BLUNDER = 1e-6
"""Samples less likely than this at the first levels do not take part."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseLevels:
    """Estimated levels and the uncertainty of their logarithms.

    `cross_rad`, `bore_rad` (heads,) are the star noise, medians over each head, `hidden_rad` the
    part of it that a sampled rate hid (see the module); `cross_scale`
    and `bore_scale` what the series' own sigmas are to be multiplied by. `log_covariance` is that
    of the logarithms of (sigma_v, sigma_u, cross and bore of head 0, …): its diagonal is the
    squared relative uncertainty, infinite where the data do not determine a level. `used` (n,)
    marks the star samples that took part.
    """

    noise: GyroNoise
    cross_rad: FloatArray
    bore_rad: FloatArray
    cross_scale: FloatArray
    bore_scale: FloatArray
    log_covariance: FloatArray
    hidden_rad: float
    used: BoolArray
    mean_nis: float

    @property
    def relative_sigma(self) -> FloatArray:
        """Relative standard deviation of each level, in the order of `log_covariance`."""
        return read_only(np.sqrt(np.diag(self.log_covariance)))

    def rescaled(self, star: StarSeries) -> StarSeries:
        """Return the series with the estimated star noise."""
        return replace(
            star,
            sigma_cross_rad=read_only(star.sigma_cross_rad * self.cross_scale[star.head]),
            sigma_bore_rad=read_only(star.sigma_bore_rad * self.bore_scale[star.head]),
        )


def estimate_noise(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
) -> NoiseLevels:
    """Estimate all levels, starting from those of the series and the settings.

    Fewer than 20 star samples within the gyro's span are a `GeometryError`.
    """
    refuse_wrong_convention(star, gyro, mounting)
    timeline = merge(star, gyro, mounting)
    samples = len(timeline.star_index)
    if samples < _LEAST_SAMPLES:
        raise GeometryError(
            f"noise levels: at least {_LEAST_SAMPLES} star samples in the gyro's span expected, "
            f"got {samples}"
        )
    start = _start_levels(star, mounting, timeline, settings)
    # Ungated: the levels given may be far off, and with them the gate.
    first = run_forward(timeline, replace(settings, gate_probability=None))
    reference = np.zeros(12)
    reference[: settings.states - 3] = first.rest[-1]
    data = likelihood_data(timeline, star, mounting, settings, reference)
    keep = np.ones(samples, dtype=np.bool_)
    thinned = np.zeros(samples, dtype=np.bool_)
    thinned[:: -(-samples // _QUICK_SAMPLES)] = True
    best = _coarse(data, start, thinned)
    _, squared = minus_log_likelihood(data, np.exp(best)[None], keep)
    # What the innovations' own spread calls usual: the levels are not right yet.
    usual = np.nanmedian(squared[0]) / float(chi2.median(3))
    credible = np.nan_to_num(squared[0]) <= usual * float(chi2.isf(_BLUNDER, 3))
    if credible.mean() > 0.5:
        keep = credible
    best = _refined(data, best, start, keep)
    covariance = _curvature(data, best, keep)
    _, squared = minus_log_likelihood(data, np.exp(best)[None], keep)
    levels = np.exp(best)
    used = np.zeros(len(star), dtype=np.bool_)
    used[timeline.star_index] = keep
    medians = np.array(
        [
            [np.median(sigma[star.head == h]) if np.any(star.head == h) else np.nan]
            for h in range(len(star.heads))
            for sigma in (star.sigma_cross_rad, star.sigma_bore_rad)
        ]
    ).reshape(-1, 2)
    apparent = levels[2:].reshape(-1, 2)
    hidden = _hidden_rad(timeline, gyro, float(levels[0]))
    scale = np.hypot(apparent, hidden / medians)
    covariance = _given_back(covariance, (apparent / scale).ravel() ** 2)
    return NoiseLevels(
        GyroNoise(float(levels[0]), float(levels[1])),
        read_only(scale[:, 0] * medians[:, 0]),
        read_only(scale[:, 1] * medians[:, 1]),
        read_only(scale[:, 0]),
        read_only(scale[:, 1]),
        read_only(covariance),
        hidden,
        used,
        float(np.nanmean(squared[0])),
    )


def _start_levels(
    star: StarSeries, mounting: Mounting, timeline: Timeline, settings: FusionSettings
) -> FloatArray:
    """Logarithms of the given random walks and of star scales that the data bound from above.

    Neighbouring samples of a head differ from the gyro's turn between them by both samples' noise
    and what the gyro adds.
    """
    walk = settings.noise.angle_random_walk
    # No rate random walk given: start at one too small to be seen.
    drift = settings.noise.rate_random_walk or 0.1 * walk / float(
        timeline.times_s[-1] - timeline.times_s[0]
    )
    knots = np.repeat(np.arange(len(timeline.times_s)), np.diff(timeline.star_start))
    gyro = Rotation.from_quat(accumulated([0.0, 0.0, 0.0, 1.0], timeline.turn_rad))
    measured = Rotation.from_quat(np.array(timeline.quat_inertial_body))
    scales = np.ones((len(star.heads), 2))
    for h, name in enumerate(star.heads):
        at = np.flatnonzero(star.head[timeline.star_index] == h)
        if len(at) < 3:
            continue
        low, high = at[:-1], at[1:]
        turn = gyro[knots[low]].inv() * gyro[knots[high]]
        off = ((measured[low] * turn).inv() * measured[high]).as_rotvec()
        off = mounting.rotation(name).inv().apply(off)
        spread = np.median(np.abs(off - np.median(off, axis=0)), axis=0) / (0.6745 * np.sqrt(2.0))
        index = timeline.star_index[at]
        given = np.median([star.sigma_cross_rad[index], star.sigma_bore_rad[index]], axis=1)
        seen = np.array([np.hypot(spread[0], spread[1]) / np.sqrt(2.0), spread[2]])
        scales[h] = np.where(seen > 0.0, seen / given, 1.0)
    return np.asarray(np.log(np.concatenate([[walk, drift], scales.ravel()])))


def _coarse(data: LikelihoodData, start: FloatArray, keep: BoolArray) -> FloatArray:
    """Best hill: from a grid over both random walks and one factor of all star noise.

    The likelihood has several hills, for white noise and a walking drift can stand in for each
    other: the best grid point of each rate random walk is followed upward.
    """
    decade = float(np.log(10.0))
    grid = np.array(list(product(_WALK_DECADES, _DRIFT_DECADES, _STAR_DECADES))) * decade
    trials = start + grid[:, [0, 1] + [2] * (len(start) - 2)]
    value = _shares(data, trials, keep).sum(axis=1)
    feet = []
    for drift in np.unique(grid[:, 1]):
        rows = np.flatnonzero(grid[:, 1] == drift)
        feet.append(rows[np.nanargmin(value[rows])])
    feet.sort(key=lambda row: float(value[row]))
    tops = np.array([_refined(data, trials[row], start, keep) for row in feet[:_HILLS]])
    value = _shares(data, tops, keep).sum(axis=1)
    return np.asarray(tops[int(np.nanargmin(value))])


def _refined(
    data: LikelihoodData, best: FloatArray, start: FloatArray, keep: BoolArray
) -> FloatArray:
    """Top of the hill, by damped scoring: the samples' own slopes give the curvature.

    *Source*: Berndt, Hall, Hall & Hausman 1974.
    """
    n = len(best)
    unit = _SLOPE_STEP * np.eye(n)
    x, damping = best, 1e-3
    shares = _shares(data, np.concatenate([x[None], x + unit, x - unit]), keep)
    value = shares[0].sum()
    for _ in range(_MAX_STEPS):
        slopes = (shares[1 : n + 1] - shares[n + 1 :]) / (2.0 * _SLOPE_STEP)
        square, slope = slopes @ slopes.T, slopes.sum(axis=1)
        floor = damping * np.diag(square) + 1e-3
        step = np.clip(-np.linalg.solve(square + np.diag(floor), slope), -1.0, 1.0)
        trial = np.clip(x + step, start - _REACH, start + _REACH)
        around = np.concatenate([trial[None], trial + unit, trial - unit])
        shares_there = _shares(data, around, keep)
        gained = value - shares_there[0].sum()
        if gained > 0.0:
            x, shares, value = trial, shares_there, value - gained
            damping = max(0.1 * damping, 1e-6)
        else:
            damping *= 10.0
        if abs(gained) < _SETTLED or damping > 1e6:
            break
    return x


def _shares(data: LikelihoodData, trials: FloatArray, keep: BoolArray) -> FloatArray:
    return minus_log_likelihood(data, np.exp(trials), keep)[0]


def _hidden_rad(timeline: Timeline, gyro: GyroSeries, angle_random_walk: float) -> float:
    """Star noise that steps sharing a rate sample hide, with samples at gyro epochs."""
    shared = np.mean(timeline.is_gyro[np.diff(timeline.star_start) > 0])
    if gyro.kind != "rate" or shared < 0.5:
        return 0.0
    return 0.5 * angle_random_walk * float(np.sqrt(np.median(np.diff(gyro.times_s))))


def _given_back(covariance: FloatArray, share: FloatArray) -> FloatArray:
    """Covariance of the logarithms after `share` (2 heads,) of the star variances was apparent."""
    if np.all(share == 1.0):
        return covariance
    jacobian = np.eye(len(covariance))
    jacobian[range(2, len(covariance)), range(2, len(covariance))] = share
    jacobian[2:, 0] = 1.0 - share
    # An apparent level that the data do not determine is small: a factor of e² is enough for it.
    known = np.where(np.isinf(covariance), 4.0, covariance)
    moved = jacobian @ known @ jacobian.T
    moved[range(2), range(2)] = np.diag(covariance)[:2]
    return np.asarray(moved)


def _curvature(data: LikelihoodData, best: FloatArray, keep: BoolArray) -> FloatArray:
    """Covariance of the logarithms: the inverse of −log L's second derivatives."""
    n, step = len(best), 0.03
    unit = step * np.eye(n)
    signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
    trials = [
        best + a * unit[i] + b * unit[j] for i in range(n) for j in range(i + 1) for a, b in signs
    ]
    value = _shares(data, np.array(trials), keep).sum(axis=1)
    mixed = value.reshape(-1, 4) @ np.array([1.0, -1.0, -1.0, 1.0]) / (4.0 * step**2)
    hessian = np.zeros((n, n))
    hessian[np.tril_indices(n)] = mixed
    hessian = hessian + np.tril(hessian, -1).T
    covariance = np.full((n, n), 0.0)
    covariance[range(n), range(n)] = np.inf
    # A level that is uncertain by more than e: the likelihood is flat, its curvature no measure.
    known = np.flatnonzero(np.diag(hessian) > 1.0)
    if len(known):
        inverse = np.linalg.pinv(hessian[np.ix_(known, known)], hermitian=True)
        if np.all(np.diag(inverse) > 0.0):
            covariance[np.ix_(known, known)] = inverse
    return covariance
