# mypy: disable-error-code="import-not-found,import-untyped"
"""CNES shareloc, its C++ RPC where it has one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.rays import Rays
from geoposition.rpc.model import RpcModel
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Contender, Missing
from geoposition.scripts.bench.work import RpcWork, every

_VERSION = installed("shareloc")
NAME = f"shareloc {_VERSION}" if _VERSION else "shareloc"


def _model(model: RpcModel) -> Any:
    from shareloc.geomodels.rpc_optim import RPCoptim

    return RPCoptim(
        {
            "offset_x": model.lon_off_deg,
            "scale_x": model.lon_scale_deg,
            "offset_y": model.lat_off_deg,
            "scale_y": model.lat_scale_deg,
            "offset_alt": model.height_off_m,
            "scale_alt": model.height_scale_m,
            "offset_col": model.samp_off_px,
            "scale_col": model.samp_scale_px,
            "offset_row": model.line_off_px,
            "scale_row": model.line_scale_px,
            "num_col": model.samp_num.tolist(),
            "den_col": model.samp_den.tolist(),
            "num_row": model.line_num.tolist(),
            "den_row": model.line_den.tolist(),
            "num_x": None,
            "den_x": None,
            "num_y": None,
            "den_y": None,
        }
    )


def project(work: RpcWork, wanted: int) -> Contender | Missing:
    """Ground to image."""
    try:
        peer = _model(work.model)
    except ImportError as error:
        return _absent(error)
    rows = every(work.points, wanted)
    lon, lat, height = work.degrees(rows)

    def run() -> Any:
        return peer.inverse_loc(lon, lat, height)

    def result(raw: Any) -> FloatArray:
        return np.stack([np.asarray(raw[0]), np.asarray(raw[1])], axis=-1)

    return Contender(NAME, rows, run, result, "C++, 1 thread")


def locate(work: RpcWork, wanted: int) -> Contender | Missing:
    """Image to ground at given heights."""
    try:
        peer = _model(work.model)
    except ImportError as error:
        return _absent(error)
    rows = every(work.points, wanted)
    line, sample, height = work.pixels(rows)

    def run() -> Any:
        return peer.direct_loc_h(line, sample, height)

    return Contender(NAME, rows, run, _ecef, "C++, 1 thread")


def locate_on_dem(
    work: RpcWork, dem: Path, geoid: Path | None, roi_deg: list[float], wanted: int
) -> Contender | Missing:
    """Image to ground on a raster; `roi_deg` is the part to read: south, west, north, east.

    As shareloc's own users do, the geoid is added and the surface built once, outside the
    timing; so are ours.
    """
    try:
        import bindings_cpp
        from shareloc.dtm_reader import dtm_reader

        peer = _model(work.model)
    except ImportError as error:
        return _absent(error)
    image = dtm_reader(
        str(dem),
        None if geoid is None else str(geoid),
        roi=roi_deg,
        roi_is_in_physical_space=True,
        fill_nodata=None,
    )
    terrain = bindings_cpp.DTMIntersection(
        image.epsg, image.alt_data, image.nb_rows, image.nb_columns, image.transform
    )
    rows = every(work.points, wanted)
    line, sample, _ = work.pixels(rows)

    def run() -> Any:
        return peer.direct_loc_dtm(line, sample, terrain)

    return Contender(NAME, rows, run, _ecef, "C++, 1 thread")


def triangulate(
    left: RpcWork, right: RpcWork, low_high_m: tuple[float, float], wanted: int
) -> Contender | Missing:
    """From matches to ground points."""
    try:
        from shareloc.geofunctions.triangulation import sensor_triangulation

        peers = _model(left.model), _model(right.model)
    except ImportError as error:
        return _absent(error)
    rows = every(left.points, wanted)
    matches = np.concatenate(
        [left.image_px[rows][:, ::-1], right.image_px[rows][:, ::-1]], axis=1
    )  # shareloc takes column, row

    def run() -> Any:
        return sensor_triangulation(matches, *peers, list(low_high_m), list(low_high_m))

    def result(raw: Any) -> FloatArray:
        return np.asarray(raw[0])

    return Contender(NAME, rows, run, result, "numpy, C++ for the RPC")


def intersect(a: Rays, b: Rays, wanted: int) -> Contender | Missing:
    """From rays to ground points."""
    try:
        from shareloc.geofunctions.triangulation import n_view_triangulation
        from shareloc.proj_utils import coordinates_conversion
    except ImportError as error:
        return _absent(error)
    rows = every(len(a.flag), wanted)
    starts = np.stack([a.origin_ecef_m[rows], b.origin_ecef_m[rows]], axis=1)
    # shareloc's vectors point up
    directions = -np.stack([a.direction_ecef[rows], b.direction_ecef[rows]], axis=1)

    def run() -> Any:
        points = n_view_triangulation(starts, directions)
        return points, coordinates_conversion(points, 4978, 4326)

    def result(raw: Any) -> FloatArray:
        return np.asarray(raw[0])

    return Contender(NAME, rows, run, result, "numpy")


def _ecef(raw: Any) -> FloatArray:
    ground = np.asarray(raw, dtype=np.float64)
    ground[:, :2] = np.radians(ground[:, :2])
    return geodetic_to_ecef(ground)


def _absent(error: ImportError) -> Missing:
    return Missing(NAME, f"not installed ({error})")
