"""`geoposition attitude determine`: attitude of each epoch from directions alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoposition.scripts.attitude.options import MountingOption, ReportOption
from geoposition.scripts.options import JsonOption


def command(
    vectors: Annotated[
        Path,
        typer.Argument(help="Table t_s,sensor,id,body_x,body_y,body_z,ref_x,ref_y,ref_z,sigma_rad"),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Attitude table to write.")],
    method: Annotated[
        Literal["triad", "q", "svd", "quest", "foam"],
        typer.Option(help="TRIAD takes the two best vectors; the others are least squares."),
    ] = "quest",
    mounting: MountingOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Determine the attitude, body to reference, of each epoch from its directions.

    Writes t_s,q_x,q_y,q_z,q_w,sigma_x_rad,sigma_y_rad,sigma_z_rad,loss,vectors,flag; an epoch
    with fewer than two vectors, or nearly parallel ones, has a flag and no numbers. With
    --mounting the directions are in each sensor's own axes.

    Example: geoposition attitude determine vectors.csv -o attitude.csv --method foam
    """
    from geoposition.scripts.attitude import static as attitude_static
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.tables import check_output, write_table

    check_output(output)
    if report is not None:
        check_output(report, (".html", ".htm"))
    with progress_bar("determining", json):
        found = attitude_static.determine(vectors, mounting, method)
    write_table(output, found.columns())
    result = found.summary() | {"output": str(output)}
    if report is not None:
        from geoposition.scripts.attitude import report as attitude_report

        attitude_report.write_static(report, str(vectors), found)
        result["report"] = str(report)
    if json:
        print_json(result)
    else:
        print_facts(str(output), result)
