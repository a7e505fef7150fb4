"""Telemetry tables: star sensors, gyros, vectors, ephemeris, attitude.

Each reader takes the contract's columns, or those a `ColumnMap` names, and refuses what cannot be
meant with the file, the line and the column. Only `read_raw_star` lets broken samples through,
for pre-processing to judge.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.errors import ArgumentError, ProductError
from geoposition.sensors.readers.attitude_columns import ColumnMap, GyroColumns
from geoposition.sensors.readers.mounting_file import GYRO
from geoposition.sensors.readers.table_file import TableFile, load_table
from geoposition.sensors.readers.table_times import read_times
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries
from geoposition.timescale import Epoch

PLAIN: Final = ColumnMap()
MADE_FLAGS: Final = ("broken", "outlier_replaced", "gap")
"""Flags of `attitude preprocess` for samples that stand in the place of lost ones."""
UNKNOWN_SIGMA_RAD: Final = float(np.radians(5.0 / 3600.0))
"""Stands for the noise of star samples whose table does not state it."""
_UNIT_TOLERANCE: Final = 1e-3
_AXES: Final = "xyz"


@dataclass(frozen=True, slots=True, eq=False)
class RawStar:
    """Star samples (n,) as they came down, row by row: NaN and broken quaternions included.

    `quat_xyzw` (n, 4) is R_inertial_sensor where it is a quaternion at all; sigmas are NaN where
    the table does not state them.
    """

    table: TableFile
    times_s: FloatArray
    quat_xyzw: FloatArray
    head: IntArray
    heads: tuple[str, ...]
    sigma_cross_rad: FloatArray
    sigma_bore_rad: FloatArray
    epoch: Epoch | None

    @property
    def sigma_stated(self) -> bool:
        """Whether every sample says its noise."""
        return bool(np.all(np.isfinite(self.sigma_cross_rad)))


@dataclass(frozen=True, slots=True, eq=False)
class StarTable:
    """A checked series, whether its noise was stated, and the epoch of its times if known."""

    series: StarSeries
    sigma_stated: bool
    epoch: Epoch | None = None
    made: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class GyroTable:
    """A checked series in the body frame, and the epoch of its times if known."""

    series: GyroSeries
    epoch: Epoch | None = None


def read_raw_star(
    path: Path, columns: ColumnMap = PLAIN, epoch: Epoch | None = None, strict: bool = False
) -> RawStar:
    """Read star samples in the order of the file, without judging them unless `strict`.

    `epoch` is that of t = 0 for times in UTC; the first sample's if None. `strict` refuses times
    that are none.
    """
    table = load_table(path)
    quat_names = columns.quaternion.xyzw
    table.require((columns.time.column, *columns.quaternion.columns), (columns.sensor_column,))
    times, start = read_times(table, columns.time, epoch, strict)
    quat = np.stack([table.numbers(name) for name in quat_names], axis=1)
    if columns.quaternion.inverse:
        quat = quat * np.array([-1.0, -1.0, -1.0, 1.0])
    if columns.sensor_column in table.names:
        names, head = np.unique(table.text(columns.sensor_column), return_inverse=True)
        heads = tuple(str(name) for name in names)
    else:
        head, heads = np.zeros(len(times), dtype=np.int64), (columns.sensor_name,)
    cross = _sigma(table, columns.noise.cross)
    bore = _sigma(table, columns.noise.bore)
    bore = np.where(np.isnan(bore), cross, bore)
    for name, sigma in (("sigma_cross_rad", cross), ("sigma_bore_rad", bore)):
        bad = np.flatnonzero(sigma <= 0.0)
        if len(bad):
            table.refuse(int(bad[0]), name, "a positive number expected")
    return RawStar(table, times, quat, head.astype(np.int64), heads, cross, bore, start)


def read_star(path: Path, columns: ColumnMap = PLAIN, epoch: Epoch | None = None) -> StarTable:
    """Read a STAR table; NaN, what is no unit quaternion, or a time that goes back is refused.

    Heads may follow each other in the file; the series is in the order of time. Samples that a
    column `flag` says were made from their neighbours (`MADE_FLAGS`) are no measurements: they
    are left out, and counted in `made`.
    """
    raw = read_raw_star(path, columns, epoch, strict=True)
    if not np.all(np.isfinite(raw.quat_xyzw)):
        for name in columns.quaternion.columns:
            raw.table.strict(name)
    norm = np.linalg.norm(raw.quat_xyzw, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > _UNIT_TOLERANCE)
    if len(bad):
        raw.table.refuse(
            int(bad[0]),
            columns.quaternion.columns[0],
            f"a unit quaternion expected, its norm is {norm[bad[0]]:.6g} "
            "(attitude preprocess sorts out broken ones)",
        )
    for k in range(len(raw.heads)):
        _never_back(raw.table, columns.time.column, raw.times_s, np.flatnonzero(raw.head == k))
    cross = raw.sigma_cross_rad if raw.sigma_stated else np.full(len(norm), UNKNOWN_SIGMA_RAD)
    bore = raw.sigma_bore_rad if raw.sigma_stated else cross
    order = np.argsort(raw.times_s, kind="stable")
    made = _made(raw.table)
    order = order[~made[order]]
    if not len(order):
        raise ProductError(path, "column flag", "measured samples expected, all are made")
    try:
        series = StarSeries.of(
            raw.times_s[order], raw.quat_xyzw[order], cross[order], bore[order],
            raw.head[order], raw.heads,
        )  # fmt: skip
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from None
    return StarTable(series, raw.sigma_stated, raw.epoch, int(made.sum()))


def _made(table: TableFile) -> BoolArray:
    """Rows whose `flag` says that they were made, not measured."""
    if "flag" not in table.names:
        return np.zeros(len(table), dtype=np.bool_)
    return np.isin(np.char.lower(table.text("flag")), MADE_FLAGS)


def read_gyro(
    path: Path,
    columns: ColumnMap = PLAIN,
    mounting: Mounting | None = None,
    epoch: Epoch | None = None,
) -> GyroTable:
    """Read a GYRO table and turn it into the body frame with the mounting of `gyro`."""
    table = load_table(path)
    what = columns.gyro or contract_gyro(table)
    table.require((columns.time.column, *what.columns))
    times, start = read_times(table, columns.time, epoch)
    _increasing(table, columns.time.column, times)
    values = np.stack([table.strict(name) for name in what.columns], axis=1) * what.unit
    if what.accumulated:
        values = np.diff(values, axis=0, prepend=values[:1])
    if what.in_reference:
        values = _to_body(table, columns, values)
    elif mounting is not None:
        values = mounting.rotation(GYRO).apply(values)
    try:
        series = GyroSeries.of(times, values, what.kind)
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from None
    return GyroTable(series, start)


def contract_gyro(table: TableFile) -> GyroColumns:
    """Tell which of the contract's two gyro tables this is: rates or increments."""
    for letter, kind in (("w", "rate"), ("d", "increment")):
        x, y, z = (f"{letter}_{axis}" for axis in _AXES)
        if any(name in table.names for name in (x, y, z)):
            return GyroColumns((x, y, z), kind=kind)  # type: ignore[arg-type]
    raise ProductError(
        table.path, "header", "columns w_x,w_y,w_z (rad/s) or d_x,d_y,d_z (rad) expected"
    )


