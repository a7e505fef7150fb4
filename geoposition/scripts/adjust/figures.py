"""Figures of an adjustment's report: residuals in images and on the ground, correlations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from geoposition.adjust import Adjustment, PointResults, Status
from geoposition.arrays import FloatArray
from geoposition.longitudes import unbroken
from geoposition.observations import ControlPoints
from geoposition.scripts.adjust.plan import Layout
from geoposition.scripts.figures import COLOURS, SIGNED_MAP, STYLE, VectorPanel, png, vectors

_MOST_ARROWS: Final = 400
_MOST_NAMES: Final = 24
_EARTH_M: Final = 6_371_000.0


def image_vectors(sets: Sequence[PointResults], image: int, name: str) -> bytes | None:
    """Residual vectors of one image before and after; None where there are too few.

    Of many points an even selection; rejected ones are left out, or nothing else would show.
    """
    places, before, after = [], [], []
    for points in sets:
        good = (points.status == Status.USED) | (points.status == Status.CHECK)
        rows = np.flatnonzero(good[points.point] & (points.product == image))
        rows = rows[:: max(-(-len(rows) // _MOST_ARROWS), 1)]
        places.append(points.image_px[rows])
        before.append(points.residual_before_px[rows])
        after.append(points.residual_px[rows])
    place, was, now = (np.concatenate(parts) for parts in (places, before, after))
    good = np.isfinite(np.hstack([place, was, now])).all(axis=1)
    if good.sum() < 2 or np.ptp(place[good], axis=0).max() <= 0.0:
        return None
    xy = place[good][:, ::-1]
    panels = [
        VectorPanel(f"{name}, {word}", xy, vector[good][:, ::-1])
        for word, vector in (("before", was), ("after", now))
    ]
    return vectors(panels, unit="px", place_labels=("column, px", "row, px"), down=True)


def ground_vectors(points: PointResults, given: ControlPoints) -> bytes | None:
    """Errors on the ground before and after: arrows east and north, colour up."""
    good = (points.status == Status.USED) | (points.status == Status.CHECK)
    good &= np.isfinite(points.error_enu_m).all(axis=1)
    good &= np.isfinite(points.error_before_enu_m).all(axis=1)
    rows = np.flatnonzero(good)
    rows = rows[:: max(-(-len(rows) // _MOST_ARROWS), 1)]
    if len(rows) < 2:
        return None
    place = map_km(given.geodetic[rows])
    if np.ptp(place, axis=0).max() <= 0.0:
        return None
    # Points in one image have no error in height to colour.
    several = np.bincount(points.point, minlength=len(points))[rows] > 1
    panels = [
        VectorPanel(word, place, error[rows, :2], error[rows, 2] if several.any() else None)
        for word, error in (
            ("before", points.error_before_enu_m), ("after", points.error_enu_m),
        )
    ]  # fmt: skip
    label = "up, m" if several.any() else ""
    return vectors(panels, unit="m", place_labels=("east, km", "north, km"), colour_label=label)


def map_km(geodetic: FloatArray, about: FloatArray | None = None) -> FloatArray:
    """Points (n, 3) on a plane about the mean (or `about`): kilometres east and north."""
    middle = np.array(geodetic if about is None else about)
    middle[:, 0] = unbroken(middle[:, 0])
    middle = middle.mean(axis=0)
    off = geodetic[:, :2] - middle[:2]
    off[:, 0] = (off[:, 0] + np.pi) % (2.0 * np.pi) - np.pi
    scale = np.array([np.cos(middle[1]), 1.0]) * _EARTH_M / 1e3
    return np.asarray(off * scale)


def correlations(done: Adjustment) -> bytes | None:
    """Correlations of the first unknowns as a coloured square; None for one or two."""
    n = min(len(done.names), _MOST_NAMES)
    if n < 3:
        return None
    sigma = done.sigma[:n]
    values = done.covariance[:n, :n] / np.outer(sigma, sigma)
    with mpl.rc_context(STYLE):
        side = 2.4 + 0.24 * n
        figure = Figure(figsize=(side + 1.4, side), layout="constrained")
        axes = figure.add_subplot()
        image: Any = axes.imshow(values, cmap=SIGNED_MAP, vmin=-1.0, vmax=1.0)
        axes.set_xticks(range(n), done.names[:n], rotation=90)
        axes.set_yticks(range(n), done.names[:n])
        axes.spines[:].set_visible(False)
        figure.colorbar(image, ax=axes, shrink=0.8, pad=0.02).set_label("correlation")
        return png(figure)


def layout_map(layout: Layout) -> bytes:
    """Chosen points by their order, and what each of them brings."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        place = map_km(layout.geodetic)
        left.plot(*place.T, "o", ms=5, color=COLOURS[1])
        for k, (x, y) in enumerate(place):
            left.annotate(str(k + 1), (x, y), xytext=(4, 4), textcoords="offset points")
        left.set_aspect("equal", adjustable="datalim")
        left.margins(0.12)
        left.set_xlabel("east, km")
        left.set_ylabel("north, km")
        left.set_title("Where")
        count = np.arange(1, len(place) + 1)
        right.plot(count, layout.expected_rmse_m, "o-", color=COLOURS[0], lw=1.2, ms=4)
        right.set_yscale("log")
        right.set_xlabel("points")
        right.set_ylabel("expected RMSE in space, m")
        right.set_title("How good")
        return png(figure)
