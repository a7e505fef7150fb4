"""An evaluation run: one scene or a list, matched, evaluated, reported, written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.calib_fields.dom import Dom
from geoposition.calib_fields.evaluate import Evaluation, EvaluationOptions, evaluate
from geoposition.calib_fields.heights import HeightAccuracy
from geoposition.calib_fields.match import Cause, DomMatches
from geoposition.calib_fields.relative import RELATIVES
from geoposition.errors import ArgumentError
from geoposition.matching import ImageSource
from geoposition.product import Product
from geoposition.scripts.checksums import checksum
from geoposition.scripts.evaluate.heights import height_accuracy
from geoposition.scripts.evaluate.settings import ListedScene, Settings, scenes_of
from geoposition.scripts.known_ground import matched_scene
from geoposition.scripts.results import Progress, plain
from geoposition.scripts.scene_coverage import coverage
from geoposition.scripts.scratch import publish_folder, scratch_beside
from geoposition.scripts.tables import write_points

__all__ = ["SceneResult", "Settings", "coverage", "evaluate_scene", "run", "write_results"]


@dataclass(frozen=True, slots=True, eq=False)
class SceneResult:
    """One scene: what is known of it, what went in, and what came out."""

    facts: Mapping[str, object]
    product: Product
    source: ImageSource
    dom: Dom
    settings: Settings
    terrain_facts: tuple[str, ...]
    evaluation: Evaluation
    inputs: tuple[Path, ...] = ()
    heights: HeightAccuracy | None = None


def run(path: Path, given: Settings, output: Path, progress: Progress) -> dict[str, object]:
    """Evaluate the product or the list at `path`, write into `output`; facts fit for JSON."""
    return write_results(
        [evaluate_scene(scene, progress) for scene in scenes_of(path, given)], output
    )


def evaluate_scene(scene: ListedScene, progress: Progress) -> SceneResult:
    """Match and evaluate one scene."""
    settings = scene.settings.resolved()
    if settings.relative not in RELATIVES:
        raise ArgumentError(
            f"--relative: one of {', '.join(RELATIVES)} expected, got {settings.relative!r}"
        )
    options = EvaluationOptions(
        relative=settings.relative,  # type: ignore[arg-type]
        reference_sigma_m=settings.reference_sigma_m or 0.0,
        line_period_s=settings.line_period_s,
    )
    found = matched_scene(scene.product, settings, progress)
    heights = None
    if settings.points is not None:
        heights = height_accuracy(settings.points, found.terrain, settings.height_sigma_m or 0.0)
    return SceneResult(
        scene.facts,
        found.product,
        found.source,
        found.dom,
        settings,
        found.terrain.provenance,
        evaluate(found.matches, found.product.model, options),
        tuple(found.inputs),
        heights,
    )


def write_results(results: Sequence[SceneResult], output: Path) -> dict[str, object]:
    """Write evaluation.json, report.html and the matches into `output`; facts fit for JSON."""
    from geoposition.scripts.evaluate.report import build_report
    from geoposition.scripts.report import render

    paths = dict.fromkeys(path for result in results for path in result.inputs)
    inputs = {str(path): checksum(path) for path in paths}
    summaries = [_summary(result) for result in results]
    summary: dict[str, object] = (
        summaries[0] if len(summaries) == 1 else {"scenes": summaries}
    ) | {"inputs": inputs}
    page = render(build_report(results, inputs))
    names = [f"matches_{k + 1:02d}.gpkg" for k in range(len(results))]
    if len(names) == 1:
        names = ["matches.gpkg"]
    summary["outputs"] = [str(output / name) for name in ("evaluation.json", "report.html", *names)]
    text = json.dumps(plain(summary), ensure_ascii=False, allow_nan=False, indent=1)
    with scratch_beside(output) as folder:
        for name, result in zip(names, results, strict=True):
            found = result.evaluation
            write_points(folder / name, columns_of(found.matches, found.residual_px))
        (folder / "report.html").write_text(page, encoding="utf-8")
        (folder / "evaluation.json").write_text(text, encoding="utf-8")
        publish_folder(folder, output, last="evaluation.json")
    return summary


def _summary(result: SceneResult) -> dict[str, object]:
    found = result.evaluation
    return (
        dict(result.facts)
        | found.as_dict()
        | ({} if result.heights is None else result.heights.as_dict())
        | {
            "product": str(result.product.path),
            "image": str(result.source.path),
            "dom": [str(path) for path in result.dom.paths],
            "heights": list(result.terrain_facts),
            "coverage": coverage(found.matches),
            "pixel_m": found.matches.pixel_m,
            "ground_sample_m": list(found.matches.ground_sample_m),
            "window_px": found.matches.window_px,
            "spacing_px": found.matches.spacing_px,
        }
    )


def columns_of(m: DomMatches, residual_px: FloatArray) -> dict[str, Any]:
    """Every patch as a row, those that were lost with their cause; residuals of used ones."""
    names = np.array([cause.name.lower() for cause in Cause])
    lon_lat = np.degrees(m.ground[:, :2])
    sigma = np.sqrt(np.diagonal(m.covariance_px2, axis1=1, axis2=2))
    sigma_m = np.sqrt(np.diagonal(m.covariance_m2, axis1=1, axis2=2))
    residual = np.full((len(m.cause), 2), np.nan)
    residual[m.used & np.isfinite(m.error_px).all(axis=1)] = residual_px
    return {
        "id": np.arange(len(m.cause)).astype(str),
        "lon": lon_lat[:, 0],
        "lat": lon_lat[:, 1],
        "height": m.ground[:, 2],
        "row": m.image_px[:, 0],
        "col": m.image_px[:, 1],
        "model_row": m.model_px[:, 0],
        "model_col": m.model_px[:, 1],
        "error_row_px": m.error_px[:, 0],
        "error_col_px": m.error_px[:, 1],
        "residual_x_px": residual[:, 0],
        "residual_y_px": residual[:, 1],
        "sigma_row_px": sigma[:, 0],
        "sigma_col_px": sigma[:, 1],
        "shift_e_m": m.shift_en_m[:, 0],
        "shift_n_m": m.shift_en_m[:, 1],
        "sigma_e_m": sigma_m[:, 0],
        "sigma_n_m": sigma_m[:, 1],
        "correlation": m.correlation,
        "cause": names[m.cause],
    }
