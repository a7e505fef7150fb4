"""What an adjustment may change: blocks of unknowns by name, each with its prior.

Every unknown is zero in the model as it came, and has a prior covariance: a wide one where little
is known. So no system is ever singular, and what the measurements add to the prior can be said
for each unknown and each combination (`observability`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from geoposition.adjust.time_basis import KnotBasis, PolynomialBasis, TimeBasis
from geoposition.arrays import FloatArray, read_only, require_finite
from geoposition.errors import ArgumentError
from geoposition.orbit_frame import inertial_velocity_ecef, nadir_orbit_axes
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel
from geoposition.timescale import Epoch

Kind = Literal["attitude", "mounting", "orbit", "time", "look", "image"]

ARCSEC_RAD: Final = np.pi / 180.0 / 3600.0
ATTITUDE_SIGMA_RAD: Final = 100.0 * ARCSEC_RAD
ORBIT_SIGMA_M: Final = 5.0
TIME_SIGMA_S: Final = 1e-3
LOOK_SIGMA_RAD: Final = 10.0 * ARCSEC_RAD
IMAGE_SIGMA_PX: Final = 100.0
AXES: Final = ("roll", "pitch", "yaw")
ORBIT_AXES: Final = ("along", "across", "down")


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Unknowns of one kind, shared by `images`: `labels` (n) with `units`, prior (n, n).

    - `attitude`: small turns about the body's X, Y, Z (roll, pitch, yaw), functions of time by
      `basis`: the corrected attitude is R_ecef_body X(roll) Y(pitch) Z(yaw). *Source*: T 2.8.
    - `mounting`: turns about the camera's axes, R_body_camera exp(turn).
    - `orbit`: metres along the axes of `axes_ecef` (columns), functions of time by `basis`.
    - `time`: seconds added to all line times.
    - `look`: polynomials of `degree` over s, the sample from −1 to 1, added to the camera's
      tangents x and y; over the whole row, or over CCD number `detector` alone.
    - `image`: line and sample moved by planes (degree 1) or constants over the image, its lines
      and samples from −1 to 1: observed less model, for RPCs and any model.
    """

    name: str
    kind: Kind
    images: tuple[int, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    covariance: FloatArray
    basis: TimeBasis | None = None
    degree: int = 0
    detector: int | None = None
    axes_ecef: FloatArray = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        covariance = require_finite(read_only(self.covariance), f"{self.name}: prior")
        n = len(self.labels)
        if covariance.shape != (n, n):
            raise ArgumentError(
                f"{self.name}: prior of shape {(n, n)} expected, got {covariance.shape}"
            )
        if np.any(np.diagonal(covariance) <= 0.0):
            raise ArgumentError(f"{self.name}: positive prior variances expected")
        if not self.images or len(set(self.images)) != len(self.images):
            raise ArgumentError(f"{self.name}: one or more images, each once, expected")
        object.__setattr__(self, "covariance", covariance)
        object.__setattr__(self, "axes_ecef", read_only(self.axes_ecef))

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns: block, dot, label."""
        return tuple(f"{self.name}.{label}" for label in self.labels)

    @property
    def prior_sigma(self) -> FloatArray:
        """Standard deviations (n,) before the adjustment."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def root(self) -> FloatArray:
        """Lower L (n, n) with prior L Lᵀ; what is correlated fully gets a trace of its own."""
        scale = self.prior_sigma
        correlation = self.covariance / np.outer(scale, scale)
        correlation[np.diag_indices(len(scale))] *= 1.0 + 1e-10
        try:
            lower = np.linalg.cholesky(correlation)
        except np.linalg.LinAlgError:
            raise ArgumentError(f"{self.name}: the prior is no covariance") from None
        result: FloatArray = scale[:, None] * lower
        return result


def attitude_bias(
    name: str,
    models: Sequence[SensorModel],
    images: Sequence[int],
    *,
    degree: int = 0,
    sigma_rad: ArrayLike = ATTITUDE_SIGMA_RAD,
) -> Block:
    """Attitude bias constant (0), linear (1) or quadratic (2) in time, for an image or a strip.

    Seconds count from the middle of the images. `sigma_rad`, one or (roll, pitch, yaw), holds
    for the constant; a higher power has the same effect at the ends of the images. *Source*:
    T 2.8.
    """
    epoch, half_s = _middle(models, images, name)
    basis = PolynomialBasis(epoch, degree)
    sigma = np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), (3,))
    scale = half_s ** -np.arange(degree + 1.0)
    return _in_time(name, "attitude", images, basis, "rad", AXES, np.outer(scale, sigma))


