"""What no estimator of a scene can beat, and what the filter is expected to show there.

The Cramér–Rao bound with the prior in force is the covariance of the filter, or the smoother,
linearised at the truth. A table that fixes one truth for all runs does not average over the
prior: there the forward filter's expected error follows from its own gains and that truth.

*Source*: Van Trees 1968, 2.4 (the bound with a prior); Tichavský, Muravchik & Nehorai 1998.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray, IntArray
from geoposition.sensors.attitude_determination.filters.filter_kernels import (
    corrected_turn,
    predict_covariance,
    update_covariance,
)
from geoposition.sensors.attitude_determination.filters.forward import run_forward
from geoposition.sensors.attitude_determination.propagation import process_noise, transition
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.smoothers.smooth import adjoint
from geoposition.sensors.attitude_determination.timeline import Timeline


def bound_rms_rad(
    timeline: Timeline, settings: FusionSettings, truth: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """RMS over all knots of the bound about each axis (3,), forward and smoothed.

    `timeline` holds data without noise, `truth` (s − 3,) the gyro's bias and constants.
    """
    done = run_forward(timeline, settings, truth if settings.states > 6 else np.empty(0))
    forward = _rms(done.covariance[done.first :])
    lag = np.zeros((len(timeline.times_s), 3, 3))
    adjoint(done, lag, np.empty((settings.states, 3)))
    return forward, _rms(done.covariance[done.first :])


def expected_rms_rad(timeline: Timeline, settings: FusionSettings, truth: FloatArray) -> FloatArray:
    """RMS (3,) over all knots that the forward filter shows for one fixed truth (s − 3,)."""
    done = run_forward(timeline, settings, truth if settings.states > 6 else np.empty(0))
    moment = np.zeros((settings.states, settings.states))
    moment[:3, :3] = timeline.covariance_rad2[done.start]
    moment[3:, 3:] = np.outer(truth, truth)
    squares = _second_moments(
        done.token,
        done.first,
        done.start,
        timeline.step_s,
        timeline.turn_rad,
        timeline.extra_rad2,
        timeline.star_start,
        timeline.covariance_rad2,
        done.walks,
        truth,
        done.reference,
        done.gain,
        moment,
    )
    return np.sqrt(squares)


def _rms(covariance: FloatArray) -> FloatArray:
    variance = np.diagonal(covariance, axis1=1, axis2=2)[:, :3]
    return np.asarray(np.sqrt(np.mean(variance, axis=0)))


@njit(cache=True, error_model="numpy")
def _second_moments(
    token: tuple[int, ...],
    first: int,
    start: int,
    steps_s: FloatArray,
    measured_rad: FloatArray,
    extra_rad2: FloatArray,
    star_start: IntArray,
    star_covariance: FloatArray,
    walks: tuple[float, float],
    truth: FloatArray,
    reference: FloatArray,
    K: FloatArray,
    moment: FloatArray,
) -> FloatArray:
    """Mean over the knots of the squared error about each axis, under given gains."""
    n = len(token)
    A, B, L2, M = np.empty((3, 3)), np.empty((3, n - 3)), np.empty((3, 3)), np.empty((3, 3))
    Qdd, Qdb, small = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    strips, square, total = np.empty((6, n - 3)), np.empty((n, n)), np.zeros(3)
    for k in range(first, len(star_start) - 1):
        if k > first:
            step = steps_s[k - 1]
            _, _, _, x, y, z = corrected_turn(
                token, truth, reference, measured_rad[k - 1], step, small, M
            )
            factors = transition(token, x, y, z, step, M, A, B, L2)
            process_noise(
                token, x, y, z, step, walks[0], walks[1], extra_rad2[k - 1], factors, M, L2,
                Qdd, Qdb,
            )  # fmt: skip
            predict_covariance(token, moment, A, B, Qdd, Qdb, walks[1] * step, strips)
        for m in range(star_start[k], star_start[k + 1]):
            if m != start:
                update_covariance(token, moment, star_covariance[m], K[m], square)
        for i in range(3):
            total[i] += moment[i, i]
    return total / (len(star_start) - 1 - first)
