"""Raw star telemetry to a series that filters can take: cleaned, filled, every sample flagged.

Telemetry comes with repeated rows, times that go back, zeros, broken words and blunders. Rows
that say nothing new are dropped; broken ones and blunders are replaced by the local model of the
motion and short gaps filled with it, flagged so that a fusion can leave them out. *Source*:
T 2.3.3, with sliding windows in place of one quadratic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geoposition.arrays import BoolArray, FlagArray, FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.rotation import continuous_quat
from geoposition.sensors.attitude_determination.checks.outliers import (
    MotionModel,
    OutlierSettings,
    model_motion,
)
from geoposition.sensors.attitude_determination.checks.time_order import forward_rows
from geoposition.sensors.telemetry import StarSeries

_UNIT_TOLERANCE: Final = 1e-3
_GAP_STEPS: Final = 1.5
_USUAL_QUANTILE: Final = 0.9
"""Steps longer than so many of the 0.9 quantile hide a sample: steps may alternate by two."""
_LONGEST_GAP_STEPS: Final = 10.0


class SampleFlag(IntEnum):
    """What became of one sample."""

    OK = 0
    DUPLICATE = 1
    """Dropped: the head has a sample of this time already."""
    BACKWARDS = 2
    """Dropped: its time contradicts the others' order, or is no time at all."""
    BROKEN = 3
    """Not a unit quaternion; replaced by the model, or dropped where there is none."""
    OUTLIER_REPLACED = 4
    """Far from the motion of its neighbours, and replaced by it."""
    GAP = 5
    """Not sent; filled with the model."""


_LABELS: Final = np.array([flag.name.lower() for flag in SampleFlag])


def sample_flag_labels(flags: FlagArray) -> NDArray[np.str_]:
    """Lower-case names of `flags`, as tables print them."""
    labels: NDArray[np.str_] = _LABELS[flags]
    return labels


@dataclass(frozen=True, slots=True)
class PreprocessSettings:
    """How samples are judged (`outliers`) and which gaps are filled.

    Gaps up to `longest_gap_s` (None: ten usual steps) are filled at the usual step; 0 fills none.
    """

    outliers: OutlierSettings = field(default_factory=OutlierSettings)
    longest_gap_s: float | None = None

    def __post_init__(self) -> None:
        if self.longest_gap_s is not None and not 0.0 <= self.longest_gap_s < np.inf:
            raise ArgumentError("preprocess: the longest gap to fill must not be negative")


@dataclass(frozen=True, slots=True, eq=False)
class Preprocessed:
    """The cleaned series, and what was done to it.

    `flag` (m,) and `row` (m,) belong to the samples of `star`: `row` is the input row each stands
    for, −1 where a gap was filled. `input_flag` (n,) says what became of every input row.
    `counts` holds, by head, how many had each flag's name, and `sign_flip`; `noise_rad` (3,), by
    head, is the scatter about the sensor's axes, NaN where too few samples tell.
    """

    star: StarSeries
    flag: FlagArray
    row: IntArray
    input_flag: FlagArray
    counts: Mapping[str, Mapping[str, int]]
    noise_rad: Mapping[str, FloatArray]

    @property
    def measured(self) -> StarSeries:
        """Only the samples that were measured and found good: what a fusion should use."""
        return self.star.where(self.flag == SampleFlag.OK)


def preprocess(
    times_s: ArrayLike,
    quat_xyzw: ArrayLike,
    sigma_cross_rad: ArrayLike,
    sigma_bore_rad: ArrayLike | None = None,
    head: ArrayLike = 0,
    heads: tuple[str, ...] = ("star",),
    settings: PreprocessSettings | None = None,
) -> Preprocessed:
    """Clean raw samples (n,) of one or several heads, in the order they came down.

    Anything may be wrong with single rows; an `ArgumentError` is raised if most of a head's
    quaternions are not unit (then the columns are wrong) or if nothing is left.
    """
    times = np.asarray(times_s, dtype=np.float64)
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    n = len(times) if times.ndim == 1 else 0
    if n == 0 or quat.shape != (n, 4):
        raise ArgumentError("star samples: times (n,) and quaternions (n, 4) expected, n > 0")
    index = np.broadcast_to(np.asarray(head, dtype=np.int64), (n,))
    if index.min() < 0 or index.max() >= len(heads):
        raise ArgumentError(f"star samples: head indices 0 .. {len(heads) - 1} expected")
    bore = sigma_cross_rad if sigma_bore_rad is None else sigma_bore_rad
    sigma = np.stack(
        [np.broadcast_to(np.asarray(s, dtype=np.float64), (n,)) for s in (sigma_cross_rad, bore)],
        axis=1,
    )
    if not (np.all(np.isfinite(sigma)) and np.all(sigma > 0.0)):
        raise ArgumentError("star samples: positive finite noise expected")
    chosen = settings or PreprocessSettings()
    parts = []
    for number, name in enumerate(heads):
        rows = np.flatnonzero(index == number)
        if len(rows):
            parts.append(_clean_head(name, number, times, quat, sigma, rows, chosen))
    return _joined(parts, heads, n)


@dataclass(frozen=True, slots=True, eq=False)
class _Head:
    """Cleaned samples of one head, and the flags of its input rows."""

    name: str
    number: int
    times_s: FloatArray
    quat_xyzw: FloatArray
    sigma_rad: FloatArray
    flag: FlagArray
    row: IntArray
    input_rows: IntArray
    input_flag: FlagArray
    sign_flips: int
    noise_rad: FloatArray


