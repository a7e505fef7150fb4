"""What the demo's report says of its results, a section for each."""

from __future__ import annotations

import numpy as np

from geoposition.accuracy import PointStatistics, axis_statistics, enu_errors_m
from geoposition.arrays import FloatArray
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.scripts import figures
from geoposition.scripts.demo.data import DemoResult
from geoposition.scripts.report import Image, Note, Section, Table, Text, number

_AXES = {"e": "east", "n": "north", "u": "up", "x": "X", "y": "Y", "z": "Z"}


def _statistics_table(caption: str, statistics: PointStatistics) -> Table:
    rows = [
        (
            _AXES[name],
            *(
                number(value, 2, sign=signed)
                for value, signed in (
                    (axis.minimum, True),
                    (axis.maximum, True),
                    (axis.mean, True),
                    (axis.std, False),
                    (axis.rmse, False),
                    (axis.nmad, False),
                )
            ),
        )
        for name, axis in statistics.axes.items()
    ]
    header = ("axis", "minimum", "maximum", "mean", "std", "RMSE", "NMAD")
    return Table(
        f"{caption} Metres; {statistics.e.count} check points. CE90 "
        f"{number(statistics.ce90_m)} m, LE90 {number(statistics.le90_m)} m, RMSE in space "
        f"{number(statistics.rmse_3d_m)} m.",
        header,
        rows,
    )


def points_section(result: DemoResult) -> Section:
    """Errors of the check points from three images, and the sigmas stated for them."""
    panels = []
    place = _kilometres(result)
    for title, part in (("True models", result.true), ("Measured models", result.measured)):
        errors = enu_errors_m(part.found.geodetic, result.check.geodetic)
        good = np.isfinite(errors[:, 2])
        panel = figures.VectorPanel(title, place[good], errors[good, :2], errors[good, 2])
        panels.append(panel)
    image = figures.vectors(
        panels,
        unit="m",
        place_labels=("east of the centre, km", "north of the centre, km"),
        colour_label="height error, m",
    )
    sigma = []
    for name, part in (("true models", result.true), ("measured models", result.measured)):
        for k, axis in enumerate("enu"):
            sigma.append(
                (
                    name,
                    _AXES[axis],
                    number(float(part.mean_sigma_m[k])),
                    number(part.statistics.axes[axis].rmse),
                    number(part.normalised_rms[axis]),
                )
            )
    return Section(
        "Check points from three images",
        (
            _statistics_table(
                "Errors of intersected points, true models (found less true).",
                result.true.statistics,
            ),
            _statistics_table(
                "Errors of intersected points, measured models (found less true).",
                result.measured.statistics,
            ),
            Image(
                image,
                "Errors at the check points: arrows in plan, dots in height, metres. Each panel "
                "has its own scale, the arrow at its top; the dots' colours are common.",
                "Two fields of arrows: random with true models, common to all points with "
                "measured ones.",
            ),
            Table(
                "Stated sigma against actual error. Sigma in metres, root mean square over the "
                "points; the last column is the root mean square of error over sigma.",
                ("models", "axis", "stated sigma", "actual RMSE", "error / sigma"),
                sigma,
                text_columns=2,
            ),
            Note(
                "The stated sigma carries the image points' noise to the ground and nothing else. "
                "With true models it agrees with the errors (a ratio near 1); with measured "
                "models the errors of orbit, attitude and mounting come on top. The sigma does "
                "not show them, the intersection's residuals only in part. Check points do."
            ),
        ),
    )


def _kilometres(result: DemoResult) -> FloatArray:
    centre = result.scene.centre_geodetic
    difference = geodetic_to_ecef(result.check.geodetic) - geodetic_to_ecef(centre)
    result_km: FloatArray = 1e-3 * (difference @ enu_axes(centre))[:, :2]
    return result_km


def causes_section(result: DemoResult) -> Section:
    """One cause of error at a time, and what one arcsecond does."""
    names = {
        "image points": f"image points, {result.options.image_sigma_px:g} px (in every row)",
        "orbit": f"orbit, {100 * result.options.scene.gps_sigma_m:g} cm",
        "attitude noise": "attitude noise",
        "mounting": "mounting",
        "all": "all together",
    }
    rows = [
        (
            names[name],
            *(number(part.axes[axis].rmse) for axis in "enu"),
            number(part.horizontal_rmse_m),
            number(part.rmse_3d_m),
        )
        for name, part in result.budget.items()
    ]
    arcsecond = [
        (line.what, number(line.measured_m, 3), number(line.expected_m, 3))
        for line in result.sensitivity
    ]
    return Section(
        "Where the errors come from",
        (
            Table(
                "RMSE at the check points with one cause at a time, metres.",
                ("cause", "east", "north", "up", "plan", "space"),
                rows,
                strong=(len(rows) - 1,),
            ),
            Table(
                "What one arcsecond does, metres: by the models, and by range × angle.",
                ("1″ of", "models", "range × angle"),
                arcsecond,
            ),
        ),
    )


