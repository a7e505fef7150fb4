"""A forward pass before its first step: storage for all knots, the state at the first one."""

from __future__ import annotations

import numpy as np

from geoposition.sensors.attitude_determination.forward import (
    NO_REFERENCE,
    ForwardPass,
    _first_fix,
    prior_variance,
)
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.timeline import Timeline


def begin(timeline: Timeline, settings: FusionSettings) -> ForwardPass:
    """Take the first credible star fix with its noise, and the priors of bias and constants."""
    n, knots, samples = settings.states, len(timeline.times_s), len(timeline.star_index)
    start = _first_fix(timeline, settings)
    first = int(np.searchsorted(timeline.star_start, start, side="right")) - 1
    quat, rest, covariance = np.empty((knots, 4)), np.empty((knots, n - 3)), np.zeros((knots, n, n))
    quat[first] = timeline.quat_inertial_body[start]
    rest[first] = 0.0
    covariance[first, :3, :3] = timeline.covariance_rad2[start]
    covariance[first, range(3, n), range(3, n)] = prior_variance(settings)
    accepted = np.zeros(samples, dtype=np.bool_)
    accepted[start] = True
    return ForwardPass(
        timeline,
        settings,
        NO_REFERENCE,
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
