"""The frequency response of an angular-displacement sensor, and the way back from it.

Such a sensor feels 0.2–450 Hz (P section 3): slow turning, the orbital motion with it, does not
show, and fast vibration is damped. The response is a second-order high pass times a second-order
low pass, on the angle or on its rate alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, signal
from scipy.interpolate import CubicSpline

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError
from geoposition.sensors.telemetry import GyroSeries

_STEP_TOLERANCE = 1e-3
"""Steps may differ by this share of their mean and still count as equal."""


@dataclass(frozen=True, slots=True)
class SensorBand:
    """Corners of a band at which the gain is 1/sqrt(2): Butterworth sections, of second order."""

    low_hz: float = 0.2
    high_hz: float = 450.0

    def __post_init__(self) -> None:
        if not 0.0 < self.low_hz < self.high_hz:
            raise ArgumentError("sensor band: corners 0 < low < high expected, in Hz")

    def response(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Complex gain (...) at `frequency_hz` (...), of the analogue sensor."""
        s = 1j * np.asarray(frequency_hz, dtype=np.float64)
        high_pass = s**2 / (s**2 + np.sqrt(2.0) * self.low_hz * s + self.low_hz**2)
        low_pass = self.high_hz**2 / (s**2 + np.sqrt(2.0) * self.high_hz * s + self.high_hz**2)
        return np.asarray(high_pass * low_pass)


def band_limited(series: GyroSeries, band: SensorBand) -> GyroSeries:
    """Pass increments (or mean rates) at equal steps through the sensor's response, causally.

    Before the series the sensor is taken to have felt, for long, the mean rate of the first
    1 / `band.low_hz` seconds. Digital sections with the band's corners
    where they are (bilinear): below a quarter of the sampling rate within 1 % of the analogue
    response near the corner.
    """
    rate_hz = _sampling_hz(series)
    if band.high_hz >= 0.5 * rate_hz:
        raise ArgumentError(
            f"sensor band: {band.high_hz:g} Hz needs a sampling rate over {2 * band.high_hz:g} Hz"
        )
    values = np.array(series.values)
    before = values[1 : 1 + max(round(rate_hz / band.low_hz), 1)].mean(axis=0)
    high_pass = signal.butter(2, band.low_hz, "highpass", fs=rate_hz, output="sos")
    low_pass = signal.butter(2, band.high_hz, "lowpass", fs=rate_hz, output="sos")
    settled = signal.sosfilt_zi(high_pass)[:, :, None] * before
    felt, _ = signal.sosfilt(high_pass, values[1:], axis=0, zi=settled)
    values[1:] = signal.sosfilt(low_pass, felt, axis=0)
    values[0] = values[1]
    return GyroSeries.of(series.times_s, values, series.kind)


