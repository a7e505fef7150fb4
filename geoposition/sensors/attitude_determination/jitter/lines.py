"""Jitter of the platform: lines in roll, pitch and yaw, from attitude, gyro rates or increments.

What is slower than the low cut (orbital motion, trend, bias) is taken out; lines are found where
the noise is white, in the measured quantity itself, and carried over to angles: a line of
amplitude A in the angle has A w in the rate, and 2 A sin(w dt / 2) in increments over dt.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, read_only
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.jitter.orbit_angles import (
    body_roll_pitch_yaw,
    orbit_roll_pitch_yaw,
)
from geoposition.sensors.attitude_determination.signal.low_pass import low_pass, low_pass_gain
from geoposition.sensors.attitude_determination.signal.peaks import Line, find_lines
from geoposition.sensors.attitude_determination.signal.spectrum import (
    Spectrum,
    highest_frequency_hz,
    spectrum,
)
from geoposition.sensors.telemetry import GyroKind, GyroSeries

AXES: Final = ("roll", "pitch", "yaw")
_ARCSEC_RAD: Final = np.pi / 648000.0
_LOW_CUT_PERIODS: Final = 10.0
_LOWEST_CUT_HZ: Final = 0.005
"""Default low cut: a tenth of the span, but always above the orbit's motion."""
_CLEAR: Final = 2.0
"""Lines are sought from so many times the low cut, where less than 6 % is taken away."""


@dataclass(frozen=True, slots=True)
class JitterSettings:
    """How jitter is looked for.

    `low_cut_hz` parts motion from jitter (None: ten periods of it fit the span, at least
    0.005 Hz); `highest_hz` ends the search (None: half the sampling rate); `false_alarm` is the
    probability that noise alone shows a line on an axis; `segments` average the drawn spectrum.
    """

    low_cut_hz: float | None = None
    highest_hz: float | None = None
    false_alarm: float = 1e-3
    most_lines: int = 20
    segments: int = 8

    def __post_init__(self) -> None:
        for value in (self.low_cut_hz, self.highest_hz):
            if value is not None and not 0.0 < value < np.inf:
                raise ArgumentError("jitter: positive frequencies expected")
        if not 0.0 < self.false_alarm < 1.0 or self.most_lines < 1 or self.segments < 1:
            raise ArgumentError("jitter: a false-alarm probability and positive counts expected")


