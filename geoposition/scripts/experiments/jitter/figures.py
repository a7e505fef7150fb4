"""P's figures 3 to 9 from our scenes, and how error runs along every image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geoposition.arrays import FloatArray
from geoposition.calib_fields.evaluation import Evaluation
from geoposition.reimage.sinusoids import amplitude_spectrum
from geoposition.scripts.experiments.jitter.chain import FilterCourse, SceneResult
from geoposition.scripts.experiments.jitter.outcome import Scene
from geoposition.scripts.figures import COLOURS, STYLE, png
from geoposition.sensors.attitude_determination.jitter.lines import AXES

ARCSEC_RAD: Final = float(np.pi / 648000.0)
_DEG_H_RAD_S: Final = float(np.pi / 648000.0)
_MOST_POINTS: Final = 3000
_MOST_ARROWS: Final = 500
SHOWN: Final = ("yaw", "roll", "pitch")
"""In the order of P figure 3."""
_SIDES: Final = ("along track, px", "across track, px")


def shaking(chain: SceneResult) -> bytes:
    """Angles of the jitter over a tenth of a second: P figure 3."""
    times = 1e3 * chain.shaken_s
    with mpl.rc_context(STYLE):
        figure, column = _column(3, 1.1)
        for axes, name in zip(column, SHOWN, strict=True):
            k = AXES.index(name)
            axes.plot(times, chain.shaken_rad[:, k] / ARCSEC_RAD, color=COLOURS[k], lw=0.8)
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.set_ylabel(f"{name}, ″")
            axes.margins(x=0.0)
        column[-1].set_xlabel("time from the image's middle, ms")
        return png(figure)


def amplitudes(chain: SceneResult) -> bytes:
    """Amplitude of the jitter by frequency, the lines found marked: P figure 4."""
    found = chain.jitter
    half = len(found.times_s) // 2
    part = np.s_[max(half - 50_000, 0) : half + 50_000]
    frequency, amplitude = amplitude_spectrum(
        found.times_s[part], found.angle_rad[part] / ARCSEC_RAD
    )
    shown = (frequency > 1.0) & (frequency <= 450.0)
    with mpl.rc_context(STYLE):
        figure, column = _column(3, 1.1)
        for axes, name in zip(column, SHOWN, strict=True):
            k = AXES.index(name)
            axes.plot(frequency[shown], amplitude[shown, k], color=COLOURS[k], lw=0.8)
            for peak in found.axes[name]:
                size = peak.amplitude_rad / ARCSEC_RAD
                axes.plot(peak.frequency_hz, size, "o", ms=4.5, mfc="none", color="#222222")
                axes.annotate(
                    f"{peak.frequency_hz:.0f} Hz\n{size:.4f}″", (peak.frequency_hz, size),
                    xytext=(0, 4), textcoords="offset points", ha="center", fontsize=7,
                )  # fmt: skip
            axes.set_ylabel(f"{name}, ″")
            axes.set_ylim(0.0, 0.042)
            axes.margins(x=0.0)
        column[-1].set_xlabel("frequency, Hz")
        return png(figure)


def filter_errors(course: FilterCourse) -> bytes:
    """Errors of the fused attitude within three of their standard deviations: P figure 5."""
    return _within(
        course.times_s, course.error_rad / ARCSEC_RAD, course.sigma_rad / ARCSEC_RAD, "″"
    )


def drift_errors(course: FilterCourse) -> bytes:
    """Errors of the estimated drift within three standard deviations: P figure 6."""
    error = (course.drift_rad_s - course.true_drift_rad_s) / _DEG_H_RAD_S
    return _within(
        course.times_s, error, course.drift_sigma_rad_s / _DEG_H_RAD_S, "°/h", ("b x", "b y", "b z")
    )


def drifts(course: FilterCourse) -> bytes:
    """Draw the estimated drift, and the true one dashed: P figure 7."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 2.4), layout="constrained")
        axes = figure.add_subplot()
        pick = _thinned(len(course.times_s))
        for k, name in enumerate("xyz"):
            estimated = course.drift_rad_s[pick, k] / _DEG_H_RAD_S
            axes.plot(course.times_s[pick], estimated, color=COLOURS[k], lw=1.1, label=f"b {name}")
            true = course.true_drift_rad_s[k] / _DEG_H_RAD_S
            axes.axhline(true, color=COLOURS[k], lw=0.7, ls="--")
        axes.set_xlabel("time, s")
        axes.set_ylabel("drift, °/h")
        axes.margins(x=0.0)
        axes.legend(ncols=3)
        return png(figure)


