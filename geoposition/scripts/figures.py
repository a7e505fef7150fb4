"""Figures of reports as PNG bytes: maps, vectors, series, histograms.

Colours are told apart by colour-blind readers: lines are Okabe and Ito's, heights cividis,
signed differences a purple to orange scale. Nothing here keeps state, opens a window or a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure

from geoposition.arrays import FloatArray

COLOURS: Final = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
HEIGHT_MAP: Final = "cividis"
SIGNED_MAP: Final = "PuOr_r"
_DPI: Final = 160
_BELOW: Final[dict[str, Any]] = {
    "location": "bottom",
    "pad": 0.02,
    "aspect": 25,
    "shrink": 0.85,
}
STYLE: Final[dict[Any, Any]] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": "#333333",
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "figure.facecolor": "white",
}
"""Matplotlib's settings for every figure: `with mpl.rc_context(STYLE)`."""


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Heights (rows, cols) at pixel centres, north up; `extent_deg` west, east, south, north."""

    height_m: FloatArray
    extent_deg: tuple[float, float, float, float]

    @property
    def metres_per_degree(self) -> tuple[float, float]:
        """Lengths of a degree of longitude and of latitude at the middle."""
        latitude = np.radians(0.5 * (self.extent_deg[2] + self.extent_deg[3]))
        return 111_320.0 * float(np.cos(latitude)), 111_130.0


@dataclass(frozen=True, slots=True)
class VectorPanel:
    """Vectors (n, 2) at places (n, 2), both (x, y); `colour_value` (n,) colours them if given."""

    title: str
    place: FloatArray
    vector: FloatArray
    colour_value: FloatArray | None = None


def footprints(
    terrain: HeightMap,
    outlines: Mapping[str, FloatArray],
    points_deg: FloatArray,
    points_label: str,
) -> bytes:
    """Map of shaded heights, image outlines (n, 2) in degrees, and points (m, 2)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 5.2), layout="constrained")
        axes = figure.add_subplot()
        colours = _shaded(axes, terrain)
        for number, (name, outline) in enumerate(outlines.items()):
            axes.plot(*outline.T, color="white", lw=3.0, solid_joinstyle="round")
            axes.plot(*outline.T, color=COLOURS[number], lw=1.7, label=name)
        label = f"{points_label} ({len(points_deg)})"
        axes.plot(*points_deg.T, ".", ms=4.5, color="white", mec="black", mew=0.4, label=label)
        _degrees(axes, terrain)
        _scale_bar(axes, terrain, 10.0)
        bar = figure.colorbar(colours, ax=axes, shrink=0.8, pad=0.02)
        bar.set_label("ellipsoidal height, m")
        figure.legend(loc="outside lower center", ncols=4)
        return png(figure)


def height_and_difference(
    terrain: HeightMap, differences: Mapping[str, HeightMap], unit_note: str
) -> bytes:
    """Beside each other: a height map, and maps of signed differences, each with its scale."""
    with mpl.rc_context(STYLE):
        count = 1 + len(differences)
        figure = Figure(figsize=(3.3 * count, 3.7), layout="constrained")
        row = figure.subplots(1, count, sharey=True)
        colours = _shaded(row[0], terrain)
        row[0].set_title("Heights found")
        bar = figure.colorbar(colours, ax=row[0], **_BELOW)
        bar.set_label("ellipsoidal height, m")
        for axes, (title, difference) in zip(row[1:], differences.items(), strict=True):
            values = difference.height_m
            limit = max(float(np.nanquantile(np.abs(values), 0.98)), 1e-3)
            image = axes.imshow(
                values,
                extent=difference.extent_deg,
                cmap=SIGNED_MAP,
                norm=Normalize(-limit, limit),
                interpolation="nearest",
            )
            axes.set_title(title)
            bar = figure.colorbar(image, ax=axes, extend="both", **_BELOW)
            bar.set_label(unit_note)
        for k, axes in enumerate(row):
            _degrees(axes, terrain, label_latitude=k == 0)
        _scale_bar(row[0], terrain, 10.0)
        return png(figure)