def _clean_head(
    name: str,
    number: int,
    times: FloatArray,
    quat: FloatArray,
    sigma: FloatArray,
    rows: IntArray,
    settings: PreprocessSettings,
) -> _Head:
    input_flag = np.zeros(len(rows), dtype=np.uint8)
    unit = _unit(quat[rows])
    _refuse_wrong_columns(name, quat[rows], unit)
    forward, duplicate = forward_rows(times[rows], unit)
    input_flag[~forward] = SampleFlag.BACKWARDS
    input_flag[duplicate] = SampleFlag.DUPLICATE
    kept = np.flatnonzero(forward)
    t, broken = times[rows][kept], ~unit[kept]
    if np.all(broken):
        raise ArgumentError(f"star head {name!r}: no usable sample")
    good = np.flatnonzero(~broken)
    q = quat[rows][kept]
    with np.errstate(invalid="ignore", divide="ignore"):
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
    flips = int(np.sum(np.einsum("ij,ij->i", q[good][1:], q[good][:-1]) < 0.0))
    model = model_motion(t[good], q[good], sigma[rows][kept][good].mean(axis=0), settings.outliers)
    flag = np.zeros(len(kept), dtype=np.uint8)
    flag[good[model.outlier]] = SampleFlag.OUTLIER_REPLACED
    flag[broken] = SampleFlag.BROKEN
    input_flag[kept] = flag
    extra = _missing(t, settings.longest_gap_s)
    row = np.concatenate([rows[kept], np.full(len(extra), -1)])
    all_sigma = np.concatenate(
        [sigma[rows][kept], np.broadcast_to(np.median(sigma[rows], axis=0), (len(extra), 2))]
    )
    all_times = np.concatenate([t, extra])
    all_flags = np.concatenate([flag, np.full(len(extra), SampleFlag.GAP, dtype=np.uint8)])
    all_quats = np.concatenate([q, np.full((len(extra), 4), np.nan)])
    replaced = all_flags != SampleFlag.OK
    all_quats[replaced] = _modelled(model, all_times[replaced])
    usable = np.isfinite(all_quats[:, 0])
    order = np.flatnonzero(usable)[np.argsort(all_times[usable], kind="stable")]
    return _Head(
        name,
        number,
        all_times[order],
        continuous_quat(all_quats[order]),
        all_sigma[order],
        all_flags[order],
        row[order],
        rows,
        input_flag,
        flips,
        model.noise_rad,
    )


def _unit(quat: FloatArray) -> BoolArray:
    with np.errstate(invalid="ignore", over="ignore"):
        norm = np.linalg.norm(quat, axis=1)
        return np.asarray(np.isfinite(norm) & (np.abs(norm - 1.0) <= _UNIT_TOLERANCE))


def _refuse_wrong_columns(name: str, quat: FloatArray, unit: BoolArray) -> None:
    filled = np.isfinite(quat).all(axis=1) & np.any(quat != 0.0, axis=1)
    wrong = filled & ~unit
    if 2 * np.sum(wrong) > np.sum(filled) > 0:
        norm = float(np.median(np.linalg.norm(quat[wrong], axis=1)))
        raise ArgumentError(
            f"star head {name!r}: {100.0 * np.mean(wrong):.0f} % of the quaternions are not unit "
            f"(norm {norm:.4g}): are these the right columns?"
        )


def _missing(times: FloatArray, longest_s: float | None) -> FloatArray:
    """Epochs at which samples seem to have been lost, at the usual step."""
    steps = np.diff(times)
    if len(steps) < 4:
        return np.empty(0)
    usual = float(np.quantile(steps, _USUAL_QUANTILE))
    step = float(np.median(steps))
    longest = _LONGEST_GAP_STEPS * step if longest_s is None else longest_s
    gaps = np.flatnonzero((steps > _GAP_STEPS * usual) & (steps <= longest))
    filled = [np.empty(0)]
    for gap in gaps:
        count = round(steps[gap] / step)
        filled.append(times[gap] + np.arange(1, count) * (steps[gap] / count))
    return np.concatenate(filled)


def _modelled(model: MotionModel, times: FloatArray) -> FloatArray:
    known, rotations = model.at(times)
    quats = np.full((len(times), 4), np.nan)
    quats[known] = rotations.as_quat()
    return quats


def _joined(parts: list[_Head], heads: tuple[str, ...], n: int) -> Preprocessed:
    times = np.concatenate([part.times_s for part in parts])
    number = np.concatenate([np.full(len(part.times_s), part.number) for part in parts])
    order = np.lexsort((number, times))
    quat = np.concatenate([part.quat_xyzw for part in parts])[order]
    sigma = np.concatenate([part.sigma_rad for part in parts])[order]
    star = StarSeries.of(times[order], quat, sigma[:, 0], sigma[:, 1], number[order], heads)
    flag = np.concatenate([part.flag for part in parts])[order]
    row = np.concatenate([part.row for part in parts])[order]
    input_flag = np.zeros(n, dtype=np.uint8)
    counts = {}
    for part in parts:
        input_flag[part.input_rows] = part.input_flag
        found = {label.name.lower(): int(np.sum(part.input_flag == label)) for label in SampleFlag}
        found["gap"] = int(np.sum(part.flag == SampleFlag.GAP))
        counts[part.name] = found | {"sign_flip": part.sign_flips}
    for array in (flag, row, input_flag):
        array.setflags(write=False)
    noise = {part.name: part.noise_rad for part in parts}
    return Preprocessed(star, flag, row, input_flag, counts, noise)
