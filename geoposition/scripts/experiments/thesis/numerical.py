"""T tables 5.2–5.4 by Monte Carlo: the same draws through raw, fused and true attitude.

Each run has its own random stream, so that what a run does depends neither on how many there are
nor on which process makes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.adjust import Block
from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.experiments.thesis.control import (
    BIAS_MODELS,
    POINTS,
    BiasModel,
    Errors,
    Layout,
    Limit,
    bias_blocks,
    compensate,
    errors_of,
    layout,
    measured_models,
    measured_points,
    predicted,
)
from geoposition.scripts.experiments.thesis.fusion import Kind, three_attitudes
from geoposition.scripts.experiments.thesis.scene import Scene, common_ground, zy3_scene
from geoposition.scripts.experiments.thesis.telemetry import (
    STAR_SIGMA_RAD,
    Instruments,
    draw,
    zy3_heads,
)
from geoposition.scripts.processes import cores, process_pool
from geoposition.sensors.simulate import ARCSEC_RAD, zy3_cameras

BIAS_MODEL: Final[BiasModel] = "constant"
"""Of the tables: T (2.8) without its linear and quadratic terms, which cost more than they mend."""
OTHERS_SHARE: Final = 4
"""The other bias models are tried in every fourth part of the runs: the first ones."""

_CHUNK: Final = 5
_PROBES: Final = 41


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeErrors:
    """Attitude error over an image, arcsec, roll, pitch, yaw: its mean, and how it wanders.

    Each (images, 3): the mean over the image, and the standard deviation about it.
    """

    mean_arcsec: FloatArray
    wander_arcsec: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """One run: check points' errors and attitude errors by attitude, errors of other models."""

    errors: Mapping[Kind, Errors]
    attitude: Mapping[Kind, AttitudeErrors]
    others: Mapping[tuple[Kind, BiasModel], Errors]


@dataclass(frozen=True, slots=True, eq=False)
class Numerical:
    """All runs, in their order, and what image noise alone would leave.

    `limits` by bias model for the pair, `three_line` with the nadir image too.
    """

    runs: tuple[RunResult, ...]
    plan: Layout
    limits: Mapping[BiasModel, Limit]
    three_line: Limit


@dataclass(frozen=True, slots=True, eq=False)
class _Chunk:
    seed: int
    runs: range
    others: int
    plan: Layout


@dataclass(frozen=True, slots=True, eq=False)
class _Setting:
    plan: Layout
    limits: Mapping[BiasModel, Limit]
    three_line: Limit


def simulate(
    runs: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
    processes: int | None = None,
) -> Numerical:
    """Run all `runs` on `processes` processes (as many as there are processors)."""
    with process_pool(min(processes or cores(), -(-runs // _CHUNK))) as pool:
        setting = pool.submit(_setting, seed).result()
        others = max(runs // OTHERS_SHARE, 1)
        chunks = [
            _Chunk(seed, range(low, min(low + _CHUNK, runs)), others, setting.plan)
            for low in range(0, runs, _CHUNK)
        ]
        done: dict[int, RunResult] = {}
        for task in as_completed([pool.submit(_run_chunk, chunk) for chunk in chunks]):
            done |= task.result()
            if progress is not None:
                progress(len(done), runs)
    return Numerical(
        tuple(done[k] for k in range(runs)), setting.plan, setting.limits, setting.three_line
    )


def pair_scene(seed: int) -> Scene:
    """ZY-3's forward and backward camera, T's stereo pair."""
    forward, _, backward = zy3_cameras()
    return zy3_scene((forward, backward), seed)


def instruments() -> Instruments:
    """One star head and the gyro, as T 5.2.2 fuses them."""
    return Instruments(heads=zy3_heads(STAR_SIGMA_RAD)[:1])


def one_run(scene: Scene, plan: Layout, random: np.random.SeedSequence, others: bool) -> RunResult:
    """Measure once, compensate with each attitude."""
    flight, survey = random.spawn(2)
    flown = instruments()
    telemetry = draw(scene, flown, flight)
    points = measured_points(scene, plan, survey)
    errors: dict[Kind, Errors] = {}
    attitudes: dict[Kind, AttitudeErrors] = {}
    more: dict[tuple[Kind, BiasModel], Errors] = {}
    for kind, attitude in three_attitudes(scene, telemetry, flown).items():
        models = measured_models(scene, telemetry, attitude)
        attitudes[kind] = attitude_errors(scene, attitude)
        for bias in BIAS_MODELS:
            if bias != BIAS_MODEL and not others:
                continue
            if bias == "process" and attitude.lag_one_rad2 is None:
                continue
            done = compensate(models, _blocks(scene, models, bias), points, plan)
            found = errors_of(done, points)
            if bias == BIAS_MODEL:
                errors[kind] = found
            if others:
                more[kind, bias] = found
    return RunResult(errors, attitudes, more)


def attitude_errors(scene: Scene, attitude: Attitude) -> AttitudeErrors:
    """Errors of an attitude over the scene's images."""
    means, wanders = [], []
    for name, model in scene.models.items():
        times = np.linspace(*scene.image_span_s(name), _PROBES)
        off = (attitude.rotation(times).inv() * model.attitude.rotation(times)).as_rotvec()
        means.append(off.mean(axis=0) / ARCSEC_RAD)
        wanders.append(off.std(axis=0) / ARCSEC_RAD)
    return AttitudeErrors(np.array(means), np.array(wanders))


def _blocks(scene: Scene, models: Sequence[PushbroomModel], kind: BiasModel) -> list[Block]:
    return bias_blocks(models, list(scene.models), kind)


def _setting(seed: int) -> _Setting:
    """Choose the control, and say what image noise alone will leave."""
    scene = pair_scene(seed)
    plan = layout(scene, common_ground(scene, POINTS, np.random.default_rng([seed, 1])))
    models = list(scene.models.values())
    limits: dict[BiasModel, Limit] = {
        model: predicted(scene, plan, _blocks(scene, models, model))
        for model in BIAS_MODELS
        if model != "process"
    }
    three = zy3_scene(zy3_cameras(), seed)
    blocks = _blocks(three, list(three.models.values()), BIAS_MODEL)
    return _Setting(plan, limits, predicted(three, plan, blocks))


def _run_chunk(chunk: _Chunk) -> dict[int, RunResult]:
    scene = pair_scene(chunk.seed)
    streams = np.random.SeedSequence([chunk.seed, 2]).spawn(chunk.runs.stop)
    return {k: one_run(scene, chunk.plan, streams[k], k < chunk.others) for k in chunk.runs}
