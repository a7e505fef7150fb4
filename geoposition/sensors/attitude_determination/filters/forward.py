"""A forward pass over a timeline with all that the smoothers and the estimate need of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from scipy.stats import chi2

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.errors import GeometryError
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate, Innovations
from geoposition.sensors.attitude_determination.filters.filter_kernels import forward_pass
from geoposition.sensors.attitude_determination.propagation import quat_of_turn, turn_of_quat
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.timeline import Timeline

NO_REFERENCE: Final = np.empty(0)
"""Linearise about the estimate itself."""

_WITNESSES = 10
"""Star samples that a gated filter asks whether the first fix is one of them."""


@dataclass(frozen=True, slots=True, eq=False)
class ForwardPass:
    """Filter output at all knots of `timeline`; rows before `first` are not set.

    `quat_xyzw` (k, 4), `rest` (k, s − 3) bias and constants, `covariance` (k, s, s), after the
    samples of each knot; `residual_rad` (m, 3), `innovation_rad2` (m, 3, 3), `gain` (m, s, 3)
    and `accepted` (m,) of the star samples, `start` being the one that gave the first attitude.
    A smoother overwrites the first three, so that long series need their memory once.
    """

    timeline: Timeline
    settings: FusionSettings
    reference: FloatArray
    first: int
    start: int
    quat_xyzw: FloatArray
    rest: FloatArray
    covariance: FloatArray
    residual_rad: FloatArray
    innovation_rad2: FloatArray
    gain: FloatArray
    accepted: BoolArray

    @property
    def token(self) -> tuple[int, ...]:
        """A tuple as long as the state: its length is what kernels are compiled for."""
        return state_token(self.settings)

    @property
    def walks(self) -> tuple[float, float]:
        """Squared angle and rate random walk."""
        noise = self.settings.noise
        return noise.angle_random_walk**2, noise.rate_random_walk**2


def state_token(settings: FusionSettings) -> tuple[int, ...]:
    """Return a tuple as long as the error state."""
    return (0,) * settings.states


def gate_threshold(settings: FusionSettings) -> float:
    """Largest normalised squared innovation that is accepted."""
    if settings.gate_probability is None:
        return float("inf")
    return float(chi2.ppf(settings.gate_probability, 3))


def prior_variance(settings: FusionSettings) -> FloatArray:
    """Variances (s − 3,) of bias and constants before any data."""
    sigma = np.repeat(
        [settings.bias_sigma_rad_s, settings.scale_sigma, settings.misalignment_sigma], (3, 3, 6)
    )
    variance: FloatArray = sigma[: settings.states - 3] ** 2
    return variance


def begin(
    timeline: Timeline, settings: FusionSettings, reference: FloatArray = NO_REFERENCE
) -> ForwardPass:
    """Take the first credible star fix with its noise, and the priors of bias and constants.

    Storage for all knots; only the first one's row is filled.
    """
    n, knots, samples = settings.states, len(timeline.times_s), len(timeline.star_index)
    start = _first_fix(timeline, settings)
    first = int(np.searchsorted(timeline.star_start, start, side="right")) - 1
    quat, rest, covariance = np.empty((knots, 4)), np.empty((knots, n - 3)), np.empty((knots, n, n))
    quat[first] = timeline.quat_inertial_body[start]
    rest[first] = 0.0
    covariance[first] = 0.0
    covariance[first, :3, :3] = timeline.covariance_rad2[start]
    covariance[first, range(3, n), range(3, n)] = prior_variance(settings)
    accepted = np.zeros(samples, dtype=np.bool_)
    accepted[start] = True
    return ForwardPass(
        timeline,
        settings,
        reference,
        first,
        start,
        quat,
        rest,
        covariance,
        np.full((samples, 3), np.nan),
        np.full((samples, 3, 3), np.nan),
        np.zeros((samples, n, 3)),
        accepted,
    )


def run_forward(
    timeline: Timeline, settings: FusionSettings, reference: FloatArray = NO_REFERENCE
) -> ForwardPass:
    """Filter a timeline from its first usable star sample on.

    With a `reference` (s − 3,), the gyro model is linearised there instead of at the estimate.
    """
    done = begin(timeline, settings, reference)
    forward_pass(
        done.token,
        done.first,
        timeline.step_s,
        timeline.turn_rad,
        timeline.extra_rad2,
        timeline.star_start,
        timeline.quat_inertial_body,
        timeline.covariance_rad2,
        done.walks,
        gate_threshold(settings),
        reference,
        done.quat_xyzw,
        done.rest,
        done.covariance,
        done.residual_rad,
        done.innovation_rad2,
        done.gain,
        done.accepted,
    )
    return done


def estimate_of(
    done: ForwardPass, first: int, samples: int, lag: FloatArray | None = None
) -> AttitudeEstimate:
    """Return the rows of the gyro epochs from knot `first` on; `samples` star samples were given.

    `lag` (k, p, p), where given, holds at each gyro knot the cross-covariance with the next.
    """
    timeline = done.timeline
    rows: slice | IntArray = slice(first, None)
    if not timeline.is_gyro[first:].all():
        rows = first + np.flatnonzero(timeline.is_gyro[first:])
    quat, rest, covariance = done.quat_xyzw[rows], done.rest[rows], done.covariance[rows]
    if done.settings.states == 6:
        parameters = np.broadcast_to(np.zeros(9), (len(quat), 9))
    else:
        parameters = np.ascontiguousarray(rest[:, 3:])
    bias = np.ascontiguousarray(rest[:, :3])
    lags = None if lag is None else lag[rows][:-1]
    for array in (quat, bias, parameters, covariance, lags):
        if array is not None:
            array.setflags(write=False)
    attitude_lags = None if lags is None else lags[:, :3, :3]
    return AttitudeEstimate(
        timeline.times_s[rows],
        quat,
        bias,
        parameters,
        covariance,
        attitude_lags,
        _innovations(done, samples),
        lags if lags is not None and lags.shape[1] == done.settings.states else None,
    )


def _innovations(done: ForwardPass, samples: int) -> Innovations:
    index, timeline = done.timeline.star_index, done.timeline
    times = np.full(samples, np.nan)
    residual, covariance = np.full((samples, 3), np.nan), np.full((samples, 3, 3), np.nan)
    accepted = np.zeros(samples, dtype=np.bool_)
    times[index] = np.repeat(timeline.times_s, np.diff(timeline.star_start))
    residual[index], covariance[index] = done.residual_rad, done.innovation_rad2
    accepted[index] = done.accepted
    for array in (times, residual, covariance, accepted):
        array.setflags(write=False)
    return Innovations(times, residual, covariance, accepted)


def _first_fix(timeline: Timeline, settings: FusionSettings) -> int:
    """Place of the star sample to start from: the first, or with a gate the first credible."""
    threshold = gate_threshold(settings)
    samples = len(timeline.star_index)
    if not np.isfinite(threshold) or samples < 3:
        return 0
    for sample in range(samples - 1):
        witnesses = range(sample + 1, min(sample + 1 + _WITNESSES, samples))
        agree = sum(_apart(timeline, settings, sample, other) <= threshold for other in witnesses)
        if 2 * agree >= len(witnesses):
            return sample
    raise GeometryError("star data: no two samples agree with the gyro's turn between them")


def _apart(timeline: Timeline, settings: FusionSettings, sample: int, other: int) -> float:
    """Squared distance of two star samples after the gyro's turn, over its variance."""
    start = timeline.star_start
    low, high = (int(np.searchsorted(start, m, side="right")) - 1 for m in (sample, other))
    turns = timeline.turn_rad[low:high]
    end = integrate(timeline.quat_inertial_body[sample], turns)
    x, y, z, w = timeline.quat_inertial_body[other]
    off = np.array(turn_of_quat(*quat_multiply(-end[0], -end[1], -end[2], end[3], x, y, z, w)))
    span = timeline.times_s[high] - timeline.times_s[low]
    turned = float(np.linalg.norm(turns, axis=1).sum())
    variance = settings.noise.angle_random_walk**2 * span
    variance += (settings.bias_sigma_rad_s * span) ** 2 + timeline.extra_rad2[low:high].sum()
    if settings.states == 15:
        variance += (settings.scale_sigma**2 + settings.misalignment_sigma**2) * turned**2
    both = timeline.covariance_rad2[sample] + timeline.covariance_rad2[other]
    return float(off @ np.linalg.solve(both + variance * np.eye(3), off))


@njit(cache=True, error_model="numpy")
def integrate(quat: FloatArray, turns: FloatArray) -> FloatArray:
    """Attitude (4,), scalar last, after `turns` (n, 3) one after the other from `quat` (4,)."""
    x, y, z, w = quat[0], quat[1], quat[2], quat[3]
    for k in range(len(turns)):
        a, b, c, d = quat_of_turn(turns[k, 0], turns[k, 1], turns[k, 2])
        x, y, z, w = quat_multiply(x, y, z, w, a, b, c, d)
    return np.array([x, y, z, w])
