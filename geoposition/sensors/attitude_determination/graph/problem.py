"""The smoothing problem as a graph over knots: set up, started, linearised, stepped, finished."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.sensors.attitude_determination.graph.back import (
    interior_means,
    pair_covariances,
)
from geoposition.sensors.attitude_determination.graph.chain import (
    LinearChain,
    eliminate,
)
from geoposition.sensors.attitude_determination.graph.dense import KnotSolution
from geoposition.sensors.attitude_determination.graph.engine import EndPrior, solve_graph
from geoposition.sensors.attitude_determination.graph.links import linear_chain, move_knots
from geoposition.sensors.attitude_determination.graph.robust import RobustNoise
from geoposition.sensors.attitude_determination.graph.stars import (
    Constants,
    StarSamples,
    constants_of,
    first_guess,
    linearised,
)
from geoposition.sensors.attitude_determination.preintegration import Links, preintegrate
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.timeline import Timeline, merge
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

_LEAST_WALK = 1e-3
"""A bias walk that adds less than this share of the angle noise over the whole run is raised to
it: a bias without any walk has no weight to link its knots with, and nothing else changes."""


@dataclass(frozen=True, slots=True)
class GraphOptions:
    """Unknowns of the heads, loss, and how the graph is cut.

    `alignment_sigma_rad` and `periodic_sigma_rad` are priors per axis, one for all heads or by
    name; heads without one are taken as mounted and free of the periodic error, whose period is
    `period_s`. `robust` weighs star samples; without it a gate in the settings becomes the
    truncated loss at that gate.
    """

    alignment_sigma_rad: float | Mapping[str, float] | None = None
    periodic_sigma_rad: float | Mapping[str, float] | None = None
    period_s: float | None = None
    robust: RobustNoise | None = None
    segment_knots: int = 40
    max_iterations: int = 60

    def __post_init__(self) -> None:
        if self.periodic_sigma_rad is not None and not (self.period_s or 0.0) > 0.0:
            raise ArgumentError("factor graph: periodic errors need a positive period_s")
        if self.segment_knots < 1 or self.max_iterations < 1:
            raise ArgumentError("factor graph: positive segment_knots and max_iterations expected")


@dataclass(slots=True, eq=False)
class State:
    """Where the next step starts: attitudes (k, 4), biases (k, 3), constants (p,)."""

    quat: FloatArray
    bias: FloatArray
    constants: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Knots `ends` on a timeline, their star samples, and the units of the unknowns.

    `bounds` are the knots between segments, `prior_end` the one of the first star sample; `walks`
    the squared random walks; `unit` (6 + p,) of attitude, bias and constants.
    """

    timeline: Timeline
    ends: IntArray
    samples: StarSamples
    layout: Constants
    settings: FusionSettings
    walks: tuple[float, float]
    bounds: IntArray
    prior_end: int
    unit: FloatArray

    @property
    def general(self) -> bool:
        """Whether the gyro has scale and misalignment."""
        return self.layout.gyro > 0


def problem_of(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting,
    options: GraphOptions,
) -> Problem:
    """Lay knots, samples and unknowns out; no overlap of the series is a `GeometryError`."""
    timeline = merge(star, gyro, mounting)
    count = np.diff(timeline.star_start)
    at_star = np.flatnonzero(count)
    last = len(timeline.times_s) - 1
    ends = np.union1d(at_star, [0, last]).astype(np.int64)
    knot = np.repeat(np.arange(len(ends)), count[ends])
    head = star.head[timeline.star_index]
    angle = 2.0 * np.pi * star.times_s[timeline.star_index] / (options.period_s or np.inf)
    phase = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    samples = StarSamples(knot, head, phase, timeline.quat_inertial_body, timeline.covariance_rad2)
    layout = constants_of(
        star.heads, settings, options.alignment_sigma_rad, options.periodic_sigma_rad
    )
    prior_end = int(knot[0])
    segments = max(1, round((len(ends) - 1) / options.segment_knots))
    bounds = np.linspace(0, len(ends) - 1, segments + 1).round().astype(np.int64)
    bounds = np.union1d(bounds, prior_end)
    span = float(timeline.times_s[-1] - timeline.times_s[0])
    sigma_v = settings.noise.angle_random_walk
    sigma_u = max(settings.noise.rate_random_walk, _LEAST_WALK * sigma_v / span)
    cross = np.sqrt(np.median(np.einsum("mii->m", samples.covariance_rad2)) / 3.0)
    bias = max(settings.bias_sigma_rad_s, sigma_v / np.sqrt(span))
    unit = np.concatenate([np.full(3, cross), np.full(3, bias), layout.sigma])
    walks = (sigma_v**2, sigma_u**2)
    return Problem(timeline, ends, samples, layout, settings, walks, bounds, prior_end, unit)