def attitude_spline(
    name: str,
    models: Sequence[SensorModel],
    images: Sequence[int],
    *,
    knots_line: ArrayLike | None = None,
    knots: int = 5,
    smooth: bool = True,
    sigma_rad: ArrayLike = ATTITUDE_SIGMA_RAD,
) -> Block:
    """Attitude bias as values at knots, each with `sigma_rad`, joined by a cubic spline.

    `knots_line` are lines of the first image, which must enclose all lines the model covers; by
    default `knots` of them, evenly. Straight lines join the knots if not `smooth`.
    """
    model = _rigorous(models, images[0], name)
    first, last = model.covered_lines
    lines = np.linspace(first, last, knots) if knots_line is None else np.asarray(knots_line)
    if lines.ndim != 1 or len(lines) < 2:
        raise ArgumentError(f"{name}: a list of knots expected")
    lines = np.sort(lines.astype(np.float64))
    # Knots that stop at the image's ends are meant to hold for the model's margin too.
    rows = model.shape[0]
    if lines[0] > 0.0 or lines[-1] < rows - 1.0:
        raise ArgumentError(
            f"{name}: knots from line 0 or before to {rows - 1} or beyond expected, "
            f"got {lines[0]:g} .. {lines[-1]:g}"
        )
    lines[0], lines[-1] = min(lines[0], first), max(lines[-1], last)
    timing = model.camera.timing
    basis = KnotBasis(timing.epoch, np.sort(timing.time_s(lines)), smooth)
    sigma = np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), (len(lines), 3))
    return _in_time(name, "attitude", images, basis, "rad", AXES, sigma)


def mounting(
    name: str, images: Sequence[int], *, sigma_rad: ArrayLike = ATTITUDE_SIGMA_RAD
) -> Block:
    """Make turns about the camera's axes, one set for all `images` of a camera."""
    sigma = np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), (3,))
    return Block(name, "mounting", tuple(images), ("x", "y", "z"), ("rad",) * 3, np.diag(sigma**2))


def orbit(
    name: str,
    models: Sequence[SensorModel],
    images: Sequence[int],
    *,
    sigma_m: ArrayLike = ORBIT_SIGMA_M,
    drift_sigma_m_s: ArrayLike | None = None,
) -> Block:
    """Offset of the orbit along track, across (right) and down; with a sigma also its drift.

    The axes are those at the middle of the images, and stay.
    """
    epoch, _ = _middle(models, images, name)
    ephemeris = _rigorous(models, images[0], name).ephemeris
    at = np.clip([epoch - ephemeris.epoch], *ephemeris.span_s)
    position, velocity = ephemeris.position_m(at)[0], ephemeris.velocity_m_s(at)[0]
    axes = nadir_orbit_axes(position, inertial_velocity_ecef(position, velocity))
    sigmas = [np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (3,))]
    if drift_sigma_m_s is not None:
        sigmas.append(np.broadcast_to(np.asarray(drift_sigma_m_s, dtype=np.float64), (3,)))
    basis = PolynomialBasis(epoch, len(sigmas) - 1)
    return _in_time(name, "orbit", images, basis, "m", ORBIT_AXES, np.array(sigmas), axes)


