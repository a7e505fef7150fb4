"""Files of an adjustment run for tests: models of the simulated pair, control, ties, RUN.toml."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import adjust_scene
import numpy as np

from geoposition.adjust import adjusted_models
from geoposition.observations import ControlPoints
from geoposition.scripts.cli import run
from geoposition.sensor_model import SensorModel
from geoposition.sensors.writers.model_file import write_model_file

NAMES = ("forward", "backward")
THETA = np.array([8.0, -5.0, 12.0, -6.0, 9.0, -7.0]) * adjust_scene.ARCSEC


def write_scene(folder: Path) -> adjust_scene.Case:
    """Write the models as they came, 42 control points and 200 ties measured with the true ones."""
    for name, model in zip(NAMES, adjust_scene.pair(), strict=True):
        write_model_file(model, folder / f"{name}.toml")
    truth = adjusted_models(adjust_scene.pair(), adjust_scene.attitude_blocks(), THETA)
    rng = np.random.default_rng(3)
    ground = adjust_scene.common_ground(42)
    known = adjust_scene.moved_enu(ground, rng.normal(0.0, adjust_scene.GPS_M, ground.shape))
    control = adjust_scene.control_points(known, adjust_scene.measured(truth, ground, rng))
    write_control(folder / "gcps.csv", control)
    write_ties(folder / "ties.csv", truth, rng)
    return adjust_scene.Case(THETA, truth, control)


def write_control(path: Path, control: ControlPoints) -> None:
    assert control.image is not None
    degrees = np.degrees(control.geodetic[:, :2])
    place = {name: i for i, name in enumerate(control.ids.tolist())}
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["id", "lon", "lat", "height", "product", "row", "col"])
        for name, product, px in zip(
            control.image.ids.tolist(), control.image.product, control.image.image_px, strict=True
        ):
            i = place[name]
            out.writerow([
                name, repr(float(degrees[i, 0])), repr(float(degrees[i, 1])),
                repr(float(control.geodetic[i, 2])), NAMES[product], *(float(v) for v in px),
            ])  # fmt: skip


def write_ties(
    path: Path, truth: tuple[SensorModel, ...], rng: np.random.Generator, count: int = 200
) -> None:
    ground = adjust_scene.common_ground(count, seed=9)
    images = adjust_scene.measured(truth, ground, rng)
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["id", "product", "row", "col"])
        for name, px in zip(NAMES, images, strict=True):
            out.writerows([f"t{i}", f"{name}.toml", *p] for i, p in enumerate(px.tolist()))


def write_run(path: Path, *tables: str) -> Path:
    """Write a RUN.toml with the two images and further tables."""
    images = [f'[[image]]\nid = "{name}"\nproduct = "{name}.toml"\n' for name in NAMES]
    path.write_text("\n".join([*images, *tables]) + "\n", encoding="utf-8")
    return path


def adjust(path: Path, out: Path) -> tuple[int, dict[str, object]]:
    """Run the command; its exit status, and adjustment.json where it was written."""
    status = run(["adjust", str(path), "-o", str(out), "--json"])
    written = out / "adjustment.json"
    facts = json.loads(written.read_text()) if written.is_file() else {}
    return status, facts


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
