"""A gyro against star samples: figures, flagged table and page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geoposition.errors import ArgumentError, GeometryError
from geoposition.scripts.attitude import figures as draw
from geoposition.scripts.attitude.input import ARCSEC_RAD, Sources, Telemetry, load, named, spans
from geoposition.scripts.attitude.report import BODY, write_page
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
from geoposition.sensors.attitude_determination.checks.gyro_check import (
    GyroCheck,
    GyroCheckSettings,
    check_gyro,
)
from geoposition.sensors.attitude_determination.checks.gyro_samples import GyroFlag
from geoposition.sensors.writers.table_file import Column

_LABELS = np.array([flag.name.lower() for flag in GyroFlag], dtype=np.str_)


@dataclass(frozen=True, slots=True, eq=False)
class GyroRun:
    """What was compared, and what came out."""

    telemetry: Telemetry
    check: GyroCheck

    def summary(self) -> dict[str, object]:
        """Return the check's figures, with counts of the gyro samples' flags."""
        flags, counts = np.unique(self.check.sample_flag, return_counts=True)
        return {
            **dict(self.check.summary()),
            "gyro_flags": {
                str(_LABELS[flag]): int(count) for flag, count in zip(flags, counts, strict=True)
            },
            **spans(self.telemetry.star, self.telemetry.gyro),
            **self.telemetry.facts,
        }

    def columns(self) -> dict[str, Column]:
        """Columns of the gyro's samples in the body frame, with a flag."""
        gyro = self.telemetry.need_gyro
        letter = "d" if gyro.kind == "increment" else "w"
        values = np.array(gyro.values)
        return {
            "t_s": np.asarray(gyro.times_s),
            **{f"{letter}_{axis}": values[:, k] for k, axis in enumerate(BODY)},
            "flag": _LABELS[self.check.sample_flag],
        }


def check(sources: Sources, interval_s: float | None, threshold: float) -> GyroRun:
    """Read both and compare."""
    telemetry = load(sources)
    settings = GyroCheckSettings(interval_s, threshold)
    try:
        found = check_gyro(telemetry.star, telemetry.need_gyro, telemetry.mounting, settings)
    except (ArgumentError, GeometryError) as error:
        raise named(error, sources) from None
    return GyroRun(telemetry, found)


def write_report(path: Path, star: str, gyro: str, run: GyroRun) -> None:
    """Write the page about the check, whole or not at all."""
    result: Any = run.summary()
    found = run.check
    verdict = "nothing is wrong" if found.valid else "; ".join(found.messages)
    keys = [
        KeyFigure(
            number(_or_nan(bias), 3, sign=True), "°/h", f"{axis}, bias",
            f"σ {number(_or_nan(sigma), 3)}",
        )
        for axis, bias, sigma in zip(
            BODY, result["bias_deg_h"], result["bias_sigma_deg_h"], strict=True
        )
    ]  # fmt: skip
    keys.append(KeyFigure(str(result["suspicious_gyro_samples"]), "", "suspicious gyro samples"))
    middle = 0.5 * (found.start_s + found.end_s)
    order = np.argsort(middle, kind="stable")
    residual = draw.bands(
        draw.Band(middle[order], found.residual_rad[order] / ARCSEC_RAD), BODY, "″"
    )
    deviation = draw.bands(
        draw.Band(found.deviation_times_s, found.deviation_rad / ARCSEC_RAD), BODY, "″"
    )
    sections = [
        Section("Findings", _findings(run, result)),
        Section(
            "Star minus gyro",
            [
                Image(deviation, "Star minus integrated gyro since the first common sample.",
                      "Deviation over time"),
                Image(residual, "What is left of the turns over intervals after the fit.",
                      "Residuals over time"),
            ],
        ),
    ]  # fmt: skip
    write_page(
        path,
        Report(
            f"Gyro check of {Path(gyro).name}", f"Against {Path(star).name}: {verdict}.",
            keys, sections, provenance({"star": star, "gyro": gyro}),
        ),
    )  # fmt: skip


def _findings(run: GyroRun, result: Any) -> list[Block]:
    blocks: list[Block] = [Note(words) for words in run.check.messages]
    if not blocks:
        blocks.append(Text("The integrated gyro follows the star sensor."))
    rows = [["lag of the star epochs, s", number(_or_nan(result["lag_s"]), 4)]]
    for k, row in enumerate(result["scale_ppm"]):
        for i, value in enumerate(row):
            name = f"scale {BODY[k]}" if i == k else f"{BODY[k]} from {BODY[i]}"
            rows.append([f"{name}, ppm", number(_or_nan(value), 0, sign=True)])
    blocks.append(Table("Gyro errors; a dash where the motion does not show one", ["what", ""],
                        rows))  # fmt: skip
    counts = [[name.replace("_", " "), str(n)] for name, n in result["gyro_flags"].items()]
    blocks.append(Table("Gyro samples", ["flag", "number"], counts))
    return blocks


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value
