"""RPCs from any sensor model, from samples of one, or from control points.

`fit_model` samples a model on a virtual grid in space, so the terrain does not matter;
`fit_samples` takes a producer's own grid. `fit_control` (`rpc.fit_control`) takes points with
errors, and depends on the terrain.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError
from geoposition.rpc.fit_build import RpcFit, build_direct, build_fit
from geoposition.rpc.fit_check import check_fit, cube_range
from geoposition.rpc.fit_grid import Normalisation, Samples, axes, sample_model, widened
from geoposition.rpc.fit_ratio import Fitted, fit_inverse
from geoposition.rpc.fit_region import FittedRegion
from geoposition.rpc.fit_solve import Denominators, FitOptions
from geoposition.sensor_model import SensorModel

NODES: Final = (151, 11, 7)
"""Lines, samples and heights of the virtual grid: dense in time, where motion is."""

LIMIT_PX: Final = 1.0
"""A fit that misses the model by more than this is refused unless more is asked for."""

_POLAR_DEG: Final = 80.0
_LEAST_IN_CUBE: Final = 0.3
_LEAST_DENOMINATOR: Final = 0.5
_COSTS_LITTLE: Final = 1.5
_LITTLE_PX: Final = 5e-3
_LEAST_SAMPLES: Final = 40


def fit_model(
    model: SensorModel,
    heights_m: tuple[float, float] | None = None,
    *,
    degree: int = 3,
    denominators: Denominators = "separate",
    direct: bool = True,
    nodes: tuple[int, int, int] = NODES,
    limit_px: float = LIMIT_PX,
) -> RpcFit:
    """Fit an RPC to `model` over its whole image, and check it between the nodes.

    Parameters
    ----------
    heights_m
        Lowest and highest ellipsoidal height, by default those of `model`; at least 100 m.
    degree
        Of the polynomials, 1 to 3.
    denominators
        "separate" for line and sample, or one "equal" for both.
    direct
        Whether to fit image to ground, too.
    nodes
        Lines, samples and heights of the grid.
    limit_px
        Largest misfit at the check grid that is accepted.

    Raises
    ------
    ArgumentError
        Unusable heights, degree or nodes.
    GeometryError
        The model does not answer, the image is around a pole, or no ratio of polynomials
        follows the model to `limit_px`.
    """
    heights = widened(model.height_range_m if heights_m is None else heights_m)
    if min(nodes) < degree + 2:
        raise ArgumentError(f"nodes: at least {degree + 2} along each axis expected, got {nodes}")
    line, samp, height = axes(model.shape, heights, nodes)
    samples = sample_model(model, line, samp, height)
    options = FitOptions(degree=_degree(degree), denominators=denominators)
    fit = _fit(samples, model.shape, options, direct)
    check = check_fit(model, fit.model, line, samp, height)
    refuse_beyond(limit_px, check.largest_px, fit.region)
    if check.den_range[:, 0].min() < _LEAST_DENOMINATOR:
        raise GeometryError("RPC fit: a denominator comes near zero between the nodes of the grid")
    rpc = replace(fit.model, fit_error_px=(check.row.rms, check.col.rms))
    warnings = list(fit.warnings)
    if check.missed:
        warnings.append(f"{check.missed} points of the check grid have no result")
    return replace(fit, model=rpc, check=check, warnings=tuple(warnings))


def fit_samples(
    image_px: FloatArray,
    geodetic: FloatArray,
    *,
    shape: tuple[int, int] | None = None,
    degree: int = 3,
    denominators: Denominators = "separate",
    direct: bool = True,
) -> RpcFit:
    """Fit an RPC to exact samples of a model: a producer's location grid, for instance.

    Parameters
    ----------
    image_px, geodetic
        Image points (..., 2) and their ground (..., 3), which must fill the image and a range
        of heights.
    shape
        Image size (lines, samples), where it is known.
    """
    options = FitOptions(degree=_degree(degree), denominators=denominators)
    samples = Samples.of(
        np.asarray(image_px, dtype=np.float64), np.asarray(geodetic, dtype=np.float64)
    )
    return _fit(samples, shape, options, direct)


def refuse_beyond(limit_px: float, largest_px: float, region: FittedRegion) -> None:
    """Refuse a fit that misses its model by more than `limit_px`, with the likely reason."""
    if largest_px <= limit_px:
        return
    latitude = max(abs(region.lat_deg[0]), abs(region.lat_deg[1]))
    reason = (
        f"the image reaches latitude {latitude:.2f}, where longitude is no smooth coordinate"
        if latitude > _POLAR_DEG
        else "motion within the image, or a camera or height range too wide for cubics"
    )
    raise GeometryError(
        f"RPC fit: it misses the model by up to {largest_px:.3g} px, {limit_px:g} px is the "
        f"limit: {reason}"
    )


def _degree(degree: int) -> int:
    if degree not in (1, 2, 3):
        raise ArgumentError(f"degree: 1, 2 or 3 expected, got {degree}")
    return degree


def _fit(
    samples: Samples, shape: tuple[int, int] | None, options: FitOptions, direct: bool
) -> RpcFit:
    if samples.image_px.shape[1] < _LEAST_SAMPLES:
        raise ArgumentError(
            f"RPC fit: at least {_LEAST_SAMPLES} samples expected, got {samples.image_px.shape[1]}"
        )
    normal = Normalisation.of(samples, shape)
    image, ground = normal.image(samples), normal.ground(samples)
    with ThreadPoolExecutor(max_workers=1) as beside:
        other = beside.submit(build_direct, normal, image, ground, options) if direct else None
        inverse, warnings = _tame_inverse(normal, ground, image, options)
    found = other.result() if other else None
    return build_fit(normal, inverse, found, FittedRegion.of(samples), shape, warnings)


def _tame_inverse(
    normal: Normalisation, ground: FloatArray, image: FloatArray, options: FitOptions
) -> tuple[Fitted, tuple[str, ...]]:
    """Damp more where a denominator vanishes in the normalised cube, if that costs little."""
    first = inverse = fit_inverse(ground, image, normal.image_scale_px, options)
    limit = max(_COSTS_LITTLE * _largest_px(first, normal), _LITTLE_PX)
    while cube_range(inverse.den)[:, 0].min() < _LEAST_IN_CUBE:
        strength = 100.0 * float(inverse.ratios.strength.min())
        inverse = fit_inverse(
            ground, image, normal.image_scale_px, replace(options, least_strength=strength)
        )
        if _largest_px(inverse, normal) > limit:
            return first, (
                "a denominator vanishes for ground that is within offset ± scale, "
                "but is not in the image at any height fitted to",
            )
    return inverse, ()


def _largest_px(fitted: Fitted, normal: Normalisation) -> float:
    return float((np.abs(fitted.ratios.residual).max(axis=1) * normal.image_scale_px).max())
