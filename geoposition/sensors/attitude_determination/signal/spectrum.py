"""Power spectra of series at even or uneven epochs, with confidence.

Even steps go through the FFT; uneven ones through the same sums at the true epochs, so a step
that alternates between 0.1 and 0.2 s brings no lines of its own. White noise of variance s² at
n epochs over T seconds has the one-sided density 2 s² T / n.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy import fft, signal, stats

from geoposition.arrays import FloatArray, read_only, require_finite, require_increasing
from geoposition.errors import ArgumentError

SpectrumMethod: TypeAlias = Literal["welch", "multitaper", "lomb-scargle"]

_EVEN_TOLERANCE: Final = 0.01
"""Epochs are even if none is farther from the even grid than this part of a step."""
_LONG: Final = 100_000
_SPREAD: Final = 12
"""Grid points on each side that one uneven sample is spread over: 1e-11 of the sum is lost."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """One-sided density of each column of a series.

    `density` (m, k) in unit²/Hz at `frequency_hz` (m,); with probability `confidence` the true
    density is between `low` and `high` times the given one. `resolution_hz` is the width
    (equivalent noise bandwidth) of a line, `freedom` the degrees of freedom.
    """

    frequency_hz: FloatArray
    density: FloatArray
    method: SpectrumMethod
    resolution_hz: float
    freedom: float
    confidence: float

    @property
    def low(self) -> float:
        """Lower confidence factor."""
        return float(self.freedom / stats.chi2.ppf(0.5 + 0.5 * self.confidence, self.freedom))

    @property
    def high(self) -> float:
        """Upper confidence factor."""
        return float(self.freedom / stats.chi2.ppf(0.5 - 0.5 * self.confidence, self.freedom))

    def amplitude(self) -> FloatArray:
        """Amplitudes (m, k) of pure lines that would give this density."""
        return read_only(np.sqrt(2.0 * self.density * self.resolution_hz))


def is_even(times_s: FloatArray) -> bool:
    """Tell whether `times_s` (n,) are multiples of one step, to 1 % of it."""
    n = len(times_s)
    grid = np.linspace(times_s[0], times_s[-1], n)
    step = (times_s[-1] - times_s[0]) / (n - 1)
    return bool(np.max(np.abs(times_s - grid)) <= _EVEN_TOLERANCE * step)


def highest_frequency_hz(times_s: FloatArray) -> float:
    """Half the sampling rate: the Nyquist limit, for uneven epochs that of the usual step."""
    if is_even(times_s):
        return 0.5 * (len(times_s) - 1) / float(times_s[-1] - times_s[0])
    return 0.5 / float(np.median(np.diff(times_s)))


def spectrum(
    times_s: ArrayLike,
    values: ArrayLike,
    *,
    method: SpectrumMethod | None = None,
    segments: int = 8,
    confidence: float = 0.95,
    highest_hz: float | None = None,
) -> Spectrum:
    """Density of `values` (n,) or (n, k) at increasing `times_s` (n,), each segment without mean.

    Welch's (Hann, half overlapping) or multitaper for even epochs, Hann-weighted Lomb–Scargle
    sums over the same segments for uneven ones; `method` None chooses. `segments` is how many
    lengths of a segment make the series; for "multitaper", half the number of sine tapers.
    *Source*: Welch 1967; Riedel & Sidorenko 1995; Scargle 1982.
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "spectrum times")
    series = require_finite(np.asarray(values, dtype=np.float64), "spectrum values")
    columns = series.reshape(len(times), -1)
    if len(times) < 16 or segments < 1:
        raise ArgumentError("spectrum: at least 16 samples and 1 segment expected")
    even = is_even(times)
    chosen: SpectrumMethod = method or ("welch" if even else "lomb-scargle")
    if not even and chosen != "lomb-scargle":
        raise ArgumentError(f"spectrum: {chosen} needs even steps, use lomb-scargle")
    limit = highest_frequency_hz(times) if highest_hz is None else highest_hz
    length = fft.prev_fast_len(max(16, len(times) // segments), real=True)
    if chosen == "welch":
        rate = 2.0 * highest_frequency_hz(times)
        frequency, density = signal.welch(columns.T.copy(), rate, nperseg=length)
        density = density.T
        resolution, count = 1.5 * rate / length, _overlapping(len(times), length)
    elif chosen == "multitaper":
        frequency, density, resolution, count = _multitaper(times, columns, segments)
    else:
        frequency, density, resolution, count = _segmented(times, columns, length, limit)
    used = (frequency > 0.0) & (frequency <= limit * (1.0 + 1e-9))
    freedom = 2.0 * count if chosen == "multitaper" else 2.0 * _effective(count)
    return Spectrum(
        read_only(frequency[used]),
        read_only(density[used]),
        chosen,
        float(resolution),
        freedom,
        confidence,
    )


def periodogram(
    times_s: FloatArray, values: FloatArray, limit_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Frequencies (m,) up to `limit_hz`, and Hann-weighted power (m,) of the whole series.

    Power is |sum w y exp(−i w t)|² / sum w²: its mean is s² for white noise of variance s².
    """
    n = len(times_s)
    span = times_s[-1] - times_s[0]
    weights = (
        np.sin(np.pi * (times_s - times_s[0] + 0.5 * span / n) / (span * (1.0 + 1.0 / n))) ** 2
    )
    if is_even(times_s):
        # Between the bins of the bare length a line would lose a third of its power.
        padded = fft.next_fast_len(2 * n if n < _LONG else n, real=True)
        sums = fft.rfft(weights * values, padded)
        frequency = np.arange(len(sums)) * ((n - 1) / (span * padded))
        used = frequency <= limit_hz * (1.0 + 1e-9)
        frequency, sums = frequency[used], sums[used]
    else:
        spacing = 0.5 / span
        count = max(2, int(limit_hz / spacing) + 1)
        frequency = np.arange(count) * spacing
        sums = fourier_sums(times_s - times_s[0], weights * values, spacing, count)
    return frequency, np.abs(sums) ** 2 / np.sum(weights**2)


def fourier_sums(
    times_s: FloatArray, values: FloatArray, spacing_hz: float, count: int
) -> FloatArray:
    """Give sums (count,) of v exp(−2 pi i k `spacing_hz` t) over uneven epochs, k = 0 .. count − 1.

    Samples are spread on a grid with a Gaussian, which is divided out after the FFT. *Source*:
    Greengard & Lee 2004, SIAM Review 46, 443–454.
    """
    size = fft.next_fast_len(4 * count, real=True)
    phase = np.mod(times_s * spacing_hz, 1.0)
    # Their tau for the band −count .. count of a grid of `size`.
    ratio = size / (2.0 * count)
    tau = np.pi * _SPREAD / ((2.0 * count) ** 2 * ratio * (ratio - 0.5))
    grid = np.zeros(size)
    _spread(phase, values, tau, grid)
    k = np.arange(count)
    sums = fft.rfft(grid)[:count] * (np.sqrt(np.pi / tau) / size) * np.exp(tau * k**2)
    return np.asarray(sums)


@njit(cache=True, error_model="numpy")
def _spread(phase: FloatArray, values: FloatArray, tau: float, grid: FloatArray) -> None:
    size = len(grid)
    for j in range(len(phase)):
        centre = int(phase[j] * size)
        for m in range(centre - _SPREAD + 1, centre + _SPREAD + 1):
            distance = 2.0 * np.pi * (phase[j] - m / size)
            grid[m % size] += values[j] * np.exp(-distance * distance / (4.0 * tau))


def _overlapping(n: int, length: int) -> int:
    step = length - length // 2
    return max(1, (n - length) // step + 1)


def _effective(count: int) -> float:
    # Half overlapping Hann segments correlate by 1/6 in amplitude, 1/36 in power.
    return count / (1.0 + 2.0 * (count - 1) / count / 36.0)


def _multitaper(
    times: FloatArray, columns: FloatArray, segments: int
) -> tuple[FloatArray, FloatArray, float, int]:
    n, count = len(times), 2 * segments
    rate = 2.0 * highest_frequency_hz(times)
    centred = columns - columns.mean(axis=0)
    density = np.zeros((n // 2 + 1, columns.shape[1]))
    place = np.pi * np.arange(1, n + 1) / (n + 1)
    for order in range(1, count + 1):
        taper = np.sqrt(2.0 / (n + 1)) * np.sin(order * place)
        density += np.abs(fft.rfft(taper[:, None] * centred, axis=0)) ** 2
    density *= 2.0 / (rate * count)
    return np.arange(len(density)) * rate / n, density, (count + 1) * rate / n, count


def _segmented(
    times: FloatArray, columns: FloatArray, length: int, limit_hz: float
) -> tuple[FloatArray, FloatArray, float, int]:
    span = (times[-1] - times[0]) * length / len(times)
    spacing = 1.0 / span
    count = int(limit_hz / spacing) + 1
    total = np.zeros((count, columns.shape[1]))
    used = 0
    for first in np.arange(_overlapping(len(times), length)) * (length - length // 2):
        part = slice(first, first + length)
        t = times[part] - times[first]
        weights = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
        # The epochs' own spacing weighs the samples: dense stretches shall not count more.
        scale = 2.0 * span / length / np.sum(weights**2)
        for k in range(columns.shape[1]):
            column = columns[part, k]
            centred = column - np.average(column, weights=weights)
            total[:, k] += scale * np.abs(fourier_sums(t, weights * centred, spacing, count)) ** 2
        used += 1
    return np.arange(count) * spacing, total / used, 1.5 / span, used
