"""A surface and its difference from a reference, as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
import rasterio
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from geoposition.datum import from_crs
from geoposition.flags import has_result
from geoposition.scripts.figures import HEIGHT_MAP, SIGNED_MAP, STYLE, png
from geoposition.terrain import RasterTerrain

_MOST_CELLS: Final = 600
_PANEL_IN: Final = 2.9
_AROUND_IN: Final = 1.2
"""Width of a panel, and what labels and scales below it take, inches."""


def surface_difference(surface: Path, reference: RasterTerrain, name: str) -> bytes:
    """Draw `surface`, a raster in metres, and its difference from the reference called `name`."""
    with rasterio.open(surface) as file:
        step = max(1, -(-max(file.shape) // _MOST_CELLS))
        height = file.read(1)[::step, ::step].astype(np.float64)
        transform, crs = file.transform, file.crs.to_string()
    rows, cols = np.indices(height.shape) * step + 0.5
    x, y = transform @ (cols, rows)
    place = from_crs(crs, np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3))
    found = reference.height_at(place)
    truth = np.where(has_result(found.flag), found.height_m, np.nan).reshape(height.shape)
    off = height - truth
    extent = tuple(v / 1e3 for v in (0.0, np.ptp(x), 0.0, np.ptp(y)))
    with mpl.rc_context(STYLE):
        high = float(np.clip(_PANEL_IN * extent[3] / extent[1], 0.8, 4.0))
        figure = Figure(figsize=(6.6, _AROUND_IN + high), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        shown = left.imshow(height, cmap=HEIGHT_MAP, extent=extent)
        left.set_title("surface from the images")
        figure.colorbar(shown, ax=left, location="bottom", label="ellipsoidal height, m")
        limit = max(float(np.nanquantile(np.abs(off), 0.98)), 1e-3)
        shown = right.imshow(
            off, cmap=SIGNED_MAP, norm=Normalize(-limit, limit), extent=extent,
            interpolation="nearest",
        )  # fmt: skip
        right.set_title(f"less {name}")
        figure.colorbar(shown, ax=right, location="bottom", label="m", extend="both")
        for axes in (left, right):
            axes.set_xlabel("km")
        left.set_ylabel("km")
        return png(figure)
