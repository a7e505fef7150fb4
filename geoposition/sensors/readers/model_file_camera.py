"""Mounting and CCDs of our model file and camera file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geoposition.arrays import read_only
from geoposition.errors import ArgumentError
from geoposition.sensors.directions import (
    CollinearDirections,
    Directions,
    PolynomialDirections,
    SplineDirections,
    TableDirections,
)
from geoposition.sensors.line_camera import Ccd, Mounting
from geoposition.sensors.readers.csm_focal_plane import CubicDirections, FocalPlane
from geoposition.sensors.readers.model_file_curves import read_rotation
from geoposition.tomlfile import TomlNode


def read_mounting(root: TomlNode) -> Mounting:
    """Read the optional table `mounting` of `root`."""
    mounting = Mounting()
    if root.has("mounting"):
        node = root.child("mounting")
        if node.has("R_body_camera_xyzw"):
            mounting = replace(mounting, R_body_camera=read_rotation(node, "R_body_camera_xyzw"))
        if node.has("lever_arm_body_m"):
            mounting = replace(mounting, lever_arm_body_m=node.numbers("lever_arm_body_m", 3))
        node.finish()
    return mounting


def read_ccds(root: TomlNode) -> tuple[Ccd, ...]:
    """Read the tables `ccd` of `root`, one or more."""
    return tuple(_ccd(node) for node in root.children("ccd"))


def _ccd(node: TomlNode) -> Ccd:
    samples = node.whole("samples", 1)
    kind = node.choice("kind", "polynomial", "table", "spline", "collinear", "cubic")
    directions: Directions
    try:
        if kind == "polynomial":
            directions = PolynomialDirections(
                node.numbers("x"),
                node.numbers("y"),
                node.number("offset", 0.0),
                node.number("scale", 1.0),
                node.flag("angles"),
            )
        elif kind in ("table", "spline"):
            table = node.table("table", "sample", "x", "y", rows=2)
            make = TableDirections if kind == "table" else SplineDirections
            directions = make(table[:, 0], table[:, 1:])
        elif kind == "collinear":
            directions = CollinearDirections(
                node.number("focal_length"),
                _pair(node, "detector_origin"),
                _pair(node, "pitch"),
                node.number("detector_rotation_rad", 0.0),
                _pair(node, "principal_point") if node.has("principal_point") else (0.0, 0.0),
                tuple(node.numbers("radial").tolist()) if node.has("radial") else (),
            )
        else:
            plane = FocalPlane(
                read_only(node.numbers("origin", 2)),
                read_only(node.numbers("step", 2)),
                node.number("focal_length"),
                _pair(node, "look_sign") if node.has("look_sign") else (1.0, 1.0),
            )
            if plane.focal_length == 0 or not np.any(plane.step):
                node.refuse("focal_length", "a focal length and a step other than 0 expected")
            x, y = node.numbers("x_cubic", 4), node.numbers("y_cubic", 4)
            directions = CubicDirections(plane, x, y)
    except ArgumentError as error:
        node.refuse("table" if node.has("table") else "kind", str(error))
    node.finish()
    return Ccd(samples, directions)


def _pair(node: TomlNode, key: str) -> tuple[float, float]:
    x, y = node.numbers(key, 2)
    return float(x), float(y)
