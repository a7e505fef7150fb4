"""The demo's results as files that the other commands read, and as one JSON object."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import geoposition
from geoposition.accuracy import axis_statistics
from geoposition.arrays import FloatArray
from geoposition.flags import Flag
from geoposition.scripts.demo.data import DemoResult, Intersection, Measured
from geoposition.scripts.demo.folder import MARK_KEY
from geoposition.scripts.demo.sanity import ground_sample_m, zenith_deg
from geoposition.scripts.results import rounded
from geoposition.scripts.tables import write_table
from geoposition.sensors.simulate import ARCSEC_RAD
from geoposition.sensors.writers.model_file import write_model_file

_SENSOR = "simulated ZY-3, {name} camera, {kind}"


def write_inputs(result: DemoResult, folder: Path) -> None:
    """Write models, tie points, control points and image points; the DEM is there already."""
    (folder / "true").mkdir()
    for models, place, kind in (
        (result.scene.measured, folder, "as its telemetry has it"),
        (result.scene.true, folder / "true", "the truth"),
    ):
        for name, model in models.items():
            sensor = _SENSOR.format(name=name, kind=kind)
            write_model_file(model, place / f"{name}.toml", sensor=sensor)
    check, grid = result.check, result.grid
    write_table(folder / "ties.csv", _tie_columns(check, grid))
    degrees: FloatArray = np.degrees(check.geodetic[:, :2]).round(12)
    write_table(
        folder / "gcps.csv",
        {
            "id": check.ids,
            "lon": degrees[:, 0],
            "lat": degrees[:, 1],
            "height": np.round(check.geodetic[:, 2], 6),
        },
    )
    nadir = check.image_px["nadir"]
    write_table(
        folder / "points.csv",
        {"id": check.ids, "row": np.round(nadir[:, 0], 4), "col": np.round(nadir[:, 1], 4)},
    )


def _tie_columns(*groups: Measured) -> dict[str, Any]:
    ids, products, image = [], [], []
    for group in groups:
        for name, px in group.image_px.items():
            ids.append(group.ids)
            products.append(np.full(len(px), f"{name}.toml"))
            image.append(px)
    points = np.round(np.concatenate(image), 4)
    return {
        "id": np.concatenate(ids),
        "product": np.concatenate(products),
        "row": points[:, 0],
        "col": points[:, 1],
    }


def as_json(result: DemoResult) -> dict[str, object]:
    """Every figure of the report by name, to six decimals; the same for the same seed."""
    options = asdict(result.options)
    options["scene"]["corrections"] = result.options.scene.corrections.describe()
    scene = result.scene
    images = {}
    for name, model in scene.true.items():
        timing = model.camera.timing
        first, last = (float(t) for t in timing.time_s(np.array([0.0, model.shape[0] - 1.0])))
        images[name] = {
            "lines": model.shape[0],
            "samples": model.shape[1],
            "ccds": len(model.camera.detectors),
            "first_line_utc": (timing.epoch + first).utc_iso(),
            "last_line_utc": (timing.epoch + last).utc_iso(),
            "ground_sample_m": dict(zip(("row", "col"), ground_sample_m(model), strict=True)),
            "satellite_zenith_deg": zenith_deg(model),
            "mounting_error_arcsec": (scene.mounting_error_rad[name] / ARCSEC_RAD).tolist(),
            "footprint_lon_lat_deg": np.round(result.outlines[name], 6).tolist(),
        }
    figures: dict[str, object] = {
        MARK_KEY: 1,
        "version": geoposition.__version__,
        "seed": result.options.seed,
        "options": options,
        "images": images,
        "check_points": len(result.check.ids),
        "intersection": {
            "true_models": _intersection(result.true),
            "measured_models": _intersection(result.measured),
        },
        "error_causes": {name: part.as_dict() for name, part in result.budget.items()},
        "control_residuals_px": {
            name: {
                "row": axis_statistics(px[:, 0]).as_dict(),
                "col": axis_statistics(px[:, 1]).as_dict(),
            }
            for name, px in result.residuals_px.items()
        },
        "heights": {
            "points": len(result.grid.ids),
            "true_models": axis_statistics(result.height_error_true_m).as_dict(),
            "measured_models": axis_statistics(result.height_error_measured_m).as_dict(),
        },
        "single_image": {name: part.as_dict() for name, part in result.single.items()},
        "one_arcsecond": [asdict(line) for line in result.sensitivity],
    }
    facts: dict[str, object] = rounded(figures)
    return facts


def _intersection(part: Intersection) -> dict[str, object]:
    found = part.found
    return {
        "intersected": int(np.sum(found.flag == Flag.OK)),
        "residual_px": {
            "median": float(np.nanmedian(found.residual_px)),
            "p95": float(np.nanquantile(found.residual_px, 0.95)),
        },
        "errors_m": part.statistics.as_dict(),
        "stated_sigma_m": dict(zip("enu", part.mean_sigma_m.tolist(), strict=True)),
        "error_over_sigma": dict(part.normalised_rms),
    }
