"""Telemetry tables to the fused attitude, by what the `attitude` commands call."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.scripts.attitude import cleaning as attitude_cleaning
from geoposition.scripts.attitude import fusion as attitude_fusion
from geoposition.scripts.attitude import jitter as attitude_jitter
from geoposition.scripts.attitude.checks import measure_axis_angles
from geoposition.scripts.attitude.input import Sources, load
from geoposition.scripts.experiments.thesis.fusion import MISALIGNMENT_SIGMA
from geoposition.scripts.experiments.thesis.scene import Scene
from geoposition.scripts.experiments.thesis.telemetry import Instruments
from geoposition.scripts.results import unseen
from geoposition.scripts.tables import write_table
from geoposition.sensors.attitude_determination.jitter.lines import Jitter
from geoposition.sensors.attitude_determination.settings import GyroModel
from geoposition.sensors.simulate import ARCSEC_RAD

METHODS: Final = ("ekf", "rts", "two-filter", "graph")
GYRO_MODELS: Final[tuple[GyroModel, ...]] = ("bias", "general")
CHOSEN: Final = ("two-filter", "general")
"""T table 5.1."""
HEAD: Final = "star-2"

_PPM: Final = 1e6


@dataclass(frozen=True, slots=True)
class FusionRow:
    """One way to fuse: RMS errors about roll, pitch, yaw over all epochs, and while imaging.

    `stated_arcsec` is the mean of its own standard deviations.
    """

    method: str
    gyro_model: str
    rms_arcsec: tuple[float, ...]
    imaging_arcsec: tuple[float, ...]
    stated_arcsec: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeChain:
    """What became of the telemetry; `fused` is what the images are located with."""

    cleaning: Mapping[str, Any]
    axis_angle: Mapping[str, Any]
    fused_axis_angle: Mapping[str, Any]
    fusions: tuple[FusionRow, ...]
    fused: attitude_fusion.FusionRun
    jitter: Jitter
    jitter_facts: Mapping[str, Any]
    gyro_jitter_facts: Mapping[str, Any]
    gyro_parameters_ppm: Mapping[str, Mapping[str, float]]

    def as_json(self) -> dict[str, Any]:
        """Figures by name."""
        return {
            "preprocess": self.cleaning,
            "axis_angle": self.axis_angle["pairs"],
            "axis_angle_fused": self.fused_axis_angle["pairs"],
            "fusion": [asdict(row) for row in self.fusions],
            "jitter": self.jitter_facts["axes"],
            "jitter_of_gyro": self.gyro_jitter_facts["axes"],
            "gyro_parameters_ppm": self.gyro_parameters_ppm,
        }


def run_attitude(
    scene: Scene, folder: Path, flown: Instruments, step: Callable[[], None]
) -> AttitudeChain:
    """Clean, check, fuse in all ways, look for jitter; all tables land in `folder`."""
    raw, star = folder / "star_raw.csv", folder / "star.csv"
    found = attitude_cleaning.clean(raw, None, None, 5.0, None, 2, None, 1)
    write_table(star, attitude_cleaning.columns(found))
    sources = Sources(star, folder / "gyro.csv", folder / "mounting.toml", sensors=(HEAD,))
    heads = Sources(star, mounting=folder / "mounting.toml")
    angles = measure_axis_angles(heads, False, None)
    step()
    (folder / "attitude").mkdir(exist_ok=True)
    rows, chosen = [], None
    for model in GYRO_MODELS:
        for method in METHODS:
            run = attitude_fusion.fuse(sources, _options(flown, method, model), unseen)
            attitude_fusion.write(folder / "attitude" / f"fused-{method}-{model}.csv", run)
            rows.append(_row(scene, run))
            if (method, model) == CHOSEN:
                chosen = run
            step()
    assert chosen is not None
    fused = folder / "fused.csv"
    attitude_fusion.write(fused, chosen)
    smooth = _smoothed_angles(folder, sources, _options(flown, *CHOSEN))
    jitter, facts = _jitter(Sources(fused), scene, folder / "ephemeris.csv")
    _, of_gyro = _jitter(Sources(folder / "gyro.csv"), scene, None)
    write_table(folder / "jitter.csv", attitude_jitter.columns(jitter))
    step()
    return AttitudeChain(
        attitude_cleaning.summary(found),
        angles.summary(),
        smooth,
        tuple(rows),
        chosen,
        jitter,
        facts,
        of_gyro,
        _gyro_parameters_ppm(flown, chosen),
    )


def _gyro_parameters_ppm(
    flown: Instruments, run: attitude_fusion.FusionRun
) -> dict[str, dict[str, float]]:
    """Scale factors and misalignments: planted, found, and the sigma stated. *Source*: T 5.7."""
    found: Any = run.summary["parameters_ppm"]
    return {
        f"{kind}_{i + 1}": {"truth": _PPM * float(value), **found[f"{kind}_{i + 1}"]}
        for kind in ("scale", "upper", "lower")
        for i, value in enumerate(getattr(flown.gyro_errors, kind))
    }


def _options(flown: Instruments, method: str, model: GyroModel) -> attitude_fusion.Options:
    return attitude_fusion.Options(
        method=method,
        gyro_model=model,
        angle_random_walk=flown.gyro_noise.angle_random_walk,
        rate_random_walk=flown.gyro_noise.rate_random_walk,
        bias_sigma_deg_h=flown.bias_sigma_rad_s / attitude_fusion.DEG_H,
        scale_sigma_ppm=MISALIGNMENT_SIGMA * _PPM,
        misalignment_sigma_ppm=MISALIGNMENT_SIGMA * _PPM,
    )


def _row(scene: Scene, run: attitude_fusion.FusionRun) -> FusionRow:
    estimate = run.estimate
    times = estimate.times_s
    off = estimate.error_rad(scene.motion.R_inertial_body(times)) / ARCSEC_RAD
    imaging = np.zeros(len(times), dtype=np.bool_)
    for name in scene.models:
        low, high = scene.image_span_s(name)
        imaging |= (times >= low) & (times <= high)

    def axes(values: FloatArray) -> tuple[float, ...]:
        return tuple(float(value) for value in values)

    return FusionRow(
        run.options.method,
        run.options.gyro_model,
        axes(np.sqrt(np.mean(off**2, axis=0))),
        axes(np.sqrt(np.mean(off[imaging] ** 2, axis=0))),
        axes(np.mean(estimate.sigma_rad, axis=0) / ARCSEC_RAD),
    )


def _smoothed_angles(
    folder: Path, sources: Sources, options: attitude_fusion.Options
) -> Mapping[str, Any]:
    """Angle between the fused axis of head 2 and the other head as measured. *Source*: T 5.2.2."""
    table, epochs = folder / "star_fused.csv", folder / "star_epochs.csv"
    run = attitude_fusion.fuse(sources, options, unseen)
    star = load(replace(sources, sensors=None)).star
    rows = (star.head != star.heads.index(HEAD)) & (star.times_s <= run.estimate.times_s[-1])
    rows &= star.times_s >= run.estimate.times_s[0]
    other = star.where(rows)
    write_table(epochs, {"t_s": np.asarray(other.times_s)})
    at = attitude_fusion.fuse(sources, replace(options, at=epochs), unseen).asked
    body = at.R_inertial_body * run.telemetry.mounting.rotation(HEAD)
    names = [HEAD, star.heads[int(other.head[0])]]
    quats = np.stack([body.as_quat(), other.quat_xyzw], axis=1).reshape(-1, 4)
    columns = {
        "t_s": np.repeat(other.times_s, 2),
        "sensor": np.tile(np.array(names, dtype=np.str_), len(other)),
        **{f"q_{name}": quats[:, k] for k, name in enumerate("xyzw")},
    }
    write_table(table, columns)
    return measure_axis_angles(Sources(table), False, None).summary()


def _jitter(
    sources: Sources, scene: Scene, ephemeris: Path | None
) -> tuple[Jitter, dict[str, object]]:
    return attitude_jitter.search(
        attitude_jitter.Request(
            sources,
            "inertial",
            ephemeris is None,
            ephemeris,
            None,
            scene.epoch,
            None,
            None,
            1e-3,
            20,
        )
    )
