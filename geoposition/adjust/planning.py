"""How good it will be: predicted accuracy for a layout of control, before any is measured.

The covariance of an adjustment does not depend on the measured values, only on where the points
are, in which images they show and how well they are measured: so it is known beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.adjust.adjustment import WeakCombination
from geoposition.adjust.linear import linearise
from geoposition.adjust.point_sets import groups, of_control
from geoposition.adjust.run import adjust
from geoposition.adjust.solve import equations_of
from geoposition.adjust.unknowns import Block
from geoposition.arrays import FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.sensor_model import SensorModel


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Predicted accuracy of a layout.

    `covariance_enu_m2` (n, 3, 3) of ground points intersected with the adjusted models, NaN where
    no two images see them; `names`, `sigma` (p) of the unknowns; `weak` as in `Adjustment`.
    """

    covariance_enu_m2: FloatArray
    names: tuple[str, ...]
    sigma: FloatArray
    weak: tuple[WeakCombination, ...]

    @property
    def sigma_enu_m(self) -> FloatArray:
        """Standard deviations east, north, up (n, 3)."""
        return np.sqrt(np.diagonal(self.covariance_enu_m2, axis1=1, axis2=2))

    @property
    def rms_enu_m(self) -> FloatArray:
        """Expected root mean square errors east, north, up (3) over the points."""
        return np.asarray(np.sqrt(np.nanmean(self.sigma_enu_m**2, axis=0)))


def measured_without_error(
    models: Sequence[SensorModel], geodetic: ArrayLike, sigma_enu_m: ArrayLike
) -> ControlPoints:
    """Control points at `geodetic` (n, 3), numbered, where each model shows them."""
    points = np.asarray(geodetic, dtype=np.float64).reshape(-1, 3)
    ids, product, image = [], [], []
    for k, model in enumerate(models):
        seen = model.ground_to_image(points)
        rows = np.flatnonzero(seen.flag == Flag.OK)
        ids.append(rows)
        product.append(np.full(len(rows), k))
        image.append(seen.image_px[rows])
    ties = TiePoints(np.concatenate(ids), np.concatenate(product), np.concatenate(image))
    covariance = diagonal_covariance(sigma_enu_m, len(points), 3)
    return ControlPoints(np.arange(len(points)), points, covariance, ties)


def predict(
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    geodetic: ArrayLike,
    check_geodetic: ArrayLike,
    *,
    sigma_enu_m: ArrayLike = 0.05,
    sigma_px: ArrayLike = 0.3,
) -> Plan:
    """Accuracy at `check_geodetic` (n, 3) with control at `geodetic` (m, 3).

    `sigma_enu_m`, one number, three, or (m, 3), is the control's own, `sigma_px` that of image
    points of control and later use alike. Nothing has to be measured.
    """
    control = measured_without_error(models, geodetic, sigma_enu_m)
    check = measured_without_error(models, check_geodetic, 1.0)
    done = adjust(
        models, blocks, control=control, check=check, control_sigma_px=sigma_px, robust=None
    )
    return Plan(done.check.covariance_enu_m2, done.names, done.sigma, done.weak)


def best_layout(
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    candidates: ArrayLike,
    check_geodetic: ArrayLike,
    count: int,
    *,
    sigma_enu_m: ArrayLike = 0.05,
    sigma_px: ArrayLike = 0.3,
) -> tuple[IntArray, FloatArray]:
    """Choose `count` of `candidates` (n, 3), one by one, each the most useful beside the others.

    Returns their numbers (count) and the expected 3-D root mean square error (count), metres,
    at `check_geodetic` after each.
    """
    control = of_control(
        "control", models, measured_without_error(models, candidates, sigma_enu_m), sigma_px
    )
    check = of_control(
        "check", models, measured_without_error(models, check_geodetic, 1.0), sigma_px
    )
    if not 1 <= count <= len(control):
        raise ArgumentError(f"layout: 1 .. {len(control)} points expected, got {count}")
    equations = equations_of(models, blocks)
    p = len(equations.S)
    zero = np.zeros(p)
    information = np.zeros((len(control), p, p))
    for group in groups(control, len(models)):
        linear = linearise(equations, control, group, zero)
        block = linear.A.transpose(0, 2, 1) @ linear.A
        information[np.ix_(group.points, linear.columns, linear.columns)] = block
    lines = [
        linearise(equations, check, group, zero, known=False)
        for group in groups(check, len(models))
    ]

    def expected_m2(covariance: FloatArray) -> float:
        traces = [
            np.trace(line.point_covariance(covariance), axis1=1, axis2=2)[line.strong]
            for line in lines
        ]
        return float(np.mean(np.concatenate(traces))) if traces else float("nan")

    total = np.eye(p)
    chosen: list[int] = []
    after = []
    for _ in range(count):
        best, best_m2 = -1, np.inf
        for i in range(len(control)):
            if i in chosen:
                continue
            value = expected_m2(np.linalg.inv(total + information[i]))
            if best < 0 or value < best_m2:
                best, best_m2 = i, value
        chosen.append(best)
        total = total + information[best]
        after.append(np.sqrt(best_m2))
    return np.array(chosen, dtype=np.int64), np.array(after)
