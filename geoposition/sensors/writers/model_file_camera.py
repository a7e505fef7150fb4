"""Mounting and CCDs as our model file and camera file have them, and the camera file itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geoposition.camera import Camera
from geoposition.errors import ArgumentError, GeometryError
from geoposition.sensors.directions import (
    CollinearDirections,
    PolynomialDirections,
    SplineDirections,
    TableDirections,
)
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers.camera_file import CAMERA_MARK, CAMERA_VERSION
from geoposition.sensors.readers.csm_focal_plane import CubicDirections
from geoposition.sensors.writers.atomic import files_whole
from geoposition.sensors.writers.model_file_parts import (
    DENSE_TOLERANCE_RAD,
    Section,
    Tables,
    csv_text,
    toml,
)

_LEAST_NODES, _MOST_NODES = 33, 2**17


def write_camera_file(
    camera: Camera, path: str | Path, *, sensor: str = "", remarks: Sequence[str] = ()
) -> tuple[Path, ...]:
    """Write look angles and mounting of `camera` to `path`, a .toml; the files written.

    Tables, where a CCD needs one, are named after it and lie beside it. `remarks` become comments.
    """
    path = Path(path)
    if path.suffix.lower() != ".toml" or any(c in path.stem for c in ':\\"'):
        raise ArgumentError(f"camera file {path}: a plain name ending in .toml expected")
    tables = Tables(path.stem)
    header: Section = {"format": CAMERA_MARK, "version": CAMERA_VERSION}
    if sensor:
        header["sensor"] = sensor
    text = "".join(f"# {' '.join(remark.split())}\n" for remark in remarks)
    text += toml(header) + "\n" + toml({"mounting": dict(mounting_section(camera))}).lstrip()
    for section in ccd_sections(camera, tables):
        text += "\n[[ccd]]\n" + toml(section)
    texts = {path.parent / name: csv_text(*table) for name, table in tables.files.items()}
    files_whole(texts | {path: text})
    return (*texts, path)


def mounting_section(camera: Camera) -> Section:
    """Table `mounting`."""
    return {
        "R_body_camera_xyzw": camera.R_body_camera.as_quat().tolist(),
        "lever_arm_body_m": camera.lever_arm_body_m.tolist(),
    }


def ccd_sections(camera: Camera, tables: Tables) -> list[Section]:
    """Tables `ccd`; directions of a kind the schema has not become dense splines."""
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
                table = dense_directions(camera, number)
            name = tables.add(f"ccd{number}", ("sample", "x", "y"), table.samples, table.table)
            section |= {"kind": kind, "table": name}
        sections.append(section)
    return sections


def dense_directions(camera: Camera, number: int) -> SplineDirections:
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
