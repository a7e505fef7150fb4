"""`geoposition attitude convert`: attitude in another frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoposition.scripts.attitude.options import (
    ColumnsOption,
    MountingOption,
    PresetOption,
)
from geoposition.scripts.options import JsonOption


def command(
    attitude: Annotated[Path, typer.Argument(help="Table t_s,q_x,q_y,q_z,q_w.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Attitude table to write.")],
    source: Annotated[
        Literal["inertial", "itrs", "orbit"], typer.Option("--from", help="Frame it is in.")
    ],
    target: Annotated[
        Literal["inertial", "itrs", "orbit"], typer.Option("--to", help="Frame it shall be in.")
    ],
    ephemeris: Annotated[
        Path | None, typer.Option(help="Table t_s,x,y,z,vx,vy,vz; for the orbit frame.")
    ] = None,
    frame: Annotated[
        Literal["itrs", "gcrs"] | None,
        typer.Option(help="Frame of the ephemeris, where the table does not say it."),
    ] = None,
    epoch: Annotated[
        str | None, typer.Option(help="UTC of t_s = 0; for inertial to Earth-fixed.")
    ] = None,
    orbit_axes: Annotated[
        Literal["zenith", "nadir", "spot"], typer.Option(help="Which axes the orbit frame has.")
    ] = "zenith",
    mounting: MountingOption = None,
    columns: ColumnsOption = None,
    preset: PresetOption = None,
    json: JsonOption = False,
) -> None:
    """Convert attitude (body to --from) into body to --to; standard deviations go along.

    To the orbit frame, roll_rad,pitch_rad,yaw_rad (turns yaw, roll, pitch) are added.

    Example: geoposition attitude convert fused.csv -o orbit.csv --from inertial --to orbit
    --ephemeris eph.csv --epoch 2015-10-13T00:00:00Z
    """
    from geoposition.scripts.attitude import conversion as attitude_conversion
    from geoposition.scripts.results import print_facts, print_json
    from geoposition.scripts.tables import check_output, write_table
    from geoposition.timescale import Epoch

    check_output(output)
    request = attitude_conversion.Request(
        attitude, source, target, ephemeris, frame,
        None if epoch is None else Epoch.from_utc(epoch), orbit_axes, columns, preset, mounting,
    )  # fmt: skip
    table, result = attitude_conversion.convert(request)
    write_table(output, table)
    result["output"] = str(output)
    if json:
        print_json(result)
    else:
        print_facts(str(output), result)
