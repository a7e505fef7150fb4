"""A calibration run: scenes matched, the camera calibrated, checked, reported and written."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geoposition.calib_fields.calibrate import calibrate, check_scene
from geoposition.calib_fields.calibration import (
    ARCSEC_RAD,
    Calibration,
    CalibrationOptions,
    CalibrationScene,
    SceneCheck,
)
from geoposition.calib_fields.evaluate import EvaluationOptions
from geoposition.errors import ArgumentError, ProductError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.calibrate.summary import summary_of
from geoposition.scripts.checksums import checksum
from geoposition.scripts.evaluate.run import columns_of
from geoposition.scripts.evaluate.settings import ListedScene, Settings, scenes_of
from geoposition.scripts.known_ground import MatchedScene, matched_scene
from geoposition.scripts.results import Progress, plain
from geoposition.scripts.scratch import publish_folder, scratch_beside
from geoposition.scripts.tables import write_points
from geoposition.sensors.calibrated_camera import line_camera
from geoposition.sensors.readers import open_product
from geoposition.sensors.readers.camera_file import CameraFile, read_camera_file
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.sensors.writers.model_file_camera import write_camera_file

CAMERA_FILE = "camera.toml"
SUMMARY_FILE = "calibration.json"


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """What came out of a run, with what went in."""

    calibration: Calibration
    scenes: tuple[MatchedScene, ...]
    names: tuple[str, ...]
    held_out: tuple[SceneCheck, ...]


def run(
    products: Sequence[Path],
    hold_out: Sequence[Path],
    given: Settings,
    degrees: tuple[int, int],
    output: Path,
    progress: Progress,
) -> dict[str, object]:
    """Calibrate on `products`, check on `hold_out`, write into `output`; facts fit for JSON.

    `degrees` are those of the look angles' polynomials over the samples, and of the attitude
    biases' over time.
    """
    listed = [scene for path in products for scene in scenes_of(path, given)]
    kept = [scene for path in hold_out for scene in scenes_of(path, given)]
    kept += [scene for scene in listed if scene.hold_out]
    used = [scene for scene in listed if not scene.hold_out]
    if not used:
        raise ArgumentError("calibrate: at least one scene that is not held out expected")
    settings = used[0].settings.resolved("calibrate")
    options = CalibrationOptions(
        degree=degrees[0],
        attitude_degree=degrees[1],
        reference_sigma_m=settings.reference_sigma_m or 0.0,
        height_sigma_m=settings.height_sigma_m or 1.0,
    )
    for scene in (*used, *kept):
        _require_rigorous(open_product(scene.product))
    matched = [_matched(scene, progress) for scene in used]
    names = tuple(_names(used))
    scenes = [
        CalibrationScene(name, _require_rigorous(found.product), found.matches)
        for name, found in zip(names, matched, strict=True)
    ]
    done = calibrate(scenes, options)
    with scratch_beside(output) as folder:
        camera = _write_camera(done, matched[0], folder)
        checks = tuple(
            _check(scene, name, camera, progress)
            for scene, name in zip(kept, _names(kept), strict=True)
        )
        result = CalibrationResult(done, tuple(matched), names, checks)
        summary = _fill(folder, result, camera, output)
        publish_folder(folder, output, last=SUMMARY_FILE)
    return summary


def apply_camera(products: Sequence[Path], camera: Path, output: Path) -> dict[str, object]:
    """Write models of `products` with the camera of a camera file; facts fit for JSON."""
    shared = read_camera_file(camera)
    opened = [open_product(path) for path in products]
    models = [shared.applied_to(product.model) for product in opened]
    names = [f"model_{k + 1:02d}.toml" for k in range(len(opened))]
    with scratch_beside(output) as folder:
        for name, product, model in zip(names, opened, models, strict=True):
            write_model_file(
                model, folder / name, sensor=product.sensor, image=product.image_path, home=output
            )
        publish_folder(folder, output, last=names[-1])
    return {
        "camera": str(camera),
        "products": [str(path) for path in products],
        "outputs": [str(output / name) for name in names],
    }


def _names(scenes: Sequence[ListedScene]) -> list[str]:
    """Names for people, told apart where two are alike."""
    plain_names = [str(scene.facts.get("name", scene.product.name)) for scene in scenes]
    if len(set(plain_names)) == len(plain_names):
        return plain_names
    return [f"{name} ({k + 1})" for k, name in enumerate(plain_names)]


def _matched(scene: ListedScene, progress: Progress) -> MatchedScene:
    return matched_scene(scene.product, scene.settings.resolved("calibrate"), progress)


def _require_rigorous(product: Product) -> PushbroomModel:
    if not isinstance(product.model, PushbroomModel):
        raise ProductError(
            product.path, "", "a rigorous model expected: an RPC has no camera to calibrate"
        )
    return product.model


def _check(scene: ListedScene, name: str, camera: CameraFile, progress: Progress) -> SceneCheck:
    found = _matched(scene, progress)
    own = CalibrationScene(name, _require_rigorous(found.product), found.matches)
    options = EvaluationOptions(
        relative="attitude", reference_sigma_m=found.settings.reference_sigma_m or 0.0
    )
    return check_scene(own, camera.applied_to(own.model), options)


def _write_camera(done: Calibration, first: MatchedScene, folder: Path) -> CameraFile:
    """Write the camera file, and read it back: what is checked is what others will use."""
    names = ", ".join(scene.name for scene in done.scenes)
    turn = " ".join(
        f"{v / ARCSEC_RAD:.4f} ({s / ARCSEC_RAD:.2g})"
        for v, s in zip(done.mounting_rad, done.mounting_sigma_rad, strict=True)
    )
    remarks = (
        f"Calibrated on known ground by geoposition, from {done.points} points in {names}.",
        f"Look angles: polynomials of degree {done.options.degree} over each CCD's samples.",
        f"Turn of the mounting, arcsec (standard deviation): {turn}.",
        f"Covariances, correlations and checks are in {SUMMARY_FILE}.",
    )
    path = folder / CAMERA_FILE
    write_camera_file(line_camera(done.camera), path, sensor=first.product.sensor, remarks=remarks)
    return read_camera_file(path)


def _fill(
    folder: Path, result: CalibrationResult, camera: CameraFile, output: Path
) -> dict[str, object]:
    """Write all files into `folder`; facts that name them where they will be, in `output`."""
    from geoposition.scripts.calibrate.report import build_report
    from geoposition.scripts.report import render

    done = result.calibration
    paths = dict.fromkeys(path for found in result.scenes for path in found.inputs)
    inputs = {str(path): checksum(path) for path in paths}
    page = render(build_report(result, inputs))
    names = [CAMERA_FILE]
    for k, (found, adjusted) in enumerate(zip(result.scenes, done.adjustment.models, strict=True)):
        product, number = found.product, f"{k + 1:02d}"
        model = camera.applied_to(product.model)
        write_model_file(
            model,
            folder / f"model_{number}.toml",
            sensor=product.sensor,
            image=found.source.path,
            home=output,
        )
        assert isinstance(adjusted, PushbroomModel)
        compensated = camera.applied_to(adjusted)
        write_model_file(
            compensated,
            folder / f"model_{number}_compensated.toml",
            sensor=product.sensor,
            image=found.source.path,
            home=output,
        )
        write_points(
            folder / f"residuals_{number}.gpkg",
            columns_of(found.matches, done.residual_px[k]),
        )
        names += [
            f"model_{number}.toml",
            f"model_{number}_compensated.toml",
            f"residuals_{number}.gpkg",
        ]
    summary = summary_of(result) | {
        "outputs": [str(output / n) for n in (SUMMARY_FILE, "report.html", *names)],
        "inputs": inputs,
    }
    text = json.dumps(plain(summary), ensure_ascii=False, allow_nan=False, indent=1)
    (folder / "report.html").write_text(page, encoding="utf-8")
    (folder / SUMMARY_FILE).write_text(text, encoding="utf-8")
    return summary
