"""The fused attitude as every filter and smoother states it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, read_only
from geoposition.attitude import Attitude
from geoposition.ephemeris import Frame
from geoposition.timescale import Epoch

STATE_NAMES: Final = (
    *(f"theta_{axis}" for axis in "xyz"),
    *(f"bias_{axis}" for axis in "xyz"),
    *(f"scale_{axis}" for axis in "xyz"),
    *(f"upper_{i}" for i in (1, 2, 3)),
    *(f"lower_{i}" for i in (1, 2, 3)),
)
"""Order of the error state: the first 6 or all 15. *Source*: T (4.2)."""


@dataclass(frozen=True, slots=True, eq=False)
class Innovations:
    """Measured minus predicted attitude, for each star sample (m,) in the order of its series.

    `residual_rad` (m, 3) is the rotation vector in the body frame, `covariance_rad2` (m, 3, 3)
    what the filter expected, `accepted` (m,) what passed the gate; NaN where a sample was not met.
    """

    times_s: FloatArray
    residual_rad: FloatArray
    covariance_rad2: FloatArray
    accepted: BoolArray

    def normalised_squared(self) -> FloatArray:
        """NIS (m,), chi-squared with 3 degrees of freedom where the filter is right."""
        solved = np.linalg.solve(self.covariance_rad2, self.residual_rad[..., None])
        return read_only(np.einsum("ij,ij->i", self.residual_rad, solved[..., 0]))


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeEstimate:
    """Attitude and gyro errors over time, with covariance.

    `quat_xyzw` (n, 4) is R_inertial_body at `times_s` (n,). The error state is the rotation
    vector d in the body frame, R_true = R_estimate exp(d), and the additive errors of bias
    (rad/s), scale, upper and lower misalignment (`STATE_NAMES`). `bias_rad_s` (n, 3);
    `parameters` (n, 9) are scale, upper, lower (zeros for the bias model). `covariance`
    (n, s, s), s = 6 or 15; `lag_one` (n − 1, 3, 3), where computed, is the cross-covariance
    E[d_k d_{k+1}^T] of neighbouring attitudes; `lag_state` (n − 1, s, s), where asked for, that
    of whole states.
    """

    times_s: FloatArray
    quat_xyzw: FloatArray
    bias_rad_s: FloatArray
    parameters: FloatArray
    covariance: FloatArray
    lag_one: FloatArray | None = None
    innovations: Innovations | None = None
    lag_state: FloatArray | None = None

    @property
    def R_inertial_body(self) -> Rotation:
        """The estimates as rotations (n,)."""
        return Rotation.from_quat(np.array(self.quat_xyzw))

    @property
    def sigma_rad(self) -> FloatArray:
        """Standard deviations (n, 3) about the body's axes."""
        return read_only(np.sqrt(np.einsum("nii->ni", self.covariance[:, :3, :3])))

    def error_rad(self, R_inertial_body: Rotation) -> FloatArray:
        """Rotation vectors (n, 3) that take the estimates to a truth, in the body frame."""
        return read_only((self.R_inertial_body.inv() * R_inertial_body).as_rotvec())

    def attitude(self, epoch: Epoch, frame: Frame = "gcrs") -> Attitude:
        """Return the input type of the imaging models, times counted from `epoch`."""
        plain = Attitude.from_samples(epoch, self.times_s, self.quat_xyzw, frame)
        return Attitude(
            plain.epoch,
            plain.curve,
            plain.frame,
            self.times_s,
            read_only(self.covariance[:, :3, :3]),
            self.lag_one,
        )