@dataclass(frozen=True, slots=True)
class JitterPeak:
    """A line in an angle: amplitude × sin(2 pi frequency (t − reference) + phase).

    The standard deviations are those of a single tone in the noise around it; `false_alarm` is
    the probability that noise alone brings such a line.
    """

    frequency_hz: float
    amplitude_rad: float
    phase_rad: float
    sigma_frequency_hz: float
    sigma_amplitude_rad: float
    sigma_phase_rad: float
    false_alarm: float

    def summary(self) -> Mapping[str, float]:
        """Figures as tables and JSON state them, amplitudes in arc seconds."""
        return {
            "frequency_hz": self.frequency_hz,
            "amplitude_arcsec": self.amplitude_rad / _ARCSEC_RAD,
            "phase_rad": self.phase_rad,
            "sigma_frequency_hz": self.sigma_frequency_hz,
            "sigma_amplitude_arcsec": self.sigma_amplitude_rad / _ARCSEC_RAD,
            "sigma_phase_rad": self.sigma_phase_rad,
            "false_alarm": self.false_alarm,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Jitter:
    """Lines of each axis, strongest first, and what they were found in.

    `angle_rad` (n, 3) at `times_s` (n,) are roll, pitch and yaw without what is slower than
    `low_cut_hz`; `spectrum` is their density (rad²/Hz). Phases count from `reference_s`.
    """

    axes: Mapping[str, tuple[JitterPeak, ...]]
    times_s: FloatArray
    angle_rad: FloatArray
    spectrum: Spectrum
    reference_s: float
    low_cut_hz: float
    highest_hz: float

    def summary(self) -> Mapping[str, object]:
        """Return the contract's `axes`, and the limits of the search."""
        return {
            "axes": {axis: [peak.summary() for peak in self.axes[axis]] for axis in AXES},
            "reference_s": self.reference_s,
            "low_cut_hz": self.low_cut_hz,
            "highest_hz": self.highest_hz,
            "rms_arcsec": {
                axis: float(np.std(self.angle_rad[:, i]) / _ARCSEC_RAD)
                for i, axis in enumerate(AXES)
            },
        }


def jitter_from_attitude(
    times_s: ArrayLike,
    R_gcrs_body: Rotation,
    ephemeris: Ephemeris | None = None,
    settings: JitterSettings | None = None,
) -> Jitter:
    """Jitter of inertial attitude at increasing `times_s` (n,), even or not.

    With `ephemeris`, from whose epoch the times then count, the angles are those to the orbit
    frame; without, those about the body's own axes. *Source*: T 2.4.
    """
    times = np.asarray(times_s, dtype=np.float64)
    if ephemeris is None:
        angles = body_roll_pitch_yaw(times, R_gcrs_body)
    else:
        angles = orbit_roll_pitch_yaw(times, R_gcrs_body, ephemeris)
    search = _Search.over(times, settings or JitterSettings())
    detrended = angles - low_pass(times, angles, search.low_cut_hz)
    return search.result(times, detrended, detrended, _Transfer("angle", 0.0))


def jitter_from_gyro(gyro: GyroSeries, settings: JitterSettings | None = None) -> Jitter:
    """Jitter of gyro rates or angular-displacement increments about the body's axes.

    The angles are the high-passed rates, integrated; the spectrum is that of the measured
    quantity, carried over to angles. *Source*: T 2.4, P 3 1).
    """
    times = gyro.times_s
    steps = np.diff(times)[:, None]
    values = gyro.values
    if gyro.kind != "rate":
        # The first sample says nothing about the span.
        values = values[1:] / steps if gyro.kind == "increment" else values[1:]
        times = times[1:]
    search = _Search.over(times, settings or JitterSettings())
    detrended = values - low_pass(times, values, search.low_cut_hz)
    if gyro.kind == "rate":
        angles = CubicSpline(times, detrended).antiderivative()(times)
    else:
        angles = np.cumsum(detrended * steps, axis=0)
    return search.result(
        times, detrended, angles - angles.mean(axis=0), _Transfer(gyro.kind, float(np.mean(steps)))
    )


@dataclass(frozen=True, slots=True)
class _Transfer:
    """What becomes of a line in the angle on its way into the measured quantity."""

    kind: GyroKind | str
    step_s: float

    def gain(self, frequency_hz: FloatArray) -> FloatArray:
        omega = 2.0 * np.pi * frequency_hz
        if self.kind == "angle":
            return np.ones_like(omega)
        if self.kind == "rate":
            return omega
        return np.asarray(2.0 * np.sin(0.5 * omega * self.step_s) / self.step_s)

    def phase_rad(self, frequency_hz: float) -> float:
        if self.kind == "angle":
            return 0.0
        delay = 0.0 if self.kind == "rate" else np.pi * frequency_hz * self.step_s
        return 0.5 * np.pi - delay


@dataclass(frozen=True, slots=True)
class _Search:
    settings: JitterSettings
    low_cut_hz: float
    highest_hz: float

    @classmethod
    def over(cls, times: FloatArray, settings: JitterSettings) -> _Search:
        if len(times) < 64:
            raise ArgumentError(f"jitter: at least 64 samples expected, there are {len(times)}")
        span = float(times[-1] - times[0])
        default = max(_LOW_CUT_PERIODS / span, _LOWEST_CUT_HZ)
        low = default if settings.low_cut_hz is None else settings.low_cut_hz
        limit = highest_frequency_hz(times)
        high = limit if settings.highest_hz is None else settings.highest_hz
        if not _CLEAR * low < high:
            raise ArgumentError(
                f"jitter: nothing to search between {_CLEAR * low:.4g} and {high:.4g} Hz"
            )
        return cls(settings, low, high)

    def result(
        self, times: FloatArray, measured: FloatArray, angles: FloatArray, transfer: _Transfer
    ) -> Jitter:
        def lines(axis: int) -> tuple[JitterPeak, ...]:
            found = find_lines(
                times,
                measured[:, axis],
                lowest_hz=_CLEAR * self.low_cut_hz,
                highest_hz=self.highest_hz,
                false_alarm=self.settings.false_alarm,
                most=self.settings.most_lines,
            )
            peaks = [self._peak(line, transfer) for line in found]
            return tuple(sorted(peaks, key=lambda peak: -peak.amplitude_rad))

        # The work is in NumPy and the FFT, which let other threads run.
        with ThreadPoolExecutor(len(AXES)) as pool:
            found = list(pool.map(lines, range(len(AXES))))
        drawn = spectrum(
            times, measured, segments=self.settings.segments, highest_hz=self.highest_hz
        )
        density = drawn.density / transfer.gain(drawn.frequency_hz)[:, None] ** 2
        return Jitter(
            dict(zip(AXES, found, strict=True)),
            read_only(times),
            read_only(angles),
            replace(drawn, density=read_only(density)),
            float(times[0]),
            self.low_cut_hz,
            self.highest_hz,
        )

    def _peak(self, line: Line, transfer: _Transfer) -> JitterPeak:
        frequency = line.frequency_hz
        kept = 1.0 - float(low_pass_gain(frequency, self.low_cut_hz))
        gain = float(transfer.gain(np.array(frequency))) * kept
        phase = line.phase_rad - transfer.phase_rad(frequency)
        return JitterPeak(
            frequency,
            line.amplitude / gain,
            float(np.mod(phase + np.pi, 2.0 * np.pi) - np.pi),
            line.sigma_frequency_hz,
            line.sigma_amplitude / gain,
            line.sigma_phase_rad,
            line.false_alarm,
        )
