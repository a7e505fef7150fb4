"""Sections of the page about the chain through files and images."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from geoposition.scripts.experiments.thesis import figures
from geoposition.scripts.experiments.thesis.figures import NAMES
from geoposition.scripts.experiments.thesis.fusion import KINDS
from geoposition.scripts.experiments.thesis.imaged import Imaged
from geoposition.scripts.experiments.thesis.scene import EPOCH_UTC
from geoposition.scripts.experiments.thesis_ch4 import NOISE
from geoposition.scripts.report import Commands, Image, Note, Section, Table, Text, number
from geoposition.scripts.surface_figures import surface_difference
from geoposition.terrain import RasterTerrain

THESIS_ANGLE_ARCSEC: Final = {"raw": 3.17, "two-filter": 2.01}
"""T 5.2.2: scatter of the angle between the axes of heads 2 and 3."""


COMMANDS_OF: Final = (
    ("figures 5.1, 5.2", "angles between the heads' axes", "attitude axis-angle"),
    ("figures 5.3, 5.4", "gyro drift and innovations, forward", "attitude fuse --method ekf"),
    ("figure 5.5", "drift, smoothed", "attitude fuse --method rts --report"),
    ("figures 5.6, 5.7", "quaternions and gyro parameters",
     "attitude fuse --method two-filter --gyro-model general"),
    ("figure 5.8", "gyro output against star sensor", "attitude gyro-check"),
    ("figures 5.10, 5.11", "control, residual vectors", "adjust (report.html)"),
    ("figure 5.12", "prototype: attitude simulation", "experiment thesis-ch3, thesis-ch4"),
    ("figure 5.13", "prototype: attitude data", "attitude preprocess, axis-angle, fuse"),
    ("figure 5.14 a", "prototype: inertial to Earth-fixed", "attitude convert"),
    ("figure 5.14 b", "prototype: stereo positioning", "adjust, intersect"),
    ("section 2.4", "jitter spectrum", "attitude jitter"),
)  # fmt: skip
"""Which command repeats which figure of T chapter 5, and which part of its prototype."""


def imaged_sections(made: Imaged, folder: Path) -> list[Section]:
    """Attitude, stereo, and how to go on."""
    return [_attitude(made), _stereo(made, folder), _files()]


def _attitude(made: Imaged) -> Section:
    chain = made.attitude
    planted = made.spoilt
    found: dict[str, int] = {}
    for counts in chain.cleaning["heads"].values():
        for flag, count in counts.items():
            found[flag] = found.get(flag, 0) + int(count)
    words = ", ".join(f"{count} {flag}" for flag, count in found.items())
    raw, fused = chain.axis_angle["pairs"][0], chain.fused_axis_angle["pairs"][0]
    lines = [
        [source, axis, number(peak["frequency_hz"], 5), number(peak["amplitude_arcsec"], 3)]
        for source, facts in (("fused attitude", chain.jitter_facts),
                              ("gyro alone", chain.gyro_jitter_facts))
        for axis, peaks in facts["axes"].items()
        for peak in peaks
    ]  # fmt: skip
    return Section(
        "From telemetry to attitude",
        [
            Text(
                f"Planted among {chain.cleaning['samples_in']} star samples: {planted.blunders} "
                f"blunders, {planted.duplicates} duplicates, {planted.lost} lost in two gaps. "
                f"Found and dealt with: {words}."
            ),
            Table(
                "Angle between the axes of heads 2 and 3, scatter in ″",
                ["", "ours", "T 5.2.2"],
                [
                    ["both as measured", number(raw["std_arcsec"]),
                     number(THESIS_ANGLE_ARCSEC["raw"])],
                    ["head 2 fused, head 3 as measured", number(fused["std_arcsec"]),
                     number(THESIS_ANGLE_ARCSEC["two-filter"])],
                ],
            ),
            Note(
                "Two like heads lose a factor of the square root of two, since head 3 stays as it "
                "is. T's 3.17″ to 2.01″ is more, as if its head 3 were the quieter one; both were "
                "quieter than T table 3.1's 4.1″ per axis, which is simulated here."
            ),
            Image(
                figures.attitude_errors(made),
                "Attitude errors over the pass, ″; images shaded.",
                "Star samples scatter by 4 arcsec, the fused attitude stays within one",
            ),
            Table(
                "Fusion in all ways: RMS errors, ″ (roll, pitch, yaw)",
                ["method", "gyro model", "whole pass", "while imaging", "stated"],
                [
                    [row.method, row.gyro_model,
                     *(" ".join(number(v, 3) for v in values)
                       for values in (row.rms_arcsec, row.imaging_arcsec, row.stated_arcsec))]
                    for row in chain.fusions
                ],
                text_columns=5,
            ),
            Table(
                "Gyro parameters of the fused attitude, ppm (T figure 5.7: all near zero)",
                ["", *chain.gyro_parameters_ppm],
                [
                    [name, *(number(part[name], 0) for part in chain.gyro_parameters_ppm.values())]
                    for name in ("truth", "value", "sigma")
                ],
            ),
            Image(
                figures.jitter_spectrum(chain),
                "Density of the fused attitude's fast part in the orbit frame; dotted: lines. The "
                "rise in yaw is the orbit frame's: 5 cm of GPS noise in the curve's velocity.",
                "Spectrum with a line at 0.65 Hz in roll and pitch",
            ),
            Table(
                "Jitter found (planted: 0.65 Hz, 4″ about roll and pitch; T 2.4)",
                ["in", "axis", "Hz", "amplitude, ″"],
                lines,
                text_columns=2,
            ),
        ],
    )  # fmt: skip


def _stereo(made: Imaged, folder: Path) -> Section:
    stereo = made.stereo
    surface = stereo.surface
    difference: dict[str, Any] = surface["comparison"]["difference_m"]
    residual: Any = stereo.intersection["residual_px"]
    rows = []
    for kind in KINDS:
        facts = stereo.adjustments[kind]
        check = facts["check"]
        rows.append(
            [
                NAMES[kind],
                number(facts["check_rmse_before_m"]),
                number(facts["check_rmse_m"]),
                *(number(check["rmse_m"][axis]) for axis in "enu"),
                number(facts["predicted_check_rmse_m"]),
            ]
        )
    return Section(
        "From images to the ground",
        [
            Text(
                f"One CCD of the forward and the backward camera, {made.size.lines} lines of "
                f"{made.size.samples} pixels each, rendered from the synthetic Songshan field "
                "through the true attitude; located with what telemetry and mounting say."
            ),
            Table(
                "adjust: RMSE at the check points of this one case, m",
                ["attitude", "before", "after", "E", "N", "U", "stated"],
                rows,
            ),
            Note(
                "One case scatters by an eighth about its expectation: the means decide. With "
                "raw attitude the adjustment's own statement is far too good: it was told of "
                "image noise alone."
            ),
            Text(
                f"Matching found {stereo.intersection['matches']} points that meet to "
                f"{number(residual['median'])} px in the median after compensation."
            ),
            Image(
                surface_difference(
                    folder / "dsm.tif", RasterTerrain(folder / "dem.tif"), "the field's DEM"
                ),
                "Surface from dense intersection, and its difference from the field's DEM.",
                "Two maps: heights, and differences of some decimetres",
            ),
            Table(
                "Surface less the field's DEM, m",
                ["cells", "matched", "mean", "median", "NMAD", "RMSE"],
                [
                    [str(difference["count"]), f"{100.0 * float(surface['matched_share']):.1f} %",
                     *(number(difference[name]) for name in ("mean", "median", "nmad", "rmse"))]
                ],
            ),
            Note(
                "NMAD is matching; the mean is what compensation with ten points leaves: about the "
                "limit in height divided by the square root of their number. The RMSE holds a few "
                "wrong matches at the images' edges, too."
            ),
        ],
    )  # fmt: skip


def _files() -> Section:
    return Section(
        "Go on from anywhere",
        [
            Text("All of it lies in the report's folder, as files that the commands take."),
            Table(
                "Which command repeats what of T",
                ["T", "what", "geoposition ..."],
                COMMANDS_OF,
                text_columns=3,
            ),
            Commands(
                [
                    ("geoposition attitude preprocess star_raw.csv -o star.csv",
                     "blunders, duplicates, gaps"),
                    ("geoposition attitude axis-angle star.csv --mounting mounting.toml",
                     "angle between the heads"),
                    ("geoposition attitude fuse --star star.csv --gyro gyro.csv "
                     "--mounting mounting.toml --sensor star-2 --method two-filter "
                     f"--gyro-model general --angle-random-walk {NOISE.angle_random_walk:.6g} "
                     f"--rate-random-walk {NOISE.rate_random_walk:.6g} -o fused.csv",
                     "attitude with covariance"),
                    ("geoposition attitude jitter fused.csv --ephemeris ephemeris.csv "
                     f"--epoch {EPOCH_UTC}", "0.65 Hz"),
                    ("geoposition info models/fused/forward.toml", "a model as the ground has it"),
                    ("geoposition adjust RUN-fused.toml -o adjusted/fused", "compensation"),
                    ("geoposition intersect adjusted/fused/forward.toml "
                     "adjusted/fused/backward.toml --ties ties.csv --gcps gcps.csv -o points.csv",
                     "ground points"),
                    ("geoposition dsm adjusted/fused/forward.toml adjusted/fused/backward.toml "
                     "--image forward.tif --image backward.tif --reference dem.tif -o dsm.tif",
                     "the surface"),
                    ("geoposition evaluate adjusted/fused/forward.toml --dom dom.tif --dem dem.tif "
                     "--image forward.tif -o accuracy", "against the orthophoto"),
                ]
            ),
        ],
    )  # fmt: skip