def profiles(scenes: Sequence[Scene], stage: str) -> bytes:
    """Error along every image: the truth as a line, the orthophoto's residuals as dots."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 0.5 + 1.15 * len(scenes)), layout="constrained")
        grid: Any = figure.subplots(len(scenes), 2, sharex=True, sharey=True, squeeze=False)
        for row, scene in zip(grid, scenes, strict=True):
            chain = scene.chain
            true = chain.error_before if stage == "before" else chain.error_after
            found = scene.before if stage == "before" else scene.after
            pick = _thinned(len(true.rows))
            line = found.matches.model_px[_used(found.matches), 0]
            for k, axes in enumerate(row):
                axes.axhline(0.0, color="#999999", lw=0.6)
                axes.plot(true.rows[pick], true.profile_px[pick, k], color="#222222", lw=0.7)
                axes.plot(line, found.residual_px[:, k], ".", ms=2.0, color=COLOURS[k])
                axes.margins(x=0.01)
            name = chain.case.published
            row[0].set_ylabel(f"{name.region}\n{name.date[5:10]}", fontsize=7.5)
        for k, axes in enumerate(grid[0]):
            axes.set_title(_SIDES[k])
        for axes in grid[-1]:
            axes.set_xlabel("line")
        return png(figure)


def vectors(panels: Sequence[tuple[str, Evaluation]]) -> bytes:
    """Residuals as arrows over line and sample, along the track to the right."""
    with mpl.rc_context(STYLE):
        figure, column = _column(len(panels), 1.5)
        for k, (axes, (title, found)) in enumerate(zip(column, panels, strict=True)):
            place = found.matches.model_px[_used(found.matches)]
            few = np.linspace(0, len(place) - 1, min(len(place), _MOST_ARROWS)).astype(np.int64)
            arrow = found.residual_px[few]
            size = max(float(np.quantile(np.hypot(*arrow.T), 0.9)), 1e-9)
            drawn = axes.quiver(
                *place[few].T, *arrow.T, angles="uv", scale_units="width", scale=22.0 * size,
                width=0.0016, color=COLOURS[k],
            )  # fmt: skip
            axes.quiverkey(drawn, 0.88, 1.08, size, f"{size:.2g} px", labelpos="E")
            axes.set_title(title)
            axes.set_ylabel("sample")
            axes.margins(0.04)
        column[-1].set_xlabel("line")
        return png(figure)


def residuals(scene: Scene) -> bytes:
    """Residuals of all matched points of the steady image over line and sample: P figure 9."""
    found = scene.after
    place = found.matches.model_px[_used(found.matches)]
    limit = max(float(np.quantile(np.abs(found.residual_px), 0.99)), 0.01)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 3.6), layout="constrained")
        grid: Any = figure.subplots(2, 2, sharey=True)
        for k, row in enumerate(grid):
            for axes, coordinate, label in zip(row, place.T, ("line", "sample"), strict=True):
                axes.axhline(0.0, color="#999999", lw=0.6)
                axes.plot(coordinate, found.residual_px[:, k], ".", ms=1.5, color=COLOURS[k])
                axes.set_ylim(-1.3 * limit, 1.3 * limit)
                axes.margins(x=0.01)
                if k == 1:
                    axes.set_xlabel(label)
            row[0].set_ylabel(_SIDES[k])
        return png(figure)


def _used(matches: Any) -> Any:
    return matches.used & np.isfinite(matches.error_px).all(axis=1)


def _within(
    times_s: FloatArray,
    error: FloatArray,
    sigma: FloatArray,
    unit: str,
    names: Sequence[str] = AXES,
) -> bytes:
    pick = _thinned(len(times_s))
    with mpl.rc_context(STYLE):
        figure, column = _column(3, 1.0)
        for k, (axes, name) in enumerate(zip(column, names, strict=True)):
            reach = 3.0 * sigma[pick, k]
            axes.fill_between(times_s[pick], -reach, reach, color=COLOURS[k], alpha=0.18, lw=0)
            axes.plot(times_s[pick], error[pick, k], color=COLOURS[k], lw=0.8)
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.set_ylabel(f"{name}, {unit}")
            axes.margins(x=0.0)
        column[-1].set_xlabel("time, s")
        return png(figure)


def _column(count: int, height: float) -> tuple[Figure, Any]:
    figure = Figure(figsize=(6.8, 0.5 + height * count), layout="constrained")
    return figure, np.atleast_1d(figure.subplots(count, 1, sharex=True))


def _thinned(count: int) -> slice:
    return slice(None, None, max(count // _MOST_POINTS, 1))
