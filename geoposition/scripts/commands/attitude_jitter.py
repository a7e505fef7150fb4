"""`geoposition attitude jitter`: lines in roll, pitch and yaw."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoposition.scripts.attitude.options import (
    ColumnsOption,
    MountingOption,
    PresetOption,
    ReportOption,
    SensorOption,
)
from geoposition.scripts.options import JsonOption


def command(
    series: Annotated[
        Path, typer.Argument(help="Attitude t_s,q_x,q_y,q_z,q_w, or gyro t_s,w_x,... or t_s,d_x,..")
    ],
    ephemeris: Annotated[
        Path | None, typer.Option(help="Table t_s,x,y,z,vx,vy,vz: angles to the orbit frame.")
    ] = None,
    frame: Annotated[
        Literal["itrs", "gcrs"] | None,
        typer.Option(help="Frame of the ephemeris, where the table does not say it."),
    ] = None,
    epoch: Annotated[
        str | None, typer.Option(help="UTC of t_s = 0; for an Earth-fixed ephemeris or attitude.")
    ] = None,
    source: Annotated[
        Literal["inertial", "itrs", "orbit"], typer.Option("--from", help="Frame of the attitude.")
    ] = "inertial",
    gyro: Annotated[
        bool, typer.Option("--gyro", help="Take the gyro of a table that has both.")
    ] = False,
    lowest: Annotated[
        float | None, typer.Option(help="Hz that part motion from jitter; 10 periods in the span.")
    ] = None,
    highest: Annotated[
        float | None, typer.Option(help="Hz up to which lines are sought; half the sampling rate.")
    ] = None,
    false_alarm: Annotated[
        float, typer.Option(help="Probability that noise alone shows a line on an axis.")
    ] = 1e-3,
    lines: Annotated[int, typer.Option(min=1, help="Most lines of an axis.")] = 20,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Table of the detrended angles to write.")
    ] = None,
    mounting: MountingOption = None,
    columns: ColumnsOption = None,
    preset: PresetOption = None,
    sensor: SensorOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Find jitter: lines with frequency, amplitude, phase and their standard deviations.

    Orbital motion and trend are removed first; sampling may be uneven. Without an ephemeris
    roll, pitch and yaw are the turns about the body's x, y and z.

    Example: geoposition attitude jitter fused.csv --ephemeris eph.csv --report jitter.html
    """
    from geoposition.scripts.attitude import jitter as attitude_jitter
    from geoposition.scripts.attitude.input import Sources
    from geoposition.scripts.results import print_json, progress_bar
    from geoposition.scripts.tables import check_output, write_table
    from geoposition.timescale import Epoch

    if output is not None:
        check_output(output)
    if report is not None:
        check_output(report, (".html", ".htm"))
    request = attitude_jitter.Request(
        Sources(star=series, mounting=mounting, columns=columns, preset=preset, sensors=sensor),
        source, gyro, ephemeris, frame, None if epoch is None else Epoch.from_utc(epoch),
        lowest, highest, false_alarm, lines,
    )  # fmt: skip
    with progress_bar("searching", json):
        found, result = attitude_jitter.search(request)
    if output is not None:
        write_table(output, attitude_jitter.columns(found))
        result["output"] = str(output)
    if report is not None:
        from geoposition.scripts.attitude import report as attitude_report

        attitude_report.write_jitter(report, str(series), found, result)
        result["report"] = str(report)
    if json:
        print_json(result)
    else:
        attitude_jitter.print_lines(str(series), result)
