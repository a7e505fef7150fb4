"""`geoposition attitude gyro-check`: the gyro, integrated, against the star sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
    star: Annotated[Path, typer.Option(help="Table t_s[,sensor],q_x,q_y,q_z,q_w, or SCA1A/B.")],
    gyro: Annotated[Path, typer.Option(help="Table t_s,w_x,w_y,w_z or t_s,d_x,d_y,d_z, or IMU1.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Gyro table to write, in the body, with a flag."),
    ] = None,
    interval: Annotated[
        float | None, typer.Option(help="Seconds over which turns are compared; 10 to 60.")
    ] = None,
    threshold: Annotated[
        float, typer.Option(help="Suspicious are intervals so many usual scatters off.")
    ] = 5.0,
    mounting: MountingOption = None,
    columns: ColumnsOption = None,
    gyro_columns: Annotated[
        Path | None, typer.Option(help="The same for the gyro's table, where it differs.")
    ] = None,
    preset: PresetOption = None,
    sensor: SensorOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Check a gyro against star samples: bias, drift, scale, lag, and samples that are off.

    Says in words what is wrong: units, sign, mounting, time stamps, stuck or wild samples.

    Example: geoposition attitude gyro-check --star star.csv --gyro gyro.csv --report check.html
    """
    from geoposition.scripts.attitude import gyro as attitude_gyro
    from geoposition.scripts.attitude.input import Sources
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.tables import check_output, write_table

    if output is not None:
        check_output(output)
    if report is not None:
        check_output(report, (".html", ".htm"))
    sources = Sources(star, gyro, mounting, columns, gyro_columns, preset, sensor)
    with progress_bar("checking", json):
        run = attitude_gyro.check(sources, interval, threshold)
    result = run.summary()
    if output is not None:
        write_table(output, run.columns())
        result["output"] = str(output)
    if report is not None:
        attitude_gyro.write_report(report, str(star), str(gyro), run)
        result["report"] = str(report)
    if json:
        print_json(result)
    else:
        print_facts(f"{gyro} against {star}", result)
