"""Batch smoothing as a factor graph: the optimum that filters and smoothers are held against.

Knots stand at the star epochs; between them the gyro is one preintegrated link with the walk of
the bias in it. Scale and misalignment of the gyro, and alignment and orbit-periodic errors of
star heads, are unknowns shared by all knots, which neither a filter's state nor its smoother holds
as easily. Interior knots of short segments are eliminated in compiled code and the rest is a
GTSAM graph of segment ends and shared unknowns (`factor_graph_engine`). Each Gauss–Newton step
integrates the gyro again, so no first-order correction of it remains at convergence.

The covariance is that of the final linearisation; with weights below 1 (Huber, Cauchy) it is that
of least squares with these weights. *Source*: Dellaert & Kaess 2017; Forster et al. 2017; P 2.1
and T 4.1 for the problem.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.sensors.attitude_determination.checks.convention_check import (
    refuse_wrong_convention,
)
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.graph.dense import densify
from geoposition.sensors.attitude_determination.graph.problem import (
    GraphOptions,
    finish,
    gauss_newton_step,
    problem_of,
    start,
)
from geoposition.sensors.attitude_determination.graph.robust import (
    RobustNoise,
    sharpened,
    start_control,
    weights,
)
from geoposition.sensors.attitude_determination.graph.stars import Constants
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

__all__ = ["GraphOptions", "GraphSolution", "HeadOffset", "RobustNoise", "smooth", "solve"]

_CONVERGED = 1e-2
"""Largest last step, in star sigmas and prior sigmas: what is left is its square in radians."""

_SETTLED_WEIGHT = 1e-3
"""Largest last change of a sample's weight."""


@dataclass(frozen=True, slots=True, eq=False)
class HeadOffset:
    """Estimated offset of one head in its own frame, (3,) each, with sigmas.

    R_body_sensor is that of the mounting times exp(alignment + sine sin(2 pi t / period)
    + cosine cos(2 pi t / period)).
    """

    alignment_rad: FloatArray
    alignment_sigma_rad: FloatArray
    sine_rad: FloatArray
    sine_sigma_rad: FloatArray
    cosine_rad: FloatArray
    cosine_sigma_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class GraphSolution:
    """`estimate`; `offsets` of the heads; `weight` (m,) of each star sample, NaN where not met."""

    estimate: AttitudeEstimate
    offsets: Mapping[str, HeadOffset]
    weight: FloatArray
    iterations: int


def smooth(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
    options: GraphOptions = GraphOptions(),  # noqa: B008  (frozen)
) -> AttitudeEstimate:
    """Estimate attitude and gyro errors at all gyro epochs from all data at once."""
    return solve(star, gyro, settings, mounting, options).estimate


def solve(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
    options: GraphOptions = GraphOptions(),  # noqa: B008  (frozen)
) -> GraphSolution:
    """Like `smooth`, with the heads' offsets and the samples' weights."""
    refuse_wrong_convention(star, gyro, mounting)
    problem = problem_of(star, gyro, settings, mounting, options)
    robust = options.robust
    if robust is None and settings.gate_probability is not None:
        robust = RobustNoise.gate(settings.gate_probability)
    state, held = start(problem)
    weight = np.ones(len(held)) if robust is None else held.astype(np.float64)
    control = None
    iteration, settled = 0, False
    while not settled and iteration < options.max_iterations:
        iteration += 1
        step, residual = gauss_newton_step(problem, state, weight)
        settled = step < _CONVERGED
        if robust is not None:
            if control is None:
                control = start_control(robust, residual[held])
            new = weights(robust, residual, control)
            sharp = robust.kind != "truncated" or control > 1e3
            settled &= sharp and float(np.max(np.abs(new - weight))) < _SETTLED_WEIGHT
            control, weight = sharpened(control), new
    knots, links, end = finish(problem, state, weight)
    dense = densify(problem.timeline, knots, links, problem.general, problem.walks)
    estimate = AttitudeEstimate(
        read_only(problem.timeline.times_s[problem.timeline.is_gyro]),
        read_only(dense.quat_xyzw),
        read_only(dense.bias_rad_s),
        read_only(np.tile(knots.constants, (len(dense.bias_rad_s), 1))),
        read_only(dense.covariance),
        read_only(dense.lag_one),
    )
    weights_all = np.full(len(star), np.nan)
    weights_all[problem.timeline.star_index] = weight
    offsets = _offsets(star, mounting, problem.layout, state.constants, end[6:, 6:])
    return GraphSolution(estimate, offsets, read_only(weights_all), iteration)


def _offsets(
    star: StarSeries,
    mounting: Mounting,
    layout: Constants,
    constants: FloatArray,
    covariance: FloatArray,
) -> dict[str, HeadOffset]:
    """Offsets of the heads that have unknowns, turned from the body into the sensors' frames."""
    result = {}
    for i, name in enumerate(star.heads):
        first = (layout.alignment[i], layout.periodic[i])
        if max(first) < 0:
            continue
        R_sensor_body = mounting.rotation(name).inv().as_matrix()
        parts: list[FloatArray] = []
        for column in (first[0], first[1], first[1] + 3 if first[1] >= 0 else -1):
            if column < 0:
                parts += [read_only(np.zeros(3)), read_only(np.zeros(3))]
                continue
            own = slice(column, column + 3)
            turned = R_sensor_body @ covariance[own, own] @ R_sensor_body.T
            parts += [
                read_only(R_sensor_body @ constants[own]),
                read_only(np.sqrt(np.diag(turned))),
            ]
        result[name] = HeadOffset(*parts)
    return result
