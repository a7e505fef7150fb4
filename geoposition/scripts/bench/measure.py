"""Interleaved timing of contenders that do the same work, after their results were compared."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.scripts.bench.machine import PeakMemory


@dataclass(frozen=True, slots=True)
class Contender:
    """One implementation: `run` is what is timed, `result` makes its answer comparable.

    It answers the points `rows` of its case; `result` gives them as ECEF metres (n, 3), image
    points (n, 2) = (line, sample), or whatever else the contenders of a case agree on, (n, k).
    """

    name: str
    rows: slice
    run: Callable[[], Any]
    result: Callable[[Any], FloatArray]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Missing:
    """A peer that could not take part, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Case:
    """One piece of work: ours first, then the peers.

    `unit` is that of the results. Peers of which more than 1 - `share` of the points are further
    than `tolerance` from ours do not do the same work and are not timed. `bytes_per_point` go to
    and from memory at the least.
    """

    key: str
    title: str
    points: int
    unit: str
    tolerance: float
    ours: Contender
    peers: Sequence[Contender | Missing] = ()
    target_mpoint_s: float | None = None
    bytes_per_point: int = 0
    share: float = 1.0


@dataclass(frozen=True, slots=True)
class Spread:
    """Smallest, middle and largest of several measurements."""

    low: float
    median: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float] | FloatArray) -> Spread:
        """Spread of `values`."""
        array = np.asarray(values, dtype=np.float64)
        return cls(float(array.min()), float(np.median(array)), float(array.max()))


@dataclass(frozen=True, slots=True)
class Row:
    """What was measured of one contender; `reason` where nothing could be.

    `mpoint_s` is by the clock, `mpoint_core_s` by the processor time of all threads; `ratio` and
    `ratio_core` are ours over theirs by either, repetition by repetition. `difference` is the
    largest from ours over the `compared` points that both answer (the case's `share` of them);
    `peak_bytes` what the call needed beyond what was there, its result included.
    """

    name: str
    reason: str = ""
    note: str = ""
    points: int = 0
    mpoint_s: Spread | None = None
    mpoint_core_s: Spread | None = None
    ratio: Spread | None = None
    ratio_core: Spread | None = None
    difference: float | None = None
    compared: int = 0
    peak_bytes: float | None = None


@dataclass(slots=True)
class CaseResult:
    """The rows of one case, ours first."""

    case: Case
    rows: list[Row] = field(default_factory=list)

    @property
    def met(self) -> bool | None:
        """Whether the best repetition reached the target, if there is one."""
        ours = self.rows[0].mpoint_s
        if self.case.target_mpoint_s is None or ours is None:
            return None
        return ours.high >= self.case.target_mpoint_s


def measure(case: Case, repeats: int) -> CaseResult:
    """Compare the results, then time all contenders in turn, `repeats` times."""
    result = CaseResult(case)
    reference, ours = _first(case, case.ours, None)
    result.rows.append(ours)
    takers = [case.ours]
    for peer in case.peers:
        if isinstance(peer, Missing):
            result.rows.append(Row(peer.name, reason=peer.reason))
            continue
        try:
            _, row = _first(case, peer, reference)
        except Exception as error:  # a peer's failure is its row, not the end of the run
            row = Row(peer.name, reason=f"failed: {type(error).__name__}: {_short(error)}")
        result.rows.append(row)
        if not row.reason:
            takers.append(peer)
    wall = {taker.name: np.empty(repeats) for taker in takers}
    cpu = {taker.name: np.empty(repeats) for taker in takers}
    for repeat in range(repeats):
        for taker in takers:
            begin, begin_cpu = time.perf_counter(), time.process_time()
            taker.run()
            cpu[taker.name][repeat] = max(time.process_time() - begin_cpu, 1e-9)
            wall[taker.name][repeat] = time.perf_counter() - begin
    mega = {row.name: row.points / 1e6 for row in result.rows}
    rate_ours = mega[case.ours.name] / wall[case.ours.name]
    core_ours = mega[case.ours.name] / cpu[case.ours.name]
    for index, row in enumerate(result.rows):
        if row.reason:
            continue
        rate, core = mega[row.name] / wall[row.name], mega[row.name] / cpu[row.name]
        result.rows[index] = Row(
            name=row.name,
            note=row.note,
            points=row.points,
            mpoint_s=Spread.of(rate),
            mpoint_core_s=Spread.of(core),
            ratio=Spread.of(rate_ours / rate) if index else None,
            ratio_core=Spread.of(core_ours / core) if index else None,
            difference=row.difference,
            compared=row.compared,
            peak_bytes=row.peak_bytes,
        )
    return result


def _first(
    case: Case, contender: Contender, reference: FloatArray | None
) -> tuple[FloatArray, Row]:
    """Run once to compile, once for the memory, and compare with ours."""
    points = len(range(*contender.rows.indices(case.points)))
    contender.run()
    with PeakMemory() as peak:
        raw = contender.run()
    answer = contender.result(raw)
    del raw
    if answer.shape[0] != points:
        reason = f"answered {answer.shape[0]} of {points} points"
        return answer, Row(contender.name, reason=reason)
    difference, compared, reason = None, 0, ""
    if reference is not None:
        expected = reference[contender.rows]
        apart = np.linalg.norm(answer - expected, axis=-1)
        both = np.isfinite(apart)
        either = np.isfinite(answer).all(axis=-1) | np.isfinite(expected).all(axis=-1)
        compared = int(both.sum())
        worst = np.quantile(apart[both], case.share) if compared else np.nan
        difference = float(worst)
        if compared < 0.9 * either.sum():
            reason = f"not the same work: only {compared} of {either.sum()} points in common"
        elif not difference <= case.tolerance:
            reason = f"not the same work: {difference:.3g} {case.unit} from ours"
    row = Row(
        contender.name,
        reason=reason,
        note=contender.note,
        points=points,
        difference=difference,
        compared=compared,
        peak_bytes=peak.bytes,
    )
    return answer, row


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120]


def best_rate(run: Callable[[], Any], points: int, repeats: int) -> float:
    """Largest rate in Mpoint/s of `repeats` calls, after one to warm up."""
    run()
    best = 0.0
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        best = max(best, points / 1e6 / (time.perf_counter() - begin))
    return best