def _to_body(table: TableFile, columns: ColumnMap, values: FloatArray) -> FloatArray:
    """Turn rates in the reference frame with the quaternion of the same row."""
    table.require(columns.quaternion.columns)
    quat = np.stack([table.strict(name) for name in columns.quaternion.xyzw], axis=1)
    norm = np.linalg.norm(quat, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > _UNIT_TOLERANCE)
    if len(bad):
        place = columns.quaternion.columns[0]
        table.refuse(int(bad[0]), place, f"a unit quaternion expected, its norm is {norm[bad[0]]}")
    rotation = Rotation.from_quat(quat)
    if not columns.quaternion.inverse:
        rotation = rotation.inv()
    turned: FloatArray = rotation.apply(values)
    return turned


def _sigma(table: TableFile, source: str | float) -> FloatArray:
    """Noise of each row: a number, a column, or NaN where there is no such column."""
    if not isinstance(source, str):
        return np.full(len(table), float(source))
    if source in table.names:
        return table.strict(source)
    return np.full(len(table), np.nan)


def _never_back(table: TableFile, column: str, times: FloatArray, rows: IntArray) -> None:
    bad = np.flatnonzero(np.diff(times[rows]) < 0.0)
    if len(bad):
        before, at = rows[bad[0]], rows[bad[0] + 1]
        table.refuse(int(at), column, f"times that never go back expected, {times[at]:.6f} s "
                     f"follows {times[before]:.6f} s")  # fmt: skip


def _increasing(table: TableFile, column: str, times: FloatArray) -> None:
    bad = np.flatnonzero(np.diff(times) <= 0.0)
    if len(bad):
        k = int(bad[0])
        table.refuse(k + 1, column, f"times that increase expected, {times[k + 1]:.6f} s "
                     f"follows {times[k]:.6f} s")  # fmt: skip
