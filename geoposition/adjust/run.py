"""`adjust`: models, unknowns and measurements to an `Adjustment`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from geoposition.adjust.adjustment import Adjustment, PointResults, Rejection, Status
from geoposition.adjust.control import HeightControl
from geoposition.adjust.corrected_model import corrected
from geoposition.adjust.observability import correlated_pairs, weak_combinations
from geoposition.adjust.point_results import nothing, results_of
from geoposition.adjust.point_sets import PointSet, groups, of_control, of_ties
from geoposition.adjust.robust import RobustOptions
from geoposition.adjust.scale_field import ScaleField, scale_fields
from geoposition.adjust.solve import Solved, block_starts, equations_of, solve, used_by_set
from geoposition.adjust.unknowns import Block
from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ArgumentError
from geoposition.observations import ControlPoints, TiePoints
from geoposition.sensor_model import SensorModel

IMAGE_SIGMA_PX = 0.3


def adjust(
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    *,
    control: ControlPoints | None = None,
    ties: TiePoints | None = None,
    check: ControlPoints | None = None,
    heights: HeightControl | None = None,
    control_sigma_px: ArrayLike = IMAGE_SIGMA_PX,
    tie_sigma_px: ArrayLike = IMAGE_SIGMA_PX,
    robust: RobustOptions | None = RobustOptions(),  # noqa: B008
    explicit_points: bool = False,
) -> Adjustment:
    """Estimate the unknowns of `blocks` from measurements in the images of `models`.

    Parameters
    ----------
    models
        Rigorous models, RPCs and others, in the order of the products' numbers.
    blocks
        Unknowns with their priors, see `unknowns`.
    control, check
        Points of known ground, with their measurements in images. Check points are kept out.
    ties
        Matches of two or more images.
    heights
        Heights of tie points, such as a DEM gives them.
    control_sigma_px, tie_sigma_px
        Standard deviation of image points, one number or (line, sample), where the tables carry
        no covariance of their own. That of `control` serves for check points too.
    robust
        How blunders are found; None keeps all points.
    explicit_points
        Keep all points as variables of the graph, instead of eliminating them beforehand. The
        same answer, more slowly, and without a search for blunders.

    Raises
    ------
    ArgumentError
        Blocks that do not fit the models, no measurements, unknown products.
    ConvergenceError
        The iteration does not settle.
    """
    models, blocks = tuple(models), tuple(blocks)
    if control is None and ties is None:
        raise ArgumentError("adjustment: control points or tie points expected")
    sets = []
    fields = _fields(models, [ties, *(c.image for c in (control, check) if c is not None)])
    if control is not None:
        sets.append(of_control("control", models, control, control_sigma_px, fields))
    if ties is not None:
        height, spread = None, None
        if heights is not None:
            height, spread = heights.of_points(ties.grouped().ids)
        sets.append(of_ties(models, ties, tie_sigma_px, height, spread, fields))
    solved = solve(
        models, blocks, sets, None if explicit_points else robust, explicit=explicit_points
    )
    probe = None if check is None else of_control("check", models, check, control_sigma_px, fields)
    return _result(models, blocks, solved, probe)


def _fields(
    models: tuple[SensorModel, ...], tables: Sequence[TiePoints | None]
) -> dict[int, ScaleField]:
    """Scales of all images with observations, made once for all roles."""
    seen = [table for table in tables if table is not None]
    for table in seen:
        table.require_products(len(models))
    products = [table.product for table in seen]
    return scale_fields(models, np.concatenate(products)) if products else {}


def _result(
    models: tuple[SensorModel, ...],
    blocks: tuple[Block, ...],
    solved: Solved,
    probe: PointSet | None,
) -> Adjustment:
    equations = equations_of(models, blocks)
    results = {"control": nothing(), "check": nothing(), "tie": nothing()}
    at = 0
    for points, several, used in zip(solved.sets, solved.groups, used_by_set(solved), strict=True):
        limits = solved.robust.limit[at : at + len(several)]
        if not limits:
            limits = [np.full(len(group.points), np.inf) for group in several]
        at += len(several)
        results[points.role] = results_of(
            equations, points, several, solved.z, solved.solution, used, limits
        )
    if probe is not None:
        several = tuple(groups(probe, len(models)))
        kept_out = [np.zeros(len(group.points), dtype=bool) for group in several]
        limits = [np.full(len(group.points), np.inf) for group in several]
        results["check"] = results_of(
            equations, probe, several, solved.z, solved.solution, kept_out, limits
        )
    theta = equations.theta(solved.z)
    covariance = equations.S @ solved.solution.covariance @ equations.S.T
    names = tuple(name for block in blocks for name in block.names)
    freedom = sum(float(np.sum(r.freedom[r.status == Status.USED])) for r in results.values())
    cost = solved.history[-1].cost
    return Adjustment(
        blocks=blocks,
        names=names,
        units=tuple(unit for block in blocks for unit in block.units),
        values=read_only(theta),
        covariance=read_only(0.5 * (covariance + covariance.T)),
        prior_sigma=read_only(np.sqrt(np.sum(equations.S**2, axis=1))),
        models=adjusted_models(models, blocks, theta),
        base_models=models,
        control=results["control"],
        check=results["check"],
        ties=results["tie"],
        rejected=(*_rejections("control", results["control"]), *_rejections("tie", results["tie"])),
        sigma0=float(np.sqrt(cost / freedom)) if freedom > 0 else float("nan"),
        redundancy=freedom,
        scale=solved.robust.scale,
        weak=tuple(weak_combinations(names, solved.solution.covariance)),
        correlated=tuple(correlated_pairs(names, covariance)),
        history=solved.history,
    )


def adjusted_models(
    models: Sequence[SensorModel], blocks: Sequence[Block], values: FloatArray
) -> tuple[SensorModel, ...]:
    """Models with all unknowns at `values` (p)."""
    first = block_starts(blocks)
    out = []
    for image, model in enumerate(models):
        mine = [i for i, block in enumerate(blocks) if image in block.images]
        parts = [values[first[i] : first[i + 1]] for i in mine]
        out.append(corrected(model, [blocks[i] for i in mine], parts))
    return tuple(out)


def _rejections(role: str, results: PointResults) -> list[Rejection]:
    size = np.hypot(results.residual_px[:, 0], results.residual_px[:, 1])
    worst = np.zeros(len(results))
    np.maximum.at(worst, results.point, np.where(np.isfinite(size), size, 0.0))
    return [
        Rejection(
            str(results.ids[i]),
            role,
            float(results.statistic[i]),
            float(results.limit[i]),
            float(worst[i]),
            "residual far outside the noise",
        )
        for i in np.flatnonzero(results.status == Status.REJECTED)
    ]
