"""Attitude tables from one frame to another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.ephemeris import Frame
from geoposition.errors import ArgumentError, ProductError
from geoposition.orbit_frame import orbit_angles
from geoposition.sensors.attitude_determination.convert import (
    AttitudeFrame,
    Orbit,
    OrbitAxes,
)
from geoposition.sensors.attitude_determination.convert import convert as convert_rotations
from geoposition.sensors.readers.attitude_columns import column_map
from geoposition.sensors.readers.attitude_tables import read_star
from geoposition.sensors.readers.ephemeris_table import read_ephemeris
from geoposition.sensors.readers.table_file import load_table
from geoposition.sensors.readers.telemetry_source import open_mounting
from geoposition.sensors.telemetry import StarSeries
from geoposition.sensors.writers.attitude_table import attitude_columns
from geoposition.sensors.writers.table_file import Column
from geoposition.timescale import Epoch

_CARRIED = ("sigma_", "bias_", "scale_", "upper_", "lower_")
"""What is about the body's axes, and so the same in every frame."""


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked: a table of attitudes body to `source`, in `target`."""

    attitude: Path
    source: AttitudeFrame
    target: AttitudeFrame
    ephemeris: Path | None
    ephemeris_frame: Frame | None
    epoch: Epoch | None
    axes: OrbitAxes
    columns: Path | None
    preset: str | None
    mounting: Path | None = None


def convert(request: Request) -> tuple[dict[str, Column], dict[str, object]]:
    """Columns of the converted table, and facts about it."""
    table = read_star(request.attitude, column_map(request.columns, request.preset), request.epoch)
    series = table.series
    epoch = request.epoch or table.epoch
    orbit = None
    if "orbit" in (request.source, request.target):
        if request.ephemeris is None:
            raise ArgumentError("--ephemeris: expected for the orbit frame, none is given")
        orbit, epoch = read_orbit(
            request.ephemeris, request.ephemeris_frame, epoch, table.epoch, series
        )
    elif request.source != request.target and epoch is None:
        raise ArgumentError(
            "--epoch: the UTC of t_s = 0 expected between inertial and Earth-fixed frames"
        )
    to_body = open_mounting(request.mounting).mounting
    turns = [to_body.rotation(name).inv().as_quat() for name in series.heads]
    R_source_body = series.R_inertial_sensor * Rotation.from_quat(np.array(turns)[series.head])
    turned = convert_rotations(
        R_source_body, series.times_s, request.source, request.target,
        epoch=epoch, orbit=orbit, axes=request.axes,
    )  # fmt: skip
    columns = attitude_columns(series.times_s, turned.as_quat())
    if len(series.heads) > 1:
        names = np.array(series.heads, dtype=np.str_)[series.head]
        columns = {"t_s": columns.pop("t_s"), "sensor": names, **columns}
    if request.target == "orbit":
        angles = orbit_angles(turned)
        columns |= {
            "roll_rad": angles.roll_rad,
            "pitch_rad": angles.pitch_rad,
            "yaw_rad": angles.yaw_rad,
        }
    columns |= _carried(request.attitude, series)
    facts: dict[str, object] = {
        "samples": len(series),
        "from": request.source,
        "to": request.target,
        "span_s": [float(series.times_s[0]), float(series.times_s[-1])],
    }
    if epoch is not None:
        facts["epoch_utc"] = epoch.utc_iso()
    return columns, facts


def read_orbit(
    path: Path,
    frame: Frame | None,
    epoch: Epoch | None,
    attitude_epoch: Epoch | None,
    series: StarSeries,
) -> tuple[Orbit, Epoch | None]:
    """Orbit from an EPH table, its times counted as the attitude's, and the epoch of both.

    Where both tables state epochs, the ephemeris is moved to the attitude's.
    """
    table = read_ephemeris(path, frame, epoch)
    times = np.array(table.times_s)
    if table.epoch is not None and attitude_epoch is not None:
        times = times + (table.epoch - attitude_epoch)
    low, high = float(series.times_s[0]), float(series.times_s[-1])
    if low < times[0] or high > times[-1]:
        raise ProductError(
            path, "",
            f"an ephemeris over {low:.3f} .. {high:.3f} s of the attitude expected, "
            f"it covers {times[0]:.3f} .. {times[-1]:.3f} s",
        )  # fmt: skip
    try:
        orbit = Orbit.of(times, table.position_m, table.velocity_m_s, table.frame)
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from None
    return orbit, epoch or table.epoch


def _carried(path: Path, series: StarSeries) -> dict[str, Column]:
    """Columns that stay as they are, for a table with one sample per row in order of time."""
    table = load_table(path)
    names = [name for name in table.names if name.startswith(_CARRIED)]
    if len(series.heads) > 1 or len(table) != len(series):
        return {}
    return {name: table.numbers(name) for name in names}
