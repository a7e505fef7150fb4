"""Typical mistakes in control points, recognised by what would mend them.

Each mistake is a change of the table: rows and columns exchanged, longitude and latitude, pixels
counted from another origin, heights above the geoid, images mixed up. The table is adjusted as it
is and changed; a change that explains the measurements far better is said, never made. The same
changes are then tried on each rejected point alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from geoposition.adjust.adjustment import Adjustment, Rejection
from geoposition.adjust.control import selected_control
from geoposition.adjust.point_sets import of_control
from geoposition.adjust.robust import RobustOptions
from geoposition.adjust.solve import solve
from geoposition.adjust.unknowns import Block
from geoposition.arrays import FloatArray
from geoposition.errors import GeopositionError
from geoposition.observations import ControlPoints, TiePoints
from geoposition.sensor_model import SensorModel

Undulation = Callable[[FloatArray], FloatArray]
"""Geoid above the ellipsoid, metres (n,), at geodetic points (n, 3)."""

_LEAST_GAIN: Final = 30.0
"""Chi-square by which a changed table must be better: beyond any chance."""
_LEAST_PART: Final = 0.5
"""Part of the cost beyond the expected that a change may leave."""
_FITS_SIGMA: Final = 6.0
_ROW_FREEDOM: Final = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """A likely mistake: `name`, a sentence for people, the cost as given and as mended."""

    name: str
    message: str
    cost: float
    cost_mended: float


@dataclass(frozen=True, slots=True)
class _Change:
    name: str
    message: str
    control: ControlPoints


def diagnose(
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    control: ControlPoints,
    *,
    control_sigma_px: ArrayLike = 0.3,
    undulation_m: Undulation | None = None,
) -> tuple[Finding, ...]:
    """Mistakes that the whole table seems to have, the likeliest first.

    A cost is the chi-square of points and priors, a blunder or an unusable point counting as
    much as the least blunder. What the unknowns' priors leave free cannot be told: half a pixel
    beside an unknown shift, or heights beside an unknown base.
    """
    given = _cost(models, blocks, control, control_sigma_px)
    expected = 2.0 * (0 if control.image is None else len(control.image))
    found = []
    for change in _changes(control, undulation_m):
        cost = _cost(models, blocks, change.control, control_sigma_px)
        too_much, left = given - expected, max(cost - expected, 0.0)
        if given - cost > _LEAST_GAIN and left < _LEAST_PART * too_much:
            found.append(Finding(change.name, change.message, given, cost))
    return tuple(sorted(found, key=lambda finding: finding.cost_mended))


def explain_rejections(
    adjustment: Adjustment,
    control: ControlPoints,
    *,
    control_sigma_px: float = 0.3,
    undulation_m: Undulation | None = None,
) -> tuple[Rejection, ...]:
    """Rejections of `adjustment`, those of control points with a likely reason each."""
    place = {str(name): i for i, name in enumerate(control.ids.tolist())}
    out = []
    for rejection in adjustment.rejected:
        if rejection.role != "control":
            out.append(replace(rejection, reason="rays do not meet: a false match"))
            continue
        point = selected_control(control, np.array([place[rejection.id]]))
        reason = _reason(adjustment, control, point, control_sigma_px, undulation_m)
        out.append(replace(rejection, reason=reason))
    return tuple(out)


def _reason(
    adjustment: Adjustment,
    control: ControlPoints,
    point: ControlPoints,
    sigma_px: float,
    undulation_m: Undulation | None,
) -> str:
    assert point.image is not None
    models = adjustment.models
    for change in _changes(point, undulation_m):
        if np.all(_misfit_sigma(models, change.control, sigma_px) < _FITS_SIGMA):
            return change.message
    misfit = _misfit_sigma(models, point, sigma_px)
    for i in range(len(control)):
        if control.ids[i] == point.ids[0]:
            continue
        moved = ControlPoints(
            point.ids, control.geodetic[i : i + 1], point.covariance_enu_m2, point.image
        )
        if np.all(_misfit_sigma(models, moved, sigma_px) < _FITS_SIGMA):
            return f"measured at point {control.ids[i]}: identifiers mixed up"
    good = misfit < _FITS_SIGMA
    if len(misfit) > 1 and np.any(good):
        bad = ", ".join(str(k) for k in point.image.product[~good])
        return f"image point wrong in image {bad}"
    if len(misfit) > 1:
        return "ground position wrong, or the image points in all images"
    return "image point or ground position wrong"


def _misfit_sigma(
    models: Sequence[SensorModel], point: ControlPoints, sigma_px: float
) -> FloatArray:
    """Distance between measured and projected in each image, over its standard deviation."""
    assert point.image is not None
    out = np.full(len(point.image), np.inf)
    for k, product in enumerate(point.image.product):
        seen = models[int(product)].ground_to_image(point.geodetic[0]).image_px
        distance = float(np.hypot(*(point.image.image_px[k] - seen)))
        covariance = point.image.covariance_px2
        sigma = sigma_px if covariance is None else float(np.sqrt(np.trace(covariance[k]) / 2.0))
        if np.isfinite(distance):
            out[k] = distance / (np.sqrt(_ROW_FREEDOM) * sigma)
    return out


def _changes(control: ControlPoints, undulation_m: Undulation | None) -> Iterator[_Change]:
    """Tables as they would be without a mistake."""
    image = control.image
    assert image is not None

    def measured(image_px: FloatArray) -> ControlPoints:
        table = TiePoints(image.ids, image.product, image_px, image.covariance_px2)
        return replace(control, image=table)

    yield _Change("swapped-row-col", "row and column exchanged", measured(image.image_px[:, ::-1]))
    lon, lat, height = control.geodetic.T
    if np.all(np.abs(lon) <= 0.5 * np.pi):
        swapped = np.column_stack([lat, lon, height])
        yield _Change(
            "swapped-lon-lat",
            "longitude and latitude exchanged",
            replace(control, geodetic=swapped),
        )
    if undulation_m is not None:
        n_m = np.asarray(undulation_m(control.geodetic))
        if np.all(np.isfinite(n_m)):
            up = np.column_stack([lon, lat, height + n_m])
            down = np.column_stack([lon, lat, height - n_m])
            yield _Change(
                "orthometric-heights",
                "height is above the geoid, not the ellipsoid",
                replace(control, geodetic=up),
            )
            yield _Change(
                "geoid-applied-twice",
                "the geoid was added to a height above the ellipsoid",
                replace(control, geodetic=down),
            )
    for a, b in combinations(np.unique(image.product).tolist(), 2):
        other = image.product.copy()
        other[image.product == a], other[image.product == b] = b, a
        table = TiePoints(image.ids, other, image.image_px, image.covariance_px2)
        yield _Change(
            "wrong-image",
            f"measurements of images {a} and {b} exchanged",
            replace(control, image=table),
        )
    for shift, text in (
        (0.5, "half a pixel: counted from the first pixel's corner, not its centre"),
        (-0.5, "half a pixel: counted from half a pixel before the first pixel's centre"),
        (1.0, "one pixel: counted from 1"),
    ):
        yield _Change(f"pixel-origin{-shift:+g}", text, measured(image.image_px - shift))


def _cost(
    models: Sequence[SensorModel],
    blocks: Sequence[Block],
    control: ControlPoints,
    sigma_px: ArrayLike,
) -> float:
    """Return the truncated cost of the adjustment of `control` alone."""
    options = RobustOptions(adapt=False)
    try:
        points = of_control("control", models, control, sigma_px)
        solved = solve(models, blocks, [points], options)
    except GeopositionError:
        return float("inf")
    limits = [float(lim[0]) for lim in solved.robust.limit if len(lim)]
    limit = max(limits, default=_LEAST_GAIN)
    used = sum(int(u.sum()) for u in solved.robust.used)
    return solved.history[-1].cost + limit * (len(control) - used)
