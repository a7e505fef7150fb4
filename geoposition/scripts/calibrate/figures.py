"""Figures of calibrations: the look angles' curves, and residuals over the image row."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geoposition.arrays import FloatArray
from geoposition.calib_fields.calibration import LookCurve
from geoposition.scripts.figures import COLOURS, STYLE, png

_AXES = ("x, along track", "y, across track")


def shapes(curves: Sequence[LookCurve]) -> bytes:
    """Change of the look angles' shape by sample, with two standard deviations."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 4.2), layout="constrained")
        column = figure.subplots(2, 1, sharex=True)
        for k, axes in enumerate(column):
            for curve in curves:
                value, reach = curve.shape_px[:, k], 2.0 * curve.shape_sigma_px[:, k]
                axes.fill_between(
                    curve.sample, value - reach, value + reach, color=COLOURS[1], alpha=0.25, lw=0
                )
                label = "calibrated ± 2σ" if curve.ccd == 0 else None
                axes.plot(curve.sample, value, color=COLOURS[1], lw=1.3, label=label)
                if curve.ccd:
                    axes.axvline(curve.sample[0] - 0.5, color="#bbbbbb", lw=0.6)
            axes.axhline(0.0, color=COLOURS[0], lw=1.0, ls="--", label="as it came")
            axes.set_ylabel(f"{_AXES[k]}, px")
            axes.margins(x=0.0)
        column[0].legend(ncols=2)
        column[1].set_xlabel("sample")
        return png(figure)


def over_row(sample: FloatArray, before_px: FloatArray, after_px: FloatArray, width: int) -> bytes:
    """Residuals by sample, before and after, medians in bins on top."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 4.2), layout="constrained")
        column = figure.subplots(2, 1, sharex=True)
        edges = np.linspace(-0.5, width - 0.5, 33)
        middle = 0.5 * (edges[1:] + edges[:-1])
        index = np.clip(np.digitize(sample, edges) - 1, 0, len(middle) - 1)
        for k, axes in enumerate(column):
            for values, colour, label in (
                (before_px[:, k], COLOURS[0], "as it came, without the mean"),
                (after_px[:, k], COLOURS[1], "calibrated"),
            ):
                axes.plot(sample, values, ".", ms=1.6, alpha=0.25, color=colour)
                medians = [
                    np.median(values[index == i]) if np.any(index == i) else np.nan
                    for i in range(len(middle))
                ]
                axes.plot(middle, medians, color=colour, lw=1.4, label=label)
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.set_ylabel(f"{_AXES[k]}, px")
            axes.margins(x=0.0)
        column[0].legend(ncols=2)
        column[1].set_xlabel("sample")
        return png(figure)
