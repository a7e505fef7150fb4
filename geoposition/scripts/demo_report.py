"""The demo's report: what was simulated, what came out, how good it is, what to run next."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from geoposition.accuracy import PointStatistics, axis_statistics
from geoposition.arrays import FloatArray
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.rotation import rotation_difference_rad
from geoposition.scripts import figures
from geoposition.scripts.demo_run import DemoResult, ground_sample_m, zenith_deg
from geoposition.scripts.report import (
    Commands,
    Image,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    Text,
    number,
)
from geoposition.sensors.simulate import ARCSEC_RAD

_AXES = {"e": "east", "n": "north", "u": "up", "x": "X", "y": "Y", "z": "Z"}


def build_report(result: DemoResult, facts: Mapping[str, str], folder: str) -> Report:
    """Report of `result` with its provenance `facts`; `folder` is where the commands run."""
    true, measured = result.true.statistics, result.measured.statistics
    heights = axis_statistics(result.height_error_measured_m)
    summary = (
        f"A simulated satellite took one place in three images, looking forward, down and "
        f"backward. From {len(result.check.ids)} check points measured in all three to "
        f"{result.options.image_sigma_px:g} px, the intersection is right to "
        f"{number(true.rmse_3d_m, 1)} m (RMSE in space) with the true orbit, attitude and "
        f"mounting, and to {number(measured.rmse_3d_m, 1)} m with the ones that the satellite's "
        f"telemetry gives. The mounting of the cameras, known to "
        f"{result.options.scene.mounting_bias_arcsec:g}″, and the noise of the star sensors make "
        f"the difference; ground control removes the first."
    )
    keys = (
        KeyFigure(
            number(true.rmse_3d_m, 2), "m", "RMSE in space, true models", "image noise alone"
        ),
        KeyFigure(
            number(measured.rmse_3d_m, 2),
            "m",
            "RMSE in space, measured models",
            f"CE90 {number(measured.ce90_m, 1)} m, LE90 {number(measured.le90_m, 1)} m",
        ),
        KeyFigure(
            number(heights.rmse, 2),
            "m",
            "RMSE of heights, measured models",
            f"{heights.count} dense points against the DEM",
        ),
        KeyFigure(
            number(result.sensitivity[1].measured_m, 2),
            "m",
            "on the ground for 1″ of pitch",
            f"range × angle: {number(result.sensitivity[1].expected_m, 2)} m",
        ),
    )
    return Report(
        "A simulated three-line scene, end to end",
        summary,
        keys,
        (
            _scene(result),
            _points(result),
            _causes(result),
            _residuals(result),
            _heights(result),
            _single(result),
            _next(result, folder),
        ),
        facts,
    )


def _terrain_map(result: DemoResult, step: int = 3) -> figures.HeightMap:
    terrain = result.terrain
    rows, cols = terrain.height_m.shape
    half = 0.5 * terrain.step_rad
    west, north = terrain.west_rad - half, terrain.north_rad + half
    extent = np.degrees(
        [west, west + cols * terrain.step_rad, north - rows * terrain.step_rad, north]
    )
    return figures.HeightMap(terrain.height_m[::step, ::step], tuple(extent.tolist()))


def _scene(result: DemoResult) -> Section:
    options = result.options.scene
    rows = []
    for name, model in result.scene.true.items():
        sample = ground_sample_m(model)
        timing = model.camera.timing
        first, last = (float(t) for t in timing.time_s(np.array([0.0, model.shape[0] - 1.0])))
        rows.append(
            (
                name,
                f"{model.shape[0]} × {model.shape[1]}",
                str(len(model.camera.detectors)),
                f"{number(sample[0])} × {number(sample[1])}",
                number(zenith_deg(model), 1),
                f"{number(first, 2)} … {number(last, 2)}",
            )
        )
    table = Table(
        "The three images. Ground sample along rows and columns at the middle height; zenith "
        f"angle of the satellite at the image's centre; seconds from {options.epoch_utc}.",
        ("camera", "rows × columns", "CCDs", "ground sample, m", "zenith, °", "time, s"),
        rows,
    )
    footprint = figures.footprints(
        _terrain_map(result),
        result.outlines,
        np.degrees(result.check.geodetic[:, :2]),
        "check points",
    )
    noise = options.star_noise_arcsec
    return Section(
        "What was simulated",
        (
            Text(
                f"A sun-synchronous orbit of {options.altitude_m / 1e3:g} km and "
                f"{options.inclination_deg:g}°, integrated with the Earth's flattening in the "
                f"inertial frame; three line cameras with figures published for ZY-3, several "
                f"CCDs each; Earth pointing with yaw steering, slow drift of "
                f"{options.drift_arcsec:g}″ and jitter of {options.jitter_hz:g} Hz and up to "
                f"{max(options.jitter_arcsec):g}″. Velocity aberration, light time and refraction "
                f"are in force."
            ),
            Text(
                f"The measured models know less: GPS at {options.gps_hz:g} Hz to "
                f"{100 * options.gps_sigma_m:g} cm, attitude at {options.star_hz:g} Hz to "
                f"{noise[0]:g}″, {noise[1]:g}″ and {noise[2]:g}″ in roll, pitch and yaw (white), "
                f"and each camera's mounting off by a constant turn of "
                f"{options.mounting_bias_arcsec:g}″ (one sigma per axis)."
            ),
            table,
            Image(
                footprint,
                "Footprints of the three images on the terrain, and the check points. Fractal "
                "terrain, ellipsoidal heights in metres, shaded from the north-west.",
                "Map of a hilly terrain with three nearly equal quadrilaterals, the footprints, "
                "and dots, the check points.",
            ),
            Image(
                _attitude_figure(result),
                "What the star sensors make of the attitude: measured less true turn about the "
                "body's axes, arcseconds. Shaded: while each image was taken.",
                "Three time series of noise about zero, with three shaded intervals.",
            ),
        ),
    )


def _attitude_figure(result: DemoResult) -> bytes:
    scene = result.scene
    seen = scene.measured_attitude
    times = np.arange(seen.span_s[0], seen.span_s[1], 0.05)
    error = rotation_difference_rad(seen.rotation(times), scene.true_attitude.rotation(times))
    intervals = {}
    for name, model in scene.true.items():
        ends = model.camera.timing.time_s(np.array([0.0, model.shape[0] - 1.0]))
        intervals[name] = (float(ends[0]), float(ends[1]))
    return figures.series(
        times,
        {name: error[:, k] / ARCSEC_RAD for k, name in enumerate(("roll", "pitch", "yaw"))},
        unit="″",
        time_label="seconds from the middle of the nadir image",
        intervals=intervals,
    )


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


def _errors_en(result: DemoResult, geodetic: FloatArray) -> tuple[FloatArray, FloatArray]:
    true = result.check.geodetic
    difference = geodetic_to_ecef(geodetic) - geodetic_to_ecef(true)
    enu = np.einsum("nji,nj->ni", enu_axes(true), difference)
    return enu[:, :2], enu[:, 2]


def _points(result: DemoResult) -> Section:
    panels = []
    place = _kilometres(result)
    for title, part in (("True models", result.true), ("Measured models", result.measured)):
        plan, up = _errors_en(result, part.found.geodetic)
        good = np.isfinite(up)
        panels.append(figures.VectorPanel(title, place[good], plan[good], up[good]))
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
                "Errors at the check points: arrows in plan, dots in height, metres. Each panel has "
                "its own scale, the arrow at its top; the dots' colours are common.",
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
                "models the errors of orbit, attitude and mounting come on top, which neither "
                "the sigma nor the intersection's residuals show. Check points do."
            ),
        ),
    )


def _kilometres(result: DemoResult) -> FloatArray:
    centre = result.scene.centre_geodetic
    difference = geodetic_to_ecef(result.check.geodetic) - geodetic_to_ecef(centre)
    result_km: FloatArray = 1e-3 * (difference @ enu_axes(centre))[:, :2]
    return result_km


def _causes(result: DemoResult) -> Section:
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


def _residuals(result: DemoResult) -> Section:
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
        panels.append(
            figures.VectorPanel(name, image[:, ::-1] / 1e3, px[:, ::-1])
        )
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
                    "camera", "row mean", "row std", "row RMSE",
                    "column mean", "column std", "column RMSE",
                ),
                rows,
            ),  # fmt: skip
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


def _heights(result: DemoResult) -> Section:
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
                        "Difference, true models": _lattice(result, result.height_error_true_m),
                        "Difference, measured models": _lattice(result, result.height_error_measured_m),
                    },
                    "height found less DEM, m",
                ),
                "Left: heights intersected with the measured models, metres. Middle and right: "
                "their difference from the DEM with true and with measured models, metres; the "
                "stripes across the flight are the attitude's noise, from line to line the same "
                "over the row.",
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


def _single(result: DemoResult) -> Section:
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
                ("camera", "east mean", "north mean", "east RMSE", "north RMSE", "plan RMSE",
                 "CE90"),
                rows,
            ),  # fmt: skip
        ),
    )


def _next(result: DemoResult, folder: str) -> Section:
    names = " ".join(f"{name}.toml" for name in result.scene.measured)
    return Section(
        "Run it yourself",
        (
            Text(
                "The folder of this report holds the scene as files: the measured models "
                "(forward.toml, nadir.toml, backward.toml and their tables), the true ones in "
                "true/, tie points, check points and the DEM. Products of real satellites take "
                "the place of the .toml files in the same commands."
            ),
            Commands(
                (
                    (f"cd {folder}", "Go to the folder:"),
                    ("geoposition info nadir.toml", "What is known of the nadir image:"),
                    (
                        "geoposition locate nadir.toml points.csv --dem dem.tif -o located.csv",
                        "Locate image points on the DEM:",
                    ),
                    (
                        "geoposition project backward.toml gcps.csv -o projected.csv",
                        "Project ground points into the backward image:",
                    ),
                    (
                        f"geoposition intersect {names} --ties ties.csv --gcps gcps.csv -o out.csv",
                        "Intersect the tie points of all three and compare with the check points:",
                    ),
                )
            ),
        ),
    )
