"""What the point commands share: columns to arrays and back, flags, the closing word."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from geoposition.arrays import FlagArray, FloatArray
from geoposition.errors import GeometryError
from geoposition.flags import Flag, flag_labels, has_result
from geoposition.scripts.results import print_facts, print_json
from geoposition.scripts.tables import Column, write_table
from geoposition.sensor_model import GroundPoints

_DEGREE_DIGITS = 12
_METRE_DIGITS = 6


def geodetic_of(table: Mapping[str, Column]) -> FloatArray:
    """Columns lon, lat (degrees), height as (n, 3) radians and metres; out of range is NaN."""
    lon = np.asarray(table["lon"], dtype=np.float64)
    lat = np.asarray(table["lat"], dtype=np.float64)
    lon = np.where(np.abs(lon) <= 360.0, lon, np.nan)
    lat = np.where(np.abs(lat) <= 90.0, lat, np.nan)
    height = np.asarray(table["height"], dtype=np.float64)
    return np.stack([np.radians(lon), np.radians(lat), height], axis=1)


def ground_columns(ground: GroundPoints) -> dict[str, Column]:
    """Columns lon, lat, height of located points, rounded far below a millimetre."""
    degrees = np.round(ground.geodetic[:, :2] * (180.0 / np.pi), _DEGREE_DIGITS)
    return {
        "lon": degrees[:, 0],
        "lat": degrees[:, 1],
        "height": np.round(ground.geodetic[:, 2], _METRE_DIGITS),
    }


def write_ground(
    path: Path, ids: Column, geodetic: FloatArray, sigma_m: float | None = None
) -> None:
    """Write known ground points (n, 3) as id,lon,lat,height: a table of control or checks.

    With `sigma_m` along each axis as sigma_e,sigma_n,sigma_u where it is given.
    """
    ground = GroundPoints(geodetic, np.full(len(geodetic), Flag.OK, dtype=np.uint8))
    columns: dict[str, Column] = {"id": np.asarray(ids, dtype=np.str_), **ground_columns(ground)}
    if sigma_m is not None:
        columns |= {f"sigma_{axis}": np.full(len(geodetic), sigma_m) for axis in "enu"}
    write_table(path, columns)


def flag_counts(flags: FlagArray) -> dict[str, int]:
    """How many points have each flag, `ok` first."""
    values, counts = np.unique(flags, return_counts=True)
    return {str(flag_labels(values)[i]): int(counts[i]) for i in range(len(values))}


def finish(
    output: Path, columns: Mapping[str, Column], flags: FlagArray, points: Path, json: bool
) -> None:
    """Write the table with its flags and say how many points were found.

    If no point has a result nothing is written: the whole input was bad.
    """
    counts = flag_counts(flags)
    if not np.any(has_result(flags)):
        reasons = ", ".join(f"{count} {name}" for name, count in counts.items())
        raise GeometryError(f"{points}: no point has a result ({reasons}); nothing is written")
    write_table(output, {**columns, "flag": flag_labels(flags)})
    result = {"points": len(flags), "ok": counts.get(Flag.OK.name.lower(), 0), "flags": counts}
    if json:
        print_json({**result, "output": str(output)})
    else:
        print_facts(str(output), result)