def vectors(
    panels: Sequence[VectorPanel],
    *,
    unit: str,
    place_labels: tuple[str, str],
    down: bool = False,
    colour_label: str = "",
) -> bytes:
    """Vector fields beside each other, each with its own scale: the key arrow at its top.

    The longest tenth of the vectors spans about a ninth of the panel. `down` puts y downwards,
    as image rows go. Colours have one scale for all panels.
    """
    with mpl.rc_context(STYLE):
        width = 3.1 * len(panels) + (0.7 if colour_label else 0.0)
        figure = Figure(figsize=(width, 3.6), layout="constrained")
        row = np.atleast_1d(figure.subplots(1, len(panels)))
        limit = _signed_limit(panels)
        dots: Any = None
        for k, (axes, panel) in enumerate(zip(row, panels, strict=True)):
            size = _long(panel.vector)
            key = _round_length(size)
            coloured = panel.colour_value is not None
            arrows = axes.quiver(
                *panel.place.T, *panel.vector.T, angles="xy", scale_units="xy",
                scale=9.0 * size / float(np.max(np.ptp(panel.place, axis=0))), width=0.0035,
                color="#333333" if coloured else COLOURS[k % len(COLOURS)],
            )  # fmt: skip
            if coloured:
                dots = axes.scatter(
                    *panel.place.T, c=panel.colour_value, s=16.0, cmap=SIGNED_MAP,
                    norm=Normalize(-limit, limit), edgecolors="#333333", linewidths=0.4, zorder=3,
                )  # fmt: skip
            axes.quiverkey(
                arrows, 0.78, 1.05, key, f"{key:g} {unit}", labelpos="E", color="#222222",
                fontproperties={"size": 8},
            )  # fmt: skip
            axes.set_title(panel.title)
            axes.set_aspect("equal")
            axes.margins(0.06)
            axes.set_xlabel(place_labels[0])
            if k == 0:
                axes.set_ylabel(place_labels[1])
            if down:
                axes.invert_yaxis()
        if dots is not None:
            bar = figure.colorbar(dots, ax=list(row), shrink=0.8, pad=0.015, extend="both")
            bar.set_label(colour_label)
        return png(figure)


def series(
    times_s: FloatArray,
    values: Mapping[str, FloatArray],
    *,
    unit: str,
    time_label: str,
    intervals: Mapping[str, tuple[float, float]],
) -> bytes:
    """Time series above each other on one scale, with named intervals shaded."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 0.6 + 1.15 * len(values)), layout="constrained")
        column = np.atleast_1d(figure.subplots(len(values), 1, sharex=True, sharey=True))
        for k, (axes, (name, line)) in enumerate(zip(column, values.items(), strict=True)):
            for number, (label, (first, last)) in enumerate(intervals.items()):
                axes.axvspan(first, last, color=COLOURS[number], alpha=0.13, lw=0)
                if k == 0:
                    axes.text(
                        0.5 * (first + last), 1.02, label, ha="center", va="bottom",
                        color=COLOURS[number], fontsize=8, transform=axes.get_xaxis_transform(),
                    )  # fmt: skip
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.plot(times_s, line, color="#222222", lw=0.7)
            axes.set_ylabel(f"{name}, {unit}")
            axes.margins(x=0.0)
        column[-1].set_xlabel(time_label)
        return png(figure)


def histograms(
    values: Mapping[str, FloatArray], *, unit: str, limit: float | None = None, bins: int = 81
) -> bytes:
    """Distributions on one axis, each of area 1; what lies beyond `limit` is left out."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 2.6), layout="constrained")
        axes = figure.add_subplot()
        all_values = np.concatenate([v[np.isfinite(v)] for v in values.values()])
        reach = limit or float(np.quantile(np.abs(all_values), 0.999))
        edges = np.linspace(-reach, reach, bins + 1)
        for number, (name, sample) in enumerate(values.items()):
            axes.hist(
                sample[np.isfinite(sample)], edges.tolist(), density=True, histtype="stepfilled",
                facecolor=COLOURS[number] + "40", edgecolor=COLOURS[number], lw=1.2, label=name,
            )  # fmt: skip
        axes.axvline(0.0, color="#777777", lw=0.7)
        axes.set_xlabel(unit)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.legend()
        return png(figure)


