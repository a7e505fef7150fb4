"""`geoposition attitude axis-angle`: angles between star heads, which a stiff satellite keeps."""

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
    star: Annotated[Path, typer.Argument(help="Table t_s,sensor,q_x,q_y,q_z,q_w, or SCA1A.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Table to write: t_s,sensor_a,sensor_b,angle_deg."),
    ] = None,
    error_split: Annotated[
        bool,
        typer.Option("--error-split", help="Separate low-frequency, high-frequency and noise."),
    ] = False,
    orbit_period: Annotated[
        float | None, typer.Option(help="Seconds; of the errors that repeat with the orbit.")
    ] = None,
    mounting: MountingOption = None,
    columns: ColumnsOption = None,
    preset: PresetOption = None,
    sensor: SensorOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Measure the angles between the optical axes of star heads: mean, scatter, drift.

    With --mounting the angles that it says stand beside them.

    Example: geoposition attitude axis-angle star.csv --error-split --report angles.html
    """
    from geoposition.errors import ArgumentError
    from geoposition.scripts.attitude import checks as attitude_checks
    from geoposition.scripts.attitude.input import Sources
    from geoposition.scripts.results import print_json, progress_bar
    from geoposition.scripts.tables import check_output, write_table

    if orbit_period is not None and not error_split:
        raise ArgumentError("--orbit-period: it belongs to --error-split")
    if output is not None:
        check_output(output)
    if report is not None:
        check_output(report, (".html", ".htm"))
    sources = Sources(star=star, mounting=mounting, columns=columns, preset=preset, sensors=sensor)
    with progress_bar("measuring", json):
        found = attitude_checks.measure_axis_angles(sources, error_split, orbit_period)
    result = found.summary()
    if output is not None:
        write_table(output, found.columns())
        result["output"] = str(output)
    if report is not None:
        from geoposition.scripts.attitude import report as attitude_report

        attitude_report.write_axis_angles(report, str(star), found)
        result["report"] = str(report)
    if json:
        print_json(result)
    else:
        attitude_checks.print_axis_angles(str(star), result)
