"""`geoposition attitude fuse`: star sensors and gyro to one attitude with its covariance."""

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
    star: Annotated[Path, typer.Option(help="Table t_s[,sensor],q_x,q_y,q_z,q_w, or SCA1A/B.")],
    gyro: Annotated[Path, typer.Option(help="Table t_s,w_x,w_y,w_z or t_s,d_x,d_y,d_z, or IMU1.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Attitude table to write.")],
    method: Annotated[
        Literal["ekf", "ukf", "cf", "cf-ukf", "rts", "two-filter", "graph"],
        typer.Option(help="Filters ekf, ukf, cf, cf-ukf; smoothers rts, two-filter, graph."),
    ] = "rts",
    gyro_model: Annotated[
        Literal["bias", "general"],
        typer.Option(help="general: scale factors and misalignments too."),
    ] = "bias",
    mounting: MountingOption = None,
    columns: ColumnsOption = None,
    gyro_columns: Annotated[
        Path | None, typer.Option(help="The same for the gyro's table, where it differs.")
    ] = None,
    preset: PresetOption = None,
    sensor: SensorOption = None,
    star_sigma_arcsec: Annotated[
        float | None, typer.Option(help="Star noise per axis; the table's, or estimated.")
    ] = None,
    star_bore_sigma_arcsec: Annotated[
        float | None, typer.Option(help="The same about the boresight, where it differs.")
    ] = None,
    angle_random_walk: Annotated[
        float | None, typer.Option(help="Gyro, rad/s^0.5; estimated if not given.")
    ] = None,
    rate_random_walk: Annotated[
        float | None, typer.Option(help="Gyro, rad/s^1.5; estimated if not given.")
    ] = None,
    bias_sigma: Annotated[float, typer.Option(help="Prior of the gyro bias, deg/h.")] = 2.0,
    scale_sigma: Annotated[float, typer.Option(help="Prior of scale factors, ppm.")] = 2000.0,
    misalignment_sigma: Annotated[
        float, typer.Option(help="Prior of misalignments, ppm (µrad).")
    ] = 2000.0,
    gate: Annotated[
        float | None,
        typer.Option(help="Leave out star samples beyond this chi-squared probability, as 0.999."),
    ] = None,
    robust: Annotated[
        bool, typer.Option("--robust", help="Weigh outliers down (method graph only).")
    ] = False,
    rate: Annotated[float | None, typer.Option(help="Epochs of the output, Hz.")] = None,
    at: Annotated[Path | None, typer.Option(help="Table t_s: epochs of the output.")] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Fuse star samples and gyro to the attitude, body to inertial, with standard deviations.

    Writes t_s,q_x,q_y,q_z,q_w,sigma_x_rad,...,bias_x,... at the gyro epochs, or at --rate or
    --at. Noise that is not given is estimated from the data. Conventions: see --columns.

    Example: geoposition attitude fuse --star star.csv --gyro gyro.csv -o fused.csv --method rts
    """
    from geoposition.errors import ArgumentError
    from geoposition.scripts.attitude import fusion
    from geoposition.scripts.attitude.input import Sources
    from geoposition.scripts.results import print_facts, print_json, progress_bar
    from geoposition.scripts.tables import check_output

    if rate is not None and at is not None:
        raise ArgumentError("--rate and --at: one of them expected, not both")
    if robust and method != "graph":
        raise ArgumentError("--robust: for --method graph only; --gate is for the others")
    if star_bore_sigma_arcsec is not None and star_sigma_arcsec is None:
        raise ArgumentError("--star-bore-sigma-arcsec: it belongs to a --star-sigma-arcsec")
    sigma = None
    if star_sigma_arcsec is not None:
        sigma = (star_sigma_arcsec, star_bore_sigma_arcsec or star_sigma_arcsec)
    check_output(output)
    if report is not None:
        check_output(report, (".html", ".htm"))
    sources = Sources(star, gyro, mounting, columns, gyro_columns, preset, sensor, sigma)
    options = fusion.Options(
        method, gyro_model, angle_random_walk, rate_random_walk, bias_sigma, scale_sigma,
        misalignment_sigma, gate, robust, rate, at,
    )  # fmt: skip
    with progress_bar("fusing", json) as progress:
        run = fusion.fuse(sources, options, progress)
    fusion.write(output, run)
    result = run.summary | {"output": str(output)}
    if report is not None:
        from geoposition.scripts.attitude import fusion_report as attitude_fusion_report

        attitude_fusion_report.write(report, run)
        result["report"] = str(report)
    if json:
        print_json(result)
    else:
        print_facts(str(output), result)
