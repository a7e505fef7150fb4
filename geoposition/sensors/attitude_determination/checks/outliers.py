"""Blunders among star samples, told from slews and jitter by windows of several lengths.

A sample is believed if any window that describes its surroundings well agrees with it: at the
start of a slew the windows before and after it disagree, and one of them is right. Where short
windows find no majority (a burst of blunders) longer ones decide; where none describes the motion
(violent jitter) the local scatter is the measure, and what follows smoothly from its neighbours
stays. What short windows alone believe, yet leaves and returns in jumps that no satellite makes,
is a burst after all.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, IntArray, read_only
from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.checks.continuity import runs, smooth_runs
from geoposition.sensors.attitude_determination.checks.ransac import WindowFits, fit_windows

_LENGTHS: Final = (21, 63, 189)
"""Samples per window: short ones follow slews, long ones outlast bursts of blunders."""
_FEWEST: Final = 12
_PER_TERM: Final = 6
"""Samples per term of a polynomial, so that half of them still tell its scatter."""
_GOOD: Final = 2.0
"""A window describes the motion if its scatter is less than so many times the usual one."""
_SMALLEST_NOISE_RAD: Final = 1e-9
_SEGMENT_STEPS: Final = 20.0
_MAD: Final = 1.4826
_AGREES: Final = 4.0
"""Scatter within which a window agrees with a believed sample, when it is to speak for others."""


@dataclass(frozen=True, slots=True)
class OutlierSettings:
    """How blunders are told: `threshold_sigma` of the scatter about polynomials of `degree`.

    `window_s` fixes one window length instead of the automatic ones (21, 63, 189 samples, each
    used where the motion asks for it). `acceleration_rad_s2` is what the satellite can do at
    most: attitude that jumps faster and back is a burst of blunders.
    """

    threshold_sigma: float = 5.0
    degree: int = 3
    window_s: float | None = None
    acceleration_rad_s2: float = 3.5e-3
    seed: int = 1

    def __post_init__(self) -> None:
        if not (self.threshold_sigma > 0.0 and 0 <= self.degree <= 5 and self.seed >= 0):
            raise ArgumentError("outliers: positive threshold, degree 0 .. 5, seed >= 0 expected")
        if self.window_s is not None and not 0.0 < self.window_s < np.inf:
            raise ArgumentError("outliers: a positive window expected")
        if not self.acceleration_rad_s2 > 0.0:
            raise ArgumentError("outliers: a positive acceleration expected")


@dataclass(frozen=True, slots=True, eq=False)
class MotionModel:
    """Local polynomials of one head's motion: which samples are blunders, and what it was.

    `outlier` (n,) belongs to the samples the model was made from, `noise_rad` (3,) is their
    scatter about the sensor's axes.
    """

    times_s: FloatArray
    outlier: BoolArray
    noise_rad: FloatArray
    segments: tuple[tuple[slice, tuple[WindowFits, ...]], ...]

    def at(self, times_s: FloatArray) -> tuple[BoolArray, Rotation]:
        """Where `times_s` (m,) lies in a span that was modelled, and the attitude there."""
        quats = np.full((len(times_s), 4), np.nan)
        for part, fits in self.segments:
            series = self.times_s[part]
            inside = np.flatnonzero((times_s >= series[0]) & (times_s <= series[-1]))
            believed = ~self.outlier[part]
            if len(inside) and np.any(believed):
                quats[inside] = _best_model(fits, series, believed, times_s[inside])
        known = np.isfinite(quats[:, 0])
        return known, Rotation.from_quat(quats[known].reshape(-1, 4))


def model_motion(
    times_s: FloatArray, quat_xyzw: FloatArray, sigma_rad: FloatArray, settings: OutlierSettings
) -> MotionModel:
    """Judge unit quaternions (n, 4) of one head at strictly increasing `times_s` (n,).

    `sigma_rad` (2,) is the stated noise across and about the boresight; where the scatter found
    is larger, it takes its place. Fewer than 12 samples between long gaps are believed unseen.
    """
    outlier = np.zeros(len(times_s), dtype=bool)
    segments, scatters = [], []
    for part in _segments(times_s):
        t, q = times_s[part], quat_xyzw[part]
        if len(t) < _FEWEST:
            continue
        stated = np.array([sigma_rad[0], sigma_rad[0], sigma_rad[1]])
        first = _fit(t, q, stated, settings)[:1]
        scatter = _scatter(first, t, q, _judge(first, t, q, stated, settings))
        # What the stated noise allows is no blunder, however quiet the series.
        noise = np.maximum(scatter, stated)
        fits = _fit(t, q, noise, settings)
        bad = _judge(fits, t, q, noise, settings)
        outlier[part] = bad
        segments.append((part, fits))
        scatters.append(scatter)
    found = np.median(scatters, axis=0) if scatters else np.full(3, np.nan)
    return MotionModel(
        read_only(times_s),
        outlier,
        read_only(found),
        tuple(segments),
    )


def _segments(times: FloatArray) -> list[slice]:
    steps = np.diff(times)
    if len(steps) == 0:
        return [slice(0, len(times))]
    cuts = np.flatnonzero(steps > _SEGMENT_STEPS * np.median(steps)) + 1
    edges = [0, *cuts.tolist(), len(times)]
    return [slice(a, b) for a, b in pairwise(edges)]


def _fit(
    times: FloatArray, quat: FloatArray, noise: FloatArray, settings: OutlierSettings
) -> tuple[WindowFits, ...]:
    lengths: tuple[int, ...] = _LENGTHS
    if settings.window_s is not None:
        step = float(np.median(np.diff(times)))
        lengths = (max(_FEWEST, round(settings.window_s / step) + 1),)
    fits: list[WindowFits] = []
    for length in lengths:
        if fits and length > len(times):
            break
        fits.append(
            fit_windows(
                times,
                quat,
                1.0 / np.maximum(noise, _SMALLEST_NOISE_RAD),
                length,
                degree=min(settings.degree, min(length, len(times)) // _PER_TERM - 1),
                threshold_sigma=settings.threshold_sigma,
                seed=settings.seed,
            )
        )
    return tuple(fits)


def _members(fits: WindowFits) -> tuple[IntArray, IntArray]:
    """Window and sample number of every residual, flat."""
    window = np.repeat(np.arange(len(fits.start)), fits.length)
    return window, (fits.start[:, None] + np.arange(fits.length)).ravel()


def _judge(
    fits: tuple[WindowFits, ...],
    times: FloatArray,
    quat: FloatArray,
    noise: FloatArray,
    settings: OutlierSettings,
) -> BoolArray:
    n = len(times)
    usual = max(float(np.median(fits[0].scale)), 1.0)
    decided, outlier = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    levels = []
    for level in fits:
        window, sample = _members(level)
        good = level.scale[window] <= _GOOD * usual
        scale = np.maximum(level.scale[window], 0.8 * usual)
        nearest = np.full(n, np.inf)
        np.minimum.at(nearest, sample[good], (level.residual.ravel() / scale)[good])
        seen = np.isfinite(nearest)
        levels.append((seen, nearest > settings.threshold_sigma))
        outlier[seen & ~decided] = levels[-1][1][seen & ~decided]
        decided |= seen
    if not np.all(decided):
        # Nothing describes the motion here: what fits the local scatter stays.
        window, sample = _members(fits[0])
        nearest = np.full(n, np.inf)
        local = np.maximum(fits[0].scale[window], usual)
        np.minimum.at(nearest, sample, fits[0].residual.ravel() / local)
        outlier[~decided] = nearest[~decided] > settings.threshold_sigma
    outlier &= ~smooth_runs(times, quat, outlier, usual * noise, settings.threshold_sigma)
    if len(fits) > 1:
        suspect = levels[1][0] & levels[1][1] & ~outlier
        outlier |= _detached(fits[1], times, quat, suspect, usual * noise, settings)
    return outlier


def _detached(
    fits: WindowFits,
    times: FloatArray,
    quat: FloatArray,
    suspect: BoolArray,
    noise: FloatArray,
    settings: OutlierSettings,
) -> BoolArray:
    """Find runs of suspects, shorter than half a window, that leave and return in jumps."""
    detached = np.zeros(len(times), dtype=bool)
    starts, ends = runs(suspect)
    # A run at either end of the series has but one side: it may be motion.
    inner = (ends - starts <= fits.length // 2) & (starts > 0) & (ends < len(times))
    if not np.any(inner):
        return detached
    model = Rotation.from_quat(_best_model((fits,), times, ~suspect, times))
    off = (model.inv() * Rotation.from_quat(quat)).as_rotvec() / noise
    for start, end in zip(starts[inner], ends[inner], strict=True):
        jumps = []
        for left, right in ((start - 1, start), (end - 1, end)):
            step = times[right] - times[left]
            possible = 2.0 * settings.acceleration_rad_s2 * step**2 / np.min(noise)
            jump = float(np.linalg.norm(off[right] - off[left]))
            jumps.append(jump > 2.0 * settings.threshold_sigma + possible)
        detached[start:end] = all(jumps)
    return detached


def _scatter(
    fits: tuple[WindowFits, ...], times: FloatArray, quat: FloatArray, outlier: BoolArray
) -> FloatArray:
    """Scatter (3,) of believed samples about their windows, by the median."""
    used = np.flatnonzero(~outlier)
    model = Rotation.from_quat(_best_model(fits, times, ~outlier, times[used]))
    off = (model.inv() * Rotation.from_quat(quat[used])).as_rotvec()
    terms = fits[0].coefficients.shape[1]
    freedom = np.sqrt(fits[0].length / max(1, fits[0].length - terms))
    spread = _MAD * freedom * np.median(np.abs(off), axis=0)
    return np.asarray(np.maximum(spread, _SMALLEST_NOISE_RAD))


def _best_model(
    fits: tuple[WindowFits, ...], series_s: FloatArray, believed: BoolArray, times: FloatArray
) -> FloatArray:
    """Quaternions (m, 4) of the best window around each of `times` (m,).

    Of the windows of the shortest length that describe the motion and agree with the believed
    samples on both sides, the one whose middle is nearest; where there is none, the nearest.
    """
    usual = float(np.median(fits[0].scale))
    known = np.flatnonzero(believed)
    place = np.searchsorted(series_s[known], times)
    beside = [known[np.clip(place + side, 0, len(known) - 1)] for side in (-1, 0)]
    chosen = np.empty((len(times), 4))
    cost = np.full(len(times), np.inf)
    for level, fit in enumerate(fits):
        window, price = _nearest_window(fit, times, beside, usual)
        # A longer window must be better by more than its length makes it look.
        take = price + 2.0 * level < cost
        chosen[take] = fit.rotations(window[take], times[take]).as_quat()
        cost[take] = price[take] + 2.0 * level
    return chosen


def _nearest_window(
    fit: WindowFits, times: FloatArray, beside: list[IntArray], usual: float
) -> tuple[IntArray, FloatArray]:
    """Best window that covers each time, and its price: the distance of its middle and faults."""
    order = np.argsort(fit.middle_s, kind="stable")
    at = np.searchsorted(fit.middle_s[order], times)
    best = np.zeros(len(times), dtype=np.int64)
    price = np.full(len(times), np.inf)
    # Windows overlap fourfold: eight neighbours hold all that cover a time.
    for shift in range(-4, 4):
        window = order[np.clip(at + shift, 0, len(order) - 1)]
        away = np.abs(times - fit.middle_s[window]) / fit.half_s[window]
        cost = away + 1e3 * (away > 1.0 + 1e-9) + 20.0 * (fit.scale[window] > _GOOD * usual)
        allowed = _AGREES * np.maximum(fit.scale[window], 0.8 * usual)
        for sample in beside:
            inside = (sample >= fit.start[window]) & (sample < fit.start[window] + fit.length)
            column = np.clip(sample - fit.start[window], 0, fit.length - 1)
            cost += 10.0 * (inside & (fit.residual[window, column] > allowed))
        better = cost < price
        best[better], price[better] = window[better], cost[better]
    return best, price
