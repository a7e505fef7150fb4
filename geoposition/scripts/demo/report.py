"""The demo's report: what was simulated, what came out, how good it is, what to run next."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from geoposition.accuracy import axis_statistics
from geoposition.rotation import rotation_difference_rad
from geoposition.scripts import figures
from geoposition.scripts.demo.data import DemoResult
from geoposition.scripts.demo.sanity import ground_sample_m, zenith_deg
from geoposition.scripts.demo.sections import (
    causes_section,
    heights_section,
    points_section,
    residuals_section,
    single_section,
)
from geoposition.scripts.report import (
    Commands,
    Image,
    KeyFigure,
    Report,
    Section,
    Table,
    Text,
    number,
)
from geoposition.sensors.simulate import ARCSEC_RAD


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
            number(true.rmse_3d_m, 1), "m", "RMSE in space, true models", "image noise alone"
        ),
        KeyFigure(
            number(measured.rmse_3d_m, 1),
            "m",
            "RMSE in space, measured models",
            f"CE90 {number(measured.ce90_m, 1)} m, LE90 {number(measured.le90_m, 1)} m",
        ),
        KeyFigure(
            number(heights.rmse, 1),
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
            points_section(result),
            causes_section(result),
            residuals_section(result),
            heights_section(result),
            single_section(result),
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
                        f"geoposition intersect {names} --ties ties.csv --gcps gcps.csv "
                        "--image-noise-only "
                        f"--sigma {result.options.image_sigma_px:g} -o out.csv",
                        "Intersect the tie points of all three and compare with the check points:",
                    ),
                )
            ),
        ),
    )
