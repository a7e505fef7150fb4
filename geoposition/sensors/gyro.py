"""Gyros: measured = (I + S) true + bias + noise, simulated exactly and corrected.

Between two samples the bias walks at random while white noise adds to the angle. Farrenkopf's
discretisation draws both with the covariance that the continuous model has at the samples,
whatever their steps, so that a filter with the same model is optimal on the simulated data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components, read_only, require_increasing
from geoposition.errors import ArgumentError
from geoposition.sensors.telemetry import GyroKind, GyroNoise, GyroParameters, GyroSeries


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedGyro:
    """Samples `values` (..., n, 3) at `times_s` (n,), and the true `bias_rad_s` (..., n, 3).

    Leading axes are runs. Units of `values` as in `GyroSeries` for `kind`; the first sample of a
    mean rate or an increment repeats the second and says nothing.
    """

    times_s: FloatArray
    values: FloatArray
    bias_rad_s: FloatArray
    kind: GyroKind

    def series(self, run: int | tuple[int, ...] = ()) -> GyroSeries:
        """Return the telemetry of one run; without runs, of the only one."""
        values = self.values[run]
        if values.ndim != 2:
            raise ArgumentError(f"simulated gyro: the index of one run of {self.values.shape[:-2]}")
        return GyroSeries.of(self.times_s, values, self.kind)


def simulate_increments(
    times_s: ArrayLike,
    increments_rad: ArrayLike,
    noise: GyroNoise,
    rng: np.random.Generator,
    parameters: GyroParameters | None = None,
    runs: int | None = None,
) -> SimulatedGyro:
    """Angles measured between the samples, from the true ones `increments_rad` (..., n − 1, 3).

    The truth is the integral of the body rate over each step (`kinematics.integrated_rate_rad`),
    or the step's rotation vector where the gyro compensates its coning. Runs come from `runs`,
    from leading axes of the truth, or from parameters of shape (runs, 3), which broadcast;
    `parameters.bias_rad_s` is the bias at the first sample.

    *Source*: Farrenkopf 1978; Reynolds 1998; Crassidis & Junkins 2012, (7.147); T (2.24)–(2.27).
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "gyro times")
    truth = as_components(increments_rad, 3, "gyro increments")
    if len(times) < 2 or truth.ndim < 2 or truth.shape[-2] != len(times) - 1:
        raise ArgumentError(f"gyro increments: shape (..., {len(times) - 1}, 3) expected")
    parameters = parameters or GyroParameters.of()
    shape = _batch(runs, truth.shape[:-2], parameters)
    step = np.diff(times)[:, None]
    bias = _bias_walk(parameters.bias_rad_s, noise, step, shape, rng)
    # Given both ends, the walk's integral is their mean times the step, and this scatter.
    scatter = np.sqrt(noise.angle_random_walk**2 * step + noise.rate_random_walk**2 * step**3 / 12)
    angle = _distorted(truth, parameters) + 0.5 * step * (bias[..., 1:, :] + bias[..., :-1, :])
    angle = angle + scatter * rng.standard_normal((*shape, len(times) - 1, 3))
    values = np.concatenate([angle[..., :1, :], angle], axis=-2)
    return SimulatedGyro(read_only(times), _frozen(values), _frozen(bias), "increment")


def simulate_mean_rates(
    times_s: ArrayLike,
    increments_rad: ArrayLike,
    noise: GyroNoise,
    rng: np.random.Generator,
    parameters: GyroParameters | None = None,
    runs: int | None = None,
) -> SimulatedGyro:
    """Mean rates since the sample before, from the same truth as `simulate_increments`."""
    made = simulate_increments(times_s, increments_rad, noise, rng, parameters, runs)
    step = np.diff(made.times_s)
    values = made.values / np.concatenate([step[:1], step])[:, None]
    return SimulatedGyro(made.times_s, _frozen(values), made.bias_rad_s, "mean-rate")


