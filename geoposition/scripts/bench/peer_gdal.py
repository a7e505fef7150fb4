"""GDAL's RPC transformer, through rasterio."""

from __future__ import annotations

from typing import Any

import numpy as np
import rasterio
from rasterio.rpc import RPC
from rasterio.transform import RPCTransformer

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.rpc.model import RpcModel
from geoposition.scripts.bench.measure import Contender
from geoposition.scripts.bench.work import RpcWork, every

NAME = f"GDAL {rasterio.__gdal_version__}"
_PIXEL_ERROR = 1e-6
"""Where GDAL's iteration ends; its default of 0.1 px would be other work."""


def _transformer(model: RpcModel) -> RPCTransformer:
    return RPCTransformer(
        RPC(
            height_off=model.height_off_m,
            height_scale=model.height_scale_m,
            lat_off=model.lat_off_deg,
            lat_scale=model.lat_scale_deg,
            line_den_coeff=model.line_den.tolist(),
            line_num_coeff=model.line_num.tolist(),
            line_off=model.line_off_px,
            line_scale=model.line_scale_px,
            long_off=model.lon_off_deg,
            long_scale=model.lon_scale_deg,
            samp_den_coeff=model.samp_den.tolist(),
            samp_num_coeff=model.samp_num.tolist(),
            samp_off=model.samp_off_px,
            samp_scale=model.samp_scale_px,
            err_bias=None,
            err_rand=None,
        ),
        RPC_PIXEL_ERROR_THRESHOLD=_PIXEL_ERROR,
    )


def project(work: RpcWork, wanted: int) -> Contender:
    """Ground to image."""
    rows = every(work.points, wanted)
    lon, lat, height = work.degrees(rows)
    transformer = _transformer(work.model)

    def run() -> Any:
        return transformer.rowcol(lon, lat, zs=height, op=_as_it_is)

    def result(raw: Any) -> FloatArray:
        # GDAL counts from the corner of the first pixel
        return np.stack([np.asarray(raw[0]), np.asarray(raw[1])], axis=-1) - 0.5

    return Contender(NAME, rows, run, result, "1 thread")


def locate(work: RpcWork, wanted: int) -> Contender:
    """Image to ground."""
    rows = every(work.points, wanted)
    line, sample, height = work.pixels(rows)
    transformer = _transformer(work.model)

    def run() -> Any:
        return transformer.xy(line, sample, zs=height, offset="center")

    def result(raw: Any) -> FloatArray:
        lon, lat = np.radians(np.asarray(raw[0])), np.radians(np.asarray(raw[1]))
        return geodetic_to_ecef(np.stack([lon, lat, height], axis=-1))

    return Contender(NAME, rows, run, result, "1 thread")


def _as_it_is(value: FloatArray) -> FloatArray:
    return value
