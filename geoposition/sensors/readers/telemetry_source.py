"""Telemetry from whatever file it comes in: a known product by its content, else a table."""

from __future__ import annotations

from pathlib import Path

from geoposition.errors import UnsupportedError
from geoposition.sensors.readers import gracefo
from geoposition.sensors.readers.attitude_columns import ColumnMap
from geoposition.sensors.readers.attitude_tables import (
    GyroTable,
    StarTable,
    read_gyro,
    read_star,
)
from geoposition.sensors.readers.mounting_file import GYRO, MountingFile, read_mounting
from geoposition.sensors.telemetry import GyroSeries, Mounting
from geoposition.timescale import Epoch


def open_mounting(path: Path | None) -> MountingFile:
    """Read a mounting file, TOML or QSA1B; no path, nothing is turned."""
    if path is None:
        return MountingFile(Mounting(), {})
    if gracefo.product_kind(path) == "QSA1B":
        return MountingFile(gracefo.read_qsa1b(path), {})
    return read_mounting(path)


def open_star(path: Path, columns: ColumnMap, epoch: Epoch | None = None) -> StarTable:
    """Read star samples: GRACE-FO SCA1A or SCA1B, or a table."""
    kind = gracefo.product_kind(path)
    if kind is None:
        return read_star(path, columns, epoch)
    if kind == "SCA1A":
        return StarTable(gracefo.read_sca1a(path), True, gracefo.EPOCH)
    if kind == "SCA1B":
        return StarTable(gracefo.read_sca1b(path), True, gracefo.EPOCH)
    raise UnsupportedError(path, "", f"star samples expected, this is a {kind} product")


def open_gyro(
    path: Path, columns: ColumnMap, mounting: Mounting, epoch: Epoch | None = None
) -> GyroTable:
    """Read gyro samples: GRACE-FO IMU1A or IMU1B, or a table; turned into the body frame."""
    kind = gracefo.product_kind(path)
    if kind is None:
        return read_gyro(path, columns, mounting, epoch)
    if kind in ("IMU1A", "IMU1B"):
        series = gracefo.read_imu(path)
        turned = mounting.rotation(GYRO).apply(series.values.copy())
        return GyroTable(GyroSeries.of(series.times_s, turned, series.kind), gracefo.EPOCH)
    raise UnsupportedError(path, "", f"gyro samples expected, this is a {kind} product")
