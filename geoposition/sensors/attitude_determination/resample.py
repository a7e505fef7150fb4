"""A fused attitude at other epochs than the gyro's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, read_only
from geoposition.attitude import SlerpCurve
from geoposition.errors import ArgumentError
from geoposition.interpolation import within_span
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate


def at_times(estimate: AttitudeEstimate, times_s: ArrayLike) -> AttitudeEstimate:
    """Return the estimate at `times_s` (n,), which must lie within its span.

    The attitude turns at the gyro's mean rate from sample to sample; gyro parameters and
    covariance go linearly. The cross-covariances of neighbours do not carry over.
    """
    times = np.asarray(times_s, dtype=np.float64)
    if times.ndim != 1 or len(times) == 0:
        raise ArgumentError("attitude: a non-empty list of times expected")
    known = estimate.times_s
    within_span(times, (float(known[0]), float(known[-1])), "attitude")
    left = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
    share = (times - known[left]) / (known[left + 1] - known[left])
    rotation = SlerpCurve.through(known, estimate.quat_xyzw).rotation(times)
    return AttitudeEstimate(
        read_only(times),
        read_only(rotation.as_quat()),
        _between(estimate.bias_rad_s, left, share),
        _between(estimate.parameters, left, share),
        _between(estimate.covariance, left, share),
        None,
        estimate.innovations,
    )


def regular_times(estimate: AttitudeEstimate, rate_hz: float) -> FloatArray:
    """Return times at `rate_hz` over the estimate's span, from its first epoch on."""
    if not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise ArgumentError("attitude: a positive rate expected")
    first, last = float(estimate.times_s[0]), float(estimate.times_s[-1])
    count = int(np.floor((last - first) * rate_hz * (1.0 + 1e-12))) + 1
    return read_only(np.minimum(first + np.arange(count) / rate_hz, last))


def _between(values: FloatArray, left: np.ndarray, share: FloatArray) -> FloatArray:
    weight = share.reshape(-1, *([1] * (values.ndim - 1)))
    return read_only(values[left] * (1.0 - weight) + values[left + 1] * weight)
