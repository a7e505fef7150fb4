# mypy: disable-error-code="import-not-found,import-untyped"
"""pyrugged, the Python port of Rugged, on Orekit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import UnsupportedError
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Contender, Missing
from geoposition.scripts.bench.orekit_data import (
    InertialSeries,
    inertial_series,
    read_heights,
)
from geoposition.scripts.bench.work import RigorousWork, every

_VERSION = installed("pyrugged")
NAME = f"pyrugged {_VERSION}" if _VERSION else "pyrugged"
_CACHE_STEP_S = 0.02
_MARGIN_PX = 100
_NOTE = "Python on Orekit, 1 thread"


def start_orekit() -> None:
    """Start Orekit with the Earth orientation that pyrugged ships, once."""
    import orekit_jcc

    if orekit_jcc.getVMEnv() is None:
        from pyrugged.configuration.init_orekit import init_orekit

        init_orekit()


def orekit_data() -> str:
    """Folder of the Earth orientation and leap seconds that pyrugged ships."""
    import pyrugged

    return str(Path(pyrugged.__file__).parent / "data" / "orekit-data-master")


def direct(work: RigorousWork, wanted: int) -> Contender | Missing:
    """Direct location at one height."""
    try:
        location = _location(inertial_series(work.scene.model), None)
    except (ImportError, UnsupportedError) as error:
        return Missing(NAME, str(error))
    rows = every(work.points, wanted)
    line, sample = _columns(work.image_px[rows])
    height = np.full(len(line), work.height_m)

    def run() -> Any:
        return location.direct_location(line, sample, height)

    return Contender(NAME, rows, run, _ecef, _NOTE)


def inverse(work: RigorousWork, wanted: int) -> Contender | Missing:
    """Inverse location."""
    try:
        location = _location(inertial_series(work.scene.model), None)
    except (ImportError, UnsupportedError) as error:
        return Missing(NAME, str(error))
    rows = every(work.points, wanted)
    lon, lat, height = (np.ascontiguousarray(work.geodetic[rows, i]) for i in range(3))
    last = work.scene.model.shape[0] - 1

    def run() -> Any:
        return location.inverse_location(-_MARGIN_PX, last + _MARGIN_PX, lat, lon, height)

    def result(raw: Any) -> FloatArray:
        return np.stack([np.array(column, dtype=np.float64) for column in raw], axis=-1)

    return Contender(NAME, rows, run, result, _NOTE)


def on_dem(work: RigorousWork, dem: Path, wanted: int) -> Contender | Missing:
    """Direct location on a raster, by Duvenhage's algorithm."""
    try:
        location = _location(inertial_series(work.scene.model), dem)
    except (ImportError, UnsupportedError) as error:
        return Missing(NAME, str(error))
    rows = every(work.points, wanted)
    line, sample = _columns(work.image_px[rows])

    def run() -> Any:
        return location.direct_location(line, sample)

    return Contender(NAME, rows, run, _ecef, _NOTE)


def tile_updater(dem: Path) -> Any:
    """Pyrugged's source of heights: the whole raster is its one tile."""
    from pyrugged.raster.tile_updater import TileUpdater

    heights = read_heights(dem)

    class OneTile(TileUpdater):  # type: ignore[misc]
        def update_tile(self, latitude: float, longitude: float, tile: Any) -> None:
            tile.set_geometry(
                heights.south_rad,
                heights.west_rad,
                heights.step_lat_rad,
                heights.step_lon_rad,
                *heights.height_m.shape,
            )
            tile.set_elevation_block(heights.height_m)

    return OneTile()


def _location(series: InertialSeries, dem: Path | None) -> Any:
    start_orekit()
    from java.util import ArrayList  # noqa: F401  (its import fails where Orekit did not start)
    from org.hipparchus.geometry.euclidean.threed import Rotation, Vector3D
    from org.orekit.time import AbsoluteDate, TimeScalesFactory
    from org.orekit.utils import (
        AngularDerivativesFilter,
        CartesianDerivativesFilter,
        TimeStampedAngularCoordinates,
        TimeStampedPVCoordinates,
    )
    from pyrugged.bodies.body_rotating_frame_id import BodyRotatingFrameId
    from pyrugged.bodies.ellipsoid_id import EllipsoidId
    from pyrugged.intersection.algorithm_id import AlgorithmId
    from pyrugged.intersection.intersection_algorithm import create_intersection_algorithm
    from pyrugged.line_sensor.line_sensor import LineSensor
    from pyrugged.line_sensor.linear_line_datation import LinearLineDatation
    from pyrugged.location.optical import CorrectionsParams, OpticalLocation
    from pyrugged.los.los_builder import LOSBuilder
    from pyrugged.model.inertial_frame_id import InertialFrameId
    from pyrugged.model.pyrugged_builder import PyRuggedBuilder

    utc = TimeScalesFactory.getUTC()
    epoch = AbsoluteDate(series.epoch.utc_iso(9).rstrip("Z"), utc)

    def at(seconds: float) -> Any:
        return epoch.shiftedBy(float(seconds))

    orbit = [
        TimeStampedPVCoordinates(at(t), Vector3D(*p.tolist()), Vector3D(*v.tolist()), Vector3D.ZERO)
        for t, p, v in zip(series.orbit_s, series.position_m, series.velocity_m_s, strict=True)
    ]
    # Hipparchus' rotations take the frame, not the vector, round
    attitude = [
        TimeStampedAngularCoordinates(
            at(t),
            Rotation(float(q[3]), float(q[0]), float(q[1]), float(q[2]), True),
            Vector3D.ZERO,
            Vector3D.ZERO,
        )
        for t, q in zip(series.attitude_s, series.quat_xyzw, strict=True)
    ]
    builder = PyRuggedBuilder()
    builder.set_ellipsoid(
        ellipsoid_id=EllipsoidId.WGS84, body_rotating_frame_id=BodyRotatingFrameId.ITRF
    )
    builder.set_time_span(
        at(series.attitude_s[0]), at(series.attitude_s[-1]), _CACHE_STEP_S, _CACHE_STEP_S
    )
    builder.set_trajectory(
        orbit,
        8,
        CartesianDerivativesFilter.USE_PV,
        attitude,
        2,
        AngularDerivativesFilter.USE_R,
        inertial_frame_id=InertialFrameId.EME2000,
    )
    builder.add_sensor(
        LineSensor(
            "line",
            LinearLineDatation(at(series.first_s), 0.0, 1.0 / series.period_s),
            np.zeros(3),
            LOSBuilder(list(series.directions)).build(),
        )
    )
    if dem is None:
        algorithm = create_intersection_algorithm(AlgorithmId.CONSTANT_ELEVATION_OVER_ELLIPSOID)
    else:
        algorithm = create_intersection_algorithm(AlgorithmId.DUVENHAGE, tile_updater(dem), 8)
    return OpticalLocation(builder.build(), algorithm, CorrectionsParams(True, True, None))


def _columns(image_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.ascontiguousarray(image_px[:, 0]), np.ascontiguousarray(image_px[:, 1])


def _ecef(raw: Any) -> FloatArray:
    columns = [np.array(column, dtype=np.float64) for column in raw]
    return geodetic_to_ecef(np.stack(columns, axis=-1))
