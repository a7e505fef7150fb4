"""T tables 5.2 to 5.4: ours, the thesis's and the limit, from the runs' check points.

A figure is the mean over the runs of what one run says, as T's come from one scene; `pooled` is
the root mean square over all runs' points, which is what a limit speaks of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.scripts.experiments.thesis.control import BIAS_MODELS, BiasModel, Errors, Limit
from geoposition.scripts.experiments.thesis.fusion import KINDS, Kind
from geoposition.scripts.experiments.thesis.numerical import BIAS_MODEL, Numerical, RunResult

Spread: TypeAlias = tuple[float, float, float]
"""Smallest error, largest error, root mean square: the columns of T table 5.4."""

AXES: Final = ("X", "Y", "Z", "E", "N", "U")
THESIS_BEFORE: Final = {"X": 11.367, "Y": 7.536, "Z": 12.940}
"""T table 5.2, with the agency's attitude."""
THESIS_AFTER: Final = {"X": 6.615, "Y": 3.744, "Z": 6.029}
"""T table 5.3, with the agency's attitude."""
THESIS_SPREAD: Final[Mapping[tuple[str, Kind], Spread]] = {
    ("X", "raw"): (0.281, 19.712, 8.254),
    ("X", "fused"): (0.052, 12.742, 6.631),
    ("X", "true"): (0.101, 12.640, 6.615),
    ("Y", "raw"): (0.033, 25.438, 10.349),
    ("Y", "fused"): (0.078, 9.050, 3.765),
    ("Y", "true"): (0.038, 9.093, 3.744),
    ("Z", "raw"): (0.151, 28.982, 10.111),
    ("Z", "fused"): (0.245, 18.220, 6.093),
    ("Z", "true"): (0.103, 18.007, 6.029),
}
"""T table 5.4; "true" is the agency's attitude there."""


@dataclass(frozen=True, slots=True)
class AxisRow:
    """One axis with one attitude: `ours` and `scatter` (of the runs' RMSE) before or after."""

    table: str
    axis: str
    attitude: Kind
    ours: Spread
    scatter: float
    limit: float | None
    thesis: Spread | None


@dataclass(frozen=True, slots=True)
class SpaceRow:
    """RMSE in space with one attitude, metres: mean and scatter over the runs, pooled.

    `stated` is what the adjustments say of themselves.
    """

    attitude: Kind
    bias_model: BiasModel
    runs: int
    before: float
    after: float
    scatter: float
    pooled: float
    stated: float
    limit: float | None


@dataclass(frozen=True, slots=True)
class AttitudeRow:
    """Attitude errors over an image, arcsec, roll, pitch, yaw: RMS of means, RMS of wander."""

    attitude: Kind
    mean: Spread
    wander: Spread


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """All of the numerical chain."""

    runs: int
    control: int
    check: int
    axes: tuple[AxisRow, ...]
    space: tuple[SpaceRow, ...]
    others: tuple[SpaceRow, ...]
    attitude: tuple[AttitudeRow, ...]
    limit_m: float
    three_line: Limit

    def row(self, kind: Kind) -> SpaceRow:
        """Row in space of one attitude."""
        return next(row for row in self.space if row.attitude == kind)

    def of_table(self, table: str) -> list[AxisRow]:
        """Rows of a table, by the thesis's number."""
        return [row for row in self.axes if row.table == table]

    @property
    def passed(self) -> dict[str, bool]:
        """What has to be shown."""
        raw, fused, true = (self.row(kind).after for kind in KINDS)
        pooled = self.row("fused").pooled
        return {
            "raw > fused >= true": raw > fused >= true,
            "fused within 5 % of true": fused <= 1.05 * true,
            "fused within 10 % of the limit": abs(pooled / self.limit_m - 1.0) <= 0.10,
        }

    def as_json(self) -> dict[str, Any]:
        """Return the contract's keys, and every table."""
        before = {row.attitude: row.before for row in self.space}
        return {
            "runs": self.runs,
            "points": {"control": self.control, "check": self.check},
            "bias_model": BIAS_MODEL,
            "checkpoint_rmse_m": {
                **{row.attitude: row.after for row in self.space},
                "before": before,
                "axes": self._axes("5.4"),
            },
            "before": {"checkpoint_rmse_m": before, "axes": self._axes("5.2")},
            "limit_m": self.limit_m,
            "three_line_limit_m": self.three_line.space_m,
            "must_show": self.passed,
            "tables": {
                **{
                    name: [asdict(row) for row in self.of_table(name)]
                    for name in ("5.2", "5.3", "5.4")
                },
                "space": [asdict(row) for row in self.space],
                "bias models": [asdict(row) for row in self.others],
                "attitude over an image": [asdict(row) for row in self.attitude],
            },
        }

    def _axes(self, table: str) -> dict[str, dict[str, float]]:
        found: dict[str, dict[str, float]] = {kind: {} for kind in KINDS}
        for row in self.of_table(table):
            found[row.attitude][row.axis.lower()] = row.ours[2]
        return found


