"""A product in words and numbers: what `geoposition info` shows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.model import RpcModel
from geoposition.scripts.footprint import footprint
from geoposition.sensor_model import SensorModel


def describe(product: Product) -> dict[str, object]:
    """Facts about `product` by name, fit for JSON."""
    model = product.model
    lines, samples = model.shape
    facts: dict[str, object] = {
        "format": product.format,
        "sensor": product.sensor,
        "model": "rigorous" if product.is_rigorous else "rpc",
        "lines": lines,
        "samples": samples,
        "height_range_m": list(model.height_range_m),
        "pixel_origin": "centre of the first pixel is row 0, col 0",
        "ground_frame": "WGS 84 (ITRS), heights above the ellipsoid",
        "footprint": footprint(model),
        **ground_sample(model),
    }
    if product.start is not None:
        facts["start_utc"] = product.start.utc_iso()
    if isinstance(model, PushbroomModel):
        facts |= _rigorous(model, product.start is not None)
    if isinstance(model, RpcModel) and not model.shape_known:
        facts["image_size"] = "unknown: derived from the RPC's offset and scale"
    facts["vendor_rpc"] = product.vendor_rpc is not None
    facts["image"] = None if product.image_path is None else str(product.image_path)
    facts["details"] = dict(product.details)
    return facts


def outline(facts: Mapping[str, object]) -> dict[str, object]:
    """Return the footprint of `facts` for people: its corners, not the polygon of GeoJSON."""
    footprint = facts["footprint"]
    assert isinstance(footprint, Mapping)
    return {name: value for name, value in footprint.items() if name != "geojson"}


def ground_sample(model: SensorModel) -> dict[str, object]:
    """Ground sample along lines and samples (m), and the view at the image's centre."""
    lines, samples = model.shape
    centre = np.array([0.5 * (lines - 1), 0.5 * (samples - 1)])
    height = float(np.mean(model.height_range_m))
    # Medians over the image: a pair of neighbours may lie on two CCDs.
    part = np.linspace(0.1, 0.9, 9)
    inner = np.stack(np.meshgrid(part * (lines - 1), part * (samples - 1)), axis=-1).reshape(-1, 2)
    step_row, step_col = (
        float(np.nanmedian(np.linalg.norm(_ecef(model, inner + step, height) - here, axis=-1)))
        for here in [_ecef(model, inner, height)]
        for step in ([1.0, 0.0], [0.0, 1.0])
    )
    ray = model.rays(centre, height)
    ground = model.image_to_ground(centre, height).geodetic
    east, north, up = -ray.direction_ecef @ enu_axes(ground)
    view: FloatArray = np.degrees([np.arccos(np.clip(up, -1, 1)), np.arctan2(east, north)])
    return {
        "ground_sample_m": {"row": round(step_row, 4), "col": round(step_col, 4)},
        "satellite_zenith_deg": round(float(view[0]), 4),
        "satellite_azimuth_deg": round(float(view[1] % 360.0), 4),
    }


def _ecef(model: SensorModel, image_px: FloatArray, height_m: float) -> FloatArray:
    return geodetic_to_ecef(model.image_to_ground(image_px, height_m).geodetic)


def _rigorous(model: PushbroomModel, dated: bool) -> dict[str, object]:
    timing = model.camera.timing
    lines = model.shape[0]
    first, last = (float(t) for t in timing.time_s(np.array([0.0, lines - 1.0])))
    covered = model.covered_lines
    # Some formats count seconds from an instant they do not tell.
    return {
        "first_line_utc": (timing.epoch + first).utc_iso() if dated else None,
        "last_line_utc": (timing.epoch + last).utc_iso() if dated else None,
        "line_period_s": (last - first) / max(lines - 1, 1),
        "scan": "forward" if last >= first else "reverse",
        "corrections": model.corrections.describe(),
        "ephemeris": {
            "frame": model.ephemeris.frame,
            "interpolation": type(model.ephemeris.curve).__name__,
            "span_s": list(model.ephemeris.span_s),
        },
        "attitude": {
            "frame": model.attitude.frame,
            "interpolation": type(model.attitude.curve).__name__,
            "span_s": list(model.attitude.span_s),
            "covariance": model.attitude.covariance_rad2 is not None,
        },
        "covered_lines": list(covered),
        "ccds": len(model.camera.detectors),
    }
