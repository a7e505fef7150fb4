"""How the satellite was turned: rotations body to reference frame over a span.

Fused attitude is an input type: it may come from a product, a table or our own fusion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from geoposition.arrays import FloatArray, read_only, require_finite, require_increasing
from geoposition.ephemeris import Frame
from geoposition.errors import ArgumentError
from geoposition.interpolation import Curve, LagrangeCurve, PolynomialCurve, within_span
from geoposition.rotation import continuous_quat
from geoposition.timescale import Epoch

_UNIT_TOLERANCE = 1e-3
"""A quaternion whose norm is off by more is not a quaternion, whatever rounding it went through."""


class RotationCurve(Protocol):
    """A rotation as a function of time, over a span."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time at which the curve is defined."""
        ...

    @property
    def knots_s(self) -> FloatArray:
        """Times (m,) at which some derivative may jump."""
        ...

    def rotation(self, times_s: FloatArray) -> Rotation:
        """Rotations at `times_s` (n,); outside the span a `SpanError`."""
        ...


def continuous_unit_quaternions(times_s: ArrayLike, quat_xyzw: ArrayLike) -> FloatArray:
    """Check a series `quat_xyzw` (n, 4) and return it unit, with signs made continuous."""
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "attitude times")
    quats = np.asarray(quat_xyzw, dtype=np.float64)
    if quats.shape != (len(times), 4):
        raise ArgumentError(f"quaternions: shape ({len(times)}, 4) expected, got {quats.shape}")
    require_finite(quats, "quaternions")
    norms = np.linalg.norm(quats, axis=1)
    if np.any(np.abs(norms - 1.0) > _UNIT_TOLERANCE):
        bad = int(np.argmax(np.abs(norms - 1.0)))
        raise ArgumentError(f"quaternions: unit norm expected, entry {bad} has {norms[bad]:.6g}")
    return read_only(continuous_quat(quats / norms[:, None]))


