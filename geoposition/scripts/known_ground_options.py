"""Options that the commands over known ground share, `evaluate` and `calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

DomOption: TypeAlias = Annotated[
    list[Path] | None, typer.Option(help="Reference orthophoto; tiles: several times.")
]
DemOption: TypeAlias = Annotated[
    list[Path] | None, typer.Option(help="DEM of the ground; tiles: several times.")
]
GeoidOption: TypeAlias = Annotated[
    Path | None, typer.Option(help="Geoid grid: the DEM's heights are orthometric.")
]
FieldOption: TypeAlias = Annotated[
    Path | None, typer.Option(help="Calibration field (field.toml) in place of these three.")
]
ReferenceSigmaOption: TypeAlias = Annotated[
    float | None,
    typer.Option(help="Standard deviation of the reference's place, per axis, m."),
]
SearchOption: TypeAlias = Annotated[float, typer.Option(help="How far off the model may be, m.")]
WindowOption: TypeAlias = Annotated[int, typer.Option(help="Side of a patch, pixels.")]
SpacingOption: TypeAlias = Annotated[
    int | None, typer.Option(help="Distance of patches, pixels; half a window.")
]
CorrelationOption: TypeAlias = Annotated[float, typer.Option(help="Least correlation of a match.")]
DomBandOption: TypeAlias = Annotated[
    int | None, typer.Option(help="Band of the orthophoto, from 1; their mean.")
]
