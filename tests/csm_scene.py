"""A simulated scene for the tests of writers: circular orbit, nadir camera, some rough attitude."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.attitude import Attitude, SlerpCurve
from geoposition.camera import LineTiming
from geoposition.constants import EARTH_RATE_RAD_S, GM_M3_S2
from geoposition.corrections import NO_CORRECTIONS, Corrections
from geoposition.ephemeris import Ephemeris
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.directions import Directions, PolynomialDirections
from geoposition.sensors.line_camera import Ccd, LineCamera, Mounting
from geoposition.sensors.timing import ConstantLineRate
from geoposition.timescale import Epoch

EPOCH = Epoch.from_utc("2020-03-01T10:20:30.123456789Z")
LINES, SAMPLES = 4000, 3001
RADIUS_M = 6378137.0 + 500e3
PIXEL_RAD = 2e-6
HEIGHTS_M = (0.0, 2000.0)


def orbit(times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Earth-fixed positions and velocities of a circular orbit, inclined by 97 degrees."""
    rate = np.sqrt(GM_M3_S2 / RADIUS_M**3)
    angle, tilt = 0.7 + rate * times_s, np.radians(97.0)
    across = np.array([0.0, np.cos(tilt), np.sin(tilt)])
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    ahead = np.array([1.0, 0.0, 0.0])
    position = RADIUS_M * (c * ahead + s * across)
    velocity = RADIUS_M * rate * (-s * ahead + c * across)
    spin = Rotation.from_rotvec(np.outer(-EARTH_RATE_RAD_S * times_s, [0.0, 0.0, 1.0]))
    position, velocity = spin.apply(position), spin.apply(velocity)
    return position, velocity - np.cross([0.0, 0.0, EARTH_RATE_RAD_S], position)


def quaternions(times_s: np.ndarray, jitter_rad: float = 1e-9) -> np.ndarray:
    """Body to Earth-fixed: z down, x ahead, pitching, with jitter."""
    position, velocity = orbit(times_s)
    z = -position / np.linalg.norm(position, axis=1, keepdims=True)
    y = np.cross(z, velocity)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    matrix = np.stack([np.cross(y, z), y, z], axis=-1)
    noise = np.random.default_rng(5).normal(0.0, jitter_rad, (len(times_s), 3))
    noise[:, 1] += 0.1 + 2e-3 * times_s
    return (Rotation.from_matrix(matrix) * Rotation.from_rotvec(noise)).as_quat()


def scene(
    corrections: Corrections = NO_CORRECTIONS,
    directions: Directions | None = None,
    timing: LineTiming | None = None,
    ephemeris: Ephemeris | None = None,
    attitude: Attitude | None = None,
    mounting: Mounting | None = None,
    ccds: tuple[Ccd, ...] | None = None,
) -> PushbroomModel:
    """Model of 4000 lines in 4 s; the tables begin 1 s before it and end 1 s after."""
    times = np.linspace(0.0, 6.0, 301)
    position, velocity = orbit(times)
    line = PolynomialDirections([0.003, 0.0], [-1500 * PIXEL_RAD, PIXEL_RAD])
    if ccds is None:
        ccds = (Ccd(SAMPLES, directions or line),)
    return PushbroomModel(
        LineCamera(
            LINES,
            timing or ConstantLineRate(EPOCH, 1.0, 1e-3),
            ccds,
            mounting or Mounting(Rotation.from_rotvec([0.02, -0.01, 0.5]), [0.3, -1.2, 2.0]),
        ),
        ephemeris or Ephemeris.hermite(EPOCH, times, position, velocity),
        attitude or Attitude(EPOCH, SlerpCurve.through(times, quaternions(times))),
        corrections,
        HEIGHTS_M,
    )


def grid(lines: int = LINES, samples: int = SAMPLES, count: int = 4000) -> np.ndarray:
    """Image points over the whole scene, its edges and corners included."""
    rng = np.random.default_rng(11)
    points = rng.uniform([-0.5, -0.5], [lines - 0.5, samples - 0.5], (count, 2))
    points[:400, 0] = np.where(np.arange(400) % 2, -0.5, lines - 0.5)
    points[400:800, 1] = np.where(np.arange(400) % 2, -0.5, samples - 0.5)
    points[:4] = [[-0.5, -0.5], [-0.5, samples - 0.5], [lines - 0.5, -0.5], [lines - 0.5] * 2]
    points[3, 1] = samples - 0.5
    return points