@dataclass(frozen=True, slots=True, eq=False)
class _SampledCurve:
    """Rotations between samples at `times_s`."""

    times_s: FloatArray
    interpolant: Slerp | RotationSpline

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last sample time."""
        return float(self.times_s[0]), float(self.times_s[-1])

    @property
    def knots_s(self) -> FloatArray:
        """The sample times."""
        return self.times_s

    def rotation(self, times_s: FloatArray) -> Rotation:
        """Rotations at `times_s` (n,)."""
        return self.interpolant(within_span(times_s, self.span_s, "attitude"))


def _samples(times_s: ArrayLike, quat_xyzw: ArrayLike) -> tuple[FloatArray, Rotation]:
    quats = continuous_unit_quaternions(times_s, quat_xyzw)
    if len(quats) < 2:
        raise ArgumentError("attitude: at least 2 samples expected")
    return read_only(times_s), Rotation.from_quat(quats)


@dataclass(frozen=True, slots=True, eq=False)
class SlerpCurve(_SampledCurve):
    """Spherical linear interpolation between samples."""

    @classmethod
    def through(cls, times_s: ArrayLike, quat_xyzw: ArrayLike) -> SlerpCurve:
        """Slerp through `quat_xyzw` (n, 4), n >= 2."""
        times, rotations = _samples(times_s, quat_xyzw)
        return cls(times, Slerp(times, rotations))


@dataclass(frozen=True, slots=True, eq=False)
class RotationSplineCurve(_SampledCurve):
    """Cubic spline with continuous angular velocity and acceleration through samples."""

    @classmethod
    def through(cls, times_s: ArrayLike, quat_xyzw: ArrayLike) -> RotationSplineCurve:
        """Spline through `quat_xyzw` (n, 4), n >= 2."""
        times, rotations = _samples(times_s, quat_xyzw)
        return cls(times, RotationSpline(times, rotations))


@dataclass(frozen=True, slots=True, eq=False)
class QuaternionCurve:
    """Quaternion whose components follow a curve, normalised: Lagrange, spline, polynomial."""

    components_xyzw: Curve

    @classmethod
    def lagrange(cls, times_s: ArrayLike, quat_xyzw: ArrayLike, points: int = 8) -> QuaternionCurve:
        """Lagrange interpolation of sign-continuous components (n, 4)."""
        quats = continuous_unit_quaternions(times_s, quat_xyzw)
        return cls(LagrangeCurve(read_only(times_s), quats, points))

    @classmethod
    def polynomial_fit(
        cls, times_s: ArrayLike, quat_xyzw: ArrayLike, degree: int
    ) -> QuaternionCurve:
        """Least-squares polynomial of `degree` through sign-continuous components (n, 4)."""
        quats = continuous_unit_quaternions(times_s, quat_xyzw)
        return cls(PolynomialCurve.fit(times_s, quats, degree))

    @property
    def span_s(self) -> tuple[float, float]:
        """Span of the components."""
        return self.components_xyzw.span_s

    @property
    def knots_s(self) -> FloatArray:
        """Knots of the components."""
        return self.components_xyzw.knots_s

    def rotation(self, times_s: FloatArray) -> Rotation:
        """Rotations at `times_s` (n,)."""
        return Rotation.from_quat(self.components_xyzw.value(times_s))


@dataclass(frozen=True, slots=True, eq=False)
class EulerCurve:
    """Rotation from angles that follow a curve: R = R1(a1) R2(a2) R3(a3), intrinsic.

    `sequence` is SciPy's, upper case ("ZXY" is 3-1-2, T 2.34). With a `LagrangeCurve` over the
    angles of chosen lines this is the method of orientation images (T 2.1.4), with a
    `PolynomialCurve` the polynomial orientation of T 2.7.
    """

    angles_rad: Curve
    sequence: str = "ZXY"

    @property
    def span_s(self) -> tuple[float, float]:
        """Span of the angles."""
        return self.angles_rad.span_s

    @property
    def knots_s(self) -> FloatArray:
        """Knots of the angles."""
        return self.angles_rad.knots_s

    def rotation(self, times_s: FloatArray) -> Rotation:
        """Rotations at `times_s` (n,)."""
        return Rotation.from_euler(self.sequence, self.angles_rad.value(times_s))


@dataclass(frozen=True, slots=True, eq=False)
class ProductCurve:
    """Two rotations, one after the other: R_a_c(t) = R_a_b(t) R_b_c(t)."""

    outer: RotationCurve
    inner: RotationCurve

    @property
    def span_s(self) -> tuple[float, float]:
        """The span both share."""
        (a, b), (c, d) = self.outer.span_s, self.inner.span_s
        return max(a, c), min(b, d)

    @property
    def knots_s(self) -> FloatArray:
        """The knots of both, inside the shared span."""
        knots = np.union1d(self.outer.knots_s, self.inner.knots_s)
        low, high = self.span_s
        return knots[(knots >= low) & (knots <= high)]

    def rotation(self, times_s: FloatArray) -> Rotation:
        """Rotations at `times_s` (n,)."""
        return self.outer.rotation(times_s) * self.inner.rotation(times_s)


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """Rotations body to `frame` over a span, at seconds from `epoch`.

    `covariance_rad2` (n, 3, 3), where known, belongs to `covariance_times_s` (n,): of the
    rotation vector in the body frame, right perturbation R_frame_body exp(d). `lag_one_rad2`
    (n − 1, 3, 3) is the cross-covariance of neighbours k and k + 1, from which that of any two
    epochs follows.
    """

    epoch: Epoch
    curve: RotationCurve
    frame: Frame = "itrs"
    covariance_times_s: FloatArray | None = None
    covariance_rad2: FloatArray | None = None
    lag_one_rad2: FloatArray | None = None

    @classmethod
    def from_samples(
        cls,
        epoch: Epoch,
        times_s: ArrayLike,
        quat_xyzw: ArrayLike,
        frame: Frame = "itrs",
        interpolation: Literal["slerp", "spline"] = "slerp",
    ) -> Attitude:
        """Attitude through samples `quat_xyzw` (n, 4), scalar last, body to `frame`."""
        curve: RotationCurve
        if interpolation == "slerp":
            curve = SlerpCurve.through(times_s, quat_xyzw)
        elif interpolation != "spline":
            raise ArgumentError(f"attitude: interpolation slerp or spline, got {interpolation!r}")
        else:
            curve = RotationSplineCurve.through(times_s, quat_xyzw)
        return cls(epoch, curve, frame)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds from `epoch`."""
        return self.curve.span_s

    def rotation(self, times_s: ArrayLike) -> Rotation:
        """R_frame_body at `times_s` (n,), seconds from `epoch`."""
        return self.curve.rotation(np.atleast_1d(np.asarray(times_s, dtype=np.float64)))
