"""Pre-processing of star telemetry as the command line asks for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geoposition.errors import ArgumentError, ProductError
from geoposition.scripts.attitude.input import ARCSEC_RAD
from geoposition.sensors.attitude_determination.checks.outliers import OutlierSettings
from geoposition.sensors.attitude_determination.checks.preprocess import (
    Preprocessed,
    PreprocessSettings,
    preprocess,
    sample_flag_labels,
)
from geoposition.sensors.readers import gracefo
from geoposition.sensors.readers.attitude_columns import ColumnMap, column_map
from geoposition.sensors.readers.attitude_tables import UNKNOWN_SIGMA_RAD, read_raw_star
from geoposition.sensors.readers.telemetry_source import open_star
from geoposition.sensors.writers.attitude_table import star_columns
from geoposition.sensors.writers.table_file import Column


def clean(
    path: Path,
    columns: Path | None,
    preset: str | None,
    threshold: float,
    window_s: float | None,
    degree: int,
    longest_gap_s: float | None,
    seed: int,
) -> Preprocessed:
    """Read raw samples and clean them."""
    settings = PreprocessSettings(
        OutlierSettings(threshold, degree, window_s, seed=seed), longest_gap_s
    )
    known = column_map(columns, preset)
    try:
        if gracefo.product_kind(path) is not None:
            series = open_star(path, known).series
            return preprocess(
                series.times_s, series.quat_xyzw, series.sigma_cross_rad, series.sigma_bore_rad,
                series.head, series.heads, settings,
            )  # fmt: skip
        return _clean_table(path, known, settings)
    except ProductError:
        raise
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from None


def _clean_table(path: Path, known: ColumnMap, settings: PreprocessSettings) -> Preprocessed:
    raw = read_raw_star(path, known)
    cross, bore = raw.sigma_cross_rad, raw.sigma_bore_rad
    if not raw.sigma_stated:
        cross = bore = np.full(len(raw.times_s), UNKNOWN_SIGMA_RAD)
    found = preprocess(raw.times_s, raw.quat_xyzw, cross, bore, raw.head, raw.heads, settings)
    return found


def columns(found: Preprocessed) -> dict[str, Column]:
    """Columns of the cleaned table, with `flag`.

    Where the input stated no noise, or all of it the same placeholder, the sigmas stay out: what
    reads the table then estimates them.
    """
    table = star_columns(found.star)
    if np.all(found.star.sigma_cross_rad == UNKNOWN_SIGMA_RAD):
        del table["sigma_cross_rad"], table["sigma_bore_rad"]
    return {**table, "flag": sample_flag_labels(found.flag)}


def summary(found: Preprocessed) -> dict[str, object]:
    """Return counts by head, and the scatter of the samples about the motion."""
    return {
        "samples_in": len(found.input_flag),
        "samples_out": len(found.star),
        "heads": {name: dict(counts) for name, counts in found.counts.items()},
        "noise_arcsec": {
            name: (noise / ARCSEC_RAD).tolist() for name, noise in found.noise_rad.items()
        },
    }
