"""Attitude from direction tables, epoch by epoch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import GeometryError
from geoposition.flags import Flag, flag_labels, has_result
from geoposition.scripts.attitude.input import ARCSEC_RAD, mounting_facts
from geoposition.scripts.point_tables import flag_counts
from geoposition.sensors.attitude_determination.static.methods import (
    StaticAttitude,
    StaticMethod,
    solve,
)
from geoposition.sensors.readers.telemetry_source import open_mounting
from geoposition.sensors.readers.vector_table import VectorTable, read_vectors
from geoposition.sensors.writers.table_file import Column


@dataclass(frozen=True, slots=True, eq=False)
class StaticRun:
    """Attitudes (k,) of the epochs `times_s` (k,); `facts` say how they came about."""

    times_s: FloatArray
    attitude: StaticAttitude
    facts: dict[str, object]

    @property
    def sigma_rad(self) -> FloatArray:
        """Standard deviations (k, 3) about the body's axes."""
        variance = np.einsum("nii->ni", self.attitude.covariance_rad2)
        sigma: FloatArray = np.sqrt(variance)
        return sigma

    def columns(self) -> dict[str, Column]:
        """Columns of the table to write."""
        found = self.attitude
        columns: dict[str, Column] = {"t_s": np.asarray(self.times_s)}
        quat = np.array(found.quat_xyzw)
        columns |= {f"q_{axis}": quat[:, k] for k, axis in enumerate("xyzw")}
        columns |= {f"sigma_{axis}_rad": self.sigma_rad[:, k] for k, axis in enumerate("xyz")}
        columns["loss"] = np.asarray(found.loss)
        columns["vectors"] = np.asarray(found.vectors, dtype=np.int64)
        columns["flag"] = flag_labels(found.flag)
        return columns

    def summary(self) -> dict[str, object]:
        """Return counts, median sigmas, and whether the losses fit the stated noise."""
        found = self.attitude
        good = found.flag == Flag.OK
        freedom = 2.0 * found.vectors[good].astype(np.float64) - 3.0
        return {
            **self.facts,
            "epochs": len(self.times_s),
            "flags": flag_counts(found.flag),
            "sigma_arcsec": dict(
                zip("xyz", (np.median(self.sigma_rad[good], axis=0) / ARCSEC_RAD).tolist(),
                    strict=True)
            ),
            "loss_per_freedom": float(np.sum(found.loss[good]) / max(float(freedom.sum()), 1.0)),
        }  # fmt: skip


def determine(path: Path, mounting: Path | None, method: StaticMethod) -> StaticRun:
    """Solve all epochs of a VECTORS table; none with an attitude is an error."""
    installed = None if mounting is None else open_mounting(mounting)
    table = read_vectors(path, None if installed is None else installed.mounting)
    found = solve(method, *_by_epoch(table))
    if not np.any(has_result(found.flag)):
        reasons = ", ".join(f"{n} {name}" for name, n in flag_counts(found.flag).items())
        raise GeometryError(f"{path}: no epoch has an attitude ({reasons}); nothing is written")
    facts: dict[str, object] = {"method": method, "vectors": len(table.sigma_rad)}
    if installed is not None:
        facts |= mounting_facts(installed)
    return StaticRun(table.times_s, found, facts)


def _by_epoch(table: VectorTable) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Vectors (k, m, 3) and their noise (k, m) of k epochs; NaN where an epoch has fewer."""
    count = np.diff(table.first)
    epochs, most = len(count), int(count.max())
    epoch = np.repeat(np.arange(epochs), count)
    place = np.arange(len(epoch)) - np.repeat(table.first[:-1], count)
    body, reference = np.full((2, epochs, most, 3), np.nan)
    sigma = np.full((epochs, most), np.nan)
    body[epoch, place] = table.body
    reference[epoch, place] = table.reference
    sigma[epoch, place] = table.sigma_rad
    return body, reference, sigma