def band_restored(
    series: GyroSeries,
    band: SensorBand,
    slow: GyroSeries,
    crossover_hz: float | None = None,
    top_hz: float | None = None,
) -> GyroSeries:
    """Turn a band-limited series into one over all frequencies from zero, with a slow one's help.

    Below `crossover_hz` (three times the band's lower corner) the motion is taken from `slow`, a
    gyro or fused attitude's increments over the same span, above it from the sensor, its response
    divided out up to `top_hz` (the upper corner) and faded out over another quarter of that. Both
    shares add to one and shift no phase, so a motion that both feel comes out as it was. Gyro
    noise and bias of the result are `slow`'s at low and the sensor's at high frequencies.

    The whole series at once by Fourier transform, its ends mirrored: the first and last 1 /
    `crossover_hz` seconds are less certain. Increments or mean rates at equal steps.
    """
    rate_hz = _sampling_hz(series)
    crossover = 3.0 * band.low_hz if crossover_hz is None else crossover_hz
    top = min(band.high_hz if top_hz is None else top_hz, 0.4 * rate_hz)
    if not 0.0 < crossover < top:
        raise ArgumentError("band: a crossover between zero and the top frequency expected")
    fast = np.concatenate([np.zeros((1, 3)), np.cumsum(series.increments_rad(), axis=0)])
    low = _angle_at(slow, series.times_s)
    ends = min(round(rate_hz / crossover), len(fast) // 4)

    def kept(frequency: FloatArray) -> NDArray[np.complex128]:
        share = _above(frequency, crossover)
        fade = np.clip((1.25 * top - frequency) / (0.25 * top), 0.0, 1.0)
        gain = 0.5 * (1.0 - np.cos(np.pi * fade)) * share
        gain[0] = 0.0
        response = band.response(frequency)
        response[0] = 1.0
        return gain / response

    def lost(frequency: FloatArray) -> NDArray[np.complex128]:
        return _above(frequency, crossover).astype(np.complex128)

    angle = low - _filtered(low, lost, rate_hz, ends) + _filtered(fast, kept, rate_hz, ends)
    values = np.diff(angle, axis=0)
    if series.kind == "mean-rate":
        values = values / np.diff(series.times_s)[:, None]
    return GyroSeries.of(series.times_s, np.concatenate([values[:1], values]), series.kind)


def _above(frequency_hz: FloatArray, crossover_hz: float) -> FloatArray:
    """Share of the fast sensor: 0 at zero with four zeros, so that its high pass divides out."""
    ratio = (frequency_hz / crossover_hz) ** 4
    result: FloatArray = ratio / (1.0 + ratio)
    return result


def _filtered(
    angle: FloatArray,
    gain: Callable[[FloatArray], NDArray[np.complex128]],
    rate_hz: float,
    ends: int,
) -> FloatArray:
    """Multiply the spectrum of angles (n, 3) by `gain`, after odd mirroring at both ends.

    They are mirrored about lines through the first and last `ends` samples, not about end
    samples: those are noisy, and their noise would last as long as the extension.
    """
    n = len(angle)
    first, last = _line_end(angle[ends - 1 :: -1]), _line_end(angle[-ends:])
    before, after = 2.0 * first - angle[:0:-1], 2.0 * last - angle[-2::-1]
    extended = np.concatenate([before, angle, after])
    size = fft.next_fast_len(len(extended), real=True)
    line = np.linspace(extended[0], extended[-1], len(extended))
    spectrum = fft.rfft(extended - line, size, axis=0)
    spectrum *= gain(np.asarray(fft.rfftfreq(size, 1.0 / rate_hz)))[:, None]
    return np.asarray(fft.irfft(spectrum, size, axis=0)[n - 1 : 2 * n - 1])


def _line_end(angle: FloatArray) -> FloatArray:
    """Value (3,) at the last sample of the line through samples (k, 3)."""
    place = np.linspace(-1.0, 0.0, len(angle)) if len(angle) > 1 else np.zeros(1)
    offset = place - place.mean()
    slope = offset @ angle / max(float(offset @ offset), 1e-300)
    return np.asarray(angle.mean(axis=0) - place.mean() * slope)


def _sampling_hz(series: GyroSeries) -> float:
    if series.kind == "rate":
        raise ArgumentError("sensor band: increments or mean rates expected")
    step = np.diff(series.times_s)
    mean = float(np.mean(step))
    if np.any(np.abs(step - mean) > _STEP_TOLERANCE * mean):
        bad = int(np.argmax(np.abs(step - mean))) + 1
        raise ArgumentError(f"sensor band: equal steps expected, that to sample {bad} differs")
    return 1.0 / mean


def _angle_at(slow: GyroSeries, times: FloatArray) -> FloatArray:
    """Return the summed angles (n, 3) of `slow` at `times`, by a cubic spline."""
    if times[0] < slow.times_s[0] - 1e-9 or times[-1] > slow.times_s[-1] + 1e-9:
        raise GeometryError("sensor band: the slow series does not cover the sensor's span")
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(slow.increments_rad(), axis=0)])
    return np.asarray(CubicSpline(slow.times_s, angle)(times))
