# mypy: disable-error-code="import-not-found,import-untyped"
"""rpcm, in numpy."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.rpc.model import RpcModel
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Contender, Missing
from geoposition.scripts.bench.work import RpcWork, every

_VERSION = installed("rpcm")
NAME = f"rpcm {_VERSION}" if _VERSION else "rpcm"


def _model(model: RpcModel) -> Any:
    # rpcm imports srtm4, a source of heights that has no wheels and is not used here
    if installed("srtm4") is None:
        sys.modules.setdefault("srtm4", ModuleType("srtm4"))
    from rpcm.rpc_model import RPCModel

    return RPCModel(
        {
            "row_offset": model.line_off_px,
            "col_offset": model.samp_off_px,
            "lat_offset": model.lat_off_deg,
            "lon_offset": model.lon_off_deg,
            "alt_offset": model.height_off_m,
            "row_scale": model.line_scale_px,
            "col_scale": model.samp_scale_px,
            "lat_scale": model.lat_scale_deg,
            "lon_scale": model.lon_scale_deg,
            "alt_scale": model.height_scale_m,
            "row_num": model.line_num.tolist(),
            "row_den": model.line_den.tolist(),
            "col_num": model.samp_num.tolist(),
            "col_den": model.samp_den.tolist(),
        },
        dict_format="rpcm",
    )


def project(work: RpcWork, wanted: int) -> Contender | Missing:
    """Ground to image."""
    try:
        peer = _model(work.model)
    except ImportError as error:
        return Missing(NAME, f"not installed ({error})")
    rows = every(work.points, wanted)
    lon, lat, height = work.degrees(rows)

    def run() -> Any:
        return peer.projection(lon, lat, height)

    def result(raw: Any) -> FloatArray:
        return np.stack([raw[1], raw[0]], axis=-1)

    return Contender(NAME, rows, run, result, "1 thread")


def locate(work: RpcWork, wanted: int) -> Contender | Missing:
    """Image to ground."""
    try:
        peer = _model(work.model)
    except ImportError as error:
        return Missing(NAME, f"not installed ({error})")
    rows = every(work.points, wanted)
    line, sample, height = work.pixels(rows)

    def run() -> Any:
        return peer.localization(sample, line, height)

    def result(raw: Any) -> FloatArray:
        lon, lat = np.radians(raw[0]), np.radians(raw[1])
        return geodetic_to_ecef(np.stack([lon, lat, height], axis=-1))

    return Contender(NAME, rows, run, result, "1 thread")
