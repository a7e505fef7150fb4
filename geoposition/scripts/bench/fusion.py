# mypy: disable-error-code="import-not-found,import-untyped"
"""Attitude fusion: ours beside filterpy's Kalman filter and GTSAM's AHRS factors.

The results compared are attitudes, as rotation vectors from the true one in arcsec.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Case, Contender, Missing
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.filters import ekf
from geoposition.sensors.attitude_determination.graph import factor_graph
from geoposition.sensors.attitude_determination.settings import FusionSettings, GyroModel
from geoposition.sensors.attitude_determination.smoothers import smooth
from geoposition.sensors.gyro import simulate_increments
from geoposition.sensors.kinematics import attitude_of_rate, integrated_rate_rad
from geoposition.sensors.star_sensor import noisy_quat_xyzw
from geoposition.sensors.telemetry import GyroNoise, GyroParameters, GyroSeries, StarSeries

_ARCSEC: Final = np.pi / 648000.0
_OURS: Final = "geoposition"
_EVERY: Final = slice(None)
_SIGMA_RAD: Final = 5.0 * _ARCSEC
_MODELS: Final[tuple[GyroModel, ...]] = ("bias", "general")
_PEER_STEPS: Final = 2000
"""A Python loop shows its rate in so many steps."""


@dataclass(frozen=True, slots=True)
class FusionScene:
    """Series of one run, and the true attitude at the gyro's epochs."""

    star: StarSeries
    gyro: GyroSeries
    truth: Rotation
    noise: GyroNoise

    def settings(self, model: GyroModel = "bias") -> FusionSettings:
        """Return the noise as simulated and a prior that the drawn bias fits."""
        return FusionSettings(self.noise, model, 2.5e-6)

    def result(self, raw: Any) -> FloatArray:
        """Attitude error (n, 3) of an estimate at the last n gyro epochs, in arcsec."""
        estimate: AttitudeEstimate = raw
        return estimate.error_rad(self.truth[-len(estimate.times_s) :]) / _ARCSEC


def fusion_scene(gyro_hz: float, star_hz: float, span_s: float, noise: GyroNoise) -> FusionScene:
    """Simulate a slow turn about all axes, one head and a gyro of increments."""
    rng = np.random.default_rng(7)
    times = np.arange(round(span_s * gyro_hz) + 1) / gyro_hz
    star_times = np.arange(round(span_s * star_hz) + 1) / star_hz

    def rate(t: FloatArray) -> FloatArray:
        waves = [np.sin(0.05 * t), np.cos(0.03 * t), np.sin(0.017 * t + 1.0)]
        return np.asarray(1e-3 * np.stack(waves, axis=-1))

    knots = np.union1d(times, star_times)
    truth = attitude_of_rate(rate, knots, (0.0, 0.0, 0.0, 1.0))
    parameters = GyroParameters.of(rng.normal(0.0, 2.5e-6, 3))
    increments = integrated_rate_rad(rate, times)
    gyro = simulate_increments(times, increments, noise, rng, parameters).series()
    quats = noisy_quat_xyzw(truth[np.searchsorted(knots, star_times)], _SIGMA_RAD, rng)
    at_gyro = Rotation.from_quat(truth[np.searchsorted(knots, times)])
    return FusionScene(StarSeries.of(star_times, quats, _SIGMA_RAD), gyro, at_gyro, noise)


