"""Producers' direct location grids: longitude and latitude of image nodes at several heights.

A GeoTIFF with two bands per height; the heights are in its tags ALTITUDE_B0, ALTITUDE_B1, ....
The geotransform gives the first node and the steps, in a system where the image's first pixel
spans 0 .. 1 (GDAL's): its centre is (0.5, 0.5) there, (0, 0) here.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import MissingFileError, ProductError, UnsupportedError


@dataclass(frozen=True, slots=True)
class LocationGrid:
    """Ground of nodes: `lon_rad`, `lat_rad` (heights, n, m) at `height_m` (heights,).

    Node (i, j) is the image point (`lines_px`[i], `samples_px`[j]), first pixel's centre (0, 0).
    """

    lines_px: FloatArray
    samples_px: FloatArray
    height_m: FloatArray
    lon_rad: FloatArray
    lat_rad: FloatArray

    @property
    def image_px(self) -> FloatArray:
        """Image points of the nodes, (n, m, 2)."""
        return np.stack(np.meshgrid(self.lines_px, self.samples_px, indexing="ij"), axis=-1)

    @property
    def geodetic(self) -> FloatArray:
        """Ground points of all nodes, (heights, n, m, 3)."""
        height = np.broadcast_to(self.height_m[:, None, None], self.lon_rad.shape)
        return np.stack([self.lon_rad, self.lat_rad, height], axis=-1)


def read_location_grid(path: str | Path) -> LocationGrid:
    """Read a direct location grid; anything else is a `ProductError`."""
    path = Path(path)
    if not path.is_file():
        raise MissingFileError(path, "", "there is no such file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as grid:
                bands, tags, at = grid.read(), grid.tags(), grid.transform
    except RasterioError as error:
        raise ProductError(path, "", f"a readable GeoTIFF expected ({error})") from None
    if "GEOID" in tags.get("REF", "").upper():
        raise UnsupportedError(path, "REF", "heights above the ellipsoid expected")
    heights = []
    for band in range(0, len(bands) - len(bands) % 2, 2):
        pair = {tags.get(f"ALTITUDE_B{band}"), tags.get(f"ALTITUDE_B{band + 1}")}
        text = pair.pop()
        if pair or text is None or not re.fullmatch(r"[+-]?\d+(\.\d*)?([eE][+-]?\d+)?", text):
            raise ProductError(path, f"ALTITUDE_B{band}", "one height for both bands expected")
        heights.append(float(text))
    if not heights or len(bands) % 2 or at.b or at.d or not (at.a and at.e):
        raise ProductError(path, "bands", "longitude and latitude at each height expected")
    rows, cols = bands.shape[1:]
    return LocationGrid(
        read_only(at.f - 0.5 + np.arange(rows) * at.e),
        read_only(at.c - 0.5 + np.arange(cols) * at.a),
        read_only(heights),
        read_only(np.radians(bands[0::2])),
        read_only(np.radians(bands[1::2])),
    )