def tables_of(done: Numerical) -> Tables:
    """Make all tables."""
    limit = done.limits[BIAS_MODEL]
    errors = {kind: [run.errors[kind] for run in done.runs] for kind in KINDS}
    rows = []
    for kind in KINDS:
        rows += _axis_rows("5.2", kind, errors[kind], 0, None)
        rows += _axis_rows("5.4", kind, errors[kind], 1, limit)
    rows += [_as_5_3(row) for row in rows if row.table == "5.4" and row.attitude == "true"]
    tried = [run for run in done.runs if run.others]
    others = [
        _space_row(kind, bias, [run.others[kind, bias] for run in tried], done.limits.get(bias))
        for kind in KINDS
        for bias in BIAS_MODELS
        if (kind, bias) in tried[0].others
    ]
    return Tables(
        len(done.runs),
        int(done.plan.is_control.sum()),
        int((~done.plan.is_control).sum()),
        tuple(rows),
        tuple(_space_row(kind, BIAS_MODEL, errors[kind], limit) for kind in KINDS),
        tuple(others),
        tuple(_attitude_row(kind, done.runs) for kind in KINDS),
        limit.space_m,
        done.three_line,
    )


def _axis_rows(
    table: str, kind: Kind, errors: Sequence[Errors], stage: int, limit: Limit | None
) -> list[AxisRow]:
    both = np.array(
        [np.concatenate([e.xyz_m[stage], e.enu_m[stage]], axis=1) for e in errors]
    )  # runs, points, axes
    size = np.abs(both)
    rmse = np.sqrt(np.mean(both**2, axis=1))
    limits = None if limit is None else np.concatenate([limit.xyz_m, limit.enu_m])
    rows = []
    for k, axis in enumerate(AXES):
        thesis = THESIS_SPREAD.get((axis, kind))
        if table == "5.2":
            value = THESIS_BEFORE.get(axis) if kind == "true" else None
            thesis = None if value is None else (float("nan"), float("nan"), value)
        ours = (
            float(size[:, :, k].min(axis=1).mean()),
            float(size[:, :, k].max(axis=1).mean()),
            float(rmse[:, k].mean()),
        )
        at = None if limits is None else float(limits[k])
        rows.append(AxisRow(table, axis, kind, ours, float(rmse[:, k].std()), at, thesis))
    return rows


def _as_5_3(row: AxisRow) -> AxisRow:
    value = THESIS_AFTER.get(row.axis)
    thesis = None if value is None else (float("nan"), float("nan"), value)
    return AxisRow("5.3", row.axis, row.attitude, row.ours, row.scatter, row.limit, thesis)


def _space_row(
    kind: Kind, bias: BiasModel, errors: Sequence[Errors], limit: Limit | None
) -> SpaceRow:
    squares = np.array([np.mean(np.sum(e.enu_m**2, axis=2), axis=1) for e in errors])
    rmse: FloatArray = np.sqrt(squares)
    stated = np.array([np.sum(e.expected_enu_m2) for e in errors])
    return SpaceRow(
        kind,
        bias,
        len(errors),
        float(rmse[:, 0].mean()),
        float(rmse[:, 1].mean()),
        float(rmse[:, 1].std()),
        float(np.sqrt(squares[:, 1].mean())),
        float(np.sqrt(stated.mean())),
        None if limit is None else limit.space_m,
    )


def _attitude_row(kind: Kind, runs: Sequence[RunResult]) -> AttitudeRow:
    found = []
    for name in ("mean_arcsec", "wander_arcsec"):
        values = np.array([getattr(run.attitude[kind], name) for run in runs])
        roll, pitch, yaw = np.sqrt(np.mean(values**2, axis=(0, 1))).tolist()
        found.append((roll, pitch, yaw))
    return AttitudeRow(kind, found[0], found[1])
