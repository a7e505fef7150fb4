"""HTML pages about attitude: fusion, angles between heads, jitter, checks, static solutions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geoposition.scripts.attitude import figures as draw
from geoposition.scripts.attitude.input import ARCSEC_RAD
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
from geoposition.scripts.tables import whole_file

if TYPE_CHECKING:
    from geoposition.scripts.attitude.checks import AxisAngles
    from geoposition.scripts.attitude.static import StaticRun
    from geoposition.sensors.attitude_determination.checks.preprocess import Preprocessed
    from geoposition.sensors.attitude_determination.jitter.lines import Jitter

BODY = ("x", "y", "z")


def write_page(path: Path, report: Report) -> None:
    """Write a page whole or not at all."""
    page = render(report)
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def write_jitter(path: Path, source: str, found: Jitter, result: Mapping[str, Any]) -> None:
    """Write the page about jitter: detrended angles, spectra, lines."""
    axes = tuple(found.axes)
    rms = result["rms_arcsec"]
    strongest = [(peak, axis) for axis in axes for peak in found.axes[axis][:1]]
    keys = [KeyFigure(number(rms[axis], 3), "″", f"{axis}, rms") for axis in axes]
    if strongest:
        peak, axis = max(strongest, key=lambda one: one[0].amplitude_rad)
        keys.insert(
            0,
            KeyFigure(
                number(peak.frequency_hz, 3), "Hz", "strongest line",
                f"{number(peak.amplitude_rad / ARCSEC_RAD, 3)}″ in {axis}",
            ),
        )  # fmt: skip
    rows = [
        [
            axis, number(p.frequency_hz, 5), number(p.sigma_frequency_hz, 5),
            number(p.amplitude_rad / ARCSEC_RAD, 4),
            number(p.sigma_amplitude_rad / ARCSEC_RAD, 4), number(p.phase_rad, 3, sign=True),
            number(p.sigma_phase_rad, 3), f"{p.false_alarm:.0e}",
        ]
        for axis in axes
        for p in found.axes[axis]
    ]  # fmt: skip
    drawn = found.spectrum
    lines: list[Block] = [
        Text(
            f"Sought from {2.0 * found.low_cut_hz:.4g} to {found.highest_hz:.4g} Hz. Phases are "
            f"those of a sine at t = {found.reference_s:.6f} s."
        ),
        Table(
            "Lines",
            ["axis", "Hz", "σ", "amplitude, ″", "σ", "phase, rad", "σ", "false alarm"],
            rows,
        )
        if rows
        else Note("No line stands out of the noise."),
    ]
    spectrum = Image(
        draw.spectra(
            drawn.frequency_hz, drawn.density / ARCSEC_RAD**2, axes, "″²/Hz",
            (drawn.low, drawn.high), {a: [p.frequency_hz for p in found.axes[a]] for a in axes},
        ),
        f"Power density of the angles with its {drawn.confidence:.0%} confidence ({drawn.method}); "
        "triangles mark the lines.",
        "Spectra of roll, pitch and yaw",
    )  # fmt: skip
    series = Image(
        draw.bands(
            draw.Band(found.times_s, found.angle_rad / ARCSEC_RAD), axes, "″"
        ),
        f"Angles without what is slower than {found.low_cut_hz:.4g} Hz.",
        "Roll, pitch and yaw over time",
    )  # fmt: skip
    write_page(
        path,
        Report(
            f"Jitter of {Path(source).name}",
            f"{len(rows)} lines in roll, pitch and yaw ({result['angles']}).",
            keys,
            [
                Section("Lines", lines),
                Section("Spectra", [spectrum]),
                Section("Angles", [series]),
            ],
            provenance({"series": source}),
        ),
    )


def write_axis_angles(path: Path, source: str, found: AxisAngles) -> None:
    """Write the page about angles between heads: mean, scatter, drift, parts of the error."""
    keys = [
        KeyFigure(
            number(pair.std_rad / ARCSEC_RAD, 2), "″", f"{' – '.join(pair.sensors)}, std",
            f"mean {number(float(np.degrees(pair.mean_rad)), 5)}°",
        )
        for pair in found.pairs
    ]  # fmt: skip
    hour = 3600.0 / ARCSEC_RAD
    rows = [
        [
            " – ".join(pair.sensors), number(float(np.degrees(pair.mean_rad)), 5),
            number(pair.std_rad / ARCSEC_RAD, 3), number(pair.drift_rad_s * hour, 2, sign=True),
            number(pair.drift_sigma_rad_s * hour, 2), number(pair.noise_rad / ARCSEC_RAD, 3),
            str(len(pair.times_s)),
        ]
        for pair in found.pairs
    ]  # fmt: skip
    header = ["heads", "mean, °", "std, ″", "drift, ″/h", "σ", "std about the drift, ″", "n"]
    series = {
        " – ".join(pair.sensors): (
            pair.times_s, (pair.angle_rad - pair.mean_rad) / ARCSEC_RAD,
        )
        for pair in found.pairs
    }  # fmt: skip
    sections = [
        Section(
            "Angles",
            [
                Text("On a stiff satellite these angles are constant: what moves is the heads'."),
                Table("Between optical axes", header, rows),
                _image(draw.angles(series, "″"), "Angles less their means."),
            ],
        )
    ]
    if found.splits:
        sections.append(Section("Parts of the error", _splits(found)))
    write_page(
        path,
        Report(
            f"Optical-axis angles of {Path(source).name}",
            f"{len(found.pairs)} pairs of star heads.",
            keys,
            sections,
            provenance({"star samples": source}),
        ),
    )


def _splits(found: AxisAngles) -> list[Block]:
    rows = []
    blocks: list[Block] = []
    for pair, part in zip(found.pairs, found.splits, strict=True):
        name = " – ".join(pair.sensors)
        if isinstance(part, str):
            blocks.append(Note(f"{name}: {part}"))
            continue
        stds = (part.low_std[0], part.high_std[0], part.random_std[0])
        rows.append([name, *(number(float(value) / ARCSEC_RAD, 3) for value in stds)])
    if rows:
        header = ["heads", "low frequency, ″", "high frequency, ″", "random, ″"]
        blocks.insert(0, Table("Standard deviations", header, rows))
    return blocks


def write_cleaning(path: Path, source: str, found: Preprocessed) -> None:
    """Write the page about pre-processing: counts by head, and when samples were replaced."""
    from geoposition.scripts.attitude.cleaning import summary

    result: Any = summary(found)
    names = list(next(iter(found.counts.values())))
    rows = [[head, *(str(count[name]) for name in names)] for head, count in found.counts.items()]
    noise = [
        [head, *(number(float(value), 2) for value in values)]
        for head, values in result["noise_arcsec"].items()
    ]
    series = {}
    for head, name in enumerate(found.star.heads):
        mine = found.star.head == head
        if np.sum(mine) > 1:
            flags = np.asarray(found.flag[mine], dtype=np.float64)
            series[name] = (found.star.times_s[mine], flags)
    replaced = len(found.star) - int(np.sum(found.flag == 0))
    sections = [
        Section(
            "Samples",
            [
                Table("By head", ["head", *(name.replace("_", " ") for name in names)], rows),
                Table("Scatter about the motion, ″", ["head", "x", "y", "boresight"], noise),
            ],
        ),
        Section(
            "When",
            [
                Text("0 ok, 3 broken, 4 outlier replaced, 5 gap filled."),
                _image(draw.angles(series, "flag"), "Flag of every sample over time."),
            ],
        ),
    ]
    write_page(
        path,
        Report(
            f"Pre-processing of {Path(source).name}",
            f"{result['samples_in']} rows in, {result['samples_out']} samples out, {replaced} of "
            "them from the model of the motion.",
            [KeyFigure(str(replaced), "", "samples replaced or filled")],
            sections,
            provenance({"star samples": source}),
        ),
    )


def write_static(path: Path, source: str, found: StaticRun) -> None:
    """Write the page about static attitude: standard deviations and losses over time."""
    result: Any = found.summary()
    good = np.isfinite(found.attitude.loss)
    times = found.times_s[good]
    sigma = found.sigma_rad[good] / ARCSEC_RAD
    keys = [
        KeyFigure(number(result["sigma_arcsec"][axis], 2), "″", f"{axis}, σ, median")
        for axis in BODY
    ]
    keys.append(
        KeyFigure(
            number(result["loss_per_freedom"], 2), "", "loss per degree of freedom",
            "1 where the stated noise is right",
        )
    )  # fmt: skip
    freedom = np.maximum(2.0 * found.attitude.vectors[good] - 3.0, 1.0)
    sections = [
        Section(
            "Standard deviations",
            [_image(draw.bands(draw.Band(times, sigma), BODY, "″"), "σ about the body's axes.")],
        ),
        Section(
            "Loss",
            [
                _image(
                    draw.angles({"loss": (times, found.attitude.loss[good] / freedom)}, "–"),
                    "Wahba's loss per degree of freedom, epoch by epoch.",
                )
            ],
        ),
        Section("Epochs", [_counts("Epochs", result["flags"])]),
    ]
    write_page(
        path,
        Report(
            f"Attitude of {Path(source).name}",
            f"{result['epochs']} epochs from {result['vectors']} directions, {result['method']}.",
            keys, sections, provenance({"vectors": source}),
        ),
    )  # fmt: skip


def _counts(caption: str, counts: Mapping[str, int]) -> Table:
    return Table(caption, ["what", "number"], [[name, str(n)] for name, n in counts.items()])


def _image(png: bytes, caption: str) -> Image:
    return Image(png, caption, caption)
