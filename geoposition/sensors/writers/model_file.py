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

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.camera import Camera, LineTiming
from geoposition.corrections import Corrections
from geoposition.errors import ArgumentError, GeometryError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.directions import (
    CollinearDirections,
    PolynomialDirections,
    SplineDirections,
    TableDirections,
)
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers.csm_focal_plane import CubicDirections
from geoposition.sensors.readers.model_file import COVARIANCE, MARK, VERSION
from geoposition.sensors.readers.model_file_curves import POSITION
from geoposition.sensors.timing import ConstantLineRate
from geoposition.sensors.writers.atomic import files_whole
from geoposition.sensors.writers.model_file_parts import (
    DENSE_TOLERANCE_RAD,
    Section,
    Tables,
    curve_section,
    epoch_section,
    rotation_section,
    toml,
)

_LEAST_NODES, _MOST_NODES = 33, 2**17


@dataclass(frozen=True, slots=True)
class ModelFileReport:
    """What was written; `attitude_error_rad` is 0 where the attitude was written as it is."""

    path: Path
    tables: tuple[Path, ...]
    attitude_error_rad: float


def write_model_file(
    model: PushbroomModel, path: str | Path, *, sensor: str = "", image: str | Path | None = None
) -> ModelFileReport:
    """Write `model` to `path`, a .toml, and its tables beside it, whole or not at all.

    The tables are named after the file: `scene.toml` has `scene_attitude.csv` and so on. The
    TOML file is put in its place last. `image` is written relative to its folder.
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
        header["image"] = Path(os.path.relpath(image, path.parent)).as_posix()
    header |= {
        "lines": camera.shape[0],
        "height_range_m": [float(h) for h in model.height_range_m],
        "timing": dict(_timing(camera.timing, camera.shape[0], tables)),
        "mounting": {
            "R_body_camera_xyzw": camera.R_body_camera.as_quat().tolist(),
            "lever_arm_body_m": camera.lever_arm_body_m.tolist(),
        },
    }
    text = "# Times are seconds from each section's epoch; see the model file's documentation.\n"
    text += toml(header)
    for section in _ccds(camera, tables):
        text += "\n[[ccd]]\n" + toml(section)
    attitude = _attitude(model.attitude, tables)
    ephemeris = epoch_section(model.ephemeris.epoch) | {"frame": model.ephemeris.frame}
    ephemeris |= curve_section(model.ephemeris.curve, POSITION, "ephemeris", tables)
    text += "\n" + toml({"ephemeris": dict(ephemeris), "attitude": dict(attitude)}).lstrip()
    text += "\n" + toml({"corrections": dict(_corrections(model.corrections))}).lstrip()
    texts = {path.parent / name: _csv(*table) for name, table in tables.files.items()}
    files_whole(texts | {path: text})
    error = attitude.get("tabulated_error_rad", 0.0)
    assert isinstance(error, float)
    return ModelFileReport(path, tuple(texts), error)


def _csv(columns: tuple[str, ...], rows: FloatArray) -> str:
    lines = [",".join(map(repr, row)) for row in rows.tolist()]
    return "\n".join([",".join(columns), *lines]) + "\n"


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


def _ccds(camera: Camera, tables: Tables) -> list[Section]:
    sections = []
    for number, detector in enumerate(camera.detectors):
        section: Section = {"samples": round(detector.last_sample - detector.first_sample) + 1}
        known = None
        if isinstance(camera, LineCamera):
            known = camera.ccds[number].directions
        if isinstance(known, PolynomialDirections):
            section |= {
                "kind": "polynomial",
                "x": known.x_coefficients.tolist(),
                "y": known.y_coefficients.tolist(),
                "offset": float(known.offset),
                "scale": float(known.scale),
                "angles": bool(known.angles),
            }
        elif isinstance(known, CollinearDirections):
            section |= {
                "kind": "collinear",
                "focal_length": float(known.focal_length),
                "detector_origin": [float(v) for v in known.detector_origin],
                "pitch": [float(v) for v in known.pitch],
                "detector_rotation_rad": float(known.detector_rotation_rad),
                "principal_point": [float(v) for v in known.principal_point],
            }
            if known.radial:
                section["radial"] = [float(v) for v in known.radial]
        elif isinstance(known, CubicDirections):
            section |= {
                "kind": "cubic",
                "focal_length": float(known.plane.focal_length),
                "origin": known.plane.origin.tolist(),
                "step": known.plane.step.tolist(),
                "look_sign": [float(v) for v in known.plane.look_sign],
                "x_cubic": known.x_cubic.tolist(),
                "y_cubic": known.y_cubic.tolist(),
            }
        else:
            kind = "spline"
            if isinstance(known, TableDirections | SplineDirections):
                kind = "table" if isinstance(known, TableDirections) else "spline"
                table = known
            else:
                table = _dense_directions(camera, number)
            name = tables.add(f"ccd{number}", ("sample", "x", "y"), table.samples, table.table)
            section |= {"kind": kind, "table": name}
        sections.append(section)
    return sections


def _dense_directions(camera: Camera, number: int) -> SplineDirections:
    """Spline through directions of a kind the schema has not, over the CCD and a margin."""
    detector = camera.detectors[number]
    margin = max(100.0, 0.05 * camera.shape[1])
    low, high = detector.first_sample - margin, detector.last_sample + margin
    nodes = _LEAST_NODES
    while nodes <= _MOST_NODES:
        samples = np.linspace(low, high, nodes)
        spline = SplineDirections(samples, camera.tangents(number, samples))
        check = 0.5 * (samples[1:] + samples[:-1])
        error = np.abs(spline.tangents(check) - camera.tangents(number, check))
        if np.max(error) <= DENSE_TOLERANCE_RAD:
            return spline
        nodes = 2 * nodes - 1
    raise GeometryError(f"model file: the directions of CCD {number} are too rough to tabulate")


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
