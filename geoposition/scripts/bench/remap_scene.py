"""What re-imaging is measured on: a satellite that shakes, its image, a ready map of places."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from geoposition.attitude import Attitude
from geoposition.corrections import ALL_CORRECTIONS
from geoposition.ephemeris import Ephemeris
from geoposition.frames import R_itrs_gcrs, itrs_from_gcrs
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.cog import Layout, written_cog
from geoposition.reimage.mapping import RowMap
from geoposition.rpc.formats.geotiff import gdal_rpc
from geoposition.rpc.model import RpcModel
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.jitter_scene import JitterSceneOptions, simulate_jitter_scene
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.timing import ConstantLineRate

HEIGHT_M: Final = 300.0
STRIP: Final = 512
_IFOV_RAD: Final = 0.5 / 490e3
_LINE_S: Final = 7e-5


def shaken_model(rows: int, cols: int) -> PushbroomModel:
    """P's satellite over an image, its true attitude with the jitter of P figure 4."""
    told = simulate_jitter_scene(JitterSceneOptions(duration_s=12.0), seed=1)
    epoch, half_s = told.orbit.epoch, 0.5 * rows * _LINE_S
    reach = 1.1 * half_s + 0.05
    times = np.arange(-reach, reach, 1e-4)
    rotation = R_itrs_gcrs(epoch, times) * told.R_inertial_body(times)
    attitude = Attitude.from_samples(epoch, times, rotation.as_quat(), "itrs", "spline")
    knots = np.arange(-12.0, 12.5, 0.5)
    position, _ = itrs_from_gcrs(*told.orbit.states(knots), epoch, knots)
    middle = 0.5 * (cols - 1)
    directions = PolynomialDirections(
        np.zeros(1), np.array([0.0, middle * _IFOV_RAD]), middle, middle
    )
    timing = ConstantLineRate(epoch, -half_s, _LINE_S)
    camera = LineCamera.single((rows, cols), timing, directions)
    ephemeris = Ephemeris.lagrange(epoch, knots, position)
    return PushbroomModel(camera, ephemeris, attitude, ALL_CORRECTIONS, (-100.0, 1500.0))


def texture(rows: int, cols: int, first_row: int = 0) -> NDArray[np.uint16]:
    """Hills and noise of some grey values: compresses as a satellite's image does."""
    rng = np.random.default_rng(first_row)
    knots = np.arange(0, cols + 16, 16)
    across = np.interp(np.arange(cols), knots, rng.normal(0.0, 90.0, len(knots)))
    along = 60.0 * np.sin(2e-2 * np.arange(first_row, first_row + rows))
    level = (700.0 + across + along[:, None]).astype(np.uint16)
    noise = rng.integers(0, 13, (2, rows, cols), dtype=np.uint8).sum(axis=0, dtype=np.uint16)
    return np.asarray(level + noise)


def image_file(path: Path, rows: int, cols: int, rpc: RpcModel | None = None) -> None:
    """Write an image of any size, holding some rows of it."""
    layout = Layout((rows, cols), 1, "uint16", rpc=None if rpc is None else gdal_rpc(rpc))
    with written_cog(path, layout, "none", "none") as raster:
        for row in range(0, rows, STRIP):
            raster.write(texture(min(STRIP, rows - row), cols, row)[None])


def dense_places(places: RowMap, rows: int, cols: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Line and sample (rows, cols) in 32 bits of each pixel, as OpenCV takes them."""
    own = np.arange(cols, dtype=np.float64)
    place = places.part(0, rows).displacement_px(own)
    line = place[..., 0] + np.arange(rows, dtype=np.float64)[:, None]
    sample = place[..., 1] + own
    return line.astype(np.float32), sample.astype(np.float32)
