"""`geoposition attitude preprocess`: raw star telemetry cleaned, filled and flagged."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.attitude.options import (
    ColumnsOption,
    PresetOption,
    ReportOption,
)
from geoposition.scripts.options import JsonOption


def command(
    star: Annotated[Path, typer.Argument(help="Table t_s[,sensor],q_x,q_y,q_z,q_w, or SCA1A/B.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Star table to write.")],
    threshold: Annotated[
        float, typer.Option(help="Outliers are so many sigma off the local motion.")
    ] = 5.0,
    window: Annotated[
        float | None, typer.Option(help="Seconds per window of the motion; chosen from the data.")
    ] = None,
    degree: Annotated[
        int, typer.Option(min=0, max=5, help="Of the polynomial that is the motion in a window.")
    ] = 2,
    longest_gap: Annotated[
        float | None, typer.Option(help="Seconds; longer gaps stay open. Ten usual steps.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the random samples.")] = 1,
    columns: ColumnsOption = None,
    preset: PresetOption = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Clean star samples: duplicates, broken quaternions, outliers (RANSAC), short gaps.

    Writes the star table with a column flag: ok, broken, outlier_replaced, gap. Samples whose
    flag is not ok come from the model of the motion; duplicate and backward rows are dropped.

    Example: geoposition attitude preprocess raw.csv -o star.csv --report cleaned.html
    """
    from geoposition.scripts.attitude import cleaning as attitude_cleaning
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.tables import check_output, write_table

    check_output(output)
    if report is not None:
        check_output(report, (".html", ".htm"))
    with progress_bar("cleaning", json):
        found = attitude_cleaning.clean(
            star, columns, preset, threshold, window, degree, longest_gap, seed
        )
    write_table(output, attitude_cleaning.columns(found))
    result = attitude_cleaning.summary(found) | {"output": str(output)}
    if report is not None:
        from geoposition.scripts.attitude import report as attitude_report

        attitude_report.write_cleaning(report, str(star), found)
        result["report"] = str(report)
    if json:
        print_json(result)
    else:
        print_facts(str(output), result)