def _shaded(axes: Any, terrain: HeightMap) -> Any:
    """Heights in colour under a shade from the north-west; return what a colour bar wants."""
    heights = np.ma.masked_invalid(terrain.height_m)
    low, high = float(heights.min()), float(heights.max())
    image = axes.imshow(
        heights, extent=terrain.extent_deg, cmap=HEIGHT_MAP, vmin=low, vmax=high,
        interpolation="bilinear",
    )  # fmt: skip
    east_m, north_m = terrain.metres_per_degree
    west, east, south, north = terrain.extent_deg
    rows, cols = heights.shape
    shade = LightSource(315.0, 40.0).hillshade(
        heights.filled(0.5 * (low + high)),
        vert_exag=3.0,
        dx=(east - west) * east_m / cols,
        dy=(north - south) * north_m / rows,
    )
    # The shade only darkens, by at most 45 %, and leaves what has no height clear.
    veil = np.zeros((rows, cols, 4))
    veil[..., 3] = np.where(np.ma.getmaskarray(heights), 0.0, 0.45 * (1.0 - shade))
    axes.imshow(veil, extent=terrain.extent_deg, interpolation="bilinear")
    return image


def _degrees(axes: Any, terrain: HeightMap, label_latitude: bool = True) -> None:
    east_m, north_m = terrain.metres_per_degree
    axes.set_aspect(north_m / east_m)
    axes.set_xlim(*terrain.extent_deg[:2])
    axes.set_ylim(*terrain.extent_deg[2:])
    axes.locator_params(nbins=4)
    axes.ticklabel_format(useOffset=False)
    axes.set_xlabel("longitude, °E")
    if label_latitude:
        axes.set_ylabel("latitude, °N")


def _scale_bar(axes: Any, terrain: HeightMap, length_km: float) -> None:
    west, east, south, north = terrain.extent_deg
    degrees = 1e3 * length_km / terrain.metres_per_degree[0]
    x, y = west + 0.05 * (east - west), south + 0.05 * (north - south)
    for colour, width in (("white", 4.5), ("black", 2.0)):
        axes.plot([x, x + degrees], [y, y], color=colour, lw=width, solid_capstyle="butt")
    axes.text(
        x + 0.5 * degrees, y + 0.015 * (north - south), f"{length_km:g} km", ha="center",
        va="bottom", fontsize=8, bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 1.0},
    )  # fmt: skip


def _long(vector: FloatArray) -> float:
    sizes = np.hypot(*vector.T)
    return max(float(np.nanquantile(sizes, 0.9)), 1e-12)


def _signed_limit(panels: Sequence[VectorPanel]) -> float:
    values = [np.abs(p.colour_value) for p in panels if p.colour_value is not None]
    return float(np.nanquantile(np.concatenate(values), 0.98)) if values else 1.0


def _round_length(size: float) -> float:
    """1, 2 or 5 times a power of ten, next to `size`."""
    power = 10.0 ** np.floor(np.log10(size))
    steps = np.array([1.0, 2.0, 5.0, 10.0])
    return float(power * steps[np.argmin(np.abs(np.log(steps * power / size)))])


def png(figure: Figure) -> bytes:
    """Return `figure` as a PNG file; the same figure has the same bytes."""
    out = BytesIO()
    # the software's name and date would change them
    figure.savefig(out, format="png", dpi=_DPI, metadata={"Software": None})
    return out.getvalue()
