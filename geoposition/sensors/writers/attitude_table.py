"""Tables of attitude as the contract has them: fused estimates, star samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray
from geoposition.rotation import continuous_quat
from geoposition.sensors.attitude_determination.estimate import STATE_NAMES, AttitudeEstimate
from geoposition.sensors.telemetry import StarSeries
from geoposition.sensors.writers.table_file import Column

_PARAMETERS = STATE_NAMES[6:]


def attitude_columns(times_s: FloatArray, quat_xyzw: ArrayLike) -> dict[str, Column]:
    """`t_s,q_x,q_y,q_z,q_w`, signs continuous from row to row, the first one's scalar positive."""
    quat = continuous_quat(quat_xyzw)
    if len(quat) and quat[0, 3] < 0.0:
        quat = -quat
    names = ("q_x", "q_y", "q_z", "q_w")
    return {"t_s": np.asarray(times_s), **{name: quat[:, k] for k, name in enumerate(names)}}


def estimate_columns(estimate: AttitudeEstimate) -> dict[str, Column]:
    """Columns of a fused attitude, body to inertial.

    `t_s`, quaternion, `sigma_x_rad` ... of the attitude about the body's axes, `bias_x` ... in
    rad/s; with 15 states scale factors and misalignments; then the standard deviations of bias
    and parameters, `sigma_bias_x` and so on, in the units of what they belong to.
    """
    columns = attitude_columns(estimate.times_s, estimate.quat_xyzw)
    variance = np.einsum("nii->ni", estimate.covariance)
    sigma = np.sqrt(np.maximum(variance, 0.0))
    for k, axis in enumerate("xyz"):
        columns[f"sigma_{axis}_rad"] = sigma[:, k]
    for k, axis in enumerate("xyz"):
        columns[f"bias_{axis}"] = np.asarray(estimate.bias_rad_s[:, k])
    states = estimate.covariance.shape[1]
    if states > 6:
        for k, name in enumerate(_PARAMETERS):
            columns[name] = np.asarray(estimate.parameters[:, k])
    for k in range(3, states):
        columns[f"sigma_{STATE_NAMES[k]}"] = sigma[:, k]
    return columns


def star_columns(star: StarSeries) -> dict[str, Column]:
    """Columns of a STAR table."""
    quat = np.array(star.quat_xyzw)
    return {
        "t_s": np.asarray(star.times_s),
        "sensor": np.array(star.heads, dtype=np.str_)[star.head],
        **{f"q_{axis}": quat[:, k] for k, axis in enumerate("xyzw")},
        "sigma_cross_rad": np.asarray(star.sigma_cross_rad),
        "sigma_bore_rad": np.asarray(star.sigma_bore_rad),
    }
