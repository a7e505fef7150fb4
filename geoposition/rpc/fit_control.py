"""RPCs from control points: few, with errors, and good for the terrain they lie on only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components, read_only
from geoposition.errors import ArgumentError
from geoposition.rpc.fit_build import RpcFit, build_fit
from geoposition.rpc.fit_grid import Normalisation, Samples
from geoposition.rpc.fit_ratio import fit_inverse
from geoposition.rpc.fit_region import FittedRegion
from geoposition.rpc.fit_solve import Denominators, FitOptions

_LEAST_POINTS = 10


@dataclass(frozen=True, slots=True, eq=False)
class ControlFit:
    """A fit to control points.

    `residual_px` (n, 2) is given − RPC at the points; `leave_one_out_px` (n, 2) is the same for
    each point with the RPC that the other points would give, to first order: what a new point
    may be expected to show.
    """

    fit: RpcFit
    residual_px: FloatArray
    leave_one_out_px: FloatArray


def fit_control(
    image_px: ArrayLike,
    geodetic: ArrayLike,
    sigma_px: ArrayLike | None = None,
    *,
    shape: tuple[int, int] | None = None,
    degree: int = 3,
    denominators: Denominators = "separate",
) -> ControlFit:
    """Fit an RPC to control points.

    All but the affine part is damped, as far as cross-validation asks for it, so ten points are
    enough for an answer; how good it is, `leave_one_out_px` says. Where the points leave the
    terrain open (heights that are a function of the place), so does the RPC: it holds on their
    surface only.

    Parameters
    ----------
    image_px, geodetic
        Image points (n, 2) and their ground (n, 3).
    sigma_px
        Standard deviations (n) of the image points.
    shape
        Image size (lines, samples), where it is known.
    degree, denominators
        As in `fit_model`.

    Raises
    ------
    ArgumentError
        Fewer than ten points, or unusable ones.
    GeometryError
        No usable RPC follows the points.
    """
    image = as_components(image_px, 2, "image_px")
    ground = as_components(geodetic, 3, "geodetic")
    if degree not in (1, 2, 3):
        raise ArgumentError(f"degree: 1, 2 or 3 expected, got {degree}")
    samples = Samples.of(image, ground)
    count = samples.image_px.shape[1]
    if count < _LEAST_POINTS:
        raise ArgumentError(
            f"RPC fit: at least {_LEAST_POINTS} control points expected, got {count}"
        )
    weight = None
    if sigma_px is not None:
        sigma = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), (count,))
        if not np.all((sigma > 0.0) & np.isfinite(sigma)):
            raise ArgumentError("sigma_px: positive numbers expected")
        weight = 1.0 / sigma**2
    normal = Normalisation.of(samples, shape)
    options = FitOptions(
        degree=degree, denominators=denominators, damp_numerators=True, minimise_maximum=False
    )
    inverse = fit_inverse(
        normal.ground(samples),
        normal.image(samples),
        normal.image_scale_px,
        options,
        weight,
    )
    residual = (inverse.ratios.residual * normal.image_scale_px[:, None]).T
    leverage = inverse.ratios.leverage
    assert leverage is not None  # asked for by `damp_numerators`
    alone = residual / np.maximum(1.0 - leverage.T, 1e-6)
    warnings = ("fitted to control points: good near them",)
    fit = build_fit(normal, inverse, None, FittedRegion.of(samples), shape, warnings)
    return ControlFit(fit, read_only(residual), read_only(alone))
