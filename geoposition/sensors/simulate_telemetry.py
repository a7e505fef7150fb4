"""Simulated telemetry: what a GPS receiver and star sensors make of the true motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError
from geoposition.frames import itrs_from_gcrs
from geoposition.sensors.simulate_attitude import Pointing
from geoposition.sensors.simulate_orbit import Orbit


def epochs_s(first_s: float, last_s: float, rate_hz: float) -> FloatArray:
    """Return the multiples of 1 / `rate_hz`, in seconds, that enclose the span."""
    if not (rate_hz > 0.0 and first_s < last_s):
        raise ArgumentError("telemetry: a positive rate and an increasing span expected")
    return np.arange(np.floor(first_s * rate_hz), np.ceil(last_s * rate_hz) + 1.0) / rate_hz


def true_ephemeris(orbit: Orbit, times_s: FloatArray) -> Ephemeris:
    """Earth-fixed positions at `times_s` (n,), Lagrange of 8 points between them.

    At 1 Hz the interpolation is right to rounding: the orbit turns by a milliradian a second.
    """
    position, velocity = orbit.states(times_s)
    position, _ = itrs_from_gcrs(position, velocity, orbit.epoch, times_s)
    return Ephemeris.lagrange(orbit.epoch, times_s, position, "itrs", 8)


def true_attitude(orbit: Orbit, pointing: Pointing, times_s: FloatArray) -> Attitude:
    """Earth-fixed attitude, a rotation spline through `times_s` (n,): the truth by definition."""
    quats = pointing.R_itrs_body(orbit, times_s).as_quat()
    return Attitude.from_samples(orbit.epoch, times_s, quats, "itrs", "spline")


def measured_ephemeris(
    truth: Ephemeris, times_s: FloatArray, sigma_m: float, rng: np.random.Generator
) -> Ephemeris:
    """`truth` at `times_s` (n,) with white noise of `sigma_m` per axis."""
    noise = sigma_m * rng.standard_normal((len(times_s), 3))
    position = truth.position_m(times_s) + noise
    return Ephemeris.lagrange(truth.epoch, times_s, position, truth.frame, 8)


def measured_attitude(
    truth: Attitude, times_s: FloatArray, sigma_rad: ArrayLike, rng: np.random.Generator
) -> Attitude:
    """`truth` at `times_s` (n,) with white noise, `sigma_rad` (3,) about the body's axes.

    The covariance comes with it.
    """
    sigma = np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), (3,))
    noise = Rotation.from_rotvec(sigma * rng.standard_normal((len(times_s), 3)))
    quats = (truth.rotation(times_s) * noise).as_quat()
    measured = Attitude.from_samples(truth.epoch, times_s, quats, truth.frame, "spline")
    covariance = np.broadcast_to(np.diag(sigma**2), (len(times_s), 3, 3)).copy()
    return Attitude(truth.epoch, measured.curve, truth.frame, times_s, covariance)