def start(problem: Problem) -> tuple[State, BoolArray]:
    """Return a state to linearise at, and the star samples (m,) that go together with it."""
    state = State(
        np.empty(0), np.zeros((len(problem.ends), 3)), np.zeros(len(problem.layout.sigma))
    )
    links = _links(problem, state)
    step = np.diff(problem.timeline.times_s[problem.ends])
    turned = np.linalg.norm(Rotation.from_quat(links.quat_xyzw).as_rotvec(), axis=1)
    settings = problem.settings
    slack = 5.0 * settings.bias_sigma_rad_s * step + 5.0 * np.sqrt(np.einsum("kii->k", links.Qaa))
    if problem.general:
        slack = slack + 5.0 * (settings.scale_sigma + settings.misalignment_sigma) * turned
    state.quat, held = first_guess(problem.samples, links.quat_xyzw, slack)
    return state, held


def _links(problem: Problem, state: State) -> Links:
    return preintegrate(
        problem.timeline,
        problem.ends,
        state.bias,
        _gyro_constants(problem, state),
        problem.general,
        *(float(np.sqrt(walk)) for walk in problem.walks),
    )


def _gyro_constants(problem: Problem, state: State) -> FloatArray:
    return state.constants[:9] if problem.general else np.zeros(9)


def _linear(
    problem: Problem, state: State, weight: FloatArray
) -> tuple[LinearChain, list[EndPrior], Links]:
    """Linearise about `state`, in units of `problem.unit`."""
    links = _links(problem, state)
    theta_c = np.concatenate([problem.unit[:3], problem.unit[6:]])
    H, g, _ = linearised(problem.samples, state.quat, state.constants, problem.layout, weight)
    H *= np.outer(theta_c, theta_c)
    g *= theta_c
    chain = linear_chain(links, state.quat, state.bias, problem.unit, H, g)
    return chain, _end_priors(problem, state, H[0], g[0]), links


def _end_priors(
    problem: Problem, state: State, star_H: FloatArray, star_g: FloatArray
) -> list[EndPrior]:
    """Return the star samples of the first knot, and the bias's prior at the first star fix."""
    p = len(state.constants)
    at = np.concatenate([np.arange(3), np.arange(6, 6 + p)])
    first_H, first_g = np.zeros((6 + p, 6 + p)), np.zeros(6 + p)
    first_H[np.ix_(at, at)], first_g[at] = star_H, star_g
    bias_H, bias_g = np.zeros((6 + p, 6 + p)), np.zeros(6 + p)
    sigma = max(problem.settings.bias_sigma_rad_s, 1e-4 * problem.unit[3])
    bias_H[range(3, 6), range(3, 6)] = (problem.unit[3] / sigma) ** 2
    bias_g[3:6] = -state.bias[problem.prior_end] * problem.unit[3] / sigma**2
    prior_at = int(np.searchsorted(problem.bounds, problem.prior_end))
    return [EndPrior(0, first_H, first_g), EndPrior(prior_at, bias_H, bias_g)]


def gauss_newton_step(
    problem: Problem, state: State, weight: FloatArray
) -> tuple[float, FloatArray]:
    """Move `state` by one Gauss–Newton step; its largest component, and the residuals after it."""
    chain, priors, _ = _linear(problem, state, weight)
    done = eliminate(chain, problem.bounds)
    p = len(state.constants)
    prior_mean = -state.constants / problem.unit[6:]
    answer = solve_graph(done, priors, np.ones(p), prior_mean, covariances=False)
    knots = interior_means(done, answer.means, answer.constants)
    largest = move_knots(knots, problem.unit, state.quat, state.bias)
    state.constants = state.constants + answer.constants * problem.unit[6:]
    _, _, residual = linearised(
        problem.samples, state.quat, state.constants, problem.layout, weight
    )
    return max(largest, float(np.abs(answer.constants).max(initial=0.0))), residual


def finish(
    problem: Problem, state: State, weight: FloatArray
) -> tuple[KnotSolution, Links, FloatArray]:
    """Covariances at the solution; the covariance of the last knot and the constants."""
    chain, priors, links = _linear(problem, state, weight)
    done = eliminate(chain, problem.bounds)
    p = len(state.constants)
    answer = solve_graph(done, priors, np.ones(p), np.zeros(p), covariances=True)
    assert answer.joint is not None
    assert answer.end is not None
    unit = problem.unit
    pair_unit = np.concatenate([unit[:6], unit])
    pairs = pair_covariances(done, answer.joint)
    pairs *= np.outer(pair_unit, pair_unit)
    knots = KnotSolution(
        problem.ends,
        state.quat,
        state.bias,
        _gyro_constants(problem, state),
        pairs,
        chain.misfit * unit[:6],
        chain.weight / np.outer(unit[:6], unit[:6]),
    )
    return knots, links, answer.end * np.outer(unit, unit)
