"""Steady attitude: what an attitude would be without its jitter (P 2.2).

The attitude is taken to the orbit frame, where an Earth-pointing satellite hardly turns, smoothed
there, and taken back: the turning with the orbit is not smoothed away. What is removed is kept.
The frame's axes follow a polynomial through the ephemeris, so that noise of its velocities does
not enter the attitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.polynomial import Chebyshev
from scipy import signal
from scipy.interpolate import CubicSpline, make_lsq_spline
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, read_only
from geoposition.attitude import Attitude, RotationSplineCurve
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, GeometryError, SpanError
from geoposition.interpolation import PolynomialCurve
from geoposition.orbit_frame import R_inertial_orbit, inertial_velocity_ecef
from geoposition.pushbroom import PushbroomModel

SteadyMethod: TypeAlias = Literal["polynomial", "low-pass", "spline"]

_ORBIT_DEGREE: Final = 9
_ORBIT_SAMPLES: Final = 200
_ORDER: Final = 4
_PER_KNOT: Final = 4
"""Samples between neighbouring knots of an attitude: between them it may bend."""
_LEAST_SAMPLES: Final = 257
_MOST_SAMPLES: Final = 1_000_000
_PAD_PERIODS: Final = 4.0
_TOLERANCE_RAD: Final = 1e-11
_MOST_KNOTS: Final = 200_000


@dataclass(frozen=True, slots=True)
class SteadyOptions:
    """How the attitude is smoothed.

    "polynomial" of `degree` in time over the image; "low-pass", without phase, of half gain at
    `cutoff_hz`; "spline", a least-squares cubic one with knots half a period of `cutoff_hz`
    apart. An RPC follows the first: cubics are what it is made of.
    """

    method: SteadyMethod = "polynomial"
    degree: int = 3
    cutoff_hz: float | None = None

    def __post_init__(self) -> None:
        if self.method == "polynomial":
            if not 0 <= self.degree <= 9:
                raise ArgumentError(f"steady attitude: degree 0 to 9 expected, got {self.degree}")
            if self.cutoff_hz is not None:
                raise ArgumentError("steady attitude: a polynomial has no cut-off frequency")
        elif self.method not in ("low-pass", "spline"):
            raise ArgumentError(
                f"steady attitude: polynomial, low-pass or spline, got {self.method!r}"
            )
        elif self.cutoff_hz is None or not 0.0 < self.cutoff_hz < np.inf:
            raise ArgumentError(f"steady attitude: {self.method} needs a positive cut-off in Hz")

    @property
    def words(self) -> str:
        """The choice, for people."""
        if self.method == "polynomial":
            return f"polynomial of degree {self.degree}"
        return f"{self.method} at {self.cutoff_hz:g} Hz"


@dataclass(frozen=True, slots=True, eq=False)
class SteadyAttitude:
    """The smoothed attitude and what was taken from it.

    `removed_rad` (n, 3) at the even `times_s` (n,), seconds from `attitude.epoch`, are rotation
    vectors in the body frame: R_ecef_body = R_ecef_steady exp(removed).
    """

    attitude: Attitude
    options: SteadyOptions
    times_s: FloatArray
    removed_rad: FloatArray


def steady_model(
    model: PushbroomModel, options: SteadyOptions | None = None
) -> tuple[PushbroomModel, SteadyAttitude]:
    """Return `model` as a perfectly steady camera would have it, and the attitude of that.

    Camera, timing and ephemeris stay. The steady model answers for the lines that `model` does.
    """
    timing = model.camera.timing
    ends = timing.time_s(np.array(model.covered_lines)) + (timing.epoch - model.attitude.epoch)
    span = float(np.min(ends)), float(np.max(ends))
    steady = steady_attitude(model.attitude, model.ephemeris, span, options)
    return replace(model, attitude=steady.attitude), steady


def steady_attitude(
    attitude: Attitude,
    ephemeris: Ephemeris,
    span_s: tuple[float, float],
    options: SteadyOptions | None = None,
) -> SteadyAttitude:
    """Smooth an Earth-fixed `attitude` within `span_s`, seconds from its epoch.

    A low-pass looks at what lies before and after the span, too, as far as it is known.

    Raises
    ------
    GeometryError
        Attitude and ephemeris share no time, or the span is too short for the cut-off.
    """
    options = options or SteadyOptions()
    if attitude.frame != "itrs" or ephemeris.frame != "itrs":
        raise ArgumentError("steady attitude: Earth-fixed (itrs) attitude and ephemeris expected")
    low, high = attitude.span_s
    first, last = max(span_s[0], low), min(span_s[1], high)
    if not first < last:
        raise SpanError("steady attitude", span_s, attitude.span_s)
    pad = 0.0 if options.cutoff_hz is None else _PAD_PERIODS / options.cutoff_hz
    shift = attitude.epoch - ephemeris.epoch
    known = ephemeris.span_s[0] - shift, ephemeris.span_s[1] - shift
    begin, end = max(first - pad, low, known[0]), min(last + pad, high, known[1])
    if begin > first + 1e-6 or end < last - 1e-6:
        raise GeometryError("steady attitude: the ephemeris does not reach as far as the attitude")
    first, last = max(first, begin), min(last, end)
    times = _even_times(attitude, begin, end)
    orbit = _OrbitFrame.of(ephemeris, begin + shift, end + shift, shift)
    R_orbit_body = orbit.R_ecef_orbit(times).inv() * attitude.rotation(times)
    reference = R_orbit_body[len(times) // 2]
    turn = (reference.inv() * R_orbit_body).as_rotvec()
    smooth = _smoothed(times, turn, (first, last), options)

    def rotation(at: FloatArray) -> Rotation:
        return orbit.R_ecef_orbit(at) * reference * Rotation.from_rotvec(smooth(at))

    steady = Attitude(attitude.epoch, _curve(rotation, first, last), "itrs")
    inner = times[(times >= first) & (times <= last)]
    removed = (steady.rotation(inner).inv() * attitude.rotation(inner)).as_rotvec()
    return SteadyAttitude(steady, options, read_only(inner), read_only(removed))


def _even_times(attitude: Attitude, begin: float, end: float) -> FloatArray:
    knots = attitude.curve.knots_s
    knots = knots[(knots >= begin) & (knots <= end)]
    count = _LEAST_SAMPLES
    if len(knots) > 2:
        step = float(np.median(np.diff(knots))) / _PER_KNOT
        count = int(np.clip(round((end - begin) / step) + 1, count, _MOST_SAMPLES))
    return np.linspace(begin, end, count)


@dataclass(frozen=True, slots=True, eq=False)
class _OrbitFrame:
    curve: PolynomialCurve
    shift_s: float

    @classmethod
    def of(cls, ephemeris: Ephemeris, begin: float, end: float, shift_s: float) -> _OrbitFrame:
        low, high = ephemeris.span_s
        # an arc of a few seconds is straight to within the noise: its direction needs more
        wider = max(10.0 - 0.5 * (end - begin), 0.0)
        times = np.linspace(max(begin - wider, low), min(end + wider, high), _ORBIT_SAMPLES)
        degree = min(_ORBIT_DEGREE, 3 + int((times[-1] - times[0]) / 15.0))
        return cls(PolynomialCurve.fit(times, ephemeris.position_m(times), degree), shift_s)

    def R_ecef_orbit(self, times_s: FloatArray) -> Rotation:
        at = np.clip(times_s + self.shift_s, *self.curve.span_s)
        position = self.curve.value(at)
        velocity = inertial_velocity_ecef(position, self.curve.rate(at))
        return R_inertial_orbit(position, velocity)


def _smoothed(
    times: FloatArray, turn: FloatArray, span: tuple[float, float], options: SteadyOptions
) -> _Smooth:
    if options.method == "polynomial":
        inside = (times >= span[0]) & (times <= span[1])
        axes = [Chebyshev.fit(times[inside], turn[inside, k], options.degree) for k in range(3)]
        return _Smooth(tuple(axes))
    assert options.cutoff_hz is not None
    length = times[-1] - times[0]
    if length * options.cutoff_hz < 0.5:
        raise GeometryError(
            f"steady attitude: {length:.3g} s of attitude are too short for a cut-off of "
            f"{options.cutoff_hz:g} Hz"
        )
    if options.method == "spline":
        pieces = max(int(np.ceil(2.0 * length * options.cutoff_hz)), 1)
        inner = np.linspace(times[0], times[-1], pieces + 1)
        knots = np.concatenate([[times[0]] * 3, inner, [times[-1]] * 3])
        return _Smooth((make_lsq_spline(times, turn, knots, k=3),))
    rate = (len(times) - 1) / length
    if options.cutoff_hz >= 0.45 * rate:
        raise GeometryError(
            f"steady attitude: a cut-off of {options.cutoff_hz:g} Hz is above what samples at "
            f"{rate / _PER_KNOT:.3g} Hz hold"
        )
    # forth and back: no phase, and half gain where the filter itself has half power
    sections = signal.butter(_ORDER, options.cutoff_hz, fs=rate, output="sos")
    pad = min(int(2.0 * rate / options.cutoff_hz), len(times) - 2)
    slow = signal.sosfiltfilt(sections, turn, axis=0, padtype="odd", padlen=pad)
    return _Smooth((CubicSpline(times, slow),))


@dataclass(frozen=True, slots=True, eq=False)
class _Smooth:
    """One curve of three columns, or three curves."""

    parts: tuple[object, ...]

    def __call__(self, times_s: FloatArray) -> FloatArray:
        values = [np.asarray(part(times_s)) for part in self.parts]  # type: ignore[operator]
        return values[0] if len(values) == 1 else np.stack(values, axis=-1)


def _curve(
    rotation: Callable[[FloatArray], Rotation], first: float, last: float
) -> RotationSplineCurve:
    """Spline through so many samples that between them it is right to `_TOLERANCE_RAD`."""
    count = 33
    while True:
        times = np.linspace(first, last, count)
        curve = RotationSplineCurve.through(times, rotation(times).as_quat())
        middle = 0.5 * (times[1:] + times[:-1])
        missed = (curve.rotation(middle).inv() * rotation(middle)).magnitude()
        if np.max(missed) <= _TOLERANCE_RAD or 2 * count > _MOST_KNOTS:
            return curve
        count = 2 * count - 1
