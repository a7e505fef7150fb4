"""Attitude biases of a simulated pair from control and matches: ours beside SciPy.

Both solve one problem: constant attitude biases of two images, 200 control points, and matches
whose ground points are unknown too. SciPy's `least_squares` gets the same residuals and the same
analytic derivatives, as a sparse Jacobian over biases and points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from geoposition.adjust import Block, adjust, adjusted_models, attitude_bias
from geoposition.adjust.linear import Equations, whitened_rows
from geoposition.adjust.point_sets import PointSet, groups, of_control, of_ties
from geoposition.adjust.solve import equations_of
from geoposition.arrays import FloatArray, IntArray
from geoposition.flags import Flag
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.sensor_model import SensorModel
from geoposition.sensors.simulate import ARCSEC_RAD, SceneOptions, simulate_scene, zy3_cameras

CONTROL: Final = 200
MATCHES: Final = 100_000
TARGET_S: Final = 3.0
"""Two images, 200 control and 100,000 tie points, on two cores."""
NOISE_PX: Final = 0.3
GPS_M: Final = 0.05
SCIPY_MATCHES: Final = 10_000
STILL: Final = SceneOptions(
    jitter_arcsec=(0.0, 0.0, 0.0),
    drift_arcsec=0.0,
    star_noise_arcsec=(0.0, 0.0, 0.0),
    gps_sigma_m=0.0,
    mounting_bias_arcsec=0.0,
)
"""A scene whose models are the true ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is measured, by which models, and the biases that are to come out."""

    models: tuple[SensorModel, ...]
    blocks: tuple[Block, ...]
    control: ControlPoints
    ties: TiePoints
    theta: FloatArray


def problem(matches: int = MATCHES, control: int = CONTROL, seed: int = 0) -> Problem:
    """Simulate a ZY-3-like pair with attitude biases of some ten arcseconds."""
    forward, _, backward = zy3_cameras()
    scene = simulate_scene(STILL, 1, (forward, backward))
    models = (scene.true["forward"], scene.true["backward"])
    blocks = tuple(
        attitude_bias(name, models, [k], sigma_rad=20.0 * ARCSEC_RAD)
        for k, name in enumerate(("forward", "backward"))
    )
    rng = np.random.default_rng(seed)
    theta = rng.normal(0.0, 10.0 * ARCSEC_RAD, 6)
    truth = adjusted_models(models, blocks, theta)

    def seen(n: int) -> tuple[FloatArray, TiePoints]:
        size = np.array(models[0].shape) - 500.0
        image = rng.uniform(500.0, size, (2 * n, 2))
        height = rng.uniform(600.0, 1500.0, 2 * n)
        ground = truth[0].image_to_ground(image, height).geodetic
        found = [model.ground_to_image(ground) for model in truth]
        both = np.flatnonzero((found[0].flag == Flag.OK) & (found[1].flag == Flag.OK))[:n]
        noisy = [
            points.image_px[both] + rng.normal(0.0, NOISE_PX, (len(both), 2)) for points in found
        ]
        return ground[both], TiePoints.of_pair(noisy[0], noisy[1])

    ground, image = seen(control)
    covariance = diagonal_covariance(GPS_M, len(ground), 3)
    known = ControlPoints(np.arange(len(ground)), ground, covariance, image)
    return Problem(models, blocks, known, seen(matches)[1], theta)


def ours(case: Problem) -> FloatArray:
    """Adjust with everything it comes with: blunder search, covariance, adjusted models."""
    done = adjust(
        case.models,
        case.blocks,
        control=case.control,
        ties=case.ties,
        control_sigma_px=NOISE_PX,
        tie_sigma_px=NOISE_PX,
    )
    return done.values


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Residuals of a problem over biases and all ground points, x: biases in units of the prior.

    `first` are the places in x of each set's points, which are offsets in ECEF metres.
    """

    case: Problem
    sets: tuple[PointSet, ...]
    equations: Equations
    first: tuple[int, ...]
    size: int

    @classmethod
    def of(cls, case: Problem) -> Rows:
        """Lines of sight and scales of all measurements."""
        equations = equations_of(case.models, case.blocks)
        sets = (
            of_control("control", case.models, case.control, NOISE_PX),
            of_ties(case.models, case.ties, NOISE_PX),
        )
        ends = len(equations.S) + 3 * np.cumsum([0, *(len(points) for points in sets)])
        return cls(case, sets, equations, tuple(int(e) for e in ends[:-1]), int(ends[-1]))

    @property
    def unknowns(self) -> int:
        """Number of biases."""
        return len(self.equations.S)

    def theta(self, x: FloatArray) -> FloatArray:
        """Biases in radians."""
        return self.equations.theta(x[: self.unknowns])

    def places(self) -> list[tuple[IntArray, int]]:
        """Points of each group, and where its set's points begin in x."""
        return [
            (group.points, first)
            for points, first in zip(self.sets, self.first, strict=True)
            for group in groups(points, len(self.case.models))
        ]

    def at(self, x: FloatArray) -> list[FloatArray]:
        """Rows (n, r, 3 + p + 1) of each group: by the point, by the biases, the residual."""
        theta, out = self.theta(x), []
        for points, start in zip(self.sets, self.first, strict=True):
            offset = x[start : start + 3 * len(points)].reshape(-1, 3)
            moved = replace(points, ecef_m=points.ecef_m + offset)
            for group in groups(points, len(self.case.models)):
                part = slice(0, len(group.points))
                work = whitened_rows(self.equations, moved, group, part, theta, True)
                work[:, :, 3:-1] = work[:, :, 3:-1] @ self.equations.S
                out.append(work)
        return out


def by_scipy(case: Problem) -> FloatArray:
    """Solve for biases and all ground points with a sparse Jacobian."""
    rows = Rows.of(case)
    p, places = rows.unknowns, rows.places()

    def residuals(x: FloatArray) -> FloatArray:
        return np.concatenate([x[:p], *(work[:, :, -1].ravel() for work in rows.at(x))])

    def jacobian(x: FloatArray) -> csr_array:
        data, row, column = [np.ones(p)], [np.arange(p)], [np.arange(p)]
        at = p
        for work, (points, start) in zip(rows.at(x), places, strict=True):
            n, r, _ = work.shape
            lines = at + np.arange(n * r).reshape(n, r)
            by_unknown = work[:, :, 3:-1]
            row.append(np.broadcast_to(lines[:, :, None], by_unknown.shape).ravel())
            column.append(np.broadcast_to(np.arange(p), by_unknown.shape).ravel())
            data.append(by_unknown.ravel())
            own = start + 3 * points[:, None, None] + np.arange(3)
            row.append(np.broadcast_to(lines[:, :, None], (n, r, 3)).ravel())
            column.append(np.broadcast_to(own, (n, r, 3)).ravel())
            data.append(-work[:, :, :3].ravel())
            at += n * r
        entries = (np.concatenate(data), (np.concatenate(row), np.concatenate(column)))
        return csr_array(entries, shape=(at, rows.size))

    found = least_squares(residuals, np.zeros(rows.size), jacobian, x_scale="jac", tr_solver="lsmr")
    return rows.theta(found.x)
