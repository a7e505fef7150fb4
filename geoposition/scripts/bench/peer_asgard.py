# mypy: disable-error-code="import-not-found,import-untyped"
"""ASGARD, the Copernicus geometry library, on Orekit and pyrugged."""

from __future__ import annotations

import warnings
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import UnsupportedError
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Contender, Missing
from geoposition.scripts.bench.orekit_data import InertialSeries, inertial_series
from geoposition.scripts.bench.peer_pyrugged import orekit_data, start_orekit, tile_updater
from geoposition.scripts.bench.work import RigorousWork, every
from geoposition.timescale import Epoch

_VERSION = installed("asgard-eopf")
NAME = f"ASGARD {_VERSION}" if _VERSION else "ASGARD"
_TOLERANCE_PX = 1e-4
_NOTE = "numpy on Orekit, 1 thread"


def direct(work: RigorousWork, wanted: int) -> Contender | Missing:
    """Direct location at one height, on the regular grid of points that ASGARD is made for."""
    try:
        geometry = _geometry(inertial_series(work.scene.model), work.scene.model.shape, None)
    except (ImportError, UnsupportedError) as error:
        return Missing(NAME, str(error))
    rows = every(work.points, wanted)
    pixels = np.ascontiguousarray(work.image_px[rows][:, ::-1])

    def run() -> Any:
        return geometry.direct_loc(pixels.copy(), altitude=work.height_m)

    return Contender(NAME, rows, run, _ecef, _NOTE)


def inverse(work: RigorousWork, wanted: int) -> Contender | Missing:
    """Inverse location, which iterates on the direct one."""
    try:
        geometry = _geometry(inertial_series(work.scene.model), work.scene.model.shape, None)
    except (ImportError, UnsupportedError) as error:
        return Missing(NAME, str(error))
    rows = every(work.points, wanted)
    ground = work.geodetic[rows].copy()
    ground[:, :2] = np.degrees(ground[:, :2])
    height = np.ascontiguousarray(ground[:, 2])

    def run() -> Any:
        return geometry.inverse_loc(ground.copy(), tolerance=_TOLERANCE_PX, altitude=height)

    def result(raw: Any) -> FloatArray:
        return np.asarray(raw)[:, ::-1]

    return Contender(NAME, rows, run, result, _NOTE)


def on_dem(work: RigorousWork, dem: Path, wanted: int) -> Contender | Missing:
    """Direct location on a raster."""
    try:
        geometry = _geometry(inertial_series(work.scene.model), work.scene.model.shape, dem)
    except (ImportError, UnsupportedError) as error:
        return Missing(NAME, str(error))
    rows = every(work.points, wanted)
    pixels = np.ascontiguousarray(work.image_px[rows][:, ::-1])

    def run() -> Any:
        return geometry.direct_loc(pixels.copy())

    return Contender(NAME, rows, run, _ecef, _NOTE)


def _geometry(series: InertialSeries, shape: tuple[int, int], dem: Path | None) -> Any:
    start_orekit()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asgard.core.product import AbstractGeometry
        from asgard.models.body import EarthBody
        from asgard.models.linedetector import LineDetectorPointingModel, LineDetectorTimestampModel
        from asgard.models.orbit import GenericOrbitModel
        from asgard.models.platform import GenericPlatformModel
        from asgard.models.propagation import PropagationModel
        from asgard.models.time import TimeReference

    text, ahead_s = _gps_epoch(series.epoch)

    def times(seconds: FloatArray) -> dict[str, Any]:
        return {"offsets": seconds + ahead_s, "unit": "s", "epoch": text}

    body = EarthBody(ellipsoid="WGS84", time_reference=TimeReference(orekit_data=orekit_data()))

    class LineScanner(AbstractGeometry):  # type: ignore[misc]
        _instr_list = ("default",)

        def __init__(self) -> None:
            super().__init__()
            self.coordinates = {"default": {"pixels": shape[1], "lines": shape[0]}}
            lines = np.arange(shape[0], dtype=np.float64)
            line_s = series.first_s + series.period_s * lines
            self.timestamp_models["default"] = LineDetectorTimestampModel(
                times={**times(line_s), "ref": "GPS"}
            )
            self.pointing_model = LineDetectorPointingModel(
                unit_vectors={"default": series.directions}
            )
            self.platform_model = GenericPlatformModel(
                states=[{"name": "default", "origin": "platform", "rotation": np.eye(3)}],
            )
            self.orbit_model = GenericOrbitModel(
                orbit={
                    "times": {"GPS": times(series.orbit_s)},
                    "positions": series.position_m,
                    "velocities": series.velocity_m_s,
                    "frame": "EME2000",
                },
                attitude={
                    "times": {"GPS": times(series.attitude_s)},
                    "quaternions": series.quat_xyzw,
                    "frame": "EME2000",
                },
                earth_body=body,
                interpolation_window=8,
            )
            self.propagation_model = PropagationModel(
                earth_body=body,
                light_time_correction=True,
                aberration_of_light_correction=True,
            )
            if dem is not None:
                _on_raster(self.propagation_model, dem)

        @classmethod
        def init_schema(cls) -> dict[str, Any]:
            return {"type": "object"}

    return LineScanner()


def _on_raster(model: Any, dem: Path) -> None:
    """Give a propagation model a raster; ASGARD itself reads heights from Zarr stores only."""
    from pyrugged.intersection.algorithm_id import AlgorithmId
    from pyrugged.intersection.intersection_algorithm import create_intersection_algorithm
    from pyrugged.location.optical import CorrectionsParams, OpticalLocation
    from pyrugged.model.pyrugged import PyRugged

    model.optical_loc = OpticalLocation(
        PyRugged(ellipsoid=model.ellipsoid, sc_to_body=None, sensors=None, name=None),
        create_intersection_algorithm(AlgorithmId.DUVENHAGE, tile_updater(dem), 8),
        CorrectionsParams(True, True, None),
    )


def _gps_epoch(epoch: Epoch) -> tuple[str, float]:
    """Give a whole second of GPS time before `epoch` as text, and the seconds from there."""
    seconds = epoch.gps_seconds
    whole = int(np.floor(seconds))
    date = datetime(1980, 1, 6) + timedelta(seconds=whole)
    return date.strftime("%Y-%m-%d_%H:%M:%S"), float(seconds - whole)


def _ecef(raw: Any) -> FloatArray:
    ground = np.array(raw[0], dtype=np.float64)
    ground[:, :2] = np.radians(ground[:, :2])
    return geodetic_to_ecef(ground)
