"""What a stereo run's report says of images: geometry, matches, bias, residuals."""

from __future__ import annotations

from itertools import combinations
from typing import Any, Final

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.ellipsoid import enu_axes
from geoposition.flags import has_result
from geoposition.longitudes import middle_of
from geoposition.scripts import figures
from geoposition.scripts.describe import ground_sample
from geoposition.scripts.report import (
    Block,
    Image,
    Note,
    Table,
    Text,
    number,
)
from geoposition.scripts.stereo import figures as stereo_figures
from geoposition.scripts.stereo.run import StereoRun
from geoposition.sensor_model import SensorModel

_MOST_VECTORS: Final = 350


def names_of(run: StereoRun) -> list[str]:
    """Names of the products, told apart by their folders where they must be."""
    names = [product.path.name for product in run.products]
    return [
        name if names.count(name) == 1 else f"{product.path.parent.name}/{name}"
        for name, product in zip(names, run.products, strict=True)
    ]


def found_rows(run: StereoRun) -> IntArray:
    """Points that have a result."""
    return np.flatnonzero(has_result(run.points.flag))


def degrees_of(run: StereoRun) -> FloatArray:
    """Longitudes and latitudes (n, 2) of the points with a result."""
    return np.asarray(np.degrees(run.points.geodetic[found_rows(run), :2]), dtype=np.float64)


def _outline(model: SensorModel, height_m: float) -> FloatArray:
    """Corners of the image on the ground (4, 2), degrees."""
    last = np.array(model.shape) - 1.0
    corners = last * np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    return np.asarray(np.degrees(model.image_to_ground(corners, height_m).geodetic[:, :2]))


def geometry_blocks(run: StereoRun) -> list[Block]:
    """Images, pairs, footprints."""
    names, points = names_of(run), run.points
    outlines: dict[str, FloatArray] = {}
    rows = []
    for name, product, model in zip(names, run.products, run.models, strict=True):
        outlines[name] = _outline(model, float(np.nanmedian(points.geodetic[:, 2])))
        view: Any = ground_sample(model)
        rows.append(
            (
                name,
                product.sensor,
                "rigorous" if product.is_rigorous else "RPC",
                "{} × {}".format(*model.shape),
                "{} × {}".format(
                    number(view["ground_sample_m"]["row"]), number(view["ground_sample_m"]["col"])
                ),
                number(view["satellite_zenith_deg"], 1),
                number(view["satellite_azimuth_deg"], 1),
            )
        )
    header = ("image", "sensor", "model", "pixels", "metres a pixel", "zenith °", "azimuth °")
    weak = int(points.weak.sum())
    blocks: list[Block] = [
        Table("The images, seen from the ground.", header, rows, text_columns=3),
        Table(
            "Geometry of each pair at the middle of the points: the angle between the lines of "
            "sight, and base to height, the difference of their slants.",
            ("pair", "convergence °", "base to height"),
            _pairs(run, names),
        ),
        Image(
            stereo_figures.footprints(
                outlines, degrees_of(run), points.geodetic[found_rows(run), 2]
            ),
            "Footprints of the images at the median height of the points, and the intersected "
            "points, coloured by height.",
            "Map of image outlines and points",
        ),
    ]
    if weak:
        blocks.append(
            Note(
                f"{weak} points are weak: their lines of sight converge by less than 2.9°, so "
                "that heights are some forty times as uncertain as places in plan."
            )
        )
    return blocks


def _pairs(run: StereoRun, names: list[str]) -> list[tuple[str, ...]]:
    middle = middle_of(run.points.geodetic)
    slants, sights = [], []
    rows: list[tuple[str, ...]] = []
    for model in run.models:
        place = model.ground_to_image(middle).image_px
        sight = model.rays(place, middle[2]).direction_ecef @ enu_axes(middle)
        sights.append(sight)
        slants.append(sight[:2] / sight[2])
    for i, j in combinations(range(len(names)), 2):
        cosine = float(np.clip(np.dot(sights[i], sights[j]), -1.0, 1.0))
        base = float(np.hypot(*(slants[i] - slants[j])))
        angle = number(float(np.degrees(np.arccos(cosine))), 2)
        rows.append((f"{names[i]} – {names[j]}", angle, number(base, 3)))
    return rows


