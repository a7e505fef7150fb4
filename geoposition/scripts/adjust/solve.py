"""An adjustment solved: heights asked again as models move, blunders explained, mistakes told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from geoposition.adjust import (
    Adjustment,
    Block,
    Finding,
    HeightControl,
    Rejection,
    RobustOptions,
    adjust,
    diagnose,
    explain_rejections,
    selected_control,
    split_control,
    terrain_heights,
)
from geoposition.adjust.diagnose import Undulation
from geoposition.arrays import FloatArray
from geoposition.datum import Geoid
from geoposition.errors import GeometryError, GeopositionError, ProductError
from geoposition.observations import ControlPoints
from geoposition.scripts.adjust.images import RunImage
from geoposition.scripts.adjust.input import IMAGE_SIGMA_PX
from geoposition.scripts.adjust.points import Points
from geoposition.scripts.adjust.request import RunInput
from geoposition.scripts.results import Progress
from geoposition.sensor_model import SensorModel
from geoposition.terrain import RasterTerrain

_MOST_HEIGHT_ROUNDS: Final = 8
_HEIGHTS_SETTLED_M: Final = 0.1
_MOST_DIAGNOSED: Final = 300
"""Control points beyond this are diagnosed by an even selection."""
_MOST_LEFT_OUT: Final = 12
_MOST_TIES_LEFT_OUT: Final = 5000


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Control points (n) predicted by all others: errors in image (m, 2), px, and ground (n, 3).

    `product` (m) and `point` (m) say whose image points they are; NaN where nothing came out.
    """

    ids: tuple[str, ...]
    point: np.ndarray[tuple[int], np.dtype[np.int64]]
    product: np.ndarray[tuple[int], np.dtype[np.int64]]
    residual_px: FloatArray
    error_enu_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """What a run found; `rejections` are those of `adjustment`, with their likely reasons."""

    run: RunInput
    images: tuple[RunImage, ...]
    points: Points
    blocks: tuple[Block, ...]
    adjustment: Adjustment
    rejections: tuple[Rejection, ...]
    findings: tuple[Finding, ...]
    left_out: LeftOut | None
    height_rounds: int


def solved(
    run: RunInput,
    images: tuple[RunImage, ...],
    blocks: tuple[Block, ...],
    points: Points,
    progress: Progress,
) -> RunResult:
    """Adjust; where that fails, the typical mistake that explains it is in the message."""
    models = [image.model for image in images]
    undulation = _undulation(run)
    try:
        done, rounds = _adjusted(run, models, blocks, points, progress)
        if points.control is not None and not np.any(done.control.status <= 1):
            raise GeometryError("no control point lies in any image where the models put it")
    except GeopositionError as error:
        raise _explained(run, models, blocks, points, undulation, error) from None
    findings: tuple[Finding, ...] = ()
    rejections = done.rejected
    if points.control is not None:
        assert run.control is not None
        rejections = explain_rejections(
            done, points.control, control_sigma_px=_sigma_px(run), undulation_m=undulation
        )
        findings = _found(run, models, blocks, points.control, undulation)
    left_out = _left_out(run, models, blocks, points)
    return RunResult(run, images, points, blocks, done, rejections, findings, left_out, rounds)


def _adjusted(
    run: RunInput,
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    points: Points,
    progress: Progress,
) -> tuple[Adjustment, int]:
    """With a DEM the heights are taken where the adjusted models meet, until they settle."""
    if run.heights is None or points.ties is None:
        return _once(run, models, blocks, points, None), 0
    terrain = RasterTerrain(run.heights.dem, run.heights.geoid)
    believed: Sequence[SensorModel] = models
    before: FloatArray | None = None
    for count in range(1, _MOST_HEIGHT_ROUNDS + 1):
        progress(count - 1, _MOST_HEIGHT_ROUNDS)
        heights = terrain_heights(believed, points.ties, terrain, run.heights.sigma_m)
        if not np.any(np.isfinite(heights.height_m)):
            raise ProductError(
                run.heights.dem, "", "heights where the ties are expected, it has none there"
            )
        done = _once(run, models, blocks, points, heights)
        believed = done.models
        if before is not None:
            moved = np.abs(heights.height_m - before)
            if np.any(np.isfinite(moved)) and np.nanmedian(moved) < _HEIGHTS_SETTLED_M:
                break
        before = heights.height_m
    return done, count


def _once(
    run: RunInput,
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    points: Points,
    heights: HeightControl | None,
) -> Adjustment:
    robust = run.robust
    return adjust(
        models,
        blocks,
        control=points.control,
        ties=points.ties,
        check=points.check,
        heights=heights,
        control_sigma_px=_sigma_px(run),
        tie_sigma_px=IMAGE_SIGMA_PX if run.ties is None else run.ties.sigma_px,
        robust=RobustOptions(robust.family_risk, robust.adapt) if robust.enabled else None,
    )


def _sigma_px(run: RunInput) -> float:
    return IMAGE_SIGMA_PX if run.control is None else run.control.image_sigma_px


def _undulation(run: RunInput) -> Undulation | None:
    """Geoid heights of whichever grid the run names."""
    grids = [
        None if run.control is None else run.control.geoid or run.control.dem_geoid,
        None if run.heights is None else run.heights.geoid,
    ]
    grid = next((path for path in grids if path is not None), None)
    if grid is None:
        return None
    geoid = Geoid.from_file(grid)
    return lambda geodetic: geoid.undulation_m(geodetic)


def _found(
    run: RunInput,
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    control: ControlPoints,
    undulation: Undulation | None,
) -> tuple[Finding, ...]:
    step = max(-(-len(control) // _MOST_DIAGNOSED), 1)
    some = selected_control(control, np.arange(0, len(control), step))
    return diagnose(models, blocks, some, control_sigma_px=_sigma_px(run), undulation_m=undulation)


def _explained(
    run: RunInput,
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    points: Points,
    undulation: Undulation | None,
    error: GeopositionError,
) -> GeopositionError:
    """Return the error with what seems wrong with the control, if something does."""
    if points.control is None or run.control is None:
        return error
    try:
        found = _found(run, models, blocks, points.control, undulation)
    except GeopositionError:
        found = ()
    if found:
        return ProductError(run.control.file, "", f"{error}; probably {found[0].message}")
    return (
        error if isinstance(error, ProductError) else ProductError(run.control.file, "", f"{error}")
    )


def _left_out(
    run: RunInput, models: Sequence[SensorModel], blocks: Sequence[Block], points: Points
) -> LeftOut | None:
    """Leave each control point out in turn, if asked for, or if nothing else checks few points."""
    control, wanted = points.control, run.check.leave_one_out
    if control is None or len(control) < 2:
        return None
    few = len(control) <= _MOST_LEFT_OUT and (
        points.ties is None or len(points.ties) <= _MOST_TIES_LEFT_OUT
    )
    if wanted is False or (wanted is None and (points.check is not None or not few)):
        return None
    point, product, residual, error = [], [], [], []
    for i, name in enumerate(control.ids.tolist()):
        others, one = split_control(control, [name])
        try:
            done = _once(run, models, blocks, replace(points, control=others, check=one), None)
        except GeopositionError:
            error.append(np.full(3, np.nan))
            continue
        rows = done.check
        point.append(np.full(len(rows.product), i))
        product.append(rows.product)
        residual.append(rows.residual_px)
        error.append(rows.error_enu_m[0])
    if not point:
        return None
    return LeftOut(
        tuple(str(name) for name in control.ids.tolist()),
        np.concatenate(point),
        np.concatenate(product),
        np.concatenate(residual),
        np.array(error),
    )
