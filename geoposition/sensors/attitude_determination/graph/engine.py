"""The graph itself, in GTSAM: segment ends and shared constants, quadratics as factors.

The only door to GTSAM on the satellite's side. Each segment of the chain is one `HessianFactor`
between its two ends and the constants, priors are `JacobianFactor`s. GTSAM eliminates the ends in
the order of time, the constants last; the joint covariances of neighbouring ends then follow from
its Bayes net by one backward pass. *Source*: Dellaert & Kaess 2017, chapters 3 and 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import GeometryError
from geoposition.sensors.attitude_determination.graph.chain import Eliminated

_CONSTANTS = gtsam.symbol("c", 0)


@dataclass(frozen=True, slots=True, eq=False)
class EndPrior:
    """A quadratic in the state of segment end `end` and the constants: H (6 + p, 6 + p), g."""

    end: int
    H: FloatArray
    g: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class GraphAnswer:
    """`means` (s + 1, 6) of the ends and `constants` (p,); `joint` (s, n, n) if asked for.

    `joint` is the covariance of (x_b, x_a, c) of each segment, `end` (m, m) that of the last
    end and the constants.
    """

    means: FloatArray
    constants: FloatArray
    joint: FloatArray | None
    end: FloatArray | None


def solve_graph(
    segments: Eliminated,
    priors: list[EndPrior],
    constants_sigma: FloatArray,
    constants_mean: FloatArray,
    covariances: bool,
) -> GraphAnswer:
    """Solve the linear graph of segments, priors of single ends, and a prior of the constants.

    A graph that does not determine its variables is a `GeometryError`.
    """
    p = len(constants_mean)
    ends = len(segments.bounds)
    graph = gtsam.GaussianFactorGraph()
    for prior in priors:
        graph.push_back(_end_factor(prior, p))
    if p:
        model = gtsam.noiseModel.Diagonal.Sigmas(constants_sigma)
        graph.push_back(gtsam.JacobianFactor(_CONSTANTS, np.eye(p), constants_mean, model))
    for i, (H, g) in enumerate(zip(segments.H, segments.g, strict=True)):
        graph.push_back(_segment_factor(i, H, g, p))
    ordering = gtsam.Ordering()
    for i in range(ends):
        ordering.push_back(i)
    if p:
        ordering.push_back(_CONSTANTS)
    try:
        net = graph.eliminateSequential(ordering)
        values = net.optimize()
    except RuntimeError:
        raise GeometryError("factor graph: the data and priors do not fix all unknowns") from None
    means = np.array([values.at(i) for i in range(ends)])
    constants = np.array(values.at(_CONSTANTS)) if p else np.empty(0)
    if not np.all(np.isfinite(means)) or not np.all(np.isfinite(constants)):
        raise GeometryError("factor graph: the data and priors do not fix all unknowns")
    if not covariances:
        return GraphAnswer(means, constants, None, None)
    joint, end = _joint_covariances(net, ends, p)
    return GraphAnswer(means, constants, joint, end)


def _end_factor(prior: EndPrior, p: int) -> gtsam.HessianFactor:
    H, g = prior.H, prior.g
    if not p:
        return gtsam.HessianFactor(prior.end, H, g, 0.0)
    return gtsam.HessianFactor(
        prior.end, _CONSTANTS, H[:6, :6], H[:6, 6:], g[:6], H[6:, 6:], g[6:], 0.0
    )


def _segment_factor(i: int, H: FloatArray, g: FloatArray, p: int) -> gtsam.HessianFactor:
    first, last = i, i + 1
    if not p:
        return gtsam.HessianFactor(last, first, H[:6, :6], H[:6, 6:], g[:6], H[6:, 6:], g[6:], 0.0)
    return gtsam.HessianFactor(
        last,
        first,
        _CONSTANTS,
        H[:6, :6],
        H[:6, 6:12],
        H[:6, 12:],
        g[:6],
        H[6:12, 6:12],
        H[6:12, 12:],
        g[6:12],
        H[12:, 12:],
        g[12:],
        0.0,
    )


def _joint_covariances(
    net: gtsam.GaussianBayesNet, ends: int, p: int
) -> tuple[FloatArray, FloatArray]:
    """Covariance of (x_b, x_a, c) for each segment, and of the last end and c: (m, m)."""
    known = np.zeros((p, p))
    if p:
        R = np.linalg.inv(net.at(ends).R())
        known = R @ R.T
    joint = np.empty((ends - 1, 12 + p, 12 + p))
    end = known
    for i in range(ends - 1, -1, -1):
        conditional = net.at(i)
        R = np.linalg.inv(conditional.R())
        own = R @ R.T
        # `known` covers the parents: (x_{i+1}, c), or c alone for the last end.
        if len(known):
            gain = R @ conditional.S()
            cross = -gain @ known
            own = own - cross @ gain.T
        else:
            cross = np.zeros((6, 0))
        if i == ends - 1:
            end = known = np.block([[own, cross], [cross.T, known]])
            continue
        segment = joint[i]
        segment[:6, :6], segment[:6, 12:] = known[:6, :6], known[:6, 6:]
        segment[12:, :6], segment[12:, 12:] = known[6:, :6], known[6:, 6:]
        segment[6:12, 6:12] = own
        segment[6:12, :6], segment[6:12, 12:] = cross[:, :6], cross[:, 6:]
        segment[:6, 6:12], segment[12:, 6:12] = cross[:, :6].T, cross[:, 6:].T
        known = np.block([[own, cross[:, 6:]], [cross[:, 6:].T, known[6:, 6:]]])
    return joint, end