def residuals_section(result: DemoResult) -> Section:
    """Image residuals of the check points in each image."""
    rows, panels = [], []
    for name, px in result.residuals_px.items():
        row, col = axis_statistics(px[:, 0]), axis_statistics(px[:, 1])
        rows.append(
            (
                name,
                number(row.mean, 2, sign=True),
                number(row.std),
                number(row.rmse),
                number(col.mean, 2, sign=True),
                number(col.std),
                number(col.rmse),
            )
        )
        image = result.check.image_px[name]
        panels.append(figures.VectorPanel(name, image[:, ::-1] / 1e3, px[:, ::-1]))
    inside = {
        name: part.found.residual_px
        for name, part in (("true", result.true), ("measured", result.measured))
    }
    return Section(
        "Image residuals against control",
        (
            Text(
                "The check points' true positions, projected with the measured models, beside "
                "where the images show them: the common arrow of an image is its mounting error, "
                "the waves along the rows are the attitude's noise, the rest is measurement."
            ),
            Table(
                "Measured less projected image points of the check points, pixels.",
                (
                    "camera",
                    "row mean",
                    "row std",
                    "row RMSE",
                    "column mean",
                    "column std",
                    "column RMSE",
                ),
                rows,
            ),
            Image(
                figures.vectors(
                    panels,
                    unit="px",
                    place_labels=("column, thousands", "row, thousands"),
                    down=True,
                ),
                "Image residual vectors, pixels, measured less projected with the measured "
                "models. Each panel has its own scale, the arrow at its top.",
                "Three fields of arrows over the images, each mostly uniform.",
            ),
            Note(
                f"Without control the intersection sees only what the rays disagree on: its own "
                f"residuals have a median of {number(float(np.nanmedian(inside['true'])))} px with "
                f"true and {number(float(np.nanmedian(inside['measured'])))} px with measured "
                f"models."
            ),
        ),
    )


def _lattice(result: DemoResult, values: FloatArray) -> figures.HeightMap:
    full = np.full(result.grid_shape[0] * result.grid_shape[1], np.nan)
    full[result.grid_index] = values
    return figures.HeightMap(full.reshape(result.grid_shape), result.grid_extent_deg)


def heights_section(result: DemoResult) -> Section:
    """Heights from dense tie points against the DEM."""
    rows = []
    for name, values in (
        ("true models", result.height_error_true_m),
        ("measured models", result.height_error_measured_m),
    ):
        axis = axis_statistics(values)
        rows.append(
            (
                name,
                str(axis.count),
                number(axis.mean, 2, sign=True),
                number(axis.median, 2, sign=True),
                number(axis.std),
                number(axis.rmse),
                number(axis.nmad),
            )
        )
    errors = (result.height_error_true_m, result.height_error_measured_m)
    lattices = [_lattice(result, values) for values in errors]
    return Section(
        "Heights from dense tie points",
        (
            Table(
                "Intersected height less the DEM's height at the same place, metres.",
                ("models", "points", "mean", "median", "std", "RMSE", "NMAD"),
                rows,
            ),
            Image(
                figures.height_and_difference(
                    _lattice(result, result.height_measured.geodetic[:, 2]),
                    {
                        "Difference, true models": lattices[0],
                        "Difference, measured models": _lattice(
                            result, result.height_error_measured_m
                        ),
                    },
                    "height found less DEM, m",
                ),
                "Left: heights intersected with the measured models, metres. Middle and right: "
                "their difference from the DEM with true and with measured models, metres; the "
                "stripes are the attitude's noise, which all pixels of a row share.",
                "Three maps: heights, and two difference maps; the last one has stripes.",
            ),
            Image(
                figures.histograms(
                    {
                        "true models": result.height_error_true_m,
                        "measured models": result.height_error_measured_m,
                    },
                    unit="height found less DEM, m",
                ),
                "Distribution of the height differences, metres; areas are equal.",
                "Two histograms: a narrow one about zero and a wider one.",
            ),
        ),
    )


def single_section(result: DemoResult) -> Section:
    """Location from one image on the DEM."""
    rows = [
        (
            name,
            *(number(part.axes[axis].mean, 2, sign=True) for axis in "en"),
            *(number(part.axes[axis].rmse) for axis in "en"),
            number(part.horizontal_rmse_m),
            number(part.ce90_m),
        )
        for name, part in result.single.items()
    ]
    return Section(
        "One image on the DEM",
        (
            Table(
                "Check points located from a single image on the DEM, measured models (found "
                "less true), metres.",
                (
                    "camera",
                    "east mean",
                    "north mean",
                    "east RMSE",
                    "north RMSE",
                    "plan RMSE",
                    "CE90",
                ),
                rows,
            ),
        ),
    )
