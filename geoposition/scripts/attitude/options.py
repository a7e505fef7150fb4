"""Options that the attitude commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

MountingOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="TOML file (or QSA1B) with each sensor's rotation to the body."),
]
ColumnsOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="TOML file that says which column is what, in which units and order."),
]
PresetOption: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Known columns: contract, spice, mro, chandrayaan2, fermi."),
]
SensorOption: TypeAlias = Annotated[
    list[str] | None, typer.Option("--sensor", help="Use only this star head; may be repeated.")
]
ReportOption: TypeAlias = Annotated[Path | None, typer.Option(help="HTML page to write.")]
