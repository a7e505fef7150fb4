"""Figures of evaluations: where matches are, profiles, spectra, the images beside each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geoposition.arrays import FloatArray
from geoposition.calib_fields.match import Cause, DomMatches
from geoposition.calib_fields.profiles import Profile, ResidualSpectrum
from geoposition.scripts.figures import COLOURS, STYLE, VectorPanel, png

LYING: Final = 1.6
"""Images longer than that lie on their side in figures."""
_MARKS: Final = {
    Cause.USED: (COLOURS[1], ".", "used"),
    Cause.OUTLIER: (COLOURS[0], "x", "outlier"),
    Cause.LOW_CORRELATION: (COLOURS[4], "+", "low correlation"),
    Cause.NOT_CONVERGED: (COLOURS[3], "v", "not converged"),
    Cause.NO_TEXTURE: ("#777777", "_", "no texture"),
    Cause.NODATA: ("#bbbbbb", "s", "no data"),
}


def distribution(matches: DomMatches, shape: tuple[int, int]) -> bytes:
    """Places of all patches over the image, marked by what became of them.

    Long images lie on their side, the lines running to the right.
    """
    lines, samples = shape
    lying = lines > LYING * samples
    tall = samples / lines if lying else lines / samples
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, float(np.clip(5.0 * tall, 2.2, 5.6))), layout="constrained")
        axes = figure.add_subplot()
        for cause, (colour, mark, label) in _MARKS.items():
            place = matches.model_px[matches.cause == cause]
            if len(place):
                x, y = place.T if lying else place.T[::-1]
                axes.plot(x, y, mark, ms=3.0, color=colour, label=f"{label} ({len(place)})")
        if lying:
            axes.set_xlim(-0.5, lines - 0.5)
            axes.set_ylim(-0.5, samples - 0.5)
        else:
            axes.set_xlim(-0.5, samples - 0.5)
            axes.set_ylim(lines - 0.5, -0.5)
        axes.set_aspect("equal")
        axes.set_xlabel("line" if lying else "sample")
        axes.set_ylabel("sample" if lying else "line")
        figure.legend(loc="outside lower center", ncols=3, markerscale=1.6)
        return png(figure)


def lying_vectors(panels: Sequence[VectorPanel], *, unit: str) -> bytes:
    """Vector fields over a long image, places and vectors (line, sample), one below the other."""
    with mpl.rc_context(STYLE):
        wide = np.ptp(panels[0].place, axis=0)
        height = float(np.clip(6.2 * wide[1] / max(float(wide[0]), 1.0), 0.8, 4.0)) + 0.7
        figure = Figure(figsize=(6.8, height * len(panels)), layout="constrained")
        column = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
        for k, (axes, panel) in enumerate(zip(column, panels, strict=True)):
            size = max(float(np.quantile(np.hypot(*panel.vector.T), 0.9)), 1e-9)
            arrows = axes.quiver(
                *panel.place.T, *panel.vector.T, angles="xy", scale_units="xy",
                scale=15.0 * size / float(wide[0]), width=0.0016, color=COLOURS[k % len(COLOURS)],
            )  # fmt: skip
            axes.quiverkey(
                arrows, 0.9, 1.06, size, f"{size:.2g} {unit}", labelpos="E", color="#222222",
                fontproperties={"size": 8},
            )  # fmt: skip
            axes.set_title(panel.title)
            axes.set_aspect("equal")
            axes.margins(0.03)
            axes.set_ylabel("sample")
        column[-1].set_xlabel("line")
        return png(figure)


def profiles(along: Profile, across: Profile) -> bytes:
    """Mean residuals by line and by sample, with two standard deviations of the means."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 4.4), layout="constrained")
        column = figure.subplots(2, 1, sharey=True)
        for axes, found, label in zip(column, (along, across), ("line", "sample"), strict=True):
            for k, name in enumerate(("x, along track", "y, across track")):
                mean, reach = found.mean_px[:, k], 2.0 * found.sigma_px[:, k]
                axes.fill_between(
                    found.centre_px, mean - reach, mean + reach, color=COLOURS[k], alpha=0.2, lw=0
                )
                axes.plot(found.centre_px, mean, ".-", color=COLOURS[k], lw=0.9, ms=3, label=name)
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.set_xlabel(label)
            axes.set_ylabel("residual, px")
            axes.margins(x=0.01)
        column[0].legend(ncols=2)
        return png(figure)


def spectrum(found: ResidualSpectrum) -> bytes:
    """Amplitudes over frequency, both axes, with the lines that stand out."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 2.8), layout="constrained")
        axes = figure.add_subplot()
        for k, name in enumerate(("x, along track", "y, across track")):
            axes.plot(
                found.frequency, found.amplitude_px[:, k], color=COLOURS[k], lw=0.9, label=name
            )
        for line in found.lines:
            axes.axvline(line.frequency, color="#999999", lw=0.6, ls="--")
            axes.annotate(
                f"{line.frequency:.3g}", (line.frequency, 1.0), xycoords=("data", "axes fraction"),
                fontsize=7.5, color="#444444", ha="left", va="top", xytext=(2, 0),
                textcoords="offset points",
            )  # fmt: skip
        axes.axhline(2.0 * found.noise_px, color="#777777", lw=0.7, ls=":", label="2 × noise")
        axes.set_xlabel(f"frequency, {found.unit}")
        axes.set_ylabel("amplitude, px")
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.0)
        axes.legend()
        return png(figure)


def beside(images: Mapping[str, FloatArray], captions: Sequence[str] = ()) -> bytes:
    """Grey images beside each other, each stretched between its 2nd and 98th percentile."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 3.9), layout="constrained")
        row: Any = np.atleast_1d(figure.subplots(1, len(images)))
        for axes, (title, grey) in zip(row, images.items(), strict=True):
            known = grey[np.isfinite(grey)]
            low, high = np.percentile(known, [2.0, 98.0]) if known.size else (0.0, 1.0)
            axes.imshow(grey, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
            axes.set_title(title)
            axes.set_xticks([])
            axes.set_yticks([])
        return png(figure)
