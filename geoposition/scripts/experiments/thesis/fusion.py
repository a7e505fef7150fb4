"""From one run's telemetry to the three attitudes of T table 5.4: raw, fused, true.

Star head 2 and gyro are fused, as T did; the raw attitude is that head's own, straight lines
between its samples. The mounting of the heads in the body is known, the cameras' is not.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

import numpy as np

from geoposition.arrays import read_only
from geoposition.attitude import Attitude
from geoposition.frames import R_itrs_body
from geoposition.scripts.experiments.thesis.scene import Scene
from geoposition.scripts.experiments.thesis.telemetry import Instruments, Telemetry
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.settings import FusionSettings, GyroModel
from geoposition.sensors.attitude_determination.smoothers.smooth import two_filter
from geoposition.sensors.star_sensor import mounting_of

Kind: TypeAlias = Literal["raw", "fused", "true"]
KINDS: Final[tuple[Kind, ...]] = ("raw", "fused", "true")
MISALIGNMENT_SIGMA: Final = 2e-3


def settings(instruments: Instruments, model: GyroModel = "general") -> FusionSettings:
    """Priors of T table 4.1's kind: what the gyro's errors are, not their values."""
    return FusionSettings(
        instruments.gyro_noise,
        model,
        instruments.bias_sigma_rad_s,
        MISALIGNMENT_SIGMA,
        MISALIGNMENT_SIGMA,
    )


def fused_estimate(telemetry: Telemetry, instruments: Instruments) -> AttitudeEstimate:
    """Two-filter smoothing with the general gyro model. *Source*: T table 5.1."""
    return two_filter(
        telemetry.star, telemetry.gyro, settings(instruments), mounting_of(instruments.heads)
    )


def fused_attitude(scene: Scene, estimate: AttitudeEstimate) -> Attitude:
    """Earth-fixed spline through the estimate, with its covariance and lag-one terms."""
    plain = scene.attitude(estimate.times_s, estimate.R_inertial_body)
    low, high = scene.window_s
    kept = np.flatnonzero((estimate.times_s >= low) & (estimate.times_s <= high))
    assert estimate.lag_one is not None
    return Attitude(
        plain.epoch,
        plain.curve,
        plain.frame,
        read_only(estimate.times_s[kept]),
        read_only(estimate.covariance[kept, :3, :3]),
        read_only(estimate.lag_one[kept[:-1]]),
    )


def raw_attitude(scene: Scene, telemetry: Telemetry, instruments: Instruments) -> Attitude:
    """Earth-fixed attitude of one star head, linear between its samples."""
    star = telemetry.star
    low, high = scene.window_s
    own = star.head == 0
    kept = np.flatnonzero(own & (star.times_s >= low) & (star.times_s <= high))
    body = star.R_inertial_sensor[kept] * instruments.heads[0].R_body_sensor.inv()
    times = star.times_s[kept]
    quats = R_itrs_body(body, scene.epoch, times).as_quat()
    return Attitude.from_samples(scene.epoch, times, quats, "itrs", "slerp")


def three_attitudes(
    scene: Scene, telemetry: Telemetry, instruments: Instruments
) -> dict[Kind, Attitude]:
    """Raw, fused and true attitude of one run."""
    estimate = fused_estimate(telemetry, instruments)
    truth = next(iter(scene.models.values())).attitude
    return {
        "raw": raw_attitude(scene, telemetry, instruments),
        "fused": fused_attitude(scene, estimate),
        "true": truth,
    }
