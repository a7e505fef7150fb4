"""The ground that an image shows, as GeoJSON: cut at ±180°, whole around a pole."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.flags import has_result
from geoposition.sensor_model import SensorModel

_ALONG = 8
_TURN_DEG = 360.0


def footprint(model: SensorModel) -> dict[str, object]:
    """Ground of the image at the middle of its heights: corners and a polygon.

    Corners (lon, lat in degrees) clockwise in the image from (0, 0). The polygon is a GeoJSON
    geometry, its rings counter-clockwise; none where the image's edge misses the Earth.

    *Source*: RFC 7946, 3.1.6 and 3.1.9 (cut at the antimeridian).
    """
    lines, samples = model.shape
    height = float(np.mean(model.height_range_m))
    corners = [[0, 0], [0, samples - 1], [lines - 1, samples - 1], [lines - 1, 0]]
    ground = model.image_to_ground(np.array(corners, dtype=np.float64), height)
    degrees = np.round(np.degrees(ground.geodetic[:, :2]), 9)
    return {
        "height_m": height,
        "corners_lon_lat_deg": degrees.tolist(),
        "geojson": _geometry(model, height),
    }


def _geometry(model: SensorModel, height_m: float) -> dict[str, object] | None:
    edge = model.image_to_ground(_edge(model.shape), height_m)
    if not has_result(edge.flag).all():
        return None
    lon, lat = np.degrees(edge.geodetic[:, :2]).T
    rings = _rings(np.unwrap(lon, period=_TURN_DEG), lat)
    if rings is None:
        return None
    polygons = [[np.round(ring, 9).tolist()] for ring in rings]
    if len(polygons) == 1:
        return {"type": "Polygon", "coordinates": polygons[0]}
    return {"type": "MultiPolygon", "coordinates": polygons}


def _edge(shape: tuple[int, int]) -> FloatArray:
    """Image points around the image, closed: the outer edges of its pixels."""
    corners = np.array([[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]]) * np.array(shape) - 0.5
    share = np.arange(_ALONG)[:, None] / _ALONG
    sides = [a + share * (b - a) for a, b in pairwise(corners)]
    return np.concatenate([*sides, corners[-1:]])


def _rings(lon: FloatArray, lat: FloatArray) -> list[FloatArray] | None:
    """Cut the area in a closed line of unwrapped longitudes into rings (n, 2) within ±180°."""
    import shapely
    from shapely.geometry.polygon import orient

    turns = round(float(lon[-1] - lon[0]) / _TURN_DEG)
    ring = np.column_stack([lon, lat])
    ring[-1] = lon[0] + turns * _TURN_DEG, lat[0]  # but for rounding it is
    if turns:
        # once around a pole: along its meridians to the pole and back
        pole = 90.0 if lat.mean() > 0.0 else -90.0
        ring = np.concatenate([ring, [[ring[-1, 0], pole], [lon[0], pole]], ring[:1]])
    shape = shapely.Polygon(ring)
    if not shape.is_valid:
        return None
    first = int(np.floor((ring[:, 0].min() + 180.0) / _TURN_DEG))
    last = int(np.ceil((ring[:, 0].max() + 180.0) / _TURN_DEG))
    parts = []
    for k in range(first, last):
        world = shapely.box(_TURN_DEG * k - 180.0, -90.0, _TURN_DEG * k + 180.0, 90.0)
        part = shapely.intersection(shape, world)
        parts.append(shapely.transform(part, lambda xy, k=k: xy - [_TURN_DEG * k, 0.0]))
    # On a grid as fine as what is written, so that a seam closes in spite of rounding.
    whole = shapely.get_parts(shapely.union_all(parts, grid_size=1e-9))
    rings = [shapely.get_coordinates(orient(part)) for part in whole if part.geom_type == "Polygon"]
    return rings or None
