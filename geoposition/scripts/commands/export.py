"""`geoposition export`: a rigorous model as a CSM state or as our own model file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[Path, typer.Argument(help="Product with a rigorous model.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help=".json: CSM state (ISIS, ASP); .toml: ours.")
    ],
    height: Annotated[
        float | None,
        typer.Option(help="Height at which the CSM rays are exact; mid of the model's range."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Write the rigorous model for other tools (CSM line-scanner state) or as a model file.

    Example: geoposition export DIM_PHR1A.XML -o camera.json
    """
    from dataclasses import asdict

    from geoposition.errors import ArgumentError, UnsupportedError
    from geoposition.pushbroom import PushbroomModel
    from geoposition.scripts.results import print_facts, print_json
    from geoposition.scripts.tables import check_output
    from geoposition.sensors.readers import open_product
    from geoposition.sensors.writers.csm import write_csm
    from geoposition.sensors.writers.model_file import write_model_file

    check_output(output, (".json", ".toml"))
    opened = open_product(product)
    if not isinstance(opened.model, PushbroomModel):
        raise UnsupportedError(
            product, "", "a rigorous model expected, this is an RPC (see `rpc convert`)"
        )
    if output.suffix.lower() == ".toml":
        if height is not None:
            raise ArgumentError("--height: for CSM states only")
        report = asdict(
            write_model_file(opened.model, output, sensor=opened.sensor, image=opened.image_path)
        )
    else:
        name = "" if opened.image_path is None else opened.image_path.name
        report = asdict(
            write_csm(opened.model, output, height_m=height, sensor=opened.sensor, image=name)
        )
    if json:
        print_json(report)
    else:
        print_facts(str(output), report)
