"""The unscented filter of 6 or 15 states, multiplicative: T (3.31)–(3.33) on the rotation vector.

T filters the quaternion's vector part; here the error is a rotation vector about the estimate,
so that points stay unit quaternions and the covariance is regular. At star errors of arcseconds
the unscented and the extended filter differ by less than a thousandth of a sigma: the problem is
linear for all it matters, and what T tables 3.2 and 3.4 show between them is other than that.
*Source*: Julier & Uhlmann 2004; Crassidis & Markley
2003; T 3.2.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.checks.convention_check import (
    refuse_wrong_convention,
)
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.filters.forward import (
    ForwardPass,
    begin,
    estimate_of,
    gate_threshold,
)
from geoposition.sensors.attitude_determination.filters.unscented_kernels import unscented_pass
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.timeline import Timeline, merge
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries


@dataclass(frozen=True, slots=True)
class SigmaPoints:
    """Spread alpha, prior knowledge beta and kappa of T (3.31).

    As given all points lie on the ellipsoid of sqrt(n) sigmas and none in the centre counts in
    the mean; T's kappa = 3 − n gives the centre a negative weight for more than 3 states.
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def weights(self, n: int) -> tuple[float, tuple[float, float, float]]:
        """Root of n + lambda; weights of the centre in mean and covariance, and of the others."""
        scale = self.alpha**2 * (n + self.kappa)
        if not 0.0 < scale < float("inf"):
            raise ArgumentError(f"unscented filter: alpha² (n + kappa) must be positive for {n}")
        centre = 1.0 - n / scale
        square = centre + 1.0 - self.alpha**2 + self.beta
        return float(np.sqrt(scale)), (centre, square, 0.5 / scale)


def filter_forward(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
    points: SigmaPoints = SigmaPoints(),
) -> AttitudeEstimate:
    """Attitude at the gyro epochs from the first usable star sample on, each from data until then.

    A `GeometryError` where the series never overlap, an `ArgumentError` where they contradict each
    other as only a wrong convention makes them.
    """
    refuse_wrong_convention(star, gyro, mounting)
    done = run_unscented(merge(star, gyro, mounting), settings, points)
    return estimate_of(done, done.first, len(star))


def run_unscented(
    timeline: Timeline,
    settings: FusionSettings,
    points: SigmaPoints = SigmaPoints(),
    low_pass_rad_s: float = 0.0,
) -> ForwardPass:
    """Filter a timeline from its first usable star sample on.

    `low_pass_rad_s`, where positive, puts a complementary filter of that corner before it
    (`complementary.cf_ukf`).
    """
    done = begin(timeline, settings)
    spread, weights = points.weights(settings.states)
    unscented_pass(
        done.token,
        done.first,
        timeline.times_s,
        timeline.turn_rad,
        timeline.extra_rad2,
        timeline.star_start,
        timeline.quat_inertial_body,
        timeline.covariance_rad2,
        done.walks,
        gate_threshold(settings),
        spread,
        weights,
        low_pass_rad_s,
        done.quat_xyzw,
        done.rest,
        done.covariance,
        done.residual_rad,
        done.innovation_rad2,
        done.gain,
        done.accepted,
    )
    return done
