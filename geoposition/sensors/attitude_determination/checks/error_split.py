"""Low-frequency, high-frequency and random error of axis angles or attitude differences.

low frequency
    What repeats with the orbit (harmonics of its period, by least squares), or, without a period,
    what is slower than `low_hz`.
high frequency
    What is left, is slower than `high_hz`, and is more than the white noise in that band.
random
    White noise.

Smoothing splines of the stated cut-offs part the series; the white noise that the two filters
pass is known from their gain, so that each standard deviation is that of its own error alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, read_only, require_finite, require_increasing
from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.signal.low_pass import low_pass, low_pass_gain
from geoposition.sensors.attitude_determination.signal.spectrum import highest_frequency_hz

_ARCSEC_RAD: Final = np.pi / 648000.0
_LOW_PERIODS: Final = 4.0
_HIGH_PART: Final = 0.1
"""Default cut-offs: a quarter of the span, and a tenth of the Nyquist frequency."""
_FEWEST: Final = 32


@dataclass(frozen=True, slots=True)
class SplitSettings:
    """Cut-offs of half gain; None takes a quarter of the span and a tenth of Nyquist.

    With `orbit_period_s`, `harmonics` of it are the low-frequency error, if the series covers a
    whole period; a straight line is taken out with them.
    """

    orbit_period_s: float | None = None
    harmonics: int = 3
    low_hz: float | None = None
    high_hz: float | None = None

    def __post_init__(self) -> None:
        for value in (self.orbit_period_s, self.low_hz, self.high_hz):
            if value is not None and not 0.0 < value < np.inf:
                raise ArgumentError("error split: positive period and cut-offs expected")
        if self.harmonics < 1:
            raise ArgumentError("error split: at least 1 harmonic expected")


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSplit:
    """Parts of a series (n,) or (n, k): `low` + `high` + `random` = values − `mean`.

    The standard deviations (k,) are of the errors themselves: white noise that passes the filters
    is counted as random. `harmonics` says whether `low` is periodic or a low-pass of `low_hz`.
    """

    times_s: FloatArray
    mean: FloatArray
    low: FloatArray
    high: FloatArray
    random: FloatArray
    low_std: FloatArray
    high_std: FloatArray
    random_std: FloatArray
    low_hz: float
    high_hz: float
    harmonics: bool

    def summary(self, column: int = 0) -> Mapping[str, object]:
        """Figures of one column of angles, in arc seconds."""
        return {
            "low_frequency_arcsec": float(self.low_std[column]) / _ARCSEC_RAD,
            "high_frequency_arcsec": float(self.high_std[column]) / _ARCSEC_RAD,
            "random_arcsec": float(self.random_std[column]) / _ARCSEC_RAD,
            "low_cutoff_hz": self.low_hz,
            "high_cutoff_hz": self.high_hz,
            "low_frequency_model": "orbit harmonics" if self.harmonics else "low-pass",
        }


def split_errors(
    times_s: ArrayLike, values: ArrayLike, settings: SplitSettings | None = None
) -> ErrorSplit:
    """Part `values` (n,) or (n, k) at strictly increasing `times_s` (n,), even or not.

    At least 32 samples, with `low_hz` < `high_hz` < Nyquist. *Source*: T 2.3.1 and abstract.
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "error split times")
    series = require_finite(np.asarray(values, dtype=np.float64), "error split values")
    if len(times) < _FEWEST or len(series) != len(times):
        raise ArgumentError(f"error split: at least {_FEWEST} samples, one value for each time")
    chosen = settings or SplitSettings()
    columns = series.reshape(len(times), -1)
    span = float(times[-1] - times[0])
    nyquist = highest_frequency_hz(times)
    low_hz = _LOW_PERIODS / span if chosen.low_hz is None else chosen.low_hz
    high_hz = _HIGH_PART * nyquist if chosen.high_hz is None else chosen.high_hz
    if not low_hz < high_hz < nyquist:
        raise ArgumentError(
            f"error split: cut-offs {low_hz:.4g} and {high_hz:.4g} Hz must rise and stay below "
            f"half the sampling rate, {nyquist:.4g} Hz"
        )
    mean = columns.mean(axis=0)
    centred = columns - mean
    period = chosen.orbit_period_s
    periodic = period is not None and span >= period
    if periodic and period is not None:
        low = _harmonics(times, centred, period, chosen.harmonics)
    else:
        low = low_pass(times, centred, low_hz)
    rest = centred - low
    high = low_pass(times, rest, high_hz)
    random = rest - high
    grid = (np.arange(4096) + 0.5) / 4096 * nyquist
    in_low = np.zeros(1) if periodic else low_pass_gain(grid, low_hz)
    in_high = low_pass_gain(grid, high_hz)
    # Shares of white noise in each part.
    noise = np.mean(random**2, axis=0) / np.mean(((1.0 - in_low) * (1.0 - in_high)) ** 2)
    high_power = np.mean(high**2, axis=0) - noise * np.mean(((1.0 - in_low) * in_high) ** 2)
    terms = (2 + 2 * chosen.harmonics) / len(times) if periodic else float(np.mean(in_low**2))
    low_power = np.mean(low**2, axis=0) - noise * terms
    shape = series.shape
    return ErrorSplit(
        read_only(times),
        read_only(mean),
        read_only(low.reshape(shape)),
        read_only(high.reshape(shape)),
        read_only(random.reshape(shape)),
        read_only(np.sqrt(np.maximum(low_power, 0.0))),
        read_only(np.sqrt(np.maximum(high_power, 0.0))),
        read_only(np.sqrt(noise)),
        low_hz,
        high_hz,
        periodic,
    )


def _harmonics(times: FloatArray, columns: FloatArray, period_s: float, count: int) -> FloatArray:
    phase = 2.0 * np.pi * (times - times[0])[:, None] / period_s * np.arange(1, count + 1)
    line = (times - times.mean())[:, None] / (times[-1] - times[0])
    design = np.hstack([np.ones_like(line), line, np.cos(phase), np.sin(phase)])
    return np.asarray(design @ np.linalg.lstsq(design, columns)[0])
