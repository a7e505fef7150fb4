"""Jitter from parallax: p(t) = j(t + lag) − j(t), solved for j line by line of its spectrum.

A sinusoid of frequency f passes with the gain 2 sin(pi f lag), half a period and half the lag
ahead: it is blind at multiples of 1 / lag. A block of lines takes a mean, which damps it by
sinc(f block). Both are undone, and their slope is part of the uncertainty.

*Source*: Iwasaki 2011, Detection and estimation of satellite attitude jitter using remote
sensing imagery, section 3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from geoposition.reimage.parallax import Parallax
from geoposition.reimage.sinusoids import Sinusoid, strongest

Axis = Literal["line", "sample"]

_LEAST_GAIN: Final = 0.2
"""Of at most 2: nearer to a blind frequency a line is noise made large."""


@dataclass(frozen=True, slots=True)
class JitterLine:
    """A line of the jitter as the image has it: along `axis`, amplitude in pixels.

    `line` has j(t) = amplitude cos(2 pi f t + phase); `gain` is what of it the parallax shows.
    """

    axis: Axis
    line: Sinusoid
    gain: float

    def amplitude_rad(self, pixel_rad: float) -> float:
        """Amplitude as an angle, where a pixel is `pixel_rad` wide: pitch for line, else roll."""
        return self.line.amplitude * pixel_rad


def jitter_of(
    parallax: Parallax, count: int = 4, significance: float = 4.0
) -> tuple[JitterLine, ...]:
    """Up to `count` lines of the jitter for each axis, strongest first."""
    found: list[JitterLine] = []
    axes: tuple[Axis, Axis] = ("line", "sample")
    for k, axis in enumerate(axes):
        for line in strongest(parallax.times_s, parallax.shift_px[:, k], count, None, significance):
            gain = parallax_gain(line.frequency_hz, parallax.lag_s, parallax.block_s)
            if abs(gain) >= _LEAST_GAIN:
                found.append(JitterLine(axis, _undone(line, parallax), abs(gain)))
    return tuple(sorted(found, key=lambda item: -item.line.amplitude))


def parallax_gain(frequency_hz: float, lag_s: float, block_s: float = 0.0) -> float:
    """Gain 2 sin(pi f lag) sinc(f block), with its sign."""
    gain = 2.0 * np.sin(np.pi * frequency_hz * lag_s) * np.sinc(frequency_hz * block_s)
    return float(gain)


def _undone(line: Sinusoid, parallax: Parallax) -> Sinusoid:
    f, lag = line.frequency_hz, parallax.lag_s
    gain = parallax_gain(f, lag, parallax.block_s)
    step = max(line.sigma_frequency_hz, 1e-9 * f)
    beside = parallax_gain(f + step, lag, parallax.block_s)
    relative = (beside - gain) / (step * gain) * line.sigma_frequency_hz
    amplitude = line.amplitude / abs(gain)
    # p = 2 a sin(pi f lag) cos(2 pi f t + phase + pi f lag + pi / 2)
    phase = line.phase_rad - np.pi * f * lag - 0.5 * np.pi + (np.pi if gain < 0.0 else 0.0)
    return Sinusoid(
        f,
        amplitude,
        float(np.remainder(phase + np.pi, 2.0 * np.pi) - np.pi),
        line.sigma_frequency_hz,
        float(np.hypot(line.sigma_amplitude / abs(gain), amplitude * relative)),
        float(np.hypot(line.sigma_phase_rad, np.pi * lag * line.sigma_frequency_hz)),
    )


@dataclass(frozen=True, slots=True)
class ComparedLine:
    """Lines of one frequency as different sources have them; `None` where one has none."""

    frequency_hz: float
    by_source: Mapping[str, Sinusoid | None]


def compared(
    sources: Mapping[str, Sequence[Sinusoid]], within_hz: float
) -> tuple[ComparedLine, ...]:
    """Lay lines of several sources beside each other: the attitude's, the images', a match's.

    Lines within `within_hz` of the strongest one left are the same line.
    """
    left = {name: list(lines) for name, lines in sources.items()}
    rows = []
    while any(left.values()):
        strong = max((line for lines in left.values() for line in lines), key=lambda s: s.amplitude)
        row: dict[str, Sinusoid | None] = {}
        for name, lines in left.items():
            near = [s for s in lines if abs(s.frequency_hz - strong.frequency_hz) <= within_hz]
            row[name] = max(near, key=lambda s: s.amplitude) if near else None
            left[name] = [s for s in lines if s not in near]
        rows.append(ComparedLine(strong.frequency_hz, row))
    return tuple(rows)
