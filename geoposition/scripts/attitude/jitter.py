"""Jitter of an attitude or gyro table, as the command line asks for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.ephemeris import Ephemeris, Frame
from geoposition.errors import ArgumentError, ProductError
from geoposition.scripts.attitude.conversion import read_orbit
from geoposition.scripts.attitude.input import Sources, load, mounting_facts
from geoposition.sensors.attitude_determination.convert import AttitudeFrame, convert
from geoposition.sensors.attitude_determination.jitter.lines import (
    AXES,
    Jitter,
    JitterSettings,
    jitter_from_attitude,
    jitter_from_gyro,
)
from geoposition.sensors.readers import gracefo
from geoposition.sensors.readers.attitude_columns import ColumnMap, column_map
from geoposition.sensors.readers.attitude_tables import contract_gyro
from geoposition.sensors.readers.table_file import load_table
from geoposition.sensors.readers.telemetry_source import open_gyro, open_mounting
from geoposition.sensors.writers.table_file import Column
from geoposition.timescale import Epoch


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked; `sources.star` is the series, whatever is in it."""

    sources: Sources
    source: AttitudeFrame
    gyro: bool
    ephemeris: Path | None
    ephemeris_frame: Frame | None
    epoch: Epoch | None
    lowest_hz: float | None
    highest_hz: float | None
    false_alarm: float
    lines: int


def search(request: Request) -> tuple[Jitter, dict[str, object]]:
    """Find the lines, and say in what."""
    path = request.sources.star
    assert path is not None
    settings = JitterSettings(
        request.lowest_hz, request.highest_hz, request.false_alarm, request.lines
    )
    columns = column_map(request.sources.columns, request.sources.preset)
    of_gyro = request.gyro or not _has_attitude(path, columns)
    if of_gyro:
        if request.ephemeris is not None:
            raise ArgumentError("--ephemeris: for an attitude, this is gyro data")
        installed = open_mounting(request.sources.mounting)
        gyro = open_gyro(path, columns, installed.mounting, request.epoch).series
        facts = mounting_facts(installed) | {
            "samples": len(gyro), "quantity": gyro.kind, "angles": "body axes",
        }  # fmt: skip
        try:
            found = jitter_from_gyro(gyro, settings)
        except ArgumentError as error:
            raise ProductError(path, "", str(error)) from None
    else:
        times, rotation, ephemeris, facts = _attitude(request)
        try:
            found = jitter_from_attitude(times, rotation, ephemeris, settings)
        except ArgumentError as error:
            raise ProductError(path, "", str(error)) from None
    return found, {**facts, **found.summary()}


def columns(found: Jitter) -> dict[str, Column]:
    """Detrended angles over time, as a table."""
    angles = {f"{axis}_rad": np.asarray(found.angle_rad[:, k]) for k, axis in enumerate(AXES)}
    return {"t_s": np.asarray(found.times_s), **angles}


def print_lines(title: str, result: Mapping[str, Any]) -> None:
    """Print the lines as a table for people."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{title}: jitter in {result['angles']}", title_justify="left", box=None)
    for name in ("axis", "Hz", "±", "amplitude ″", "±", "phase rad", "false alarm"):
        table.add_column(name, justify="left" if name == "axis" else "right")
    for axis in AXES:
        for line in result["axes"][axis]:
            table.add_row(
                axis,
                f"{line['frequency_hz']:.5f}", f"{line['sigma_frequency_hz']:.5f}",
                f"{line['amplitude_arcsec']:.4g}", f"{line['sigma_amplitude_arcsec']:.2g}",
                f"{line['phase_rad']:+.3f}", f"{line['false_alarm']:.1e}",
            )  # fmt: skip
    console = Console()
    console.print(table)
    rms = ", ".join(f"{axis} {value:.3g}″" for axis, value in result["rms_arcsec"].items())
    console.print(
        f"searched {2.0 * result['low_cut_hz']:.4g} .. {result['highest_hz']:.4g} Hz; rms {rms}"
    )


def _has_attitude(path: Path, columns: ColumnMap) -> bool:
    """Tell whether a series is an attitude; neither attitude nor gyro is refused."""
    kind = gracefo.product_kind(path)
    if kind is not None:
        return kind.startswith("SCA")
    table = load_table(path)
    if all(name in table.names for name in columns.quaternion.columns):
        return True
    try:
        known = columns.gyro or contract_gyro(table)
    except ProductError:
        known = None
    if known is not None and all(name in table.names for name in known.columns):
        return False
    raise ProductError(
        path, "header",
        f"columns {','.join(columns.quaternion.columns)} of an attitude, or w_x,w_y,w_z or "
        "d_x,d_y,d_z of a gyro expected",
    )  # fmt: skip


def _attitude(
    request: Request,
) -> tuple[FloatArray, Rotation, Ephemeris | None, dict[str, object]]:
    telemetry = load(request.sources)
    star = telemetry.star
    if len(star.heads) > 1:
        raise ProductError(
            str(request.sources.star), "column sensor",
            f"one attitude expected, there are {', '.join(star.heads)}: choose one with --sensor",
        )  # fmt: skip
    rotation = star.R_inertial_sensor * telemetry.mounting.rotation(star.heads[0]).inv()
    epoch = request.epoch or telemetry.epoch
    facts = telemetry.facts | {"samples": len(star), "quantity": "attitude"}
    facts["angles"] = "body axes"
    if request.ephemeris is None:
        if request.source == "itrs":
            rotation = convert(rotation, star.times_s, "itrs", "inertial", epoch=_need(epoch))
        return star.times_s, rotation, None, facts
    orbit, epoch = read_orbit(
        request.ephemeris, request.ephemeris_frame, epoch, telemetry.epoch, star
    )
    facts["angles"] = "orbit frame"
    start = Epoch(0) if epoch is None else epoch
    if orbit.frame == "itrs" or request.source == "itrs":
        start = _need(epoch)
    rotation = convert(rotation, star.times_s, request.source, "inertial", epoch=epoch, orbit=orbit)
    return star.times_s, rotation, orbit.ephemeris(start), facts


def _need(epoch: Epoch | None) -> Epoch:
    if epoch is None:
        raise ArgumentError("--epoch: the UTC of t_s = 0 expected, for the Earth's turning")
    return epoch
