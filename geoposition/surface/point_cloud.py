"""A point cloud as LAS or LAZ 1.4, written as the points come: the only door to laspy.

Coordinates are those of a map system with ellipsoidal heights, to the millimetre. Intensity is
the grey value, user data the number of images, and `sigma_z` (m) the standard deviation of the
height.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import laspy
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import NDArray
from rasterio.crs import CRS

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError

SUFFIXES: Final = (".las", ".laz")

_STEP_M: Final = 1e-3
_STEP_DEG: Final = 1e-8
_POINT_FORMAT: Final = 6
_CHUNK: Final = 1 << 20


class PointCloud:
    """A file being written; a context manager. Nothing is told of it until it is closed."""

    def __init__(self, path: str | PathLike[str], crs: str | int, origin: FloatArray):
        """`origin` (3,) is a place near the points: coordinates are stored from there."""
        suffix = Path(path).suffix.lower()
        if suffix not in SUFFIXES:
            raise ArgumentError(f"point cloud: .las or .laz expected, got {Path(path).name!r}")
        system = CRS.from_user_input(crs)
        header = laspy.LasHeader(point_format=_POINT_FORMAT, version="1.4")
        step = _STEP_DEG if system.is_geographic else _STEP_M
        header.scales = np.array([step, step, _STEP_M])
        header.offsets = np.floor(np.asarray(origin, dtype=np.float64))
        header.vlrs.append(WktCoordinateSystemVlr(system.to_wkt(version="WKT1_GDAL")))
        header.global_encoding.wkt = True
        header.generating_software = "geoposition"
        header.add_extra_dim(laspy.ExtraBytesParams("sigma_z", np.float32, "sigma of height, m"))
        self.points = 0
        self._header = header
        self._writer: Any = laspy.open(
            str(path), mode="w", header=header, do_compress=suffix == ".laz"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.close()

    def add(
        self,
        map_points: FloatArray,
        sigma_m: NDArray[np.float32],
        grey: NDArray[np.float32],
        rays: NDArray[np.uint8],
    ) -> None:
        """Append points (n, 3), their sigmas, grey values and numbers of images (n,)."""
        for first in range(0, len(map_points), _CHUNK):
            part = slice(first, first + _CHUNK)
            n = len(map_points[part])
            record = laspy.ScaleAwarePointRecord.zeros(n, header=self._header)
            record.x, record.y, record.z = map_points[part].T
            record.intensity = np.clip(np.nan_to_num(grey[part]), 0, 65535).astype(np.uint16)
            record.user_data = rays[part]
            record.return_number[:] = 1
            record.number_of_returns[:] = 1
            record.sigma_z = sigma_m[part]
            self._writer.write_points(record)
            self.points += n
