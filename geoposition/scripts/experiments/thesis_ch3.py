"""T tables 3.2–3.4: extended, unscented, complementary and unscented filter, with their bound.

T table 3.1: 180 s at 0.5 deg/s about X, gyro at 10 Hz, star sensor at 4 Hz, so that every other
star epoch lies between gyro epochs; star noise 1e-5 in the quaternion's vector part, 2e-5 rad per
axis. The truth is the thesis's, fixed; the prior is the first star fix, and 1 deg/h for a drift
of 1 deg/h. The bound is the covariance of the optimal linear estimate along the truth: it needs
no samples. Smoothers, which T does not run here, show what all data together would give.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError
from geoposition.scripts.experiments.monte_carlo import (
    ARCSEC_RAD,
    DEG_H_RAD_S,
    Scene,
    simulate,
    without_noise,
)
from geoposition.sensors.attitude_determination.filters.complementary import run_complementary
from geoposition.sensors.attitude_determination.filters.forward import ForwardPass, run_forward
from geoposition.sensors.attitude_determination.filters.ukf import run_unscented
from geoposition.sensors.attitude_determination.monte_carlo.bound import bound_rms_rad
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.smoothers.smooth import smooth_timeline
from geoposition.sensors.attitude_determination.timeline import Timeline
from geoposition.sensors.kinematics import quat_product_xyzw
from geoposition.sensors.telemetry import GyroNoise, GyroParameters

SPAN_S: Final = 180.0
STAR_SIGMA_RAD: Final = 2e-5
NOISE: Final = GyroNoise(0.1 / 206265.0, 0.001 / 206265.0)
SETTINGS: Final = FusionSettings(NOISE, bias_sigma_rad_s=DEG_H_RAD_S)
DRIFT: Final = GyroParameters.of(np.full(3, DEG_H_RAD_S))
CUTOFF_HZ: Final = 1.0
"""Corner of the complementary filter in front of the unscented one; T states none."""

THESIS: Final[Mapping[str, tuple[str, tuple[float, ...], tuple[float, ...]]]] = {
    "ekf-6": ("3.2", (0.65, 0.73, 0.72), (0.11, 0.14, 0.15)),
    "cf-ukf": ("3.3", (0.61, 0.73, 0.73), (0.10, 0.13, 0.13)),
    "ukf": ("3.4", (0.65, 0.79, 0.79), (0.10, 0.13, 0.13)),
}
"""Table, mean and standard deviation of roll, pitch and yaw error in arcsec."""

_SWEEP_CUTOFF_HZ: Final = (0.2, 0.5, 1.0, 2.0, 5.0)
_SWEEP_COMPLEMENTARY_HZ: Final = (0.003, 0.01, 0.03, 0.1)
_SWEEP_RUNS: Final = 50
_NEES_EVERY: Final = 100

_Method = Callable[[Timeline], ForwardPass]


def _unscented(cutoff_hz: float) -> _Method:
    return lambda line: run_unscented(line, SETTINGS, low_pass_rad_s=2.0 * np.pi * cutoff_hz)


def _complementary(cutoff_hz: float) -> _Method:
    return lambda line: run_complementary(line, SETTINGS, cutoff_hz)


METHODS: Final[Mapping[str, _Method]] = {
    "ekf-6": lambda line: run_forward(line, SETTINGS),
    "ukf": _unscented(0.0),
    "cf-ukf": _unscented(CUTOFF_HZ),
    "rts": lambda line: smooth_timeline(line, SETTINGS, "rts"),
    "two-filter": lambda line: smooth_timeline(line, SETTINGS, "two-filter"),
}
_SWEEP: Final[Mapping[tuple[str, float | None], _Method]] = {
    ("ukf", None): _unscented(0.0),
    **{("cf-ukf", hz): _unscented(hz) for hz in _SWEEP_CUTOFF_HZ},
    **{("cf", hz): _complementary(hz) for hz in _SWEEP_COMPLEMENTARY_HZ},
}


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """What a method did over all runs.

    `rms_arcsec` (3,) over all epochs and runs; `mean_arcsec`, `std_arcsec` (3,) of each run's own
    root mean square, as T states them; `nees` is the mean normalised squared attitude error over
    3, which is 1 for a covariance that is right; `drift_rad_s`, `drift_sigma_rad_s` (3,) the mean
    drift at the end and its stated sigma.
    """

    runs: int
    rms_arcsec: FloatArray
    mean_arcsec: FloatArray
    std_arcsec: FloatArray
    nees: float
    drift_rad_s: FloatArray
    drift_sigma_rad_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Chapter3:
    """Result of the experiment; `sweep` holds other cut-offs, by "cf" or "cf-ukf" and Hz."""

    runs: int
    methods: Mapping[str, Scatter]
    bound_arcsec: Mapping[str, FloatArray]
    sweep: Mapping[tuple[str, float | None], Scatter]

    def as_json(self) -> dict[str, object]:
        """Return the contract's keys, and the tables by the thesis's numbers."""
        rts = self.methods["rts"]
        return {
            "runs": self.runs,
            "rms_arcsec": {name: s.rms_arcsec for name, s in self.methods.items()},
            "bound_arcsec": dict(self.bound_arcsec),
            "nees_over_3": {name: s.nees for name, s in self.methods.items()},
            "gyro_parameters": {
                f"bias_{axis}_deg_h": {
                    "truth": 1.0,
                    "mean": float(rts.drift_rad_s[i] / DEG_H_RAD_S),
                    "sigma": float(rts.drift_sigma_rad_s[i] / DEG_H_RAD_S),
                }
                for i, axis in enumerate("xyz")
            },
            "prior": {"star_rad": STAR_SIGMA_RAD, "bias_deg_h": 1.0},
            "finding": self.finding(),
            "tables": {
                **{THESIS[name][0]: [self._row(name)] for name in THESIS},
                "smoothed": [self._row(name) for name in ("rts", "two-filter")],
                "cut-offs": [
                    {
                        "method": name,
                        "cutoff_hz": hz,
                        "runs": s.runs,
                        "rms_arcsec": s.rms_arcsec,
                        "nees_over_3": s.nees,
                    }
                    for (name, hz), s in self.sweep.items()
                ],
            },
        }

    def _row(self, name: str) -> dict[str, object]:
        found, thesis = self.methods[name], THESIS.get(name)
        return {
            "method": name,
            "rms": found.rms_arcsec,
            "bound": self.bound_arcsec[name],
            "mean": found.mean_arcsec,
            "scatter": found.std_arcsec,
            "thesis_mean": None if thesis is None else thesis[1],
            "thesis_scatter": None if thesis is None else thesis[2],
            "nees_over_3": found.nees,
        }

    def finding(self) -> str:
        """Whether the complementary filter in front of the unscented one helps, with figures."""
        plain = float(np.mean(self.sweep["ukf", None].rms_arcsec))
        tried = {
            hz: float(np.mean(s.rms_arcsec))
            for (name, hz), s in self.sweep.items()
            if name == "cf-ukf"
        }
        best = min(tried, key=lambda hz: tried[hz])
        used, alone = self.methods["cf-ukf"], self.methods["ukf"]
        verb = "helps" if tried[best] < 0.98 * plain else "does not help"
        return (
            f"The complementary filter in front of the unscented one {verb}: at its best cut-off, "
            f'{best:g} Hz, {tried[best]:.3f}" beside {plain:.3f}" without it on the same runs; '
            f'over all runs {np.mean(used.rms_arcsec):.3f}" at {CUTOFF_HZ:g} Hz beside '
            f'{np.mean(alone.rms_arcsec):.3f}" and a bound of '
            f'{np.mean(self.bound_arcsec["ukf"]):.3f}". Its squared error is {used.nees:.2f} times '
            f"what its covariance states ({alone.nees:.2f} without it)."
        )


def run(
    runs: int = 1000, seed: int = 3, progress: Callable[[int, int], None] | None = None
) -> Chapter3:
    """Repeat the chapter's experiments over `runs` drawn sets of noise."""
    if runs < 2:
        raise ArgumentError("experiment: at least 2 runs expected")
    place = scene()
    results: dict[str, list[_Result]] = {name: [] for name in METHODS}
    sweep: dict[tuple[str, float | None], list[_Result]] = {key: [] for key in _SWEEP}
    done = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for chunk in simulate(place, DRIFT, runs, np.random.default_rng(seed)):
            truth = chunk.truth_quat_xyzw

            def tried(
                method: _Method, lines: Sequence[Timeline], truth: FloatArray = truth
            ) -> list[_Result]:
                return list(pool.map(lambda line: _result(method(line), truth), lines))

            for name, method in METHODS.items():
                results[name] += tried(method, chunk.timelines)
            for key, method in _SWEEP.items():
                sweep[key] += tried(method, chunk.timelines[: _SWEEP_RUNS - len(sweep[key])])
            done += len(chunk.timelines)
            if progress is not None:
                progress(done, runs)
    return Chapter3(
        runs,
        {name: _scatter(found) for name, found in results.items()},
        bounds(),
        {key: _scatter(found) for key, found in sweep.items()},
    )