def simulate_rates(
    times_s: ArrayLike,
    rate_rad_s: ArrayLike,
    noise: GyroNoise,
    rng: np.random.Generator,
    parameters: GyroParameters | None = None,
    runs: int | None = None,
) -> SimulatedGyro:
    """Rates sampled at their times, from the true ones `rate_rad_s` (..., n, 3).

    The white noise of a sample is averaged over its share of time, half a step to either side,
    so that the trapezoid's angle walks with the stated angle random walk.
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "gyro times")
    truth = as_components(rate_rad_s, 3, "gyro rates")
    if len(times) < 2 or truth.ndim < 2 or truth.shape[-2] != len(times):
        raise ArgumentError(f"gyro rates: shape (..., {len(times)}, 3) expected")
    parameters = parameters or GyroParameters.of()
    shape = _batch(runs, truth.shape[:-2], parameters)
    step = np.diff(times)[:, None]
    bias = _bias_walk(parameters.bias_rad_s, noise, step, shape, rng)
    share = 0.5 * (np.concatenate([step[:1], step]) + np.concatenate([step, step[-1:]]))
    sigma = noise.angle_random_walk / np.sqrt(share)
    values = _distorted(truth, parameters) + bias
    values = values + sigma * rng.standard_normal((*shape, len(times), 3))
    return SimulatedGyro(read_only(times), _frozen(values), _frozen(bias), "rate")


def draw_parameters(
    rng: np.random.Generator,
    runs: int,
    bias_sigma_rad_s: float,
    scale_sigma: float = 0.0,
    misalignment_sigma: float = 0.0,
) -> GyroParameters:
    """Gyro errors (runs, 3) drawn from a prior without mean, as consistency tests need them."""
    sigmas = (bias_sigma_rad_s, scale_sigma, misalignment_sigma, misalignment_sigma)
    return GyroParameters.of(*(sigma * rng.standard_normal((runs, 3)) for sigma in sigmas))


def corrected(
    series: GyroSeries, parameters: GyroParameters, bias_rad_s: ArrayLike | None = None
) -> GyroSeries:
    """Take a gyro's known errors out of its series: (I + S)^-1 (measured − bias).

    `bias_rad_s` (n, 3), where given, takes the place of the constant bias: one value per sample,
    the mean of neighbours where a sample is a mean or an increment. *Source*: T (4.8) with
    (I + S)^-1 for the first-order I − S.
    """
    if bias_rad_s is None:
        bias = np.broadcast_to(parameters.bias_rad_s, series.values.shape)
    else:
        bias = as_components(bias_rad_s, 3, "gyro bias")
        if bias.shape != series.values.shape:
            raise ArgumentError(f"gyro bias: shape {series.values.shape} expected")
        if series.kind != "rate":
            bias = np.concatenate([bias[:1], 0.5 * (bias[1:] + bias[:-1])])
    if series.kind == "increment":
        step = np.diff(series.times_s)
        bias = bias * np.concatenate([step[:1], step])[:, None]
    inverse = np.linalg.inv(np.eye(3) + parameters.matrix)
    return GyroSeries.of(series.times_s, (series.values - bias) @ inverse.T, series.kind)


def angle_variance_rad2(noise: GyroNoise, elapsed_s: ArrayLike) -> FloatArray:
    """Variance (...) of the angle integrated over `elapsed_s` (...) from a known bias, per axis.

    sigma_v^2 t + sigma_u^2 t^3 / 3. *Source*: Farrenkopf 1978.
    """
    t = np.asarray(elapsed_s, dtype=np.float64)
    return np.asarray(noise.angle_random_walk**2 * t + noise.rate_random_walk**2 * t**3 / 3.0)


def allan_deviation_rad_s(noise: GyroNoise, averaging_s: ArrayLike) -> FloatArray:
    """Allan deviation (...) of the rate over `averaging_s` (...): noise and bias walk.

    *Source*: IEEE Std 952-1997, annex C: sigma_v^2 / tau + sigma_u^2 tau / 3.
    """
    tau = np.asarray(averaging_s, dtype=np.float64)
    return np.sqrt(noise.angle_random_walk**2 / tau + noise.rate_random_walk**2 * tau / 3.0)


def _batch(
    runs: int | None, leading: tuple[int, ...], parameters: GyroParameters
) -> tuple[int, ...]:
    given = () if runs is None else (runs,)
    parts = (parameters.bias_rad_s, parameters.scale, parameters.upper, parameters.lower)
    try:
        return np.broadcast_shapes(given, leading, *(part.shape[:-1] for part in parts))
    except ValueError:
        raise ArgumentError("gyro: runs, truth and parameters do not go together") from None


def _bias_walk(
    start: FloatArray,
    noise: GyroNoise,
    step: FloatArray,
    shape: tuple[int, ...],
    rng: np.random.Generator,
) -> FloatArray:
    """Bias (*shape, n, 3), a random walk from `start` (..., 3) over steps (n − 1, 1)."""
    bias = np.empty((*shape, len(step) + 1, 3))
    bias[..., 0, :] = start
    walk = noise.rate_random_walk * np.sqrt(step) * rng.standard_normal((*shape, len(step), 3))
    bias[..., 1:, :] = start[..., None, :] + np.cumsum(walk, axis=-2)
    return bias


def _distorted(true: FloatArray, parameters: GyroParameters) -> FloatArray:
    """(I + S) applied to (..., n, 3)."""
    matrix = np.eye(3) + parameters.matrix
    result: FloatArray = true @ np.swapaxes(matrix, -1, -2)
    return result


def _frozen(values: FloatArray) -> FloatArray:
    # Batches are large: frozen in place, not copied.
    values.setflags(write=False)
    return values
