"""Write a rigorous model as our own model file: TOML and CSV tables, read back bit for bit.

The schema is the docstring of `geoposition.sensors.readers.model_file`. Interpolants, directions
and timings that the schema has are written as they are, and read back to the same rays to the
last bit; others become dense tables (attitude within 1e-10 rad, positions within 1e-6 m,
directions within 1e-10), and the error found is in the file and in the report.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoposition.attitude import Attitude
from geoposition.camera import LineTiming
from geoposition.corrections import Corrections
from geoposition.errors import ArgumentError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.readers.model_file import COVARIANCE, MARK, VERSION
from geoposition.sensors.readers.model_file_curves import POSITION
from geoposition.sensors.timing import ConstantLineRate
from geoposition.sensors.writers.atomic import files_whole
from geoposition.sensors.writers.model_file_camera import ccd_sections, mounting_section
from geoposition.sensors.writers.model_file_parts import (
    Section,
    Tables,
    csv_text,
    curve_section,
    epoch_section,
    rotation_section,
    toml,
)


@dataclass(frozen=True, slots=True)
class ModelFileReport:
    """What was written; `attitude_error_rad` is 0 where the attitude was written as it is."""

    path: Path
    tables: tuple[Path, ...]
    attitude_error_rad: float


def write_model_file(
    model: PushbroomModel,
    path: str | Path,
    *,
    sensor: str = "",
    image: str | Path | None = None,
    home: Path | None = None,
) -> ModelFileReport:
    """Write `model` to `path`, a .toml, and its tables beside it, whole or not at all.

    The tables are named after the file: `scene.toml` has `scene_attitude.csv` and so on. The
    TOML file is put in its place last. `image` is written relative to its folder, or
    to `home` where the files will be moved to in the end.
    """
    path = Path(path)
    if path.suffix.lower() != ".toml":
        raise ArgumentError(f"model file {path}: a name ending in .toml expected")
    if any(c in path.stem for c in ':\\"'):
        raise ArgumentError(f"model file {path}: a name without colons or quotes expected")
    tables = Tables(path.stem)
    camera = model.camera
    header: Section = {"format": MARK, "version": VERSION}
    if sensor:
        header["sensor"] = sensor
    if image is not None:
        header["image"] = Path(os.path.relpath(image, home or path.parent)).as_posix()
    header |= {
        "lines": camera.shape[0],
        "height_range_m": [float(h) for h in model.height_range_m],
        "timing": dict(_timing(camera.timing, camera.shape[0], tables)),
        "mounting": dict(mounting_section(camera)),
    }
    text = "# Times are seconds from each section's epoch; see the model file's documentation.\n"
    text += toml(header)
    for section in ccd_sections(camera, tables):
        text += "\n[[ccd]]\n" + toml(section)
    attitude = _attitude(model.attitude, tables)
    ephemeris = epoch_section(model.ephemeris.epoch) | {"frame": model.ephemeris.frame}
    ephemeris |= curve_section(model.ephemeris.curve, POSITION, "ephemeris", tables)
    text += "\n" + toml({"ephemeris": dict(ephemeris), "attitude": dict(attitude)}).lstrip()
    text += "\n" + toml({"corrections": dict(_corrections(model.corrections))}).lstrip()
    texts = {path.parent / name: csv_text(*table) for name, table in tables.files.items()}
    files_whole(texts | {path: text})
    error = attitude.get("tabulated_error_rad", 0.0)
    assert isinstance(error, float)
    return ModelFileReport(path, tuple(texts), error)


def _timing(timing: LineTiming, lines: int, tables: Tables) -> Section:
    section = epoch_section(timing.epoch)
    if isinstance(timing, ConstantLineRate):
        return section | {
            "kind": "rate",
            "first_line_s": timing.first_line_s,
            "line_period_s": timing.line_period_s,
        }
    ends = getattr(timing, "lines", None)
    if ends is None:
        inner = timing.knots_line
        ends = np.union1d([0.0, max(lines - 1.0, 1.0)], inner)
    times = getattr(timing, "times_s", None)
    name = tables.add(
        "lines", ("line", "t_s"), ends, timing.time_s(ends) if times is None else times
    )
    return section | {"kind": "table", "table": name}


def _attitude(attitude: Attitude, tables: Tables) -> Section:
    section = epoch_section(attitude.epoch) | {"frame": attitude.frame}
    if attitude.covariance_rad2 is not None and attitude.covariance_times_s is not None:
        flat = attitude.covariance_rad2.reshape(-1, 9)
        section["covariance"] = tables.add(
            "covariance", ("t_s", *COVARIANCE), attitude.covariance_times_s, flat
        )
        if attitude.lag_one_rad2 is not None:
            section["lag_one"] = tables.add(
                "lag_one", COVARIANCE, attitude.lag_one_rad2.reshape(-1, 9)
            )
    return section | rotation_section(attitude.curve, "attitude", tables)


def _corrections(corrections: Corrections) -> Section:
    section: Section = {
        "velocity_aberration": corrections.velocity_aberration,
        "light_time": corrections.light_time,
    }
    if corrections.refraction is not None:
        section["refraction"] = {
            "refractivity": float(corrections.refraction.refractivity),
            "scale_height_m": float(corrections.refraction.scale_height_m),
        }
    return section


def rewrite_model_file(product: Product, path: str | Path) -> ModelFileReport:
    """Write a product's rigorous model with its names; a product of RPC only is refused."""
    if not isinstance(product.model, PushbroomModel):
        raise ArgumentError(f"{product.path}: a rigorous model expected, this product has an RPC")
    return write_model_file(product.model, path, sensor=product.sensor, image=product.image_path)
