"""Figures of attitude reports: series with 3-sigma bands, innovations, spectra, angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geoposition.arrays import BoolArray, FloatArray
from geoposition.scripts.figures import COLOURS, STYLE, png

_MOST_POINTS: Final = 4000
"""A figure is 1000 pixels wide: more points only make the page heavy."""


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A series (n, k) with its standard deviations (n, k); `dots` are samples beside it."""

    times_s: FloatArray
    values: FloatArray
    sigma: FloatArray | None = None
    dots: tuple[FloatArray, FloatArray] | None = None


def bands(band: Band, labels: Sequence[str], unit: str, time_label: str = "time, s") -> bytes:
    """Series above each other, each with its own scale and a band of three sigma."""
    pick = _thinned(len(band.times_s))
    times = band.times_s[pick]
    with mpl.rc_context(STYLE):
        figure, column = _column(len(labels))
        for k, (axes, label) in enumerate(zip(column, labels, strict=True)):
            line = band.values[pick, k]
            if band.dots is not None:
                at, dots = band.dots
                few = _thinned(len(at))
                axes.plot(at[few], dots[few, k], ".", ms=1.6, color="#888888", zorder=1)
            if band.sigma is not None:
                reach = 3.0 * band.sigma[pick, k]
                axes.fill_between(
                    times, line - reach, line + reach, color=COLOURS[k % 6], alpha=0.25, lw=0
                )
            axes.plot(times, line, color=COLOURS[k % 6], lw=0.9)
            axes.set_ylabel(f"{label}, {unit}")
            axes.margins(x=0.0)
        column[-1].set_xlabel(time_label)
        return png(figure)


def innovations(
    times_s: FloatArray, residual: FloatArray, sigma: FloatArray, accepted: BoolArray, unit: str
) -> bytes:
    """Innovations (n, 3) as dots within three of their sigmas (n, 3); rejected ones set off."""
    with mpl.rc_context(STYLE):
        figure, column = _column(3)
        pick = _thinned(len(times_s))
        for k, axes in enumerate(column):
            for sign in (-3.0, 3.0):
                axes.plot(times_s[pick], sign * sigma[pick, k], color="#999999", lw=0.7)
            good = accepted[pick]
            axes.plot(times_s[pick][good], residual[pick, k][good], ".", ms=2.0, color=COLOURS[k])
            if not accepted.all():
                axes.plot(times_s[~accepted], residual[~accepted, k], "x", ms=4.0, color="#222222")
                # One wild sample must not flatten the others.
                reach = 6.0 * float(np.median(sigma[:, k]))
                axes.set_ylim(-reach, reach)
            axes.set_ylabel(f"{'xyz'[k]}, {unit}")
            axes.margins(x=0.0)
        column[-1].set_xlabel("time, s")
        return png(figure)


def spectra(
    frequency_hz: FloatArray,
    density: FloatArray,
    labels: Sequence[str],
    unit: str,
    confidence: tuple[float, float],
    lines: Mapping[str, Sequence[float]] | None = None,
) -> bytes:
    """Densities (m, k) with their confidence as a band; found lines as ticks below."""
    good = frequency_hz > 0.0
    frequency = frequency_hz[good]
    # A spectrum is thinned by its maxima: no line may vanish from the drawing.
    block = max(len(frequency) // _MOST_POINTS, 1)
    cut = len(frequency) // block * block
    frequency = frequency[:cut].reshape(-1, block).mean(axis=1)
    values = density[good][:cut].reshape(-1, block, density.shape[1]).max(axis=1)
    with mpl.rc_context(STYLE):
        figure, column = _column(len(labels), 1.5)
        for k, (axes, label) in enumerate(zip(column, labels, strict=True)):
            axes.fill_between(
                frequency, values[:, k] * confidence[0], values[:, k] * confidence[1],
                color=COLOURS[k % 6], alpha=0.2, lw=0,
            )  # fmt: skip
            axes.loglog(frequency, values[:, k], color=COLOURS[k % 6], lw=0.8)
            for place in (lines or {}).get(label, ()):
                axes.plot(place, 0.04, "^", ms=4, color="#222222",
                          transform=axes.get_xaxis_transform())  # fmt: skip
            axes.set_ylabel(f"{label}, {unit}")
            axes.margins(x=0.0)
        column[-1].set_xlabel("frequency, Hz")
        return png(figure)


def angles(series: Mapping[str, tuple[FloatArray, FloatArray]], unit: str) -> bytes:
    """Series with their own times, named, each about its mean, above each other."""
    with mpl.rc_context(STYLE):
        figure, column = _column(len(series))
        for k, (axes, (name, (times, values))) in enumerate(
            zip(column, series.items(), strict=True)
        ):
            pick = _thinned(len(times))
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.plot(times[pick], values[pick], ".-", ms=2.5, lw=0.6, color=COLOURS[k % 6])
            axes.set_title(name)
            axes.set_ylabel(unit)
            axes.margins(x=0.0)
        column[-1].set_xlabel("time, s")
        return png(figure)


def _column(count: int, height: float = 1.25) -> tuple[Figure, Any]:
    figure = Figure(figsize=(6.8, 0.6 + height * count), layout="constrained")
    return figure, np.atleast_1d(figure.subplots(count, 1, sharex=True))


def _thinned(count: int) -> slice:
    return slice(None, None, max(count // _MOST_POINTS, 1))
