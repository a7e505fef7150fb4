"""Angles between star heads as a command line's result: figures, table, words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from geoposition.errors import ArgumentError, GeometryError
from geoposition.scripts.attitude.input import ARCSEC_RAD, Sources, load, named
from geoposition.sensors.attitude_determination.checks.axis_angle import (
    AxisAngle,
    angle_between_rad,
    axis_angles,
    boresight_inertial,
)
from geoposition.sensors.attitude_determination.checks.error_split import (
    ErrorSplit,
    SplitSettings,
    split_errors,
)
from geoposition.sensors.writers.table_file import Column


@dataclass(frozen=True, slots=True, eq=False)
class AxisAngles:
    """Angles of all pairs, the parts of their errors where asked for, and facts of the run.

    `splits` has one entry per pair: the parts, or why there are none; `mounted_rad`, where a
    mounting is given, the angle that it says.
    """

    pairs: tuple[AxisAngle, ...]
    splits: tuple[ErrorSplit | str, ...]
    mounted_rad: tuple[float, ...]
    facts: dict[str, object]

    def summary(self) -> dict[str, object]:
        """Return the contract's `pairs`, with `error_split` where asked for."""
        found = []
        for k, pair in enumerate(self.pairs):
            one = dict(pair.summary())
            if self.splits:
                part = self.splits[k]
                one["error_split"] = part if isinstance(part, str) else part.summary()
            if self.mounted_rad:
                one["mounted_deg"] = float(np.degrees(self.mounted_rad[k]))
                one["offset_arcsec"] = (pair.mean_rad - self.mounted_rad[k]) / ARCSEC_RAD
            found.append(one)
        return {**self.facts, "pairs": found}

    def columns(self) -> dict[str, Column]:
        """Angles over time, pair below pair."""
        counts = [len(pair.times_s) for pair in self.pairs]
        names = np.array([pair.sensors for pair in self.pairs], dtype=np.str_)
        angles = np.concatenate([pair.angle_rad for pair in self.pairs])
        return {
            "t_s": np.concatenate([pair.times_s for pair in self.pairs]),
            "sensor_a": np.repeat(names[:, 0], counts),
            "sensor_b": np.repeat(names[:, 1], counts),
            "angle_deg": np.degrees(angles),
        }


def measure_axis_angles(
    sources: Sources, error_split: bool, orbit_period_s: float | None
) -> AxisAngles:
    """Read the heads, measure their angles and, if asked, part their errors."""
    telemetry = load(sources)
    try:
        pairs = axis_angles(telemetry.star)
    except GeometryError as error:
        raise named(error, sources) from None
    splits: list[ErrorSplit | str] = []
    settings = SplitSettings(orbit_period_s=orbit_period_s)
    for pair in pairs if error_split else ():
        try:
            splits.append(split_errors(pair.times_s, pair.angle_rad, settings))
        except ArgumentError as error:
            # A short series has an angle and a scatter, but no parts: that is no failure.
            splits.append(str(error))
    facts = {**telemetry.facts, "star_samples": len(telemetry.star)}
    mounted: tuple[float, ...] = ()
    if sources.mounting is not None:
        axes = {
            name: boresight_inertial(telemetry.mounting.rotation(name))
            for name in telemetry.star.heads
        }
        mounted = tuple(
            float(angle_between_rad(axes[pair.sensors[0]], axes[pair.sensors[1]])) for pair in pairs
        )
    return AxisAngles(pairs, tuple(splits), mounted, facts)


def print_axis_angles(title: str, result: Mapping[str, Any]) -> None:
    """Print the pairs as a table for people."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None)
    names = ["heads", "mean °", "std ″", "drift ″/h", "±", "n"]
    split = "error_split" in result["pairs"][0]
    mounted = "mounted_deg" in result["pairs"][0]
    if mounted:
        names.append("mounted °")
    if split:
        names += ["low ″", "high ″", "random ″"]
    for name in names:
        table.add_column(name, justify="left" if name == "heads" else "right")
    reasons = set()
    for pair in result["pairs"]:
        cells = [
            " – ".join(pair["sensors"]),
            f"{pair['mean_deg']:.5f}", f"{pair['std_arcsec']:.3f}",
            f"{pair['drift_arcsec_per_h']:.3g}", f"{pair['drift_sigma_arcsec_per_h']:.2g}",
            str(pair["n"]),
        ]  # fmt: skip
        if mounted:
            cells.append(f"{pair['mounted_deg']:.5f}")
        if split:
            parts = pair["error_split"]
            if isinstance(parts, str):
                reasons.add(parts)
                cells += ["–"] * 3
            else:
                cells += [
                    f"{parts[f'{kind}_arcsec']:.3f}"
                    for kind in ("low_frequency", "high_frequency", "random")
                ]
        table.add_row(*cells)
    console = Console()
    console.print(table)
    for reason in sorted(reasons):
        console.print(reason)
