"""The multiplicative extended Kalman filter, of 6 or 15 states, forward in time.

The attitude's error is a rotation vector in the body frame, so its covariance is regular and the
quaternion stays unit. The first star fix gives the first attitude and is not used again.

*Source*: T (3.14)–(3.30), (4.1)–(4.8) without noise on constants and with (I + S)^-1; Lefferts,
Markley & Shuster 1982; Crassidis & Junkins, *Optimal Estimation of Dynamic Systems*, 7.2.
"""

from __future__ import annotations

from geoposition.sensors.attitude_determination.checks.convention_check import (
    refuse_wrong_convention,
)
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.filters.forward import estimate_of, run_forward
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.timeline import merge
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries


def filter_forward(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
) -> AttitudeEstimate:
    """Attitude at the gyro epochs from the first usable star sample on, each from data until then.

    Series that never overlap are a `GeometryError`; series that contradict each other as only a
    wrong convention makes them, an `ArgumentError`.
    """
    timeline = merge(star, gyro, mounting)
    refuse_wrong_convention(star, gyro, mounting)
    done = run_forward(timeline, settings)
    return estimate_of(done, done.first, len(star))
