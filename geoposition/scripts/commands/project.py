"""`geoposition project`: ground points into the image."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[Path, typer.Argument(help="Product: metadata file, folder, RPC, model.")],
    points: Annotated[Path, typer.Argument(help="Table with id,lon,lat,height.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Table to write.")],
    json: JsonOption = False,
) -> None:
    """Project ground points (degrees, metres above the ellipsoid, WGS 84) into the image.

    Writes id,lon,lat,height,row,col,flag; the first pixel's centre is (0, 0).

    Example: geoposition project DIM_PHR1A.XML gcps.csv -o image.csv
    """
    import numpy as np

    from geoposition.scripts import point_tables
    from geoposition.scripts.tables import check_output, read_table
    from geoposition.sensors.readers import open_product

    check_output(output)
    opened = open_product(product)
    table = read_table(points, ("lon", "lat", "height"))
    image = opened.model.ground_to_image(point_tables.geodetic_of(table))
    names = ("id", "lon", "lat", "height")
    columns = {name: table[name] for name in names}
    columns |= {"row": image.image_px[:, 0], "col": image.image_px[:, 1]}
    point_tables.finish(output, columns, np.asarray(image.flag), points, json)
