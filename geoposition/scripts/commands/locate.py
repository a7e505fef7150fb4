"""`geoposition locate`: image points to the ground."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    product: Annotated[Path, typer.Argument(help="Product: metadata file, folder, RPC, model.")],
    points: Annotated[Path, typer.Argument(help="Table with id,row,col[,height].")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Table to write.")],
    height: Annotated[
        float | None, typer.Option(help="Ellipsoidal height of all points, metres.")
    ] = None,
    dem: Annotated[Path | None, typer.Option(help="Raster of heights to locate on.")] = None,
    geoid: Annotated[
        Path | None, typer.Option(help="Geoid grid: the DEM's heights are orthometric.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Locate image points on the ground: on a height, or where they meet a DEM.

    Writes id,row,col,lon,lat,height,flag: degrees on WGS 84, metres above the ellipsoid. Without
    --height and --dem the table needs a column height.

    Example: geoposition locate DIM_PHR1A.XML points.csv -o ground.csv --height 120
    """
    import numpy as np

    from geoposition.errors import ArgumentError
    from geoposition.flags import Flag
    from geoposition.locate import locate
    from geoposition.scripts import point_tables
    from geoposition.scripts.results import progress_bar
    from geoposition.scripts.tables import check_output, read_table
    from geoposition.sensor_model import GroundPoints
    from geoposition.sensors.readers import open_product
    from geoposition.terrain import ConstantTerrain, Terrain

    if height is not None and dem is not None:
        raise ArgumentError("--height and --dem: one of them expected, not both")
    if geoid is not None and dem is None:
        raise ArgumentError("--geoid: it belongs to a --dem, and none is given")
    check_output(output)
    opened = open_product(product)
    table = read_table(points, ("row", "col"), optional=("height",))
    image = np.stack([table["row"], table["col"]], axis=1).astype(np.float64)
    terrain: Terrain | None = None
    if dem is not None:
        from geoposition.terrain.raster import RasterTerrain

        terrain = RasterTerrain(dem, geoid)
    elif height is not None:
        terrain = ConstantTerrain(height)
    with progress_bar("locating", json) as progress:
        if terrain is not None:
            ground = locate(opened.model, image, terrain, progress)
        elif "height" in table:
            ground = opened.model.image_to_ground(image, table["height"])
        else:
            raise ArgumentError(f"{points}: a column height expected, or one of --height and --dem")
    flag = np.where(np.isfinite(image).all(axis=1), ground.flag, np.uint8(Flag.BAD_INPUT))
    point_tables.finish(
        output,
        {"id": table["id"], "row": table["row"], "col": table["col"]}
        | point_tables.ground_columns(GroundPoints(ground.geodetic, flag)),
        flag,
        points,
        json,
    )
