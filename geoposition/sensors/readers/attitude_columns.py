"""Which column of a telemetry table is what: the contract's own, presets, or a TOML file.

A `--columns` file names what differs from the contract's tables; every table and key of it is
optional, an unknown one is refused::

    [time]
    column = "t_s"
    unit = "s"                  # s, ms, us, min, h, day
    format = "seconds"          # or "utc": ISO 8601, seconds are counted from the epoch
    epoch_utc = "2015-10-13T00:00:00Z"  # of t = 0; with format "utc" the first sample's if absent

    [sensor]                    # several heads in one table
    column = "sensor"
    name = "star"               # of the only head, where there is no such column

    [quaternion]
    columns = ["q_x", "q_y", "q_z", "q_w"]
    order = "xyzw"              # or "wxyz": the order of `columns`
    direction = "sensor_to_inertial"    # or "inertial_to_sensor": what it does to components

    [gyro]
    columns = ["w_x", "w_y", "w_z"]
    unit = "rad/s"              # rad, deg, arcsec, mdeg, alone (increments) or over s or h
    frame = "body"              # or "reference": turned with the quaternion of the same row
    rate = "instant"            # or "mean": over the time since the row before
    accumulated = false         # true: angles since the start, not since the row before

    [noise]
    sigma_cross_rad = "sigma_cross_rad" # a column, or a number for all rows
    sigma_bore_rad = "sigma_bore_rad"

"Direction" is about components: `sensor_to_inertial` means v_inertial = R(q) v_sensor with
R(q) v = q v q*. A SPICE C-kernel quaternion and a textbook's direction cosine matrix A(q) of
T (2.15) to (2.17) are `inertial_to_sensor`. Examples of other missions, as their documents
describe them: TH-1 and ZY-3 give sensor to inertial with the scalar last or first (`order`), the
gyro in degrees per second; MRO's is the preset below.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

import numpy as np

from geoposition.errors import ArgumentError
from geoposition.timescale import Epoch
from geoposition.tomlfile import TomlNode, read_toml

_TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0, "day": 86400.0}
_ANGLE_UNITS: Final = {
    "rad": 1.0,
    "deg": float(np.pi / 180.0),
    "mdeg": float(np.pi / 180e3),
    "arcsec": float(np.pi / 648e3),
}
_GYRO_UNITS: Final = {
    angle + per: size / seconds
    for angle, size in _ANGLE_UNITS.items()
    for per, seconds in (("", 1.0), ("/s", 1.0), ("/h", 3600.0))
}


@dataclass(frozen=True, slots=True)
class TimeColumn:
    """Where the time stands; `unit_s` seconds each, counted from `epoch` where known."""

    column: str = "t_s"
    unit_s: float = 1.0
    utc: bool = False
    epoch: Epoch | None = None


@dataclass(frozen=True, slots=True)
class QuaternionColumns:
    """Where the quaternion stands, in which order and direction; an absent choice is plain."""

    columns: tuple[str, str, str, str] = ("q_x", "q_y", "q_z", "q_w")
    order: Literal["xyzw", "wxyz"] = "xyzw"
    inverse: bool = False

    @property
    def xyzw(self) -> tuple[str, ...]:
        """The columns, scalar last."""
        c = self.columns
        return c if self.order == "xyzw" else (c[1], c[2], c[3], c[0])


@dataclass(frozen=True, slots=True)
class GyroColumns:
    """Where the gyro stands: `unit` in rad or rad/s, increments, and the frame it is in."""

    columns: tuple[str, str, str]
    unit: float = 1.0
    kind: Literal["rate", "mean-rate", "increment"] = "rate"
    in_reference: bool = False
    accumulated: bool = False


@dataclass(frozen=True, slots=True)
class NoiseColumns:
    """Noise of star samples: names of columns, or numbers for all rows, rad."""

    cross: str | float = "sigma_cross_rad"
    bore: str | float = "sigma_bore_rad"


@dataclass(frozen=True, slots=True)
class ColumnMap:
    """Columns of one kind of telemetry table. `gyro` None: the contract's w_ or d_ columns."""

    time: TimeColumn = field(default_factory=TimeColumn)
    quaternion: QuaternionColumns = field(default_factory=QuaternionColumns)
    gyro: GyroColumns | None = None
    noise: NoiseColumns = field(default_factory=NoiseColumns)
    sensor_column: str = "sensor"
    sensor_name: str = "star"


