"""The HTML page about one stereo run: geometry, matches, residuals, heights, accuracy."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.accuracy import AxisStatistics
from geoposition.arrays import FloatArray, IntArray
from geoposition.ellipsoid import enu_axes
from geoposition.flags import has_result
from geoposition.scripts import figures, stereo_figures
from geoposition.scripts.describe import ground_sample
from geoposition.scripts.report import (
    Block,
    Image,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    Text,
    number,
    provenance,
    render,
)
from geoposition.scripts.stereo_run import Options, StereoRun
from geoposition.scripts.tables import whole_file
from geoposition.sensor_model import SensorModel

_MOST_VECTORS: Final = 350
_AXES: Final = {"x": "X", "y": "Y", "z": "Z", "e": "east", "n": "north", "u": "up"}


def write(path: Path, page: str) -> None:
    """Write the page, whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def page(run: StereoRun, options: Options, source: str) -> str:
    """HTML of the run; `source` says where the ties come from."""
    return render(build(run, options, source))


def build(run: StereoRun, options: Options, source: str) -> Report:
    """Put the page's pieces together."""
    facts: Any = run.summary
    residual = facts["residual_px"]
    sections = [
        Section("Images and geometry", _geometry(run)),
        Section("Matches", _matches(run)),
        Section("Relative bias", _bias(run)),
        Section("Image residuals", _residuals(run)),
        Section("Heights", _heights(run)),
        Section("Stated accuracy", _accuracy(run)),
    ]
    if run.checks is not None:
        sections.append(Section("Check points", _checks(run)))
    return Report(
        title="Stereo intersection of " + ", ".join(_names(run)),
        summary=(
            f"{facts['intersected']} of {facts['matches']} points seen in {len(run.products)} "
            f"images were intersected. Their lines of sight miss each other by "
            f"{_px(residual['median'])} px in the images (median), converge by "
            f"{number(facts['convergence_deg'], 1)}°, and the ground lies between "
            f"{number(facts['height_m']['min'], 0)} and {number(facts['height_m']['max'], 0)} m."
        ),
        key_figures=_keys(run),
        sections=sections,
        provenance=provenance(
            {
                "products": ", ".join(str(product.path) for product in run.products),
                "models": ", ".join(facts["models"]),
                "ties": source,
                "image points": f"sigma {number(facts['sigma_px'], 3)} px"
                + ("" if options.sigma_px is not None else ", from their scatter"),
                "relative bias": "removed" if options.remove_bias else "left in",
                "reference": (
                    "none" if run.differences is None else ", ".join(run.differences.provenance)
                ),
                "least convergence": f"{options.min_convergence_deg:g}°",
            }
        ),
    )


def _names(run: StereoRun) -> list[str]:
    names = [product.path.name for product in run.products]
    return [
        name if names.count(name) == 1 else f"{product.path.parent.name}/{name}"
        for name, product in zip(names, run.products, strict=True)
    ]


def _px(value: float | None) -> str:
    return "–" if value is None else number(value, 2)


def _keys(run: StereoRun) -> list[KeyFigure]:
    facts: Any = run.summary
    keys = [
        KeyFigure(str(facts["intersected"]), "", "points", f"of {facts['matches']} matches"),
        KeyFigure(_px(facts["residual_px"]["median"]), "px", "image residual, median",
                  f"95 % below {_px(facts['residual_px']['p95'])} px"),
        KeyFigure(number(facts["convergence_deg"], 1), "°", "convergence",
                  f"base to height {number(facts['base_to_height'], 2)}"),
    ]  # fmt: skip
    if run.checks is not None:
        found = run.checks.statistics
        keys.append(
            KeyFigure(number(found.rmse_3d_m, 2), "m", "RMSE in space at check points",
                      f"CE90 {number(found.ce90_m)} m, LE90 {number(found.le90_m)} m")
        )  # fmt: skip
    if run.differences is not None:
        off = run.differences.statistics
        keys.append(
            KeyFigure(number(off.median, 2, sign=True), "m", "height less reference, median",
                      f"NMAD {number(off.nmad)} m, {off.count} points")
        )  # fmt: skip
    return keys


def _good(run: StereoRun) -> IntArray:
    return np.flatnonzero(has_result(run.points.flag))


def _degrees(run: StereoRun) -> FloatArray:
    return np.asarray(np.degrees(run.points.geodetic[_good(run), :2]), dtype=np.float64)


def _geometry(run: StereoRun) -> list[Block]:
    names, points = _names(run), run.points
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
            stereo_figures.footprints(outlines, _degrees(run), points.geodetic[_good(run), 2]),
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


def _outline(model: SensorModel, height_m: float) -> FloatArray:
    """Corners of the image on the ground (4, 2), degrees."""
    last = np.array(model.shape) - 1.0
    corners = last * np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    return np.asarray(np.degrees(model.image_to_ground(corners, height_m).geodetic[:, :2]))


def _pairs(run: StereoRun, names: list[str]) -> list[tuple[str, ...]]:
    middle = np.nanmedian(run.points.geodetic, axis=0)
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