def scene() -> Scene:
    """T table 3.1."""
    return Scene(
        lambda t: np.broadcast_to(np.radians([0.5, 0.0, 0.0]), (*np.shape(t), 3)),
        np.arange(round(SPAN_S * 10) + 1) / 10.0,
        np.arange(round(SPAN_S * 4) + 1) / 4.0,
        NOISE,
        STAR_SIGMA_RAD,
    )


def bounds() -> dict[str, FloatArray]:
    """Root mean square (3,) in arcsec of the optimal estimate, forward and smoothed.

    All forward methods share one bound, both smoothers the other.
    """
    clean = without_noise(scene(), DRIFT)
    forward, smoothed = bound_rms_rad(clean, SETTINGS, DRIFT.bias_rad_s)
    return {
        name: (smoothed if name in ("rts", "two-filter") else forward) / ARCSEC_RAD
        for name in METHODS
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Result:
    """One run: RMS error (3,) in rad, mean NEES over 3, last drift and its sigma (3,)."""

    rms_rad: FloatArray
    nees: float
    drift_rad_s: FloatArray
    drift_sigma_rad_s: FloatArray


def _result(done: ForwardPass, truth_xyzw: FloatArray) -> _Result:
    conjugate = done.quat_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
    off = quat_product_xyzw(conjugate, truth_xyzw)
    # The vector part is half the small rotation vector, to 1e-15 at these errors.
    error = 2.0 * off[:, :3] * np.sign(off[:, 3:])
    rows = slice(_NEES_EVERY, None, _NEES_EVERY)
    solved = np.linalg.solve(done.covariance[rows, :3, :3], error[rows, :, None])[..., 0]
    return _Result(
        np.sqrt(np.mean(error**2, axis=0)),
        float(np.mean(np.sum(error[rows] * solved, axis=1)) / 3.0),
        done.rest[-1, :3].copy(),
        np.sqrt(np.diag(done.covariance[-1])[3:6]),
    )


def _scatter(results: Sequence[_Result]) -> Scatter:
    rms = np.array([result.rms_rad for result in results]) / ARCSEC_RAD
    return Scatter(
        len(results),
        np.sqrt(np.mean(rms**2, axis=0)),
        np.mean(rms, axis=0),
        np.std(rms, axis=0, ddof=1),
        float(np.mean([result.nees for result in results])),
        np.mean([result.drift_rad_s for result in results], axis=0),
        results[-1].drift_sigma_rad_s,
    )
