"""One scene from its telemetry to steady images, each step by what its command runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.raster_files import opened_image
from geoposition.scripts.attitude import fusion as attitude_fusion
from geoposition.scripts.attitude import jitter as attitude_jitter
from geoposition.scripts.attitude.input import Sources
from geoposition.scripts.experiments.jitter import files, truth
from geoposition.scripts.experiments.jitter.cases import Case
from geoposition.scripts.experiments.jitter.ground import Ground
from geoposition.scripts.experiments.jitter.scene import Sighting
from geoposition.scripts.reimage import run as reimage_run
from geoposition.scripts.reimage.input import AttitudeInput, jittered_model
from geoposition.scripts.results import unseen
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.jitter.lines import Jitter
from geoposition.sensors.attitude_determination.signal.low_pass import low_pass
from geoposition.sensors.readers import open_product

_FIGURE_S: Final = 0.1
_FIGURE_HZ: Final = 100.0
_SLOW_HZ: Final = 5.0
"""P figure 3 shows jitter without what is slower."""


@dataclass(frozen=True, slots=True, eq=False)
class FilterCourse:
    """Fused attitude and drift over the telemetry, and their errors: P figures 5 to 7."""

    times_s: FloatArray
    error_rad: FloatArray
    sigma_rad: FloatArray
    drift_rad_s: FloatArray
    drift_sigma_rad_s: FloatArray
    true_drift_rad_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SceneResult:
    """What came of one scene; `before` and `after` are the summaries of the two re-imagings.

    `shaken_s`, `shaken_rad` (n, 3) are the jitter's angles over a tenth of a second, `fused_sigma`
    (3,) the standard deviations of the fused attitude in the image's middle, rad.
    """

    case: Case
    folder: Path
    fusion: dict[str, object]
    jitter: Jitter
    shaken_s: FloatArray
    shaken_rad: FloatArray
    peak_rad: FloatArray
    course: FilterCourse
    fused_sigma_rad: FloatArray
    before: dict[str, Any]
    after: dict[str, Any]
    error_before: truth.TrueError
    error_after: truth.TrueError
    mapping_error: truth.TrueError
    told: truth.Telemetry


def run_scene(
    sighting: Sighting, true: PushbroomModel, ground: Ground, folder: Path
) -> SceneResult:
    """Write the scene's telemetry and image, fuse, find the jitter, make both steady images."""
    case = sighting.case
    telemetry = folder / "telemetry"
    files.write_telemetry(sighting, telemetry)
    image = folder / "image.tif"
    files.write_models(sighting, true, folder, image)
    files.write_image(image, case, true, ground, unseen)
    fused = fuse(sighting, telemetry, folder / "fused.csv")
    jitter, _ = attitude_jitter.search(_search(telemetry))
    before = _reimaged(folder, ground, None, "before")
    attitude = AttitudeInput(folder / "fused.csv")
    after = _reimaged(folder, ground, attitude, "after")
    errors = [
        _steady_error(folder, name, source, true, ground)
        for name, source in (("before", None), ("after", attitude))
    ]
    shaken_s, shaken_rad, peak_rad = _shaken(jitter)
    return SceneResult(
        case=case,
        folder=folder,
        fusion=fused.summary,
        jitter=jitter,
        shaken_s=shaken_s,
        shaken_rad=shaken_rad,
        peak_rad=peak_rad,
        course=_course(sighting, fused.estimate),
        fused_sigma_rad=_sigma_at(fused.asked, 0.0),
        before=before,
        after=after,
        error_before=errors[0],
        error_after=errors[1],
        mapping_error=truth.mapping_error(true, ground.terrain),
        told=_told(sighting),
    )


def fuse(sighting: Sighting, telemetry: Path, output: Path) -> attitude_fusion.FusionRun:
    """Fuse stars and increments as `attitude fuse` does, at the epochs of `times.csv`."""
    noise = sighting.scene.options.sensor_noise
    sources = Sources(
        star=telemetry / "star.csv",
        gyro=telemetry / "displacement.csv",
        mounting=telemetry / "mounting.toml",
    )
    options = attitude_fusion.Options(
        method="rts",
        angle_random_walk=noise.angle_random_walk,
        rate_random_walk=noise.rate_random_walk,
        at=telemetry / "times.csv",
    )
    run = attitude_fusion.fuse(sources, options, unseen)
    attitude_fusion.write(output, run)
    return run


def _search(telemetry: Path) -> attitude_jitter.Request:
    return attitude_jitter.Request(
        sources=Sources(star=telemetry / "displacement.csv"),
        source="inertial",
        gyro=True,
        ephemeris=None,
        ephemeris_frame=None,
        epoch=None,
        lowest_hz=None,
        highest_hz=None,
        false_alarm=1e-3,
        lines=20,
    )


def _reimaged(
    folder: Path,
    ground: Ground,
    attitude: AttitudeInput | None,
    name: str,
) -> dict[str, Any]:
    request = reimage_run.Request(
        image=folder / "image.tif",
        output=folder / name,
        attitude=attitude,
        dem=ground.dem,
        report=False,
    )
    return dict(reimage_run.run(open_product(folder / "onboard.toml"), request, unseen))


def _steady_error(
    folder: Path, name: str, source: AttitudeInput | None, true: PushbroomModel, ground: Ground
) -> truth.TrueError:
    """Error of the steady image in `name`, whose model is read from its file."""
    with opened_image(folder / "image.tif") as image:
        believed = jittered_model(open_product(folder / "onboard.toml"), image, source, None)
    steady = open_product(folder / name / "steady.toml").model
    return truth.steady_error(true, steady, believed, ground.terrain)


def _shaken(jitter: Jitter) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles faster than `_SLOW_HZ`: a tenth of a second of them, and the peaks of all."""
    angles = jitter.angle_rad - low_pass(jitter.times_s, jitter.angle_rad, _SLOW_HZ)
    near = np.abs(jitter.times_s) <= 0.5 * _FIGURE_S
    return jitter.times_s[near], angles[near], np.abs(angles).max(axis=0)


def _course(sighting: Sighting, estimate: AttitudeEstimate) -> FilterCourse:
    step = max(round(sighting.scene.options.sensor_hz / _FIGURE_HZ), 1)
    pick = np.s_[::step]
    times = np.array(estimate.times_s[pick])
    true = sighting.scene.R_inertial_body(times)
    variance = np.einsum("nii->ni", estimate.covariance[pick])
    sigma = np.sqrt(np.maximum(variance, 0.0))
    return FilterCourse(
        times,
        (true.inv() * estimate.R_inertial_body[pick]).as_rotvec(),
        sigma[:, :3],
        np.array(estimate.bias_rad_s[pick]),
        sigma[:, 3:6],
        np.array(sighting.scene.installation.drift_rad_s),
    )


def _sigma_at(estimate: AttitudeEstimate, time_s: float) -> FloatArray:
    return np.array(estimate.sigma_rad[int(np.argmin(np.abs(estimate.times_s - time_s)))])


def _told(sighting: Sighting) -> truth.Telemetry:
    options = sighting.scene.options
    star = sighting.scene.star
    return truth.Telemetry(
        float(np.median(star.sigma_cross_rad)),
        options.star_hz,
        len(star.heads),
        options.sensor_noise.angle_random_walk,
        options.duration_s,
        2.0 * sighting.size.half_s,
    )