_SPICE = ColumnMap(
    quaternion=QuaternionColumns(("q_s", "q_x", "q_y", "q_z"), "wxyz", inverse=True),
    gyro=GyroColumns(("w_ref_x", "w_ref_y", "w_ref_z"), in_reference=True),
)
PRESETS: Final = {
    "contract": ColumnMap(),
    "mro": _SPICE,
    "chandrayaan2": _SPICE,
    "spice": _SPICE,
    "fermi": ColumnMap(gyro=GyroColumns(("w_x_rad_s", "w_y_rad_s", "w_z_rad_s"))),
}
"""Known tables: decoded C-kernels (scalar first, reference to spacecraft, rate in the reference
frame) as `spice`, `mro`, `chandrayaan2`; Fermi's position history as `fermi`."""


def column_map(columns: Path | None = None, preset: str | None = None) -> ColumnMap:
    """Map of a `--columns` file, of a preset, or of the contract."""
    if columns is not None and preset is not None:
        raise ArgumentError("--columns and --preset: one of them expected, not both")
    if columns is not None:
        return read_column_map(columns)
    if preset is None:
        return PRESETS["contract"]
    if preset not in PRESETS:
        raise ArgumentError(f"--preset: one of {', '.join(PRESETS)} expected, got {preset!r}")
    return PRESETS[preset]


def read_column_map(path: Path) -> ColumnMap:
    """Read a `--columns` file; a wrong key or value is a `ProductError` with its place."""
    root = read_toml(path)
    time = _time(_child(root, "time"))
    quaternion = _quaternion(_child(root, "quaternion"))
    gyro = _gyro(_child(root, "gyro")) if root.has("gyro") else None
    noise = _noise(_child(root, "noise"))
    sensor = _child(root, "sensor")
    result = ColumnMap(
        time, quaternion, gyro, noise,
        sensor.text("column", "sensor"), sensor.text("name", "star"),
    )  # fmt: skip
    sensor.finish()
    root.finish()
    return result


def _child(root: TomlNode, key: str) -> TomlNode:
    """Table under `key`, or an empty one."""
    if root.has(key):
        return root.child(key)
    root.asked.add(key)
    return TomlNode(root.path, key, {})


def _choice(node: TomlNode, key: str, default: str, *others: str) -> str:
    if not node.has(key):
        node.asked.add(key)
        return default
    return node.choice(key, default, *others)


def _names(node: TomlNode, key: str, count: int) -> tuple[str, ...]:
    value = node.need(key)
    good = isinstance(value, list) and len(value) == count and len(set(map(str, value))) == count
    if not good or not all(isinstance(name, str) for name in value):
        node.refuse(key, f"a list of {count} names of columns expected")
    return tuple(value)


def _time(node: TomlNode) -> TimeColumn:
    epoch = None
    if node.has("epoch_utc") or node.has("epoch_tai_s"):
        epoch = node.epoch()
    result = TimeColumn(
        node.text("column", "t_s"),
        _TIME_UNITS[_choice(node, "unit", *_TIME_UNITS)],
        _choice(node, "format", "seconds", "utc") == "utc",
        epoch,
    )
    node.finish()
    return result


def _quaternion(node: TomlNode) -> QuaternionColumns:
    order = _choice(node, "order", "xyzw", "wxyz")
    names = tuple(f"q_{axis}" for axis in order)
    if node.has("columns"):
        names = _names(node, "columns", 4)
    direction = _choice(node, "direction", "sensor_to_inertial", "inertial_to_sensor")
    node.finish()
    a, b, c, d = names
    plain: Literal["xyzw", "wxyz"] = "xyzw" if order == "xyzw" else "wxyz"
    return QuaternionColumns((a, b, c, d), plain, direction == "inertial_to_sensor")


def _gyro(node: TomlNode) -> GyroColumns:
    unit = _choice(node, "unit", "rad/s", *(name for name in _GYRO_UNITS if name != "rad/s"))
    increments = "/" not in unit
    names = tuple(f"{'d' if increments else 'w'}_{axis}" for axis in "xyz")
    if node.has("columns"):
        names = _names(node, "columns", 3)
    mean = _choice(node, "rate", "instant", "mean") == "mean"
    accumulated = node.flag("accumulated")
    if accumulated and not increments:
        node.refuse("accumulated", "it belongs to a unit of angle, not of rate")
    frame = _choice(node, "frame", "body", "reference")
    node.finish()
    kind: Literal["rate", "mean-rate", "increment"] = "mean-rate" if mean else "rate"
    x, y, z = names
    return GyroColumns(
        (x, y, z), _GYRO_UNITS[unit], "increment" if increments else kind,
        frame == "reference", accumulated,
    )  # fmt: skip


def _noise(node: TomlNode) -> NoiseColumns:
    found: dict[str, str | float] = {}
    for key in ("sigma_cross_rad", "sigma_bore_rad"):
        if not node.has(key):
            node.asked.add(key)
            found[key] = key
        elif isinstance(node.data[key], str):
            found[key] = node.text(key)
        else:
            found[key] = node.number(key)
    node.finish()
    return NoiseColumns(found["sigma_cross_rad"], found["sigma_bore_rad"])