def fusion_cases(quick: bool = False) -> Iterator[Case]:
    """High-rate smoothing, an hour of telemetry with both gyro models, and a graph's size."""
    fast = fusion_scene(10_000.0, 10.0, 1.0 if quick else 60.0, GyroNoise(0.015 * _ARCSEC, 1e-9))
    yield _ours(
        "fusion-10khz",
        "two-filter smoothing at 10 kHz",
        fast,
        lambda: smooth.two_filter(fast.star, fast.gyro, fast.settings()),
        300_000.0,
    )
    for model in _MODELS:
        yield hour_case(model, 60.0 if quick else 3600.0)
    even = fusion_scene(10.0, 5.0, 60.0 if quick else 3600.0, GyroNoise(5e-7, 3e-9))
    yield _ours(
        "fusion-forward",
        "forward filter, gyro 10 Hz, star 5 Hz, 6 states",
        even,
        lambda: ekf.filter_forward(even.star, even.gyro, even.settings()),
        None,
        _filterpy(even),
    )
    steady = fusion_scene(20.0, 4.0, 25.0 if quick else 600.0, GyroNoise(5e-7, 0.0))
    knots = len(steady.star)
    yield Case(
        key="fusion-graph",
        title=f"factor graph of {knots} star knots",
        points=knots,
        unit="arcsec",
        tolerance=0.01,
        ours=Contender(
            _OURS,
            _EVERY,
            lambda: factor_graph.smooth(steady.star, steady.gyro, steady.settings()),
            lambda raw: steady.result(raw)[:: len(steady.gyro) // (knots - 1)],
            "attitude at all gyro epochs, with covariance",
        ),
        peers=(_gtsam(steady),),
        target_mpoint_s=2400.0 / 0.15 / 1e6,
    )


def hour_case(model: GyroModel, span_s: float = 3600.0) -> Case:
    """Smooth telemetry of a gyro at 10 Hz and a star sensor at 4 Hz."""
    hour = fusion_scene(10.0, 4.0, span_s, GyroNoise(5e-7, 3e-9))
    settings = hour.settings(model)
    return _ours(
        f"fusion-hour-{settings.states}",
        f"RTS, gyro 10 Hz, star 4 Hz, {settings.states} states",
        hour,
        partial(smooth.rts, hour.star, hour.gyro, settings),
        36_000.0,
    )


def _ours(
    key: str,
    title: str,
    scene: FusionScene,
    run: Callable[[], AttitudeEstimate],
    target_per_s: float | None,
    *peers: Contender | Missing,
) -> Case:
    return Case(
        key=key,
        title=title,
        points=len(scene.gyro),
        unit="arcsec",
        tolerance=0.01,
        ours=Contender(_OURS, _EVERY, run, scene.result),
        peers=peers,
        target_mpoint_s=None if target_per_s is None else target_per_s / 1e6,
    )


def _filterpy(scene: FusionScene) -> Contender | Missing:
    """Run the same error-state filter on filterpy's matrices, for star epochs among the gyro's."""
    version = installed("filterpy")
    name = f"filterpy {version}" if version else "filterpy"
    try:
        from filterpy.kalman import KalmanFilter
    except ImportError as error:
        return Missing(name, f"not installed ({error})")
    steps = min(_PEER_STEPS, len(scene.gyro))
    star_at = {int(k): m for m, k in enumerate(np.searchsorted(
        scene.gyro.times_s, scene.star.times_s - 1e-6
    ))}  # fmt: skip
    sv2, su2 = scene.noise.angle_random_walk**2, scene.noise.rate_random_walk**2
    stars = scene.star.R_inertial_sensor

    def run() -> Rotation:
        kalman = KalmanFilter(dim_x=6, dim_z=3)
        kalman.P = np.diag([_SIGMA_RAD**2] * 3 + [scene.settings().bias_sigma_rad_s ** 2] * 3)
        kalman.H, kalman.R = np.eye(3, 6), _SIGMA_RAD**2 * np.eye(3)
        attitude, bias, found = stars[0], np.zeros(3), [stars[0]]
        identity = np.eye(3)
        for k in range(1, steps):
            step = scene.gyro.times_s[k] - scene.gyro.times_s[k - 1]
            turn = scene.gyro.values[k] - bias * step
            back = Rotation.from_rotvec(-turn).as_matrix()
            kalman.F = np.block([[back, -step * identity], [0.0 * identity, identity]])
            cross = -0.5 * su2 * step**2 * identity
            angle = (sv2 * step + su2 * step**3 / 3.0) * identity
            kalman.Q = np.block([[angle, cross], [cross, su2 * step * identity]])
            kalman.predict()
            attitude = attitude * Rotation.from_rotvec(turn)
            if k in star_at:
                kalman.x = np.zeros((6, 1))
                kalman.update((attitude.inv() * stars[star_at[k]]).as_rotvec()[:, None])
                attitude = attitude * Rotation.from_rotvec(kalman.x[:3, 0])
                bias = bias + kalman.x[3:, 0]
            found.append(attitude)
        return Rotation.concatenate(found)

    def result(raw: Any) -> FloatArray:
        return np.asarray((raw.inv() * scene.truth[:steps]).as_rotvec() / _ARCSEC)

    note = f"the first {steps} epochs"
    return Contender(name, slice(0, steps), run, result, note)


def _gtsam(scene: FusionScene) -> Contender | Missing:
    """GTSAM's AHRS factors between star knots, one constant bias; the build is timed too."""
    version = installed("gtsam")
    name = f"GTSAM {version}" if version else "GTSAM"
    try:
        import gtsam
    except ImportError as error:
        return Missing(name, f"not installed ({error})")
    each = (len(scene.gyro) - 1) // (len(scene.star) - 1)
    steps = np.diff(scene.gyro.times_s)
    rates = scene.gyro.values[1:] / steps[:, None]
    prior = scene.settings().bias_sigma_rad_s
    quats = scene.star.quat_xyzw

    def run() -> Any:
        parameters = gtsam.PreintegratedRotationParams()
        parameters.setGyroscopeCovariance(scene.noise.angle_random_walk**2 * np.eye(3))
        graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
        star_noise = gtsam.noiseModel.Isotropic.Sigma(3, _SIGMA_RAD)
        bias_noise = gtsam.noiseModel.Isotropic.Sigma(3, prior)
        bias = len(quats)
        start.insert(bias, np.zeros(3))
        graph.add(gtsam.PriorFactorVector(bias, np.zeros(3), bias_noise))
        for k, (x, y, z, w) in enumerate(quats):
            attitude = gtsam.Rot3.Quaternion(w, x, y, z)
            start.insert(k, attitude)
            graph.add(gtsam.PriorFactorRot3(k, attitude, star_noise))
            if k:
                measured = gtsam.PreintegratedAhrsMeasurements(parameters)
                for i in range((k - 1) * each, k * each):
                    measured.integrateMeasurement(rates[i], steps[i])
                graph.add(gtsam.AHRSFactor(k - 1, k, bias, measured))
        return gtsam.GaussNewtonOptimizer(graph, start).optimize()

    def result(raw: Any) -> FloatArray:
        found = Rotation.from_matrix([raw.atRot3(k).matrix() for k in range(len(quats))])
        return np.asarray((found.inv() * scene.truth[::each]).as_rotvec() / _ARCSEC)

    return Contender(name, _EVERY, run, result, "attitude at the star knots, no covariance")