def match_blocks(run: StereoRun) -> list[Block]:
    """Tell what became of the matches, and where they lie."""
    facts: Any = run.summary
    points, ties = run.points, run.ties
    used = np.isfinite(points.image_residual_px[:, 0]) & has_result(points.flag)[points.point]
    places = {
        name: ties.image_px[np.flatnonzero(used & (ties.product == k))]
        for k, name in enumerate(names_of(run))
    }
    places = {name: place for name, place in places.items() if len(place)}
    rows = [
        (name, str(int(np.sum(ties.product == k))), str(len(places.get(name, ()))), str(lost))
        for k, (name, lost) in enumerate(zip(names_of(run), facts["rejected_rays"], strict=True))
    ]
    flags = ", ".join(f"{count} {name}" for name, count in facts["flags"].items())
    counts = np.bincount(points.rays[found_rows(run)])
    rays = ", ".join(f"{n} from {k} images" for k, n in enumerate(counts) if n)
    return [
        Text(f"What became of the points: {flags}. Of those with a result {rays}."),
        Table(
            "Observations by image; a wrong ray among three or more is left out.",
            ("image", "matches", "used", "found wrong"),
            rows,
        ),
        Image(
            stereo_figures.match_density(places),
            "How the matches that were used are spread over each image, counts in a cell.",
            "Maps of the number of matches",
        ),
    ]


def bias_blocks(run: StereoRun) -> list[Block]:
    """Relative bias, and its removal."""
    names = names_of(run)
    rows = [
        (
            names[bias.product],
            *(number(value, 3, sign=True) for value in bias.residual_px),
            *(number(value, 3, sign=True) for value in bias.bias_px),
            str(len(bias.observable)),
            number(bias.noise_px, 3),
        )
        for bias in run.biases
    ]
    blocks: list[Block] = [
        Table(
            "Constant part of each image's residuals (observed − projected) with the models as "
            "they came, and the whole disagreement if that image alone is to blame, pixels. Of a "
            "pair only the direction across the epipolar lines shows.",
            ("image", "residual row", "residual col", "bias row", "bias col", "directions seen",
             "noise"),
            rows,
        ),
    ]  # fmt: skip
    if run.removal is None or run.before is None:
        blocks.append(Text("The bias was left in the models."))
        return blocks
    rows = []
    for name, change in zip(names, run.removal.as_dicts(), strict=True):
        shift: Any = change["shift_px"]
        turn: Any = change["attitude_arcsec"]
        words = "–" if turn is None else ", ".join(number(value, 3, sign=True) for value in turn)
        rows.append((name, *(number(value, 3, sign=True) for value in shift), words))
    was, now = (
        float(np.median(p.residual_px[has_result(p.flag)])) for p in (run.before, run.points)
    )
    blocks += [
        Table(
            "What was changed so that all images agree with the first: image points moved by so "
            "many pixels, of a rigorous model by a constant turn about its body axes, arcsec.",
            ("image", "row px", "column px", "turn x, y, z ″"),
            rows,
        ),
        Text(f"Median residual {number(was, 3)} px before and {number(now, 3)} px after."),
    ]
    return blocks


def residual_blocks(run: StereoRun) -> list[Block]:
    """Residuals of each image: table, vectors, histograms."""
    points, ties = run.points, run.ties
    panels, rows = [], []
    histograms: list[Block] = []
    for k, name in enumerate(names_of(run)):
        mine = np.flatnonzero(
            (ties.product == k)
            & np.isfinite(points.image_residual_px[:, 0])
            & has_result(points.flag)[points.point]
        )
        if not len(mine):
            continue
        residual = points.image_residual_px[mine]
        some = mine[:: max(1, len(mine) // _MOST_VECTORS)]
        panels.append(
            figures.VectorPanel(
                name, ties.image_px[some][:, ::-1] / 1e3, points.image_residual_px[some][:, ::-1]
            )
        )
        median, spread = np.median(residual, axis=0), np.std(residual, axis=0)
        rows.append(
            (
                name,
                str(len(mine)),
                *(number(value, 3, sign=True) for value in median),
                *(number(value, 3) for value in spread),
                number(float(np.max(np.hypot(*residual.T))), 2),
            )
        )
        histograms.append(
            Image(
                figures.histograms(
                    {"row": residual[:, 0], "column": residual[:, 1]}, unit=f"residual, {name}, px"
                ),
                f"Residuals of the image points of {name}, pixels.",
                "Two histograms of residuals",
            )
        )
    header = ("image", "points", "median row", "median col", "std row", "std col", "largest")
    blocks: list[Block] = [Table("Residuals, observed − projected, pixels.", header, rows)]
    if panels and all(np.ptp(panel.place, axis=0).max() > 0 for panel in panels):
        blocks.append(
            Image(
                figures.vectors(
                    panels, unit="px", place_labels=("column, thousands", "row, thousands"),
                    down=True,
                ),
                "Residual vectors in the images, each panel with its own scale.",
                "Fields of residual arrows",
            )
        )  # fmt: skip
    return [*blocks, *histograms]
