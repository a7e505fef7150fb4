"""Sections of the experiment's page on one scene: jitter, fusion, matches, commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from geoposition.scripts.evaluate import figures as evaluate_figures
from geoposition.scripts.experiments.jitter import figures
from geoposition.scripts.experiments.jitter.outcome import Outcome, Scene
from geoposition.scripts.report import Block, Commands, Image, Note, Table, Text, number
from geoposition.sensors.attitude_determination.jitter.lines import AXES


def jitter_blocks(scene: Scene, facts: Mapping[str, Any]) -> list[Block]:
    """Build P figures 3 and 4, and the lines found."""
    chain = scene.chain
    true = facts["jitter"]["true_arcsec"]
    rows = []
    for axis in AXES:
        for peak in chain.jitter.axes[axis]:
            planted = true[axis].get(f"{round(peak.frequency_hz):g}")
            rows.append(
                (
                    axis,
                    number(peak.frequency_hz, 5),
                    f"{peak.sigma_frequency_hz:.1g}",
                    number(peak.amplitude_rad / figures.ARCSEC_RAD, 5),
                    f"{peak.sigma_amplitude_rad / figures.ARCSEC_RAD:.1g}",
                    "–" if planted is None else number(planted, 3),
                )
            )
    peaks = facts["jitter"]["peak_arcsec"]
    return [
        Image(
            figures.shaking(chain),
            "Angles summed up from the sensor's increments, without what is slower than 5 Hz. "
            "Largest over the telemetry: "
            + ", ".join(f"{axis} {number(peaks[axis], 3)}″" for axis in figures.SHOWN)
            + " (P: 0.02″, 0.06″, 0.08″).",
            "Three series of oscillating angles.",
        ),
        Image(
            figures.amplitudes(chain),
            "Amplitudes of ten seconds; circles mark the lines found (P: 200, 300 and 350 Hz, up "
            "to 0.025″).",
            "Three spectra with three lines each.",
        ),
        Table(
            "Lines found in the increments, with standard deviations, beside what was planted.",
            ("axis", "Hz", "σ", "amplitude, ″", "σ", "planted, ″"),
            rows,
        ),
    ]


def fusion_blocks(scene: Scene, facts: Mapping[str, Any]) -> list[Block]:
    """Build P figures 5 to 7."""
    course = scene.chain.course
    told = facts["filter"]
    return [
        Image(
            figures.filter_errors(course),
            "Fused less true attitude, shaded within three standard deviations. RMS "
            + ", ".join(f"{number(v, 2)}″" for v in told["rms_arcsec"])
            + "; expected "
            + ", ".join(f"{number(v, 2)}″" for v in told["sigma_arcsec"])
            + ". P's filter reaches 0.3″ relative.",
            "Three series within bands.",
        ),
        Image(
            figures.drift_errors(course),
            "Estimated less true drift, shaded within three standard deviations.",
            "Three series within bands.",
        ),
        Image(
            figures.drifts(course),
            "Estimated drift (lines) and the true one (dashed), 0.5 °/h as P figure 7 allows. The "
            "smoother knows one constant drift for the whole span.",
            "Three lines over time.",
        ),
        Note(
            "The telemetry's star noise of 5″ leaves the drift uncertain by "
            f"{number(float(np.mean(told['drift_sigma_deg_h'])), 3)} °/h, which costs the image "
            "some hundredths of a pixel."
        ),
    ]


def match_blocks(outcome: Outcome) -> list[Block]:
    """Build P figures 8 and 9."""
    scene = outcome.scenes[0]
    found = scene.after.matches
    shape = outcome.size.lines, outcome.size.samples
    return [
        Image(
            evaluate_figures.distribution(found, shape),
            f"{scene.chain.case.published.region}: patches of the steady image matched with the "
            "orthophoto, and what became of them.",
            "Points over the image.",
        ),
        Image(
            figures.vectors(
                [
                    ("On-board attitude", scene.before),
                    ("Stars and angular displacement", scene.after),
                ]
            ),
            "Residuals about the shift, each panel with its own scale.",
            "Two vector fields.",
        ),
        Image(
            figures.residuals(scene),
            "Residuals of all points of the compensated image over line and sample.",
            "Four scatter plots.",
        ),
    ]


def commands_blocks(scene: Scene) -> list[Block]:
    """Give the commands that repeat each step."""
    case = scene.chain.case
    name, options = case.name, f"--field fields/{case.field}"
    walk = scene.chain.told.angle_random_walk
    return [
        Text(
            "Every step read the files of the one before. In the experiment's folder these "
            "commands repeat them for one scene, or start from files of your own."
        ),
        Commands(
            [
                (
                    f"geoposition attitude fuse --star {name}/telemetry/star.csv --gyro "
                    f"{name}/telemetry/displacement.csv --mounting {name}/telemetry/mounting.toml "
                    f"--angle-random-walk {walk:.9g} --rate-random-walk 0 "
                    f"--at {name}/telemetry/times.csv -o fused.csv",
                    "stars and increments to the attitude",
                ),
                (
                    f"geoposition attitude jitter {name}/telemetry/displacement.csv",
                    "lines of the jitter",
                ),
                (
                    f"geoposition reimage {name}/onboard.toml {name}/image.tif -o steady "
                    f"--attitude fused.csv --dem fields/{case.field}/dem.tif",
                    "steady image, model and RPC",
                ),
                (
                    f"geoposition evaluate steady/steady.tif {options} --search 20 -o accuracy",
                    "its accuracy over the field",
                ),
                ("geoposition evaluate after.toml -o table-2", "all scenes: P table 2"),
            ]
        ),
    ]
