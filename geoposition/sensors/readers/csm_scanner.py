"""A line scanner as CSM describes it: straight rays, on whatever body it flew around."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, as_components
from geoposition.attitude import Attitude
from geoposition.camera import LineTiming
from geoposition.constants import WGS84_A_M, WGS84_B_M
from geoposition.corrections import NO_CORRECTIONS
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ProductError, UnsupportedError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.directions import Directions
from geoposition.sensors.line_camera import LineCamera, Mounting
from geoposition.sensors.readers.csm_focal_plane import FocalPlane
from geoposition.timescale import Epoch

_WGS84_TOLERANCE_M = 1e-3
"""On the semi-axes: GRS 80 differs by 0.1 mm, the next Earth ellipsoid by metres."""

_EARTH_HEIGHTS_M = (-500.0, 9000.0)
"""Lowest and highest land above the ellipsoid."""


@dataclass(frozen=True, slots=True)
class LineScanner:
    """Camera, orbit and attitude of a CSM description, in its body's fixed frame.

    The nouns are those of the Earth ("itrs" reads as the body's fixed frame); `semi_axes_m` tells
    which body it is. Directions are final: CSM knows neither aberration nor refraction.
    """

    path: Path
    camera: LineCamera
    ephemeris: Ephemeris
    attitude: Attitude
    semi_axes_m: tuple[float, float]
    height_range_m: tuple[float, float]
    sensor: str
    start: Epoch | None = None

    def rays(self, image_px: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Camera centres (..., 3), metres, and unit directions (..., 3), body-fixed.

        `image_px` (..., 2) is (line, sample), the first pixel's centre (0, 0). A line whose time
        the tables do not cover is a `SpanError`: nothing is extrapolated.
        """
        points = as_components(image_px, 2, "image_px")
        flat = points.reshape(-1, 2)
        time = self.camera.timing.time_s(flat[:, 0])
        epoch = self.camera.timing.epoch
        centre = self.ephemeris.position_m(time + (epoch - self.ephemeris.epoch))
        R_fixed_body = self.attitude.rotation(time + (epoch - self.attitude.epoch))
        tangents = self.camera.tangents(0, flat[:, 1])
        look = np.concatenate([tangents, np.ones((len(flat), 1))], axis=1)
        look /= np.linalg.norm(look, axis=1, keepdims=True)
        direction = R_fixed_body.apply(self.camera.R_body_camera.apply(look))
        return centre.reshape(*points.shape[:-1], 3), direction.reshape(*points.shape[:-1], 3)

    @property
    def is_wgs84(self) -> bool:
        """Whether the body's ellipsoid is WGS 84."""
        a, b = self.semi_axes_m
        return abs(a - WGS84_A_M) < _WGS84_TOLERANCE_M and abs(b - WGS84_B_M) < _WGS84_TOLERANCE_M

    def model(self) -> PushbroomModel:
        """Rigorous model; another body than the Earth is an `UnsupportedError`."""
        if not self.is_wgs84:
            a, b = self.semi_axes_m
            raise UnsupportedError(
                self.path,
                "ellipsoid",
                f"WGS 84 expected for ground coordinates, this one has semi-axes {a:.10g} and "
                f"{b:.10g} m; its rays can be had from read_line_scanner",
            )
        low, high = self.height_range_m
        # Writers of CSM state the whole solid Earth, +-10 km, for want of better.
        heights = (max(low, _EARTH_HEIGHTS_M[0]), min(high, _EARTH_HEIGHTS_M[1]))
        if heights[0] > heights[1]:
            raise ProductError(
                self.path,
                "elevation range",
                f"from low to high expected, got {low:g} .. {high:g} m",
            )
        return PushbroomModel(self.camera, self.ephemeris, self.attitude, NO_CORRECTIONS, heights)


def facing_the_body(
    build: Callable[[LineCamera], LineScanner],
    shape: tuple[int, int],
    timing: LineTiming,
    plane: FocalPlane,
    undistort: Callable[[FocalPlane], Directions],
) -> LineScanner:
    """Scanner whose camera looks to the ground: CSM intersects a line, whichever way it points."""
    scanner = build(LineCamera.single(shape, timing, undistort(plane)))
    centre, direction = scanner.rays([0.5 * (shape[0] - 1), 0.5 * (shape[1] - 1)])
    if np.dot(centre, direction) <= 0:
        return scanner
    # -(x, y, 1) is (-x, y, 1) after half a turn about the camera's x axis.
    mirrored = replace(plane, look_sign=(-plane.look_sign[0], plane.look_sign[1]))
    half_turn = Mounting(Rotation.from_quat([1.0, 0.0, 0.0, 0.0]))
    return build(LineCamera.single(shape, timing, undistort(mirrored), half_turn))
