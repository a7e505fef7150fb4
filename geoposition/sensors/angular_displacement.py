"""The angular-displacement sensor: increments at kilohertz, its errors and their calibration.

The sensor is turned against the body by its installation error and each axis has a scale error:
measured increment = (I + scale) R_sensor_body (true increment) + drift dt + noise. Its frequency
response is in `angular_band`. To the fusion it is a gyro whose series is of kind "increment"; what
the installation and scale leave behind, the general gyro model estimates.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, as_components, read_only
from geoposition.errors import ArgumentError, ConvergenceError, GeometryError
from geoposition.rotation import skew
from geoposition.sensors.gyro import SimulatedGyro, corrected, simulate_increments
from geoposition.sensors.telemetry import GyroNoise, GyroParameters, GyroSeries


@dataclass(frozen=True, slots=True, eq=False)
class Installation:
    """How a triad is built in and scaled: constant errors of an angular-displacement sensor.

    `turn_rad` (3,) is the rotation vector with R_body_sensor = exp(turn); `scale` (3,) is
    relative, along the sensor's axes; `drift_rad_s` (3,) too. *Source*: P (2), with the rotation
    in full where P has its first order Delta.
    """

    turn_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    scale: FloatArray = field(default_factory=lambda: np.zeros(3))
    drift_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("turn_rad", "scale", "drift_rad_s"):
            object.__setattr__(self, name, read_only(as_components(getattr(self, name), 3, name)))

    @property
    def parameters(self) -> GyroParameters:
        """The same errors as those of the general gyro model, exactly."""
        turn = Rotation.from_rotvec(np.array(self.turn_rad)).inv().as_matrix()
        error = (1.0 + self.scale)[:, None] * turn - np.eye(3)
        return GyroParameters.of(
            self.drift_rad_s,
            np.diag(error),
            error[(0, 0, 1), (1, 2, 2)],
            error[(1, 2, 2), (0, 0, 1)],
        )


def simulate_angular_displacement(
    times_s: ArrayLike,
    increments_rad: ArrayLike,
    noise: GyroNoise,
    rng: np.random.Generator,
    installation: Installation | None = None,
    runs: int | None = None,
) -> SimulatedGyro:
    """Increments as the sensor reads them, from the body's true ones (..., n − 1, 3), any rate."""
    parameters = (installation or Installation()).parameters
    return simulate_increments(times_s, increments_rad, noise, rng, parameters, runs)


def rates_from_increments(series: GyroSeries) -> GyroSeries:
    """Mean rates between the samples of an increment series. *Source*: P (1)."""
    step = np.diff(series.times_s)
    rate = series.increments_rad() / step[:, None]
    return GyroSeries.of(series.times_s, np.concatenate([rate[:1], rate]), "mean-rate")


def installation_undone(series: GyroSeries, installation: Installation) -> GyroSeries:
    """Return the increments in the body, with installation, scale and drift taken out."""
    return corrected(series, installation.parameters)


@dataclass(frozen=True, slots=True, eq=False)
class InstallationFit:
    """An estimated `installation` and the standard deviations of its nine numbers.

    `sigma` (9,): of the turn (rad), the scale and the drift (rad/s); `residual_rad` (3,) is the
    RMS misfit per interval and axis.
    """

    installation: Installation
    sigma: FloatArray
    residual_rad: FloatArray


def fit_installation(
    series: GyroSeries, times_s: ArrayLike, increments_rad: ArrayLike
) -> InstallationFit:
    """Installation, scale and drift against a reference that knows the body's turning.

    `increments_rad` (n − 1, 3) are true rotation vectors between `times_s` (n,), for instance of
    fused star and gyro attitude over an attitude manoeuvre; the sensor's angles are interpolated
    at these times and summed up. A motion that turns about one axis only does not tell all of
    them apart: `GeometryError`.
    """
    times = np.asarray(times_s, dtype=np.float64)
    truth = as_components(increments_rad, 3, "reference increments")
    if truth.shape != (len(times) - 1, 3) or len(times) < 5:
        raise ArgumentError("installation: at least 4 reference increments between times expected")
    if times[0] < series.times_s[0] or times[-1] > series.times_s[-1]:
        raise GeometryError("installation: the reference reaches beyond the sensor's span")
    measured = np.diff(_angle_at(series, times), axis=0)
    step = np.diff(times)
    x = np.zeros(9)
    for _ in range(10):
        turned = Rotation.from_rotvec(-x[:3]).apply(truth)
        misfit = measured - (1.0 + x[3:6]) * turned - x[6:] * step[:, None]
        design = _design(turned, x[3:6], step)
        # Columns differ by orders of magnitude: scaled, so that the rank means something.
        size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        change, _, rank, singular = np.linalg.lstsq(design / size, misfit.ravel(), rcond=1e-9)
        if rank < 9 or singular[-1] < 1e-5 * singular[0]:
            raise GeometryError("installation: the motion does not tell its errors apart")
        change = change / size
        x[:3] = (Rotation.from_rotvec(x[:3]) * Rotation.from_rotvec(change[:3])).as_rotvec()
        x[3:] += change[3:]
        if np.max(np.abs(change[:6])) < 1e-12:
            break
    else:
        raise ConvergenceError("installation: the fit does not converge")
    freedom = max(misfit.size - 9, 1)
    inverse = np.linalg.inv((design / size).T @ (design / size)) / np.outer(size, size)
    variance = np.sum(misfit**2) / freedom * np.diag(inverse)
    return InstallationFit(
        Installation(x[:3], x[3:6], x[6:]),
        read_only(np.sqrt(variance)),
        read_only(np.sqrt(np.mean(misfit**2, axis=0))),
    )


def _design(turned: FloatArray, scale: FloatArray, step: FloatArray) -> FloatArray:
    """Return derivatives (3 n, 9) of measured increments by turn (on the right), scale and drift.

    exp(−d×) exp(−t×) u = turned − d × turned to first order.
    """
    design = np.zeros((len(turned), 3, 9))
    design[:, :, :3] = (1.0 + scale)[:, None] * skew(turned)
    design[:, range(3), range(3, 6)] = turned
    design[:, range(3), range(6, 9)] = step[:, None]
    return design.reshape(-1, 9)


def _angle_at(series: GyroSeries, times: FloatArray) -> FloatArray:
    """Return summed angles (n, 3) at `times`, linear between the samples."""
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(series.increments_rad(), axis=0)])
    return np.stack([np.interp(times, series.times_s, angle[:, k]) for k in range(3)], axis=-1)
