"""A rigorous model in the form the Orekit-based peers (pyrugged, ASGARD) take."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio

from geoposition.arrays import FloatArray
from geoposition.errors import UnsupportedError
from geoposition.frames import R_eme2000_gcrs, R_gcrs_body, gcrs_from_itrs
from geoposition.pushbroom import PushbroomModel
from geoposition.timescale import Epoch

_MARGIN_S = 0.2
_LINEAR_S = 1e-9


@dataclass(frozen=True, slots=True)
class InertialSeries:
    """Ephemeris and attitude of the camera in EME2000, and its lines of sight.

    `orbit_s` (n,) with `position_m`, `velocity_m_s` (n, 3); `attitude_s` (k,) with `quat_xyzw`
    (k, 4), camera to EME2000, continuous in sign; `directions` (samples, 3) unit, in the camera;
    line l is taken at `first_s` + l `period_s`. Seconds from `epoch`.
    """

    epoch: Epoch
    orbit_s: FloatArray
    position_m: FloatArray
    velocity_m_s: FloatArray
    attitude_s: FloatArray
    quat_xyzw: FloatArray
    directions: FloatArray
    first_s: float
    period_s: float


def inertial_series(
    model: PushbroomModel, orbit_step_s: float = 0.5, attitude_step_s: float = 0.02
) -> InertialSeries:
    """Sample a model. The peers take one CCD and evenly timed lines: else `UnsupportedError`."""
    camera = model.camera
    if len(camera.detectors) != 1 or np.any(camera.lever_arm_body_m != 0.0):
        raise UnsupportedError("bench", "camera", "one CCD at the ephemeris' point expected")
    lines, samples = camera.shape
    probe = np.linspace(0, lines - 1, 101)
    times = camera.timing.time_s(probe)
    period = float((times[-1] - times[0]) / (lines - 1))
    if np.max(np.abs(times - times[0] - period * probe)) > _LINEAR_S:
        raise UnsupportedError("bench", "line times", "evenly timed lines expected")
    epoch = camera.timing.epoch
    span = float(times[0]), float(times[-1])
    orbit_s = _steps(span, _offset_span(model.ephemeris.span_s, model.ephemeris.epoch, epoch),
                     orbit_step_s)  # fmt: skip
    there = orbit_s + (epoch - model.ephemeris.epoch)
    position, velocity = gcrs_from_itrs(
        model.ephemeris.position_m(there), model.ephemeris.velocity_m_s(there), epoch, orbit_s
    )
    attitude_s = _steps(span, _offset_span(model.attitude.span_s, model.attitude.epoch, epoch),
                        attitude_step_s)  # fmt: skip
    R_ecef_camera = (
        model.attitude.rotation(attitude_s + (epoch - model.attitude.epoch)) * camera.R_body_camera
    )
    R_inertial_camera = R_eme2000_gcrs() * R_gcrs_body(R_ecef_camera, epoch, attitude_s)
    quat = R_inertial_camera.as_quat()
    flips = np.cumprod(np.where(np.sum(quat[1:] * quat[:-1], axis=1) < 0, -1.0, 1.0))
    quat[1:] *= flips[:, None]
    tangents = camera.tangents(0, np.arange(samples, dtype=np.float64))
    directions = np.concatenate([tangents, np.ones((samples, 1))], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turn = R_eme2000_gcrs()
    return InertialSeries(
        epoch,
        orbit_s,
        turn.apply(position),
        turn.apply(velocity),
        attitude_s,
        quat,
        directions,
        float(times[0]),
        period,
    )


def _offset_span(span_s: tuple[float, float], own: Epoch, epoch: Epoch) -> tuple[float, float]:
    offset = own - epoch
    return span_s[0] + offset, span_s[1] + offset


def _steps(wanted: tuple[float, float], allowed: tuple[float, float], step_s: float) -> FloatArray:
    """Give times that cover the image and some of each side, within what there is."""
    spare = max(_MARGIN_S, 6 * step_s)
    low = max(min(wanted) - spare, allowed[0] + 1e-9)
    high = min(max(wanted) + spare, allowed[1] - 1e-9)
    return np.linspace(low, high, max(int(np.ceil((high - low) / step_s)), 8) + 1)


@dataclass(frozen=True, slots=True)
class Heights:
    """Nodes of a raster in longitude and latitude: row 0 is the southernmost."""

    south_rad: float
    west_rad: float
    step_lat_rad: float
    step_lon_rad: float
    height_m: FloatArray


def read_heights(dem: Path) -> Heights:
    """Read the raster that `scenes.write_terrain` wrote."""
    with rasterio.open(dem) as raster:
        height = raster.read(1).astype(np.float64)
        transform = raster.transform
    rows = height.shape[0]
    return Heights(
        float(np.radians(transform.f + (rows - 0.5) * transform.e)),
        float(np.radians(transform.c + 0.5 * transform.a)),
        float(np.radians(-transform.e)),
        float(np.radians(transform.a)),
        np.ascontiguousarray(height[::-1]),
    )
