"""What the attitude commands read: star samples and gyro of one run, checked against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geoposition.errors import ArgumentError, GeometryError, ProductError
from geoposition.sensors.readers.attitude_columns import column_map
from geoposition.sensors.readers.mounting_file import MountingFile
from geoposition.sensors.readers.telemetry_source import open_gyro, open_mounting, open_star
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries
from geoposition.timescale import Epoch

ARCSEC_RAD = float(np.pi / 648000.0)
_DOUBTFUL = 0.5
"""Share of the turn by which star and gyro may differ without a word."""


@dataclass(frozen=True, slots=True)
class Sources:
    """Where the telemetry lies and how it is to be read, as the command line says it."""

    star: Path | None = None
    gyro: Path | None = None
    mounting: Path | None = None
    columns: Path | None = None
    gyro_columns: Path | None = None
    preset: str | None = None
    sensors: Sequence[str] | None = None
    star_sigma_arcsec: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """Star samples, gyro where asked for, mounting; `facts` say what was done on the way."""

    star: StarSeries
    gyro: GyroSeries | None
    mounting: Mounting
    sigma_stated: bool
    epoch: Epoch | None
    facts: dict[str, object]

    @property
    def need_gyro(self) -> GyroSeries:
        """The gyro of a command that reads one."""
        assert self.gyro is not None
        return self.gyro


def load(sources: Sources) -> Telemetry:
    """Read star samples and, where named, the gyro; spans that never overlap are refused."""
    assert sources.star is not None
    columns = column_map(sources.columns, sources.preset)
    installed = open_mounting(sources.mounting)
    table = open_star(sources.star, columns)
    star, facts = _without_duplicates(_only(table.series, sources))
    stated = table.sigma_stated
    if sources.star_sigma_arcsec is not None:
        star, stated = _with_sigma(star, sources.star_sigma_arcsec), True
    facts |= mounting_facts(installed)
    if table.made:
        facts["made_samples_left_out"] = table.made
    gyro = None
    if sources.gyro is not None:
        gyro_map = columns
        if sources.gyro_columns is not None:
            gyro_map = column_map(sources.gyro_columns)
        gyro = open_gyro(sources.gyro, gyro_map, installed.mounting, table.epoch).series
        _overlap(sources, star, gyro)
    return Telemetry(star, gyro, installed.mounting, stated, table.epoch, facts)


def mounting_facts(installed: MountingFile) -> dict[str, object]:
    """How far the given mounting matrices were from rotations, if any were given."""
    if not installed.matrix_error:
        return {}
    return {"mounting_matrix_error": dict(installed.matrix_error)}


def spans(star: StarSeries, gyro: GyroSeries | None = None) -> dict[str, object]:
    """Return counts and spans, for the closing word."""
    facts: dict[str, object] = {
        "star_samples": len(star),
        "heads": list(star.heads),
        "star_span_s": [float(star.times_s[0]), float(star.times_s[-1])],
    }
    if gyro is not None:
        facts["gyro_samples"] = len(gyro)
        facts["gyro_kind"] = gyro.kind
        facts["gyro_span_s"] = [float(gyro.times_s[0]), float(gyro.times_s[-1])]
    return facts


def _only(star: StarSeries, sources: Sources) -> StarSeries:
    """Keep the heads that were asked for."""
    if not sources.sensors:
        return star
    unknown = [name for name in sources.sensors if name not in star.heads]
    if unknown:
        raise ArgumentError(
            f"--sensor: one of {', '.join(star.heads)} expected, got {unknown[0]!r}"
        )
    wanted = tuple(name for name in star.heads if name in sources.sensors)
    kept = star.where(np.isin(star.head, [star.heads.index(name) for name in wanted]))
    head = np.array([wanted.index(star.heads[k]) for k in kept.head], dtype=np.int64)
    head.setflags(write=False)
    return replace(kept, head=head, heads=wanted)


def _without_duplicates(star: StarSeries) -> tuple[StarSeries, dict[str, object]]:
    """Drop repetitions of a head's sample: the same measurement must not count twice."""
    keep = np.ones(len(star), dtype=np.bool_)
    for head in range(len(star.heads)):
        rows = np.flatnonzero(star.head == head)
        keep[rows[1:][np.diff(star.times_s[rows]) == 0.0]] = False
    if keep.all():
        return star, {}
    return star.where(keep), {"duplicates_dropped": int(np.sum(~keep))}


def _with_sigma(star: StarSeries, sigma_arcsec: tuple[float, float]) -> StarSeries:
    cross, bore = (value * ARCSEC_RAD for value in sigma_arcsec)
    return StarSeries.of(star.times_s, star.quat_xyzw, cross, bore, star.head, star.heads)


def _overlap(sources: Sources, star: StarSeries, gyro: GyroSeries) -> None:
    first, last = gyro.times_s[0], gyro.times_s[-1]
    if not np.any((star.times_s >= first) & (star.times_s <= last)):
        raise ProductError(
            str(sources.star), "",
            f"star samples ({star.times_s[0]:.3f} .. {star.times_s[-1]:.3f} s) that overlap the "
            f"gyro's {first:.3f} .. {last:.3f} s in {sources.gyro} expected",
        )  # fmt: skip


def agree(telemetry: Telemetry) -> dict[str, object]:
    """Refuse star and gyro of contradicting conventions; a lesser doubt becomes a warning."""
    from geoposition.sensors.attitude_determination.checks.convention_check import check_conventions

    found = check_conventions(telemetry.star, telemetry.need_gyro, telemetry.mounting)
    if found.message:
        raise GeometryError(f"{found.message} (see --columns and --mounting)")
    if found.as_given > _DOUBTFUL:
        share = f"{100.0 * found.as_given:.0f} %"
        return {"warning": f"star and gyro differ by {share} of the turn: check mounting and times"}
    return {}


def named(error: Exception, sources: Sources) -> ProductError:
    """Name the star file in a refusal that the numbers caused."""
    return ProductError(str(sources.star), "", str(error))
