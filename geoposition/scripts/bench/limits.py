"""How fast a case could be at most on a machine: its memory, or its arithmetic.

The arithmetic of a point is counted low: only what any way to the same answer must do, each
square root, division or trigonometric function as one operation. What is measured against it is
the product of matrices, which keeps all units of the processor busy all the time. No program
reaches either limit; how far one is from the nearer of the two says what is left to gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from geoposition.scripts.bench.measure import Case

_POLYNOMIALS: Final = 16 + 4 * 2 * 20 + 12
"""An RPC's value: 16 products of the variables, four sums of 20 terms, the scales."""
_LOCATE: Final = 2 * _POLYNOMIALS + 2 * 2 * 2 * 20
"""The way back: its start, one Newton step with the derivatives by two variables."""
_LOOK: Final = 8 * (7 + 6) + 60 + 10 + 30 + 60
"""A rigorous line of sight: position from 8 states, quaternion, look, rotation, corrections."""
_GEODETIC: Final = 80
"""Intersection with an ellipsoid at a height, longitude, latitude and height of it."""
_FILTER_6: Final = 2 * 2 * 6**3
"""Covariance of six states carried by one step."""
_PATCH: Final = 64 * 64

FLOP: Final[dict[str, float]] = {
    "direct": _LOOK + _GEODETIC,
    "inverse": 2 * _LOOK,  # where it is, and the residual there
    "dem": _LOOK + _GEODETIC + 20,
    "rpc-project": _POLYNOMIALS,
    "rpc-locate": _LOCATE,
    "rpc-dem": _LOCATE + 20,
    "pair-rays": 60 + _GEODETIC,
    "pair": 4 * _LOCATE + 60 + _GEODETIC,  # two points define a ray
    "pair-covariance": 4 * _LOCATE + 60 + _GEODETIC + 2 * 3**3,
    "rpc-fit": 4 * 39**2,  # normal equations of four ratios, the symmetric half
    "fusion-10khz": 2 * _FILTER_6,
    "fusion-hour-6": 2 * _FILTER_6,
    "fusion-hour-15": 2 * 2 * 2 * 15**3,
    "fusion-forward": _FILTER_6,
    "fusion-graph": 5 * _FILTER_6 + 9**3,
    "adjust": 2 * (2 * _LOOK + 2 * 4 * 10 * 3 + 49),  # two linearisations, points eliminated
    "dom-match": 2 * _PATCH * 10,  # two steps: interpolate, subtract, three sums
    "remap-bilinear": 8,
    "remap-cubic": 32,
    "reimage-bilinear": 8,
    "reimage-cubic": 32,
    "ortho-bilinear": 8,
}
"""Operations on 64-bit numbers for each point, by the first part of a case's key."""


@dataclass(frozen=True, slots=True)
class Machine:
    """Copies from memory to memory, read and written, and 64-bit arithmetic, in 1e9/s."""

    copy_gb_s: float
    gflop_s: float


@dataclass(frozen=True, slots=True)
class Limit:
    """The most that a case could reach, and by `what`: "memory" or "arithmetic"."""

    mpoint_s: float
    what: str


def limit_of(case: Case, machine: Machine) -> Limit | None:
    """Return the nearer limit, None where neither is known."""
    limits = []
    if case.bytes_per_point:
        limits.append(Limit(1e3 * machine.copy_gb_s / case.bytes_per_point, "memory"))
    flop = FLOP.get(_work(case.key))
    if flop:
        limits.append(Limit(1e3 * machine.gflop_s / flop, "arithmetic"))
    return min(limits, key=lambda limit: limit.mpoint_s, default=None)


def _work(key: str) -> str:
    """Key of the work itself: peers and sizes make no difference to a point."""
    for known in sorted(FLOP, key=len, reverse=True):
        if key == known or key.startswith(known + "-"):
            return known
    return key
