"""T tables 4.2–4.10: attitude with the general gyro model, filtered and smoothed.

Every table stands beside the thesis's figures and the Cramér–Rao bound for the prior in force
(first star fix 6 arcsec, 0.2 deg/h, 2000 ppm). The tables keep the thesis's one truth for all
runs, so their expectation is not quite the bound, and stands beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.arrays import FloatArray
from geoposition.scripts.experiments.monte_carlo import (
    ARCSEC_RAD,
    DEG_H_RAD_S,
    Runs,
    Scene,
    backward,
    backward_timeline,
    simulate,
    without_noise,
)
from geoposition.scripts.experiments.thesis_tables import (
    ConsistencyRow,
    ParameterRow,
    RmsRow,
    ThesisCh4,
    apart,
    parameter_rows,
    parameter_vector,
    rms_row,
)
from geoposition.sensors.attitude_determination.graph import factor_graph
from geoposition.sensors.attitude_determination.monte_carlo.batch import (
    BatchMethod,
    BatchResult,
    run_batch,
)
from geoposition.sensors.attitude_determination.monte_carlo.bound import (
    bound_rms_rad,
    expected_rms_rad,
)
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.gyro import draw_parameters
from geoposition.sensors.telemetry import GyroNoise, GyroParameters

SPAN_S: Final = 5400.0
NOISE: Final = GyroNoise(np.sqrt(10.0) * 1e-7, np.sqrt(10.0) * 1e-10)
SIGMA_RAD: Final = 6.0 * ARCSEC_RAD
BIAS_SIGMA_RAD_S: Final = 0.2 * DEG_H_RAD_S
GENERAL: Final = FusionSettings(NOISE, "general", BIAS_SIGMA_RAD_S, 2e-3, 2e-3)
SIMPLE: Final = FusionSettings(NOISE, "bias", BIAS_SIGMA_RAD_S)

_BIAS: Final = (0.1 * DEG_H_RAD_S,) * 3
TRUTH: Final = GyroParameters.of(
    _BIAS, (1500e-6, 1000e-6, 1500e-6), (1000e-6, 1500e-6, 2000e-6), (500e-6, 1000e-6, 1500e-6)
)
"""T table 4.1."""
BIAS_ONLY: Final = GyroParameters.of(_BIAS)


_METHODS: Final[tuple[BatchMethod, ...]] = ("ekf", "rts", "two-filter")
_NAMES: Final = {"ekf": "ekf-15", "rts": "rts", "two-filter": "two-filter"}


def turning(t: FloatArray) -> FloatArray:
    """Body rate (..., 3) in rad/s at times (...). *Source*: T 4.2.1."""
    waves = np.stack([np.sin(0.01 * t), np.sin(0.002 * t), np.cos(0.001 * t)], axis=-1)
    return np.asarray(np.radians(0.1) * waves)


def steady(t: FloatArray) -> FloatArray:
    """Body rate (..., 3) of T table 4.7."""
    return np.full((*np.shape(t), 3), np.radians(0.1) * 0.1)


def scene(rate: Callable[[FloatArray], FloatArray] = turning, span_s: float = SPAN_S) -> Scene:
    """T table 4.1: gyro and star sensor at 1 Hz."""
    times = np.arange(span_s + 0.5)
    return Scene(rate, times, times, NOISE, SIGMA_RAD)


def run(
    runs: int = 1000,
    seed: int = 4,
    graph_runs: int = 50,
    progress: Callable[[int, int], None] | None = None,
) -> ThesisCh4:
    """Make all tables from `runs` runs; the factor graph from the first `graph_runs` of them."""
    work = _Progress(progress, 4 * runs + max(runs // 5, 1))
    rng = np.random.default_rng(seed)
    main = _main(runs, graph_runs, rng, work)
    rows, parameters, agreement = main
    rows += _pair("4.6", turning, BIAS_ONLY, runs, rng, work)
    rows += _pair("4.7", steady, TRUTH, runs, rng, work)
    consistency = _consistency(max(runs // 5, 1), rng, work)
    return ThesisCh4(runs, tuple(rows), tuple(parameters), tuple(consistency), agreement)


class _Progress:
    def __init__(self, report: Callable[[int, int], None] | None, total: int):
        self.report, self.total, self.done = report, total, 0

    def __call__(self, more: int) -> None:
        self.done += more
        if self.report is not None:
            self.report(min(self.done, self.total), self.total)


def _main(
    runs: int, graph_runs: int, rng: np.random.Generator, work: _Progress
) -> tuple[list[RmsRow], list[ParameterRow], dict[str, float]]:
    """Tables 4.2–4.5 and 4.8–4.10: one scene, all methods on the same data."""
    place = scene()
    truth = parameter_vector(TRUTH)
    clean = without_noise(place, TRUTH)
    forward, smoothed = bound_rms_rad(clean, GENERAL, truth)
    expected = expected_rms_rad(clean, GENERAL, truth)
    reverse, mirrored = backward_timeline(clean), truth * np.repeat([-1.0, 1.0], (3, 9))
    back_bound = (
        expected_rms_rad(reverse, GENERAL, mirrored),
        bound_rms_rad(reverse, GENERAL, mirrored)[0],
    )
    gathered: dict[str, list[BatchResult]] = {
        name: [] for name in ("ekf", "rts", "two-filter", "back")
    }
    graph: list[FloatArray] = []
    simple: list[FloatArray] = []
    drifts: list[FloatArray] = []
    for chunk in simulate(place, TRUTH, runs, rng):
        drifts.append(chunk.bias_rad_s[:, -1] - TRUTH.bias_rad_s)
        for name in _METHODS:
            gathered[name].append(_estimate(chunk, GENERAL, name))
        gathered["back"].append(_estimate(backward(chunk), GENERAL, "ekf"))
        simple.append(_estimate(chunk, SIMPLE, "ekf").rms_rad)
        for star, gyro in chunk.series[: max(graph_runs - len(graph), 0)]:
            estimate = factor_graph.smooth(star, gyro, GENERAL)
            error = estimate.error_rad(Rotation.from_quat(chunk.truth_quat_xyzw))
            graph.append(np.sqrt(np.mean(error**2, axis=0)))
        work(2 * len(chunk.timelines))
    drift = np.concatenate(drifts)
    rms = {name: np.concatenate([part.rms_rad for part in got]) for name, got in gathered.items()}
    rows = [
        rms_row("4.3", "ekf-15", rms["ekf"], expected, forward),
        rms_row("4.5", "rts", rms["rts"], smoothed, smoothed),
        rms_row("4.9", "backward ekf-15", rms["back"], *back_bound),
        rms_row("4.10", "two-filter", rms["two-filter"], smoothed, smoothed),
        rms_row("4.2.1 text", "ekf-6", np.concatenate(simple), None, None),
    ]
    agreement = {"two-filter/rts": apart(rms["two-filter"], rms["rts"])}
    if graph:
        rows.append(rms_row("graph", "graph", np.array(graph), smoothed, smoothed))
        agreement["graph/rts"] = apart(np.array(graph), rms["rts"][: len(graph)])
    ends = truth + np.concatenate([drift, np.zeros((len(drift), 9))], axis=1)
    parameters = [
        *parameter_rows("4.2", [part.last for part in gathered["ekf"]], ends),
        *parameter_rows("4.4", [part.first for part in gathered["rts"]], truth),
        *parameter_rows("4.8", [part.first for part in gathered["two-filter"]], truth),
    ]
    return rows, parameters, agreement


def _pair(
    table: str,
    rate: Callable[[FloatArray], FloatArray],
    parameters: GyroParameters,
    runs: int,
    rng: np.random.Generator,
    work: _Progress,
) -> list[RmsRow]:
    """Table 4.6 or 4.7: the general and the simple gyro model beside each other."""
    place, truth = scene(rate), parameter_vector(parameters)
    clean = without_noise(place, parameters)
    general: list[FloatArray] = []
    simple: list[FloatArray] = []
    smoothed: list[FloatArray] = []
    for chunk in simulate(place, parameters, runs, rng):
        general.append(_estimate(chunk, GENERAL, "ekf").rms_rad)
        simple.append(_estimate(chunk, SIMPLE, "ekf").rms_rad)
        smoothed.append(_estimate(chunk, SIMPLE, "rts").rms_rad)
        work(len(chunk.timelines))
    bound, _ = bound_rms_rad(clean, GENERAL, truth)
    expected = expected_rms_rad(clean, GENERAL, truth)
    rows = [rms_row(table, "ekf-15", np.concatenate(general), expected, bound)]
    # At a steady rate, scale and misalignment are one more bias, beside the prior of the drift.
    plain = np.mean(clean.turn_rad / clean.step_s[:, None], axis=0) - rate(np.zeros(()))
    offset = plain if rate is steady else truth[:3]
    forward, after = bound_rms_rad(clean, SIMPLE, truth[:3])
    expected = expected_rms_rad(clean, SIMPLE, offset)
    rows.append(rms_row(table, "ekf-6", np.concatenate(simple), expected, forward))
    rows.append(rms_row(f"{table} smoothed", "rts-6", np.concatenate(smoothed), after, after))
    return rows


def _consistency(runs: int, rng: np.random.Generator, work: _Progress) -> list[ConsistencyRow]:
    place = scene(span_s=900.0)
    drawn = draw_parameters(rng, runs, BIAS_SIGMA_RAD_S, 2e-3, 2e-3)
    constants = np.concatenate([drawn.scale, drawn.upper, drawn.lower], axis=1)
    found: dict[str, list[FloatArray]] = {}
    done = 0
    for chunk in simulate(place, drawn, runs, rng):
        count = len(chunk.timelines)
        rows = slice(done, done + count)
        for name in _METHODS:
            result = _estimate(chunk, GENERAL, name)
            knot = -1 if name == "ekf" else len(chunk.truth_quat_xyzw) // 2
            probe = result.last if name == "ekf" else result.middle
            rest = np.concatenate([chunk.bias_rad_s[:, knot], constants[rows]], axis=1)
            nees = probe.nees(chunk.truth_quat_xyzw[knot], rest)
            found.setdefault(f"NEES of {_NAMES[name]}", []).append(nees)
            if name == "ekf":
                found.setdefault("NIS of ekf-15", []).append(result.nis)
        done += count
        work(count)
    table = []
    for what, parts in found.items():
        samples = runs * (len(place.star_times_s) - 1) if what == "NIS of ekf-15" else runs
        freedom = 3 if what == "NIS of ekf-15" else 15
        low, high = chi2.ppf([0.025, 0.975], freedom * samples) / samples
        mean = float(np.mean(np.concatenate(parts)))
        table.append(ConsistencyRow(what, runs, mean, (float(low), float(high))))
    return table


def _estimate(chunk: Runs, settings: FusionSettings, method: BatchMethod) -> BatchResult:
    return run_batch(chunk.timelines, chunk.truth_quat_xyzw, settings, method)
