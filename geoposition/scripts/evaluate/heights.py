"""Heights of a table of intersected points, beside the DEM."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.calib_fields.heights import HeightAccuracy, evaluate_heights
from geoposition.errors import GeometryError, ProductError
from geoposition.scripts.tables import read_table
from geoposition.terrain import Terrain


def height_accuracy(path: Path, terrain: Terrain, reference_sigma_m: float) -> HeightAccuracy:
    """Evaluate the heights of a table with columns lon, lat (degrees) and height."""
    columns = read_table(path, ("lon", "lat", "height"), texts=())
    lon, lat, height = (
        np.asarray(columns[name], dtype=np.float64) for name in ("lon", "lat", "height")
    )
    points: FloatArray = np.column_stack([np.radians(lon), np.radians(lat), height])
    try:
        return evaluate_heights(points, terrain, reference_sigma_m)
    except GeometryError as error:
        raise ProductError(path, "height", str(error)) from None
