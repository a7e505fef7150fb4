"""The report of a calibration: curves, parameters, what is determined, checks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from geoposition.calib_fields.calibration import ARCSEC_RAD, Calibration
from geoposition.scripts.calibrate import figures as calibrate_figures
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
)

if TYPE_CHECKING:
    from geoposition.scripts.calibrate.run import CalibrationResult

_MOST_WEAK: Final = 12
_KINDS: Final = {
    "mounting with look": "mounting with look angles (a constant or tilted look angle is a turn)",
    "mounting with attitude": "mounting with the scenes' attitude biases",
    "look with look": "look angles among each other",
    "look with attitude": "look angles with attitude biases",
}


def build_report(result: CalibrationResult, inputs: Mapping[str, str]) -> Report:
    """Report of one calibration; `inputs` are the files and their checksums."""
    done = result.calibration
    sections = [
        Section("Look angles", _looks(result)),
        Section("What is determined", _determined(done)),
        Section("Checks", _checks(result)),
        Section("Parameters", [_parameters(done)]),
        Section("How it was done", _method(done)),
    ]
    facts: dict[str, object] = {f"input {Path(name).name}": sums for name, sums in inputs.items()}
    options = done.options
    facts["options"] = (
        f"look angles of degree {options.degree} by CCD, attitude bias of degree "
        f"{options.attitude_degree} in time by scene; prior deviations: mounting "
        f"{options.mounting_sigma_rad / ARCSEC_RAD:g}″, attitude "
        f"{options.attitude_sigma_rad / ARCSEC_RAD:g}″, look angles "
        f"{options.look_sigma_rad / ARCSEC_RAD:g}″, single heights {options.height_sigma_m:g} m"
    )
    count = len(done.scenes)
    of = result.names[0] if count == 1 else f"{count} scenes"
    return Report(
        f"Camera calibration from {of}", _summary(result), _keys(result), sections,
        provenance(facts),
    )  # fmt: skip


def _largest(done: Calibration) -> tuple[float, float]:
    """Largest change of shape, and the deviation there."""
    size = np.concatenate([np.hypot(*curve.shape_px.T) for curve in done.curves])
    sigma = np.concatenate([np.hypot(*curve.shape_sigma_px.T) for curve in done.curves])
    at = int(np.argmax(size))
    return float(size[at]), float(sigma[at])


def _after(done: Calibration) -> tuple[float, float]:
    """Root mean square error of held-out points, both axes together: before and after."""
    before, after = (
        float(np.sqrt(np.mean([np.sum(np.square(getattr(c, name))) for c in done.checks])))
        for name in ("before_px", "after_px")
    )
    return before, after


def _summary(result: CalibrationResult) -> str:
    done = result.calibration
    size, sigma = _largest(done)
    before, after = _after(done)
    text = (
        f"{done.points} points on known ground in {len(done.scenes)} scene"
        f"{'s' if len(done.scenes) > 1 else ''} give the look angles of {len(done.curves)} CCD"
        f"{'s' if len(done.curves) > 1 else ''}: their shape changes by up to {number(size)} ± "
        f"{number(2.0 * sigma)} px. Points kept out of the fit are off by {number(before)} px as "
        f"the camera came and by {number(after, 3)} px calibrated."
    )
    if result.held_out:
        most = max(check.after.estimates["relative_px"].interval[1] for check in result.held_out)
        count = len(result.held_out)
        text += (
            f" In {count} scene{'s' if count > 1 else ''} kept out altogether less than "
            f"{number(most, 3)} px are left within the image, with a confidence of 95 %."
        )
    return text


def _keys(result: CalibrationResult) -> tuple[KeyFigure, ...]:
    done = result.calibration
    size, sigma = _largest(done)
    before, after = _after(done)
    keys = [
        KeyFigure(number(size), "px", "largest change of shape", f"± {number(2.0 * sigma)} (2σ)"),
        KeyFigure(number(after, 3), "px", "held-out points", f"{number(before)} px before"),
    ]
    for check in result.held_out[:2]:
        was, now = (e.estimates["relative_px"] for e in (check.before, check.after))
        remark = f"95 %: below {number(now.interval[1], 3)}; {number(was.value)} px before"
        keys.append(KeyFigure(number(now.value, 3), "px", f"scene kept out: {check.name}", remark))
    return tuple(keys)


def _looks(result: CalibrationResult) -> list[Block]:
    done = result.calibration
    rows = []
    for curve in done.curves:
        for k, axis in enumerate(("along", "across")):
            ends = [0, len(curve.sample) // 2, -1]
            rows.append(
                (
                    f"{curve.ccd} {axis}",
                    *(
                        f"{number(curve.shape_px[i, k], 3)} ± "
                        f"{number(2.0 * curve.shape_sigma_px[i, k], 3)}"
                        for i in ends
                    ),
                )
            )
    scene, used, residual = done.scenes[0], done.used[0], done.residual_px[0]
    matches = scene.matches
    known = matches.used & np.isfinite(matches.error_px).all(axis=1)
    before = matches.error_px[known][used]
    return [
        Image(
            calibrate_figures.shapes(done.curves),
            "Change of the look angles, calibrated less as they came, without what a turn of the "
            "whole camera makes; shaded: two standard deviations.",
            "Two line plots over the image row, each a curve with a band.",
        ),
        Table(
            "Change of the look angles' shape at the ends and the middle of each CCD, pixels, "
            "with two standard deviations.",
            ("CCD", "first sample", "middle", "last sample"),
            rows,
        ),
        Image(
            calibrate_figures.over_row(
                matches.model_px[known][used][:, 1],
                before - before.mean(axis=0),
                residual[used],
                scene.model.shape[1],
            ),
            f"Errors of the matched points of {scene.name} by sample, with medians.",
            "Two scatter plots over the image row, before and after.",
        ),
    ]


def _determined(done: Calibration) -> list[Block]:
    a = done.adjustment
    blocks: list[Block] = []
    if len(done.scenes) == 1:
        blocks.append(
            Note(
                "From one scene a turn of the mounting cannot be told from a bias of its attitude: "
                "the mounting here is that of this scene, attitude bias included, and its "
                "deviation is that of the attitude's prior. The shape of the look angles does not "
                "depend on it."
            )
        )
    else:
        blocks.append(
            Text(
                f"The mounting is what {len(done.scenes)} scenes have in common; what each has of "
                "its own is its attitude's bias."
            )
        )
    blocks.append(
        Table(
            "Largest correlations between unknowns, by kind.",
            ("between", "largest |correlation|"),
            [
                (words, number(done.correlations[kind], 3))
                for kind, words in _KINDS.items()
                if kind in done.correlations
            ],
        )
    )
    weak = a.weak[:_MOST_WEAK]
    if weak:
        blocks.append(
            Table(
                "Combinations of unknowns that rest on their priors: the measurements took less "
                "than half of their prior variance. Only their sums matter to where the camera "
                "looks.",
                ("combination, in prior deviations", "determined, %"),
                [
                    (
                        "  ".join(f"{number(v, 2, sign=True)} {name}" for name, v in w.parts),
                        number(100.0 * w.gain, 0),
                    )
                    for w in weak
                ],
            )
        )
    return blocks


def _checks(result: CalibrationResult) -> list[Block]:
    def pair(values: tuple[float, float]) -> str:
        return " / ".join(number(value, 3) for value in values)

    done = result.calibration
    blocks: list[Block] = [
        Table(
            "Half of each scene's points, in fields of a chess board, were kept out of a solution "
            "of the other half: root mean square errors along / across the track, pixels.",
            ("scene", "points", "as it came", "calibrated", "matching's own"),
            [
                (
                    c.name, str(c.points), pair(c.before_px), pair(c.after_px), pair(c.stated_px),
                )
                for c in done.checks
            ],
        )
    ]  # fmt: skip
    if not result.held_out:
        blocks.append(Note("No scene was kept out: name one with --hold-out to check on it."))
        return blocks
    rows = []
    for check in result.held_out:
        for label, found in (("as it came", check.before), ("calibrated", check.after)):
            cells = []
            for name in ("bias_line_px", "bias_sample_px", "relative_px"):
                estimate = found.estimates[name]
                low, high = (number(value, 3) for value in estimate.interval)
                cells.append(f"{number(estimate.value, 3)} ({low}…{high})")
            m = " / ".join(number(found.estimates[name].value, 3) for name in ("m_x", "m_y"))
            rows.append((f"{check.name}, {label}", *cells[:2], m, cells[2]))
    blocks.append(
        Table(
            "Scenes kept out altogether, pixels, with intervals of 95 %: mean error along and "
            "across the track, and root mean squares after removing a constant attitude error.",
            ("scene", "bias x", "bias y", "M x / M y", "relative"),
            rows,
            strong=tuple(range(1, len(rows), 2)),
        )
    )
    return blocks


def _parameters(done: Calibration) -> Table:
    a = done.adjustment
    return Table(
        "All unknowns, arcseconds, with standard deviations; and which part of the prior variance "
        "the measurements took. A look angle's coefficient is its effect at the CCD's end.",
        ("unknown", "value", "σ", "unit", "determined, %"),
        [
            (
                name,
                number(value / ARCSEC_RAD, 4, sign=True),
                number(sigma / ARCSEC_RAD, 4),
                unit.replace("rad", "″"),
                number(100.0 * gain, 0),
            )
            for name, value, sigma, gain, unit in zip(
                a.names, a.values, a.sigma, a.gain, a.units, strict=True
            )
        ],
    )


def _method(done: Calibration) -> list[Block]:
    lines = [
        f"{scene.name}: " + ", ".join(f"{line.frequency:.4g} Hz" for line in found)
        for scene, found in zip(done.scenes, done.vibrations, strict=True)
        if found
    ]
    vibration = (
        "Vibrations found in the residuals of a first solution were taken out of the "
        f"measurements ({'; '.join(lines)})."
        if lines
        else "No vibration stood out of the residuals of the first solution."
    )
    return [
        Text(
            "Patches matched with the reference orthophoto are control points in the image, with "
            "the matching's covariance, widened to the scatter about the first solution; patches "
            "that share pixels count as fewer. Look angles, mounting and attitude biases are "
            "estimated together in one factor graph, blunders left out."
        ),
        Text(vibration),
    ]
