"""Residuals along and across the track, and the vibration that they still hold.

A patch averages the image over its lines, so a vibration is measured smaller than it is; the
amplitudes are divided by what a window of that size and turn lets through.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import optimize

from geoposition.arrays import FloatArray, IntArray

_MOST_LINES: Final = 5
_OVERSAMPLING: Final = 5
_MOST_FREQUENCIES: Final = 4000
_LEAST_TRANSFER: Final = 0.25
_FALSE_ALARM: Final = 1e-3
_LEAST_CYCLES: Final = 1.5
_DRIFT_DEGREE: Final = 2
_BOW_DEGREE: Final = 3
_SMALLEST_BIN: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Means of residuals in bins: `centre_px` (m,), `mean_px` (m, 2), their `sigma_px` (m, 2)."""

    centre_px: FloatArray
    mean_px: FloatArray
    sigma_px: FloatArray
    count: IntArray


def profile(coordinate_px: FloatArray, residual_px: FloatArray, bins: int) -> Profile:
    """Average residuals (n, 2) in `bins` equal bins of a coordinate (n,), those of some points."""
    low, high = float(coordinate_px.min()), float(coordinate_px.max())
    width = max(high - low, 1e-9) / bins
    index = np.clip(((coordinate_px - low) / width).astype(np.int64), 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    kept = count >= _SMALLEST_BIN
    number = np.maximum(count, 1)[:, None]
    mean = np.stack([np.bincount(index, r, bins) for r in residual_px.T], axis=1) / number
    square = np.stack([np.bincount(index, r * r, bins) for r in residual_px.T], axis=1) / number
    sigma = np.sqrt(np.maximum(square - mean**2, 0.0) / np.maximum(number - 1, 1))
    centre: FloatArray = low + (np.arange(bins, dtype=np.float64) + 0.5) * width
    return Profile(centre[kept], mean[kept], sigma[kept], count[kept])


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A vibration: frequency, its amplitudes and phases along track (line) and across (sample).

    The residual is amplitude · sin(2π frequency · t + phase), t the time or the line from the
    middle of those it was found over. `sigma_...`
    are standard deviations; `transfer` is what the windows let through, already divided out.
    """

    frequency: float
    sigma_frequency: float
    amplitude_px: tuple[float, float]
    sigma_amplitude_px: float
    phase_rad: tuple[float, float]
    transfer: float

    def measured(self, time: FloatArray) -> FloatArray:
        """Return what patches at `time` (n,) show of it: (n, 2), damped by their windows.

        `time` counts from the middle of the times it was found over.
        """
        turn = 2.0 * np.pi * self.frequency * time[:, None] + np.array(self.phase_rad)
        result: FloatArray = self.transfer * np.array(self.amplitude_px) * np.sin(turn)
        return result


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSpectrum:
    """Amplitudes (m, 2) at frequencies (m,), their noise level, and the lines that stand out.

    `unit` is Hz, or cycles per line where the model tells no time.
    """

    frequency: FloatArray
    amplitude_px: FloatArray
    noise_px: float
    lines: tuple[SpectralLine, ...]
    unit: str


def residual_spectrum(
    time: FloatArray,
    sample_px: FloatArray,
    residual_px: FloatArray,
    *,
    detector: IntArray,
    window: tuple[float, float],
    dependence: float = 1.0,
    unit: str = "Hz",
) -> ResidualSpectrum:
    """Find vibrations in residuals (n, 2) at `time` (n,), seconds or lines.

    What belongs to the sample (a cubic for each `detector` (n,)) and slow drift are fitted along.
    `window` are the durations a patch averages over, down and right; `dependence` so many points
    count as one, because their windows overlap. *Source*: Scargle 1982, ApJ 263, for the false
    alarm; each line found is fitted with those before it.
    """
    span = float(np.ptp(time))
    if not span > 0.0 or len(time) < 30:
        return ResidualSpectrum(np.zeros(0), np.zeros((0, 2)), float("nan"), (), unit)
    t = time - 0.5 * (time.min() + time.max())
    base = _slow_terms(t / span, sample_px, detector)
    highest = _highest(window, span)
    step = 1.0 / (_OVERSAMPLING * span)
    count = min(max(int(highest / step), 2), _MOST_FREQUENCIES)
    frequency = np.linspace(_LEAST_CYCLES / span, highest, count)
    project = np.linalg.qr(base)[0]
    found: list[float] = []
    first: FloatArray | None = None
    noise = float("nan")
    while True:
        q = project if not found else np.linalg.qr(np.hstack([base, *_waves(t, found)]))[0]
        left = residual_px - q @ (q.T @ residual_px)
        power = _power(t, left, frequency)
        variance = np.maximum(left.var(axis=0), 1e-12)
        independent = max(len(t) / dependence, 4.0)
        z = 0.25 * independent * np.sum(power / variance, axis=1)
        if first is None:
            first = np.sqrt(power)
            noise = float(np.sqrt(4.0 * np.mean(variance) / independent))
        # the sum of two exponentials, one per axis: (1 + z) exp(-z)
        peak = int(np.argmax(z))
        alarm = count / _OVERSAMPLING * (1.0 + z[peak]) * np.exp(-z[peak])
        if alarm > _FALSE_ALARM or len(found) >= _MOST_LINES:
            break
        found = _settled(t, residual_px, base, [*found, float(frequency[peak])], step)
    lines = _lines(t, residual_px, base, found, window, dependence)
    scale = 1.0 / _transfer(frequency, window)
    return ResidualSpectrum(frequency, first * scale[:, None], noise, lines, unit)


def _slow_terms(place: FloatArray, sample_px: FloatArray, detector: IntArray) -> FloatArray:
    columns = [place**k for k in range(1, _DRIFT_DEGREE + 1)]
    for number in np.unique(detector):
        own = detector == number
        middle, half = sample_px[own].mean(), max(float(np.ptp(sample_px[own])), 1.0)
        u = np.where(own, (sample_px - middle) / half, 0.0)
        columns += [np.where(own, u**k, 0.0) for k in range(_BOW_DEGREE + 1)]
    return np.stack(columns, axis=1)


def _transfer(frequency: FloatArray, window: tuple[float, float]) -> FloatArray:
    result: FloatArray = np.sinc(frequency * window[0]) * np.sinc(frequency * window[1])
    return np.maximum(np.abs(result), 1e-3)


def _highest(window: tuple[float, float], span: float) -> float:
    """Frequency above which the windows let too little through."""
    trial = np.linspace(0.0, 1.0 / max(max(abs(w) for w in window), 1e-12), 400)
    passed = np.sinc(trial * window[0]) * np.sinc(trial * window[1]) >= _LEAST_TRANSFER
    return max(float(trial[passed].max()), 3.0 / span)


def _power(t: FloatArray, left: FloatArray, frequency: FloatArray) -> FloatArray:
    """Squared amplitudes (m, 2) of sine waves fitted one at a time."""
    out = np.empty((len(frequency), 2))
    chunk = max(1, 2_000_000 // len(t))
    for start in range(0, len(frequency), chunk):
        part = frequency[start : start + chunk]
        phase = 2.0 * np.pi * part[:, None] * t
        c, s = np.cos(phase), np.sin(phase)
        cc, ss, cs = np.sum(c * c, axis=1), np.sum(s * s, axis=1), np.sum(c * s, axis=1)
        det = (cc * ss - cs * cs)[:, None]
        a, b = c @ left, s @ left
        x = (ss[:, None] * a - cs[:, None] * b) / det
        y = (cc[:, None] * b - cs[:, None] * a) / det
        out[start : start + chunk] = x * x + y * y
    return out


def _waves(t: FloatArray, frequencies: list[float]) -> list[FloatArray]:
    return [
        np.stack([np.sin(2.0 * np.pi * f * t), np.cos(2.0 * np.pi * f * t)], axis=1)
        for f in frequencies
    ]


def _settled(
    t: FloatArray, residual: FloatArray, base: FloatArray, start: list[float], step: float
) -> list[float]:
    """Adjust all frequencies together, everything else fitted along."""

    def misfit(frequencies: FloatArray) -> FloatArray:
        q = np.linalg.qr(np.hstack([base, *_waves(t, list(frequencies))]))[0]
        result: FloatArray = (residual - q @ (q.T @ residual)).ravel()
        return result

    solution = optimize.least_squares(
        misfit, start, x_scale=step, diff_step=1e-5, max_nfev=20, xtol=1e-9
    )
    return [float(f) for f in solution.x]


def _lines(
    t: FloatArray,
    residual: FloatArray,
    base: FloatArray,
    frequencies: list[float],
    window: tuple[float, float],
    dependence: float,
) -> tuple[SpectralLine, ...]:
    if not frequencies:
        return ()
    terms = np.hstack([base, *_waves(t, frequencies)])
    solution = np.linalg.lstsq(terms, residual, rcond=None)[0]
    left = residual - terms @ solution
    variance = float(np.mean(left.var(axis=0)))
    independent = max(len(t) / dependence, 4.0)
    sigma = np.sqrt(2.0 * variance / independent)
    lines = []
    for k, f in enumerate(frequencies):
        s, c = solution[base.shape[1] + 2 * k : base.shape[1] + 2 * k + 2]
        raw = np.hypot(s, c)
        passed = float(_transfer(np.array([f]), window)[0])
        strength = float(np.sqrt(np.sum(raw**2)))
        # Cramér–Rao for the frequency of a sine wave over a span
        sigma_f = np.sqrt(6.0 * variance / independent) / (np.pi * float(np.ptp(t)) * strength)
        phase = np.arctan2(c, s)
        lines.append(
            SpectralLine(
                f,
                float(sigma_f),
                (float(raw[0] / passed), float(raw[1] / passed)),
                float(sigma / passed),
                (float(phase[0]), float(phase[1])),
                passed,
            )
        )
    return tuple(sorted(lines, key=lambda line: -float(np.hypot(*line.amplitude_px))))
