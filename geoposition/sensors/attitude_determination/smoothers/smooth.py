"""Fixed-interval smoothing: Rauch-Tung-Striebel, and the forward and backward filter weighed.

Both solve the same least-squares problem over all data, two ways, and agree to rounding. With
scale factors and misalignments the problem is not linear: `PASSES` times the filter runs again,
linearised at the smoothed parameters with the first prior, so that 2000 ppm cost no ppm.

*Source*: T (4.9)–(4.17), P (8), corrected: the backward pass starts without information, one side
is the predicted one, later passes take the linearisation point but no prior from earlier ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, TypeAlias

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.checks.convention_check import (
    refuse_wrong_convention,
)
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.filters.forward import (
    ForwardPass,
    estimate_of,
    run_forward,
)
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.smoothers.information_kernels import (
    information_pass,
)
from geoposition.sensors.attitude_determination.smoothers.smooth_kernels import (
    adjoint_pass,
    extend_back,
)
from geoposition.sensors.attitude_determination.timeline import Timeline, merge
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

PASSES: Final = 4
"""At most so many linearisations of the general gyro model."""

_SETTLED_SIGMA = 1e-3
"""Parameters that move by a smaller share of their sigma need no further linearisation."""

Lag: TypeAlias = Literal["attitude", "state"]
"""How much of the lag-one cross-covariance to keep: of the attitude (3 x 3) or the whole state."""

_Backward: TypeAlias = Callable[[ForwardPass, FloatArray, FloatArray], None]


def rts(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
    lag: Lag = "attitude",
) -> AttitudeEstimate:
    """Smooth after Rauch, Tung and Striebel: attitude at all gyro epochs, each from all data."""
    return _smooth(star, gyro, settings, mounting, lag, adjoint)


def two_filter(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
    lag: Lag = "attitude",
) -> AttitudeEstimate:
    """Weigh a forward filter with a backward information filter; the same estimate as `rts`."""
    return _smooth(star, gyro, settings, mounting, lag, information)


def cross_covariance(estimate: AttitudeEstimate, first: int, second: int) -> FloatArray:
    """E[x_first x_second^T] (p, p) of two epochs of a smoothed estimate, by their place.

    p is 3 for an estimate with `lag_one` of the attitude, and the number of states where `lag`
    was "state". The chain P_{k,k+1} P_{k+1}^-1 P_{k+1,k+2} … is exact for the whole state, whose
    smoothing errors are a Markov chain; for the attitude alone it neglects what the bias
    carries past an epoch. *Source*: Rauch, Tung & Striebel 1965.
    """
    if estimate.lag_one is None:
        raise ArgumentError("cross-covariance: a smoothed estimate with lag-one terms expected")
    lags = estimate.lag_one if estimate.lag_state is None else estimate.lag_state
    size, epochs = lags.shape[-1], len(estimate.times_s)
    if not (0 <= first < epochs and 0 <= second < epochs):
        raise ArgumentError(f"cross-covariance: epochs 0 .. {epochs - 1} expected")
    low, high = min(first, second), max(first, second)
    if low == high:
        return read_only(estimate.covariance[low, :size, :size])
    result = np.array(lags[low])
    for k in range(low + 1, high):
        whole = estimate.covariance[k, :size, :size]
        # scaled to unit variances: rad, rad/s and pure numbers differ by 1e6
        sigma = np.sqrt(np.diag(whole))
        scaled = whole / np.outer(sigma, sigma)
        result = (result / sigma) @ np.linalg.solve(scaled, lags[k] / sigma[:, None])
    return read_only(result if first <= second else result.T)


def smooth_timeline(
    timeline: Timeline, settings: FusionSettings, backward: Literal["rts", "two-filter"] = "rts"
) -> ForwardPass:
    """Return the smoothed state at the knots of a timeline, from its first usable star sample."""
    chosen = adjoint if backward == "rts" else information
    lag = _lag_store(timeline, settings, "attitude")
    return _smoothed(timeline, settings, chosen, lag, np.empty((settings.states, 3)))


def _smooth(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting,
    lag: Lag,
    backward: _Backward,
) -> AttitudeEstimate:
    timeline = merge(star, gyro, mounting)
    refuse_wrong_convention(star, gyro, mounting)
    store = _lag_store(timeline, settings, lag)
    at_first = np.empty((settings.states, store.shape[1]))
    done = _smoothed(timeline, settings, backward, store, at_first)
    if done.first > 0:
        extend_back(
            done.token,
            done.first,
            timeline.step_s,
            timeline.turn_rad,
            timeline.extra_rad2,
            timeline.is_gyro,
            done.walks,
            done.reference,
            done.quat_xyzw,
            done.rest,
            done.covariance,
            store,
            at_first,
        )
    return estimate_of(done, 0, len(star), store)


def _smoothed(
    timeline: Timeline,
    settings: FusionSettings,
    backward: _Backward,
    lag: FloatArray,
    at_first: FloatArray,
) -> ForwardPass:
    done = run_forward(timeline, settings)
    if settings.states > 6:
        # The filter's last word on constants is the smoother's: no backward pass is needed here.
        for _ in range(PASSES - 1):
            reference = done.rest[-1].copy()
            sigma = np.sqrt(np.diagonal(done.covariance[-1])[6:])
            done = run_forward(timeline, settings, reference)
            if np.all(np.abs(done.rest[-1, 3:] - reference[3:]) <= _SETTLED_SIGMA * sigma):
                break
    backward(done, lag, at_first)
    return done


def _lag_store(timeline: Timeline, settings: FusionSettings, lag: Lag) -> FloatArray:
    if lag not in ("attitude", "state"):
        raise ArgumentError(f"lag: attitude or state expected, got {lag!r}")
    size = 3 if lag == "attitude" else settings.states
    return np.zeros((len(timeline.times_s), size, size))


def adjoint(done: ForwardPass, lag: FloatArray, at_first: FloatArray) -> None:
    """Fold all later data into a forward pass, in place, as the RTS smoother does."""
    timeline = done.timeline
    adjoint_pass(
        done.token,
        done.first,
        done.start,
        timeline.step_s,
        timeline.turn_rad,
        timeline.is_gyro,
        timeline.star_start,
        done.reference,
        done.residual_rad,
        done.innovation_rad2,
        done.gain,
        done.accepted,
        done.quat_xyzw,
        done.rest,
        done.covariance,
        lag,
        at_first,
    )


def information(done: ForwardPass, lag: FloatArray, at_first: FloatArray) -> None:
    """Fold all later data into a forward pass, in place, by a backward information filter."""
    timeline = done.timeline
    information_pass(
        done.token,
        done.first,
        done.start,
        timeline.step_s,
        timeline.turn_rad,
        timeline.extra_rad2,
        timeline.is_gyro,
        timeline.star_start,
        timeline.covariance_rad2,
        done.walks,
        done.reference,
        done.residual_rad,
        done.gain,
        done.accepted,
        done.quat_xyzw,
        done.rest,
        done.covariance,
        lag,
        at_first,
    )