def time_offset(name: str, images: Sequence[int], *, sigma_s: float = TIME_SIGMA_S) -> Block:
    """Seconds by which all lines were taken later than the timing says."""
    return Block(name, "time", tuple(images), ("offset",), ("s",), np.array([[sigma_s**2]]))


def look_angles(
    name: str,
    images: Sequence[int],
    *,
    degree: int = 2,
    detector: int | None = None,
    sigma_rad: ArrayLike = LOOK_SIGMA_RAD,
) -> Block:
    """Polynomial corrections of the tangents x (along) and y (across) over the image row.

    With `detector` they belong to that CCD alone and run over its own samples. Each coefficient
    has `sigma_rad` at the ends; shared by all images of a camera. *Source*: P 10.
    """
    if not 0 <= degree <= 5:
        raise ArgumentError(f"{name}: degree 0 .. 5 expected, got {degree}")
    labels = tuple(f"{axis}{k}" for k in range(degree + 1) for axis in "xy")
    sigma = np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), (len(labels),))
    units = ("rad",) * len(labels)
    covariance = np.diag(sigma**2)
    return Block(
        name, "look", tuple(images), labels, units, covariance, degree=degree, detector=detector
    )


def image_bias(
    name: str,
    images: Sequence[int],
    *,
    degree: int = 0,
    sigma_px: ArrayLike = IMAGE_SIGMA_PX,
) -> Block:
    """Shift (degree 0) or affine (1) bias of image points, observed less model: RPC bias."""
    if degree not in (0, 1):
        raise ArgumentError(f"{name}: degree 0 (shift) or 1 (affine) expected, got {degree}")
    parts = ("", "_per_line", "_per_sample")[: 1 + 2 * degree]
    labels = tuple(f"{axis}{part}" for part in parts for axis in ("line", "sample"))
    sigma = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), (len(labels),))
    units = ("px",) * len(labels)
    return Block(name, "image", tuple(images), labels, units, np.diag(sigma**2), degree=degree)


def covered_times(model: PushbroomModel) -> tuple[Epoch, float, float]:
    """Epoch of the timing, and the seconds at which the model's lines begin and end."""
    timing = model.camera.timing
    ends = np.sort(timing.time_s(np.array(model.covered_lines)))
    return timing.epoch, float(ends[0]), float(ends[1])


def _rigorous(models: Sequence[SensorModel], image: int, name: str) -> PushbroomModel:
    if not 0 <= image < len(models):
        raise ArgumentError(f"{name}: image {image} is unknown, 0 .. {len(models) - 1} expected")
    model = models[image]
    if not isinstance(model, PushbroomModel):
        raise ArgumentError(f"{name}: image {image} has no rigorous model; use image_bias")
    return model


def _middle(models: Sequence[SensorModel], images: Sequence[int], name: str) -> tuple[Epoch, float]:
    """Instant in the middle of all lines of `images`, and half the time they take."""
    if not images:
        raise ArgumentError(f"{name}: one or more images expected")
    spans = [covered_times(_rigorous(models, image, name)) for image in images]
    epoch = spans[0][0]
    first = min((at - epoch) + low for at, low, _ in spans)
    last = max((at - epoch) + high for at, _, high in spans)
    return epoch + 0.5 * (first + last), 0.5 * (last - first)


def _in_time(
    name: str,
    kind: Kind,
    images: Sequence[int],
    basis: TimeBasis,
    unit: str,
    axes: tuple[str, ...],
    sigma: FloatArray,
    axes_ecef: FloatArray | None = None,
) -> Block:
    """Block of three axes by function of time; `sigma` (functions, 3)."""
    labels = tuple(f"{axis}_{label}" for label in basis.labels for axis in axes)
    units = tuple(
        unit if power == 0 else f"{unit}/s" if power == 1 else f"{unit}/s{power}"
        for power in basis.powers
        for _ in axes
    )
    covariance = np.diag(sigma.ravel() ** 2)
    where = np.eye(3) if axes_ecef is None else axes_ecef
    return Block(name, kind, tuple(images), labels, units, covariance, basis, axes_ecef=where)
