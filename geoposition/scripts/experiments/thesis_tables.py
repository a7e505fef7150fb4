"""Rows of T chapter 4's tables, the thesis's own figures, and how rows come from runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.scripts.experiments.monte_carlo import ARCSEC_RAD, DEG_H_RAD_S
from geoposition.sensors.attitude_determination.estimate import STATE_NAMES
from geoposition.sensors.attitude_determination.monte_carlo.batch import Probe
from geoposition.sensors.telemetry import GyroParameters

Axes: TypeAlias = tuple[float, float, float]
"""Roll, pitch, yaw in arcsec: T's Euler angles of a small error are the body's axes."""

PARAMETER_NAMES: Final = tuple(
    f"{name}_deg_h" if name.startswith("bias") else f"{name}_ppm" for name in STATE_NAMES[3:]
)
_UNITS: Final = np.array([DEG_H_RAD_S] * 3 + [1e-6] * 9)

THESIS_RMS: Final[Mapping[str, Axes]] = {
    "4.3 ekf-15": (0.87, 0.87, 0.87),
    "4.5 rts": (0.50, 0.49, 0.50),
    "4.6 ekf-15": (0.72, 0.71, 0.71),
    "4.6 ekf-6": (0.70, 0.71, 0.71),
    "4.7 ekf-15": (0.72, 0.70, 0.72),
    "4.7 ekf-6": (0.70, 0.71, 0.71),
    "4.9 backward ekf-15": (0.86, 0.82, 0.91),
    "4.10 two-filter": (0.47, 0.46, 0.47),
}
THESIS_PARAMETERS: Final[Mapping[str, tuple[float, ...]]] = {
    "4.2": (
        *(0.1196, 0.1253, 0.1257, 1470.0, 957.5, 1434.0),
        *(961.3, 1426.0, 1905.0, 512.9, 982.2, 1431.9),
    ),
    "4.4": (
        *(0.0910, 0.0939, 0.1049, 1492.0, 1002.0, 1498.0),
        *(995.1, 1502.0, 1994.0, 492.5, 998.9, 1493.0),
    ),
    "4.8": (
        *(0.0910, 0.1067, 0.1046, 1497.0, 999.9, 1488.0),
        *(1002.0, 1499.0, 1989.0, 496.5, 993.6, 1495.0),
    ),
}


@dataclass(frozen=True, slots=True)
class RmsRow:
    """One line of a table of attitude errors: RMS over all runs, scatter of the runs' own.

    `expected` is what the method shows on average for this truth, `bound` what none beats.
    """

    table: str
    method: str
    runs: int
    rms: Axes
    scatter: Axes
    thesis: Axes | None
    expected: Axes | None
    bound: Axes | None


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One gyro parameter: `mean` over the runs, stated `sigma` of a run, RMS error `rms`.

    `within_3_sigma` is the share of runs nearer to the truth than that. deg/h or ppm.
    """

    table: str
    name: str
    truth: float
    mean: float
    sigma: float
    rms: float
    within_3_sigma: float
    thesis: float | None


@dataclass(frozen=True, slots=True)
class ConsistencyRow:
    """Mean NEES (15 degrees of freedom) or NIS (3) and its 95 % band, truth from the prior."""

    what: str
    runs: int
    mean: float
    band: tuple[float, float]

    @property
    def inside(self) -> bool:
        """Whether the mean lies in the band."""
        return self.band[0] <= self.mean <= self.band[1]


@dataclass(frozen=True, slots=True)
class ThesisCh4:
    """All tables of T chapter 4; `agreement` is the largest ratio − 1 between two methods."""

    runs: int
    rms: tuple[RmsRow, ...]
    parameters: tuple[ParameterRow, ...]
    consistency: tuple[ConsistencyRow, ...]
    agreement: Mapping[str, float]

    def as_json(self) -> dict[str, Any]:
        """Return the keys of the command's contract and every table by the thesis's number."""
        found = {row.method: row for row in self.rms if row.table in _MAIN}
        tables: dict[str, list[dict[str, Any]]] = {}
        for row in self.rms:
            tables.setdefault(row.table, []).append(asdict(row))
        for line in self.parameters:
            tables.setdefault(line.table, []).append(asdict(line))
        return {
            "runs": self.runs,
            "rms_arcsec": {name: row.rms for name, row in found.items()},
            "bound_arcsec": {name: row.bound for name, row in found.items()},
            "expected_arcsec": {name: row.expected for name, row in found.items()},
            "simple_model_error_arcsec": next(
                row.rms for row in self.rms if row.table == "4.2.1 text"
            ),
            "gyro_parameters": {
                row.name: {"truth": row.truth, "mean": row.mean, "sigma": row.sigma}
                for row in self.parameters
                if row.table == "4.8"
            },
            "consistency": [{**asdict(row), "inside": row.inside} for row in self.consistency],
            "agreement": dict(self.agreement),
            "prior": {"star_arcsec": 6.0, "bias_deg_h": 0.2, "scale_misalignment_ppm": 2000.0},
            "tables": tables,
        }


_MAIN: Final = ("4.3", "4.5", "4.10", "4.6", "graph", "4.6 smoothed")


def axes_arcsec(rms_rad: FloatArray) -> Axes:
    """Three angles in arcsec."""
    roll, pitch, yaw = (float(value) for value in rms_rad / ARCSEC_RAD)
    return roll, pitch, yaw


def rms_row(
    table: str,
    method: str,
    rms_rad: FloatArray,
    expected_rad: FloatArray | None,
    bound_rad: FloatArray | None,
) -> RmsRow:
    """Row of the runs' RMS errors (r, 3); the mean over runs is of squares, as the bound is."""
    return RmsRow(
        table,
        method,
        len(rms_rad),
        axes_arcsec(np.sqrt(np.mean(rms_rad**2, axis=0))),
        axes_arcsec(np.std(rms_rad, axis=0)),
        THESIS_RMS.get(f"{table} {method}"),
        None if expected_rad is None else axes_arcsec(expected_rad),
        None if bound_rad is None else axes_arcsec(bound_rad),
    )


def parameter_rows(table: str, probes: Sequence[Probe], truth: FloatArray) -> list[ParameterRow]:
    """Rows of the gyro parameters estimated at one knot; `truth` (r or 1, 12)."""
    found = np.concatenate([probe.rest for probe in probes]) / _UNITS
    sigmas = np.concatenate(
        [np.sqrt(np.diagonal(p.covariance, axis1=1, axis2=2)[:, 3:]) for p in probes]
    )
    sigmas, true = sigmas / _UNITS, np.broadcast_to(truth / _UNITS, found.shape)
    error = found - true
    return [
        ParameterRow(
            table,
            name,
            float(true[:, i].mean()),
            float(found[:, i].mean()),
            float(sigmas[:, i].mean()),
            float(np.sqrt(np.mean(error[:, i] ** 2))),
            float(np.mean(np.abs(error[:, i]) <= 3.0 * sigmas[:, i])),
            THESIS_PARAMETERS[table][i] if table in THESIS_PARAMETERS else None,
        )
        for i, name in enumerate(PARAMETER_NAMES)
    ]


def parameter_vector(parameters: GyroParameters) -> FloatArray:
    """Bias, scale, upper, lower (12,)."""
    return np.concatenate(
        [parameters.bias_rad_s, parameters.scale, parameters.upper, parameters.lower]
    )


def apart(one: FloatArray, other: FloatArray) -> float:
    """Largest ratio − 1 between the runs' RMS errors (r, 3) by two methods."""
    return float(np.max(np.abs(one / other - 1.0)))
