"""Star heads: quaternions and star directions as they measure them, simulated.

A head's measured quaternion is R_inertial_body R_body_sensor exp(slow) exp(noise), both turns in
the sensor's axes with the boresight along +z: `slow` moves with the orbit and with the
temperature, `noise` is white, small across the boresight and larger about it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, as_components, read_only, require_increasing
from geoposition.errors import ArgumentError
from geoposition.sensors.kinematics import quat_from_rotvec_xyzw, quat_product_xyzw
from geoposition.sensors.simulate_attitude import Vibration
from geoposition.sensors.telemetry import Mounting, StarSeries

AttitudeCurve: TypeAlias = Callable[[FloatArray], Rotation]
"""R_inertial_body (n,) at times (n,) in seconds, such as `Attitude.rotation`."""


@dataclass(frozen=True, slots=True, eq=False)
class ThermalDrift:
    """Slow turn of a head against the body, in the sensor's axes, from `start_s` on.

    It grows at `rate_rad_s` (3,) and settles by `settled_rad` (3,) with a time constant:
    rate t + settled (1 − exp(−t / time_constant_s)); nothing before the start.
    """

    rate_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))
    settled_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    time_constant_s: float = 1800.0
    start_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rate_rad_s", "settled_rad"):
            object.__setattr__(self, name, read_only(as_components(getattr(self, name), 3, name)))
        if not self.time_constant_s > 0.0:
            raise ArgumentError("thermal drift: a positive time constant expected")

    def turn_rad(self, times_s: ArrayLike) -> FloatArray:
        """Rotation vectors (..., 3) in the sensor at `times_s` (...)."""
        t = np.maximum(np.asarray(times_s, dtype=np.float64) - self.start_s, 0.0)[..., None]
        settled = self.settled_rad * -np.expm1(-t / self.time_constant_s)
        result: FloatArray = self.rate_rad_s * t + settled
        return result


@dataclass(frozen=True, slots=True, eq=False)
class StarHead:
    """One head as built: mounting, white noise and slow errors.

    `sigma_cross_rad` about the sensor's x and y, `sigma_bore_rad` about its z, per sample.
    `low_frequency` errors repeat with the orbit (`orbit_periodic`); T 2.2.2 gives them tens of
    arcseconds.
    """

    name: str = "star"
    sigma_cross_rad: float = 2.4e-5  # 5 arcsec
    sigma_bore_rad: float = 2.4e-5
    R_body_sensor: Rotation = field(default_factory=Rotation.identity)
    low_frequency: tuple[Vibration, ...] = ()
    drift: ThermalDrift | None = None

    def __post_init__(self) -> None:
        if not (self.sigma_cross_rad > 0.0 and self.sigma_bore_rad > 0.0):
            raise ArgumentError(f"star head {self.name}: positive noise expected")

    @property
    def sigma_rad(self) -> FloatArray:
        """Noise (3,) about the sensor's axes."""
        return np.array([self.sigma_cross_rad, self.sigma_cross_rad, self.sigma_bore_rad])

    def slow_error_rad(self, times_s: ArrayLike) -> FloatArray:
        """Rotation vectors (n, 3) in the sensor, of all slow errors at `times_s` (n,)."""
        times = np.asarray(times_s, dtype=np.float64)
        turn = np.zeros((*times.shape, 3))
        for part in (*self.low_frequency, *(() if self.drift is None else (self.drift,))):
            turn = turn + part.turn_rad(times)
        return turn


def orbit_periodic(
    period_s: float, amplitude_rad: ArrayLike, phase_rad: ArrayLike | None = None
) -> tuple[Vibration, ...]:
    """Low-frequency error as harmonics 1, 2, ... of the orbit.

    `amplitude_rad` and `phase_rad` (harmonics, 3) about the sensor's axes.
    """
    amplitude = np.atleast_2d(as_components(amplitude_rad, 3, "amplitude"))
    phase = np.zeros_like(amplitude) if phase_rad is None else np.atleast_2d(phase_rad)
    if phase.shape != amplitude.shape or not period_s > 0.0:
        raise ArgumentError("orbit-periodic error: a period, and phases as many as amplitudes")
    return tuple(
        Vibration((k + 1) / period_s, amplitude[k], phase[k]) for k in range(len(amplitude))
    )


def mounting_of(heads: Sequence[StarHead]) -> Mounting:
    """Return the mounting that the heads were built with, without their slow errors."""
    return Mounting({head.name: head.R_body_sensor for head in heads})


def simulate_star_series(
    heads: Sequence[StarHead],
    times_s: Sequence[ArrayLike],
    attitude: AttitudeCurve,
    rng: np.random.Generator,
) -> StarSeries:
    """Quaternions of all heads, merged in the order of time.

    `times_s` has one increasing list of epochs for each head; samples at one epoch keep the
    order of the heads.
    """
    if len(heads) == 0 or len(heads) != len(times_s):
        raise ArgumentError("star heads: one list of epochs for each head expected")
    epochs = [require_increasing(np.asarray(t, dtype=np.float64), "star times") for t in times_s]
    quats = []
    for head, times in zip(heads, epochs, strict=True):
        turn = Rotation.from_rotvec(head.slow_error_rad(times))
        true = (attitude(times) * head.R_body_sensor * turn).as_quat()
        quats.append(noisy_quat_xyzw(true, head.sigma_rad, rng))
    index = np.concatenate([np.full(len(times), k) for k, times in enumerate(epochs)])
    order = np.argsort(np.concatenate(epochs), kind="stable")
    cross = np.array([head.sigma_cross_rad for head in heads])
    bore = np.array([head.sigma_bore_rad for head in heads])
    return StarSeries.of(
        np.concatenate(epochs)[order],
        np.concatenate(quats)[order],
        cross[index[order]],
        bore[index[order]],
        index[order],
        tuple(head.name for head in heads),
    )


def noisy_quat_xyzw(
    quat_xyzw: ArrayLike,
    sigma_rad: ArrayLike,
    rng: np.random.Generator,
    runs: int | None = None,
) -> FloatArray:
    """Quaternions (..., 4), or (runs, ..., 4), with white noise about the sensor's axes.

    `sigma_rad` (..., 3) or one number. Noise on the quaternion's vector part, as T table 3.1
    states it, is half of this.
    """
    quat = as_components(quat_xyzw, 4, "star quaternions")
    shape = quat.shape[:-1] if runs is None else (runs, *quat.shape[:-1])
    noise = np.asarray(sigma_rad, dtype=np.float64) * rng.standard_normal((*shape, 3))
    return quat_product_xyzw(quat, quat_from_rotvec_xyzw(noise))
