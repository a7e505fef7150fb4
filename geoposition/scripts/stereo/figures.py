"""Figures of a stereo run's report: footprints, where matches lie, heights on a grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from geoposition.arrays import FloatArray
from geoposition.scripts.figures import (
    COLOURS,
    HEIGHT_MAP,
    SIGNED_MAP,
    STYLE,
    HeightMap,
    png,
)

_MOST_CELLS: Final = 90
_POINTS_PER_CELL: Final = 2.0
_DENSITY_CELLS: Final = 24
_PANEL_IN: Final = 2.7
_AROUND_IN: Final = 1.2
"""Width of a map, and what labels and scales below it take, inches."""


def footprints(
    outlines: Mapping[str, FloatArray], points_deg: FloatArray, height_m: FloatArray
) -> bytes:
    """Outlines (n, 2) in degrees of images by name, and points (m, 2) coloured by height."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.8), layout="constrained")
        axes = figure.add_subplot()
        for number, (name, outline) in enumerate(outlines.items()):
            closed = np.vstack([outline, outline[:1]])
            axes.plot(*closed.T, color=COLOURS[number % len(COLOURS)], lw=1.5, label=name)
        dots = axes.scatter(
            points_deg[:, 0], points_deg[:, 1], c=height_m, s=3.0, cmap=HEIGHT_MAP, lw=0
        )
        axes.set_aspect(1.0 / max(float(np.cos(np.radians(np.mean(points_deg[:, 1])))), 0.05))
        axes.set_xlabel("longitude, °")
        axes.set_ylabel("latitude, °")
        axes.ticklabel_format(useOffset=False)
        axes.locator_params(nbins=5)
        bar = figure.colorbar(dots, ax=axes, shrink=0.8, pad=0.02)
        bar.set_label("ellipsoidal height, m")
        figure.legend(loc="outside lower center", ncols=3)
        return png(figure)


def match_density(places: Mapping[str, FloatArray]) -> bytes:
    """How many matches lie where in each image: places (n, 2) as (line, sample), by name."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.2 * len(places), 3.2), layout="constrained")
        row = np.atleast_1d(figure.subplots(1, len(places)))
        for k, (axes, (name, image_px)) in enumerate(zip(row, places.items(), strict=True)):
            span = np.maximum(np.ptp(image_px, axis=0), 1.0)
            parts = np.maximum(np.rint(_DENSITY_CELLS * span / span.max()), 1.0)
            line, sample = (
                np.linspace(low, low + size, int(part) + 1)
                for low, size, part in zip(image_px.min(axis=0), span, parts, strict=True)
            )
            count = np.histogram2d(image_px[:, 0], image_px[:, 1], [line, sample])[0]
            image = axes.pcolormesh(
                sample, line, np.ma.masked_equal(count, 0), cmap=HEIGHT_MAP, rasterized=True
            )
            axes.set_aspect("equal")
            axes.invert_yaxis()
            axes.set_title(name)
            axes.set_xlabel("column, px")
            axes.locator_params(nbins=4)
            if k == 0:
                axes.set_ylabel("row, px")
            figure.colorbar(image, ax=axes, location="bottom", pad=0.02, aspect=25).set_label(
                "matches in a cell"
            )
        return png(figure)


def gridded(points_deg: FloatArray, values: FloatArray) -> HeightMap:
    """Means of `values` (n,) at points (n, 2) in cells of a grid over them; NaN where none."""
    known = np.isfinite(values)
    west, south = points_deg.min(axis=0)
    east, north = points_deg.max(axis=0)
    north, east = max(north, south + 1e-6), max(east, west + 1e-6)
    per_degree = np.cos(np.radians(0.5 * (south + north)))
    wide, high = (east - west) * per_degree, north - south
    cells = np.clip(np.sqrt(max(known.sum(), 1) / _POINTS_PER_CELL), 4, _MOST_CELLS)
    step = max(wide, high) / cells
    cols, rows = max(int(np.ceil(wide / step)), 1), max(int(np.ceil(high / step)), 1)
    col = np.minimum(((points_deg[known, 0] - west) * per_degree / step).astype(int), cols - 1)
    row = np.minimum(((north - points_deg[known, 1]) / step).astype(int), rows - 1)
    index = row * cols + col
    total = np.bincount(index, values[known], minlength=rows * cols)
    count = np.bincount(index, minlength=rows * cols)
    with np.errstate(invalid="ignore"):
        mean = (total / count).reshape(rows, cols)
    extent = (west, west + cols * step / per_degree, north - rows * step, north)
    bounds = tuple(float(value) for value in extent)
    return HeightMap(mean, (bounds[0], bounds[1], bounds[2], bounds[3]))


def height_maps(terrain: HeightMap, differences: Mapping[str, HeightMap]) -> bytes:
    """Beside each other: heights on a grid, and signed differences by name, each with its scale."""
    with mpl.rc_context(STYLE):
        count = 1 + len(differences)
        east_m, north_m = terrain.metres_per_degree
        west, east, south, north = terrain.extent_deg
        shape = (north - south) * north_m / ((east - west) * east_m)
        high = _AROUND_IN + float(np.clip(_PANEL_IN * shape, 0.8, 4.0))
        figure = Figure(figsize=(max(3.3 * count, 5.0), high), layout="constrained")
        row = np.atleast_1d(figure.subplots(1, count, sharey=True))
        _one_map(figure, row[0], terrain, "Heights found", "ellipsoidal height, m", None)
        row[0].set_ylabel("latitude, °")
        for axes, (title, difference) in zip(row[1:], differences.items(), strict=True):
            limit = max(float(np.nanquantile(np.abs(difference.height_m), 0.98)), 1e-3)
            _one_map(figure, axes, difference, title, "difference, m", limit)
        return png(figure)


def _one_map(
    figure: Any, axes: Any, grid: HeightMap, title: str, unit: str, limit: float | None
) -> None:
    east_m, north_m = grid.metres_per_degree
    colours: dict[str, Any] = {"cmap": HEIGHT_MAP}
    if limit is not None:
        colours = {"cmap": SIGNED_MAP, "norm": Normalize(-limit, limit)}
    image = axes.imshow(
        np.ma.masked_invalid(grid.height_m),
        extent=grid.extent_deg,
        interpolation="nearest",
        aspect=north_m / east_m,
        **colours,
    )
    axes.set_title(title)
    axes.set_xlabel("longitude, °")
    axes.ticklabel_format(useOffset=False)
    axes.locator_params(nbins=4)
    bar = figure.colorbar(image, ax=axes, location="bottom", pad=0.02, aspect=25, shrink=0.85)
    bar.set_label(unit)
