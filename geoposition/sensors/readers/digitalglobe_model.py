"""Rigorous model of a Basic (1B) image from DigitalGlobe support data."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, read_only
from geoposition.attitude import Attitude, SlerpCurve
from geoposition.camera import LineTiming
from geoposition.corrections import ALL_CORRECTIONS
from geoposition.ephemeris import Ephemeris, velocity_kind
from geoposition.errors import ArgumentError, GeometryError
from geoposition.interpolation import SplineCurve
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.directions import CollinearDirections
from geoposition.sensors.line_camera import LineCamera, Mounting
from geoposition.sensors.readers.digitalglobe_image import ImageSupport
from geoposition.sensors.readers.digitalglobe_support import CameraSupport, Samples

_UPPER = np.triu_indices(4)
_MAX_TANGENT = 0.2
"""Ten times what these telescopes see."""
_POSITION_NOISE_M = 0.02
"""What the positions may scatter about their own velocities; 0.0001 m in the products seen."""


def build_model(
    image: ImageSupport,
    timing: LineTiming,
    ephemeris: Samples,
    attitude: Samples,
    camera: CameraSupport,
    height_range_m: tuple[float, float],
) -> PushbroomModel:
    """Make the model: bare camera and true attitude, hence all corrections."""
    _require_cover(image, timing, ephemeris)
    _require_cover(image, timing, attitude)
    line_camera = _line_camera(image, timing, camera)
    try:
        return PushbroomModel(
            line_camera,
            _ephemeris(ephemeris),
            _attitude(attitude),
            ALL_CORRECTIONS,
            height_range_m,
        )
    except (ArgumentError, GeometryError) as error:
        raise attitude.group.error(attitude.list_name, str(error)) from None


def _require_cover(image: ImageSupport, timing: LineTiming, samples: Samples) -> None:
    lines = timing.time_s(np.array([0.0, image.shape[0] - 1.0])) + (timing.epoch - samples.epoch)
    low, high = float(np.min(lines)), float(np.max(lines))
    if not (samples.times_s[0] <= low and high <= samples.times_s[-1]):
        raise samples.group.error(
            "startTime",
            f"{samples.list_name} spans 0 .. {samples.times_s[-1]:.3f} s of it, "
            f"the image's lines {low:.3f} .. {high:.3f} s",
        )


def _line_camera(image: ImageSupport, timing: LineTiming, camera: CameraSupport) -> LineCamera:
    directions = CollinearDirections(
        camera.principal_distance_mm,
        camera.detector_origin_mm,
        (0.0, -camera.pitch_mm),
        camera.detector_rotation_rad,
    )
    widest = float(np.max(np.abs(directions.tangents(np.array([0.0, image.shape[1] - 1.0])))))
    if widest > _MAX_TANGENT:
        raise camera.group.error(
            "PRINCIPAL_DISTANCE/PD",
            f"a view of at most {_MAX_TANGENT} rad off the axis expected, got {widest:g}",
        )
    mounting = Mounting(
        Rotation.from_quat(camera.quat_xyzw_body_camera),
        np.array(camera.perspective_centre_body_m),
    )
    return LineCamera.single(image.shape, timing, directions, mounting)


def _ephemeris(samples: Samples) -> Ephemeris:
    """Hermite, after a test that the velocities are the rate of the positions.

    The positions carry about 0.1 mm of noise, which the derivative of an 8-point Lagrange curve
    turns into 0.1 m/s; the curves differ by 0.2 mm. Hermite keeps the maker's velocities.
    """
    position, velocity = samples.values[:, :3], samples.values[:, 3:6]
    step = samples.times_s[1] - samples.times_s[0]
    tolerance_m_s = max(0.5, _POSITION_NOISE_M / step)
    kind = velocity_kind(samples.times_s, position, velocity, tolerance_m_s)
    if kind != "earth-fixed":
        raise samples.group.error(
            samples.list_name,
            f"velocities must be the rate of the ECEF positions, these are {kind}",
        )
    curve = SplineCurve.hermite(samples.times_s, position, velocity)
    return Ephemeris(samples.epoch, curve, "itrs")


def _attitude(samples: Samples) -> Attitude:
    curve = SlerpCurve.through(samples.times_s, samples.values[:, :4])
    covariance = body_covariance_rad2(samples.values[:, :4], samples.values[:, 4:])
    variances = np.diagonal(covariance, axis1=1, axis2=2)
    if np.any(variances < 0):
        k = int(np.argmax(np.any(variances < 0, axis=1)))
        raise samples.group.error(samples.list_name, f"entry {k + 1}: a covariance expected")
    if not np.any(variances):
        return Attitude(samples.epoch, curve, "itrs")
    return Attitude(samples.epoch, curve, "itrs", read_only(samples.times_s), read_only(covariance))


def body_covariance_rad2(quat_xyzw: FloatArray, upper: FloatArray) -> FloatArray:
    """Covariance (n, 3, 3) of the body rotation vector from that of the quaternion.

    `upper` (n, 10) is the upper triangle, by rows, of the covariance of (x, y, z, w). A small
    turn d on the right, R exp(d), changes the quaternion by Xi(q) d / 2 with orthonormal columns
    Xi, so that C_d = 4 Xi^T C_q Xi; what C_q holds along q itself, nothing but rounding, drops.

    Source: Markley & Crassidis (2014), eq. 2.89 and 3.162, in this module's order and sense.
    """
    C_q = np.zeros((len(upper), 4, 4))
    C_q[:, _UPPER[0], _UPPER[1]] = upper
    C_q[:, _UPPER[1], _UPPER[0]] = upper
    x, y, z, w = (quat_xyzw / np.linalg.norm(quat_xyzw, axis=1, keepdims=True)).T
    Xi = np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]]).transpose(2, 0, 1)
    C_d: FloatArray = 4.0 * np.einsum("nji,njk,nkl->nil", Xi, C_q, Xi)
    return 0.5 * (C_d + C_d.transpose(0, 2, 1))


def sigma_summary(ephemeris: Samples, attitude: Samples) -> dict[str, list[float]]:
    """1-sigma of position (ECEF x, y, z; m) and attitude (body x, y, z; arcsec), RMS over time."""
    position = np.sqrt(np.mean(np.abs(ephemeris.values[:, [6, 9, 11]]), axis=0))
    covariance = body_covariance_rad2(attitude.values[:, :4], attitude.values[:, 4:])
    turn = np.sqrt(np.mean(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    return {
        "position_sigma_ecef_m": [round(float(v), 4) for v in position],
        "attitude_sigma_body_arcsec": [round(float(np.degrees(v)) * 3600, 4) for v in turn],
    }
