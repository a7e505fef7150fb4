"""Piecewise cubics with a proven error: how any smooth curve reaches the compiled kernels.

A kernel cannot call every interpolant a product may prescribe, so the interpolants are tabulated
once as cubics between knots, split until the error is below a stated tolerance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.errors import ConvergenceError

_NODES = np.array([0.0, 0.25, 0.75, 1.0])
_CHECKS = np.array([0.125, 0.5, 0.875])
_TO_COEFFICIENTS = np.linalg.inv(np.vander(_NODES, 4, increasing=True))
_CHECK_POWERS = np.vander(_CHECKS, 4, increasing=True)
_MAX_SPLITS = 24
_MAX_SEGMENTS = 2**14


class PiecewiseCubic(NamedTuple):
    """Cubics in s = (x − knots[i]) / (knots[i + 1] − knots[i]).

    `coefficients` (n, 4, k) are ascending in s. `bins` gives, for equal cells of x, the segment
    at the cell's lower end: a kernel starts its search there. A named tuple, since kernels take
    it as it is.
    """

    knots: FloatArray
    coefficients: FloatArray
    bins: IntArray
    bin_origin: float
    bin_scale: float


def tabulate(
    evaluate: Callable[[FloatArray], FloatArray],
    knots: FloatArray,
    tolerance: FloatArray,
) -> PiecewiseCubic:
    """Tabulate `evaluate`, which takes x (n, m) and returns values (n, m, k).

    `knots` (j,) increase and contain every place where a derivative jumps. Segments are halved
    until the cubic misses the function by no more than `tolerance` (k,) at three inner points.
    """
    todo = np.stack([knots[:-1], knots[1:]], axis=1)
    done_edges, done_coefficients = [], []
    for _ in range(_MAX_SPLITS):
        low, length = todo[:, :1], todo[:, 1:] - todo[:, :1]
        values = evaluate(low + length * np.concatenate([_NODES, _CHECKS]))
        coefficients = np.einsum("ij,njk->nik", _TO_COEFFICIENTS, values[:, :4])
        error = np.abs(np.einsum("ci,nik->nck", _CHECK_POWERS, coefficients) - values[:, 4:])
        good = np.all(error <= tolerance, axis=(1, 2))
        done_edges.append(todo[good])
        done_coefficients.append(coefficients[good])
        bad = todo[~good]
        if not len(bad):
            break
        if len(bad) > max(_MAX_SEGMENTS, 8 * len(knots)):
            raise ConvergenceError(
                "a curve is too rough to tabulate, maybe from rounding: are its seconds counted "
                "from an epoch years away?"
            )
        middle = bad.mean(axis=1)
        todo = np.concatenate(
            [np.stack([bad[:, 0], middle], axis=1), np.stack([middle, bad[:, 1]], axis=1)]
        )
    else:
        raise ConvergenceError("a curve is too rough to tabulate: its derivative jumps off a knot")
    edges = np.concatenate(done_edges)
    order = np.argsort(edges[:, 0], kind="stable")
    all_knots = np.append(edges[order, 0], edges[order[-1], 1])
    table = np.ascontiguousarray(np.concatenate(done_coefficients)[order])
    cells = 1 if len(table) == 1 else 4 * len(table)
    scale = cells / (all_knots[-1] - all_knots[0])
    lower_ends = all_knots[0] + np.arange(cells) / scale
    bins = np.searchsorted(all_knots, lower_ends, side="right") - 1
    bins = np.clip(bins, 0, len(table) - 1).astype(np.int64)
    return PiecewiseCubic(all_knots, table, bins, float(all_knots[0]), float(scale))


def merge_knots(candidates: FloatArray, low: float, high: float, least_step: float) -> FloatArray:
    """Increasing knots from `low` to `high`: the candidates between, thinned to `least_step`."""
    inner = np.unique(candidates[(candidates > low) & (candidates < high)])
    kept = [low]
    for knot in inner:
        if knot - kept[-1] >= least_step:
            kept.append(float(knot))
    if len(kept) > 1 and high - kept[-1] < least_step:
        kept.pop()
    return np.array([*kept, high])