def _matches(run: StereoRun) -> list[Block]:
    facts: Any = run.summary
    points, ties = run.points, run.ties
    used = np.isfinite(points.image_residual_px[:, 0]) & has_result(points.flag)[points.point]
    places = {
        name: ties.image_px[np.flatnonzero(used & (ties.product == k))]
        for k, name in enumerate(_names(run))
    }
    places = {name: place for name, place in places.items() if len(place)}
    rows = [
        (name, str(int(np.sum(ties.product == k))), str(len(places.get(name, ()))), str(lost))
        for k, (name, lost) in enumerate(zip(_names(run), facts["rejected_rays"], strict=True))
    ]
    flags = ", ".join(f"{count} {name}" for name, count in facts["flags"].items())
    counts = np.bincount(points.rays[_good(run)])
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


def _bias(run: StereoRun) -> list[Block]:
    names = _names(run)
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


def _residuals(run: StereoRun) -> list[Block]:
    points, ties = run.points, run.ties
    panels, rows = [], []
    histograms: list[Block] = []
    for k, name in enumerate(_names(run)):
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


def _heights(run: StereoRun) -> list[Block]:
    good, degrees = _good(run), _degrees(run)
    terrain = stereo_figures.gridded(degrees, run.points.geodetic[good, 2])
    maps = {}
    if run.differences is not None:
        off = run.differences.difference_m[good]
        maps = {"Less the reference": stereo_figures.gridded(degrees, off)}
    if not maps:
        return [
            Image(
                stereo_figures.height_maps(terrain, {}),
                "Heights of the intersected points, means of cells, metres.",
                "Map of heights",
            )
        ]
    assert run.differences is not None
    return [
        Image(
            stereo_figures.height_maps(terrain, maps),
            "Heights of the intersected points, means of cells, and their difference from the "
            "reference, metres.",
            "Maps of heights and of differences",
        ),
        Table(
            "Height found less the reference's at the same place, metres.",
            ("", "points", "minimum", "maximum", "mean", "median", "RMSE", "NMAD"),
            [("height", str(run.differences.statistics.count),
              *_cells(run.differences.statistics, ("minimum", "maximum", "mean", "median",
                                                   "rmse", "nmad")))],
        ),
        Image(
            figures.histograms(
                {"height": run.differences.difference_m}, unit="height found less reference, m"
            ),
            "Distribution of the height differences, metres.",
            "A histogram",
        ),
    ]  # fmt: skip


def _cells(axis: AxisStatistics, names: tuple[str, ...]) -> list[str]:
    signed = {"minimum", "maximum", "mean", "median"}
    return [number(getattr(axis, name), 3, sign=name in signed) for name in names]


def _accuracy(run: StereoRun) -> list[Block]:
    facts: Any = run.summary
    words = {"total": "all", "image_points": "image points", "models": "models"}
    rows = [
        (words[name], *(number(sigma[axis], 3) for axis in "enu"))
        for name, sigma in facts["sigma_enu_m"].items()
    ]
    stated = [
        f"{name}: " + (", ".join(_stated(key, value) for key, value in known.items()) or "nothing")
        for name, known in zip(_names(run), facts["model_sigma"], strict=True)
    ]
    return [
        Table(
            "Standard deviations as stated, medians over the points, metres.",
            ("from", "east", "north", "up"),
            rows,
        ),
        Note(
            "Errors of the image points differ from point to point; those of the models, orbit "
            "and attitude, are common to neighbouring points and do not average out. Known of the "
            f"models: {'; '.join(stated)}. What is not stated is not in the sigmas."
        ),
    ]


def _stated(name: str, value: Any) -> str:
    words = {
        "attitude_arcsec": ("attitude", "″"),
        "orbit_m": ("orbit", "m"),
        "image_px": ("image", "px"),
        "ground_m": ("on the ground", "m"),
    }
    label, unit = words[name]
    numbers = value if isinstance(value, list) else [value]
    return f"{label} {' / '.join(number(one, 2) for one in numbers)} {unit}"


def _checks(run: StereoRun) -> list[Block]:
    assert run.checks is not None
    found = run.checks.statistics
    names = ("minimum", "maximum", "least", "most", "mean", "std", "rmse")
    rows = [(_AXES[name], *_cells(found.axes[name], names)) for name in _AXES]
    return [
        Table(
            f"Errors of the intersected check points, found less true, metres; {found.e.count} "
            "points. |min| and |max| are the smallest and largest size.",
            ("axis", "minimum", "maximum", "|min|", "|max|", "mean", "std", "RMSE"),
            rows,
        ),
        Table(
            "In plan and in space, metres.",
            ("plan RMSE", "RMSE in space", "CE90", "LE90"),
            [(number(found.horizontal_rmse_m, 3), number(found.rmse_3d_m, 3),
              number(found.ce90_m, 3), number(found.le90_m, 3))],
            text_columns=0,
        ),
        Note("The check points took no part in anything: neither bias nor models follow them."),
    ]  # fmt: skip
