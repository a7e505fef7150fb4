"""Figures of the real chains as PNG bytes."""

from __future__ import annotations

from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geoposition.scripts.experiments.real.side_by_side import VENDOR_PX
from geoposition.scripts.experiments.real.worldview import WorldView
from geoposition.scripts.figures import COLOURS, STYLE, VectorPanel, png, vectors

AXES: Final = ("row", "col")
_EARTH_M: Final = 6_371_000.0


def vendor_profiles(found: WorldView) -> bytes:
    """Vendor's RPC less model along the lines: as delivered, adjusted, and the known scatter."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 4.4), layout="constrained")
        grid: Any = figure.subplots(len(found.rpcs), 2, sharex=True, sharey="row", squeeze=False)
        for row, (name, rpcs) in zip(grid, found.rpcs.items(), strict=True):
            reference, adjusted = rpcs.profile_reference, rpcs.profile_adjusted
            for k, (axes, axis) in enumerate(zip(row, AXES, strict=True)):
                mean, std, _ = VENDOR_PX[name][axis]
                axes.axhspan(mean - std, mean + std, color="#BBBBBB", alpha=0.4, lw=0,
                             label="mean ± std known before")  # fmt: skip
                axes.plot(reference.line_px, reference.profile_px[:, k], color="#222222", lw=1.6,
                          label="model as delivered")  # fmt: skip
                axes.plot(adjusted.line_px, adjusted.profile_px[:, k], color=COLOURS[k], lw=0.8,
                          label="model adjusted")  # fmt: skip
                axes.set_title(f"{name}, {axis}")
                axes.margins(x=0.0)
            row[0].set_ylabel("vendor's RPC less model, px")
        for axes in grid[-1]:
            axes.set_xlabel("line")
        handles, labels = grid[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        return png(figure)


def check_errors(found: WorldView) -> bytes:
    """Errors of the check points before and after: arrows in plan, colour up where it is small."""
    panels = []
    for stage, title in (("before", "Working models"), ("after", "Adjusted models")):
        part = found.intersected[stage]
        middle = part.true.mean(axis=0)
        place = (part.true - middle)[:, :2] * (np.cos(middle[1]), 1.0) * _EARTH_M / 1e3
        up = part.error_enu_m[:, 2] if stage == "after" else None
        panels.append(VectorPanel(title, place, part.error_enu_m[:, :2], up))
    return vectors(
        panels, unit="m", place_labels=("east, km", "north, km"), colour_label="up (adjusted), m"
    )
