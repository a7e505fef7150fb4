"""How sensors are built in, from a TOML file.

One table per sensor by its name in the telemetry, `gyro` among them, either at the top or below
`[sensors]`. Each says the rotation to the body in one of these ways::

    [star1]
    quat_xyzw = [0, 0, 0, 1]            # or quat_wxyz
    direction = "sensor_to_body"        # optional; or "body_to_sensor"

    [star2]
    matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]  # v_body = matrix v_sensor; T table 5.1

    [star3]
    sequence = "3-1-2"                  # turns of the sensor about its own axes, from the body's
    euler_deg = [10.0, 20.0, 30.0]      # or euler_rad, in the order of `sequence`

    [gyro]
    matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]

A matrix that is not quite orthogonal, as laboratories and datasheets give it, is replaced by the
nearest rotation; how far it was off is reported. One that is off by more than 0.05 (Frobenius
norm), or mirrors, is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError
from geoposition.rotation import (
    nearest_rotation,
    quat_xyzw_from_wxyz,
    rotation_from_intrinsic_euler,
)
from geoposition.sensors.telemetry import Mounting
from geoposition.tomlfile import TomlNode, read_toml

GYRO: Final = "gyro"
"""Name of the gyro in a mounting file."""
_LARGEST_ERROR: Final = 0.05
_UNIT_TOLERANCE: Final = 1e-3
_WAYS: Final = ("quat_xyzw", "quat_wxyz", "matrix", "euler_deg", "euler_rad")


@dataclass(frozen=True, slots=True)
class MountingFile:
    """`mounting`, and the Frobenius norm by which each given matrix missed a rotation."""

    mounting: Mounting
    matrix_error: Mapping[str, float]


def read_mounting(path: Path) -> MountingFile:
    """Read a mounting file; what is wrong in it is a `ProductError` with its place."""
    root = read_toml(path)
    if root.has("sensors"):
        tables = root.child("sensors")
        root.finish()
    else:
        tables = root
    if not tables.data:
        tables.refuse("", "a table for each sensor expected, there is none")
    rotations, errors = {}, {}
    for name in tables.data:
        rotation, error = _rotation(tables.child(name))
        rotations[name] = rotation
        if error is not None:
            errors[name] = error
    return MountingFile(Mounting(rotations), errors)


def _rotation(node: TomlNode) -> tuple[Rotation, float | None]:
    ways = [way for way in _WAYS if node.has(way)]
    if len(ways) != 1:
        node.refuse(ways[1] if ways else _WAYS[0], f"one of {', '.join(_WAYS)} expected")
    way, error = ways[0], None
    if way.startswith("quat"):
        rotation = _quaternion(node, way)
    elif way == "matrix":
        rotation, error = _matrix(node)
    else:
        angles = node.numbers(way, 3)
        if way == "euler_deg":
            angles = np.radians(angles)
        try:
            rotation = rotation_from_intrinsic_euler(node.text("sequence"), angles)
        except ArgumentError as problem:
            node.refuse("sequence", str(problem))
    if node.has("direction"):
        direction = node.choice("direction", "sensor_to_body", "body_to_sensor")
        rotation = rotation if direction == "sensor_to_body" else rotation.inv()
    node.finish()
    return rotation, error


def _quaternion(node: TomlNode, way: str) -> Rotation:
    quat = node.numbers(way, 4)
    norm = float(np.linalg.norm(quat))
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        node.refuse(way, f"a unit quaternion expected, its norm is {norm:.6g}")
    return Rotation.from_quat(quat if way == "quat_xyzw" else quat_xyzw_from_wxyz(quat))


def _matrix(node: TomlNode) -> tuple[Rotation, float]:
    rows: Any = node.need("matrix")
    if not (isinstance(rows, list) and len(rows) == 3):
        node.refuse("matrix", "three rows of three numbers expected")
    holder = TomlNode(node.path, node.at("matrix"), {str(k): row for k, row in enumerate(rows)})
    matrix: FloatArray = np.stack([holder.numbers(str(k), 3) for k in range(3)])
    try:
        nearest = nearest_rotation(matrix)
    except ArgumentError:
        node.refuse("matrix", "a rotation expected, this matrix is singular or mirrors")
    error = float(nearest.error)
    if error > _LARGEST_ERROR:
        node.refuse("matrix", f"a rotation expected, this matrix is {error:.2g} from the nearest")
    return nearest.rotation, error
