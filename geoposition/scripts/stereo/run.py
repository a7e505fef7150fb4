"""A stereo run: ties from the images, intersection, relative bias, checks, table, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.accuracy import error_ellipsoids
from geoposition.arrays import FloatArray
from geoposition.error_budget import ModelError
from geoposition.errors import ArgumentError
from geoposition.flags import Flag, flag_labels
from geoposition.intersect import MIN_CONVERGENCE_RAD
from geoposition.matching import MatchOptions, match_images
from geoposition.observations import TiePoints
from geoposition.product import Product
from geoposition.scripts.point_tables import flag_counts, ground_columns
from geoposition.scripts.product_images import image_of
from geoposition.scripts.results import Progress
from geoposition.scripts.stereo.bias import Removal, remove_bias
from geoposition.scripts.stereo.checks import (
    HeightDifferences,
    PointChecks,
    check_points,
    compare_heights,
)
from geoposition.scripts.stereo.errors import StatedSigmas, describe_error, model_errors
from geoposition.scripts.stereo.sense import require_sense
from geoposition.scripts.tables import PARQUET_SUFFIXES, VECTOR_DRIVERS, Column, write_points
from geoposition.scripts.tie_tables import Checks
from geoposition.sensor_model import GroundPoints, SensorModel
from geoposition.triangulate import IntersectedPoints, triangulate
from geoposition.triangulate.bias import RelativeBias, relative_bias

SUFFIXES = tuple(sorted({".csv", *PARQUET_SUFFIXES, *VECTOR_DRIVERS}))

_FIRST_SIGMA_PX: Final = 0.5
_LEAST_SIGMA_PX: Final = 0.01
"""No measurement of image points is better, however well synthetic ones agree."""


@dataclass(frozen=True, slots=True)
class Options:
    """What is asked of a run beside its products and ties.

    `sigma_px` of image points; None takes it from the scatter of the residuals about each
    image's bias.
    """

    sigma_px: float | None = None
    min_convergence_deg: float = float(np.degrees(MIN_CONVERGENCE_RAD))
    stated: StatedSigmas = field(default_factory=StatedSigmas)
    remove_bias: bool = False
    checks: Checks | None = None
    reference: Path | None = None
    geoid: Path | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_convergence_deg < 90.0:
            raise ArgumentError(
                f"--min-convergence: 0 .. 90 degrees expected, got {self.min_convergence_deg}"
            )
        if self.geoid is not None and self.reference is None:
            raise ArgumentError("--geoid: with --reference only")


@dataclass(frozen=True, slots=True, eq=False)
class StereoRun:
    """Intersected points and all there is to say about them; `summary` is fit for JSON."""

    products: tuple[Product, ...]
    models: tuple[SensorModel, ...]
    ties: TiePoints
    points: IntersectedPoints
    before: IntersectedPoints | None
    biases: tuple[RelativeBias, ...]
    removal: Removal | None
    checks: PointChecks | None
    differences: HeightDifferences | None
    summary: dict[str, object]


def match_products(
    products: Sequence[Product],
    images: Sequence[Path],
    progress: Progress,
    options: MatchOptions | None = None,
) -> TiePoints:
    """Tie points of all products, found in their images."""
    if images and len(images) != len(products):
        raise ArgumentError(f"--image: one for each of {len(products)} products expected")
    sources = [
        image_of(product, images[i] if images else None) for i, product in enumerate(products)
    ]
    return match_images(sources, [product.model for product in products], options, progress)


def intersect(
    products: Sequence[Product], ties: TiePoints, options: Options, progress: Progress
) -> StereoRun:
    """Triangulate the ties and describe the result."""
    models: tuple[SensorModel, ...] = tuple(product.model for product in products)
    errors = model_errors(products, options.stated)
    least = float(np.radians(options.min_convergence_deg))

    def solve(
        models: Sequence[SensorModel], sigma_px: float, errors: Sequence[ModelError | None] | None
    ) -> IntersectedPoints:
        return triangulate(
            models, ties, sigma_px, errors=errors, min_convergence_rad=least, progress=progress
        )

    points = solve(models, options.sigma_px or _FIRST_SIGMA_PX, None)
    require_sense(products, ties, points, least)
    biases = relative_bias(ties, points)
    before, removal = None, None
    if options.remove_bias:
        before, removal = points, remove_bias(models, ties, points)
        models = removal.models
        points = solve(models, options.sigma_px or _FIRST_SIGMA_PX, None)
    sigma_px = options.sigma_px or _scatter_px(relative_bias(ties, points))
    if options.sigma_px is None or any(error is not None for error in errors):
        points = solve(models, sigma_px, errors)
    good = points.flag == Flag.OK
    residual = points.residual_px[good]
    summary: dict[str, object] = {
        "products": [str(product.path) for product in products],
        "models": ["rigorous" if product.is_rigorous else "rpc" for product in products],
        "matches": len(points.ids),
        "intersected": int(good.sum()),
        "flags": flag_counts(points.flag),
        "weak": int(np.sum(points.weak)),
        "rejected_rays": [int(points.rejected[ties.of_product(k)].sum())
                          for k in range(len(products))],
        "residual_px": _spread(residual),
        "sigma_px": sigma_px,
        **_geometry(points),
        "height_m": {
            "median": float(np.nanmedian(points.geodetic[:, 2])),
            "min": float(np.nanmin(points.geodetic[:, 2])),
            "max": float(np.nanmax(points.geodetic[:, 2])),
        },
        "relative_bias_px": [_bias(bias) for bias in biases],
        "bias_removed": removal is not None,
        "model_sigma": [describe_error(error) for error in errors],
        "sigma_enu_m": _sigmas(points),
    }  # fmt: skip
    if before is not None and removal is not None:
        was = before.residual_px[before.flag == Flag.OK]
        summary["residual_before_removal_px"] = _spread(was)
        summary["bias_removal"] = removal.as_dicts()
    checks = None if options.checks is None else check_points(points, options.checks)
    if checks is not None:
        summary |= checks.as_dict()
    differences = None
    if options.reference is not None:
        differences = compare_heights(points, options.reference, options.geoid)
        summary["reference"] = differences.as_dict()
    return StereoRun(tuple(products), models, ties, points, before, biases, removal, checks,
                     differences, summary)  # fmt: skip


def _scatter_px(biases: Sequence[RelativeBias]) -> float:
    noise = [bias.noise_px for bias in biases if np.isfinite(bias.noise_px)]
    return max(float(np.sqrt(np.mean(np.square(noise)))) if noise else 0.0, _LEAST_SIGMA_PX)


def _spread(residual_px: FloatArray) -> dict[str, float | None]:
    if not residual_px.size:
        return {"median": None, "p95": None}
    return {
        "median": float(np.median(residual_px)),
        "p95": float(np.percentile(residual_px, 95)),
    }


def _geometry(points: IntersectedPoints) -> dict[str, object]:
    """Convergence, and the base-to-height ratio of a symmetric pair that has it."""
    angle = float(np.nanmedian(points.convergence_rad))
    return {
        "convergence_deg": float(np.degrees(angle)),
        "base_to_height": float(2.0 * np.tan(0.5 * angle)),
    }


def _sigmas(points: IntersectedPoints) -> dict[str, dict[str, float]]:
    """Medians over the points of the standard deviations: all, from image points, from models."""
    parts = {
        "total": points.covariance_enu_m2,
        "image_points": points.random_enu_m2,
        "models": points.systematic_enu_m2,
    }
    return {
        name: {
            axis: float(np.sqrt(max(np.nanmedian(covariance[:, k, k]), 0.0)))
            for k, axis in enumerate("enu")
        }
        for name, covariance in parts.items()
    }


def _bias(bias: RelativeBias) -> dict[str, object]:
    """One image's share of the disagreement, as (row, col)."""
    return {
        "product": bias.product,
        "residual": bias.residual_px.tolist(),
        "residual_sigma": bias.residual_sigma_px.tolist(),
        "bias": bias.bias_px.tolist(),
        "bias_sigma": bias.bias_sigma_px.tolist(),
        "observable_directions": len(bias.observable),
        "noise": bias.noise_px,
        "count": bias.count,
    }


def write(output: Path, run: StereoRun, covariance: bool = False) -> None:
    """Write the points; with `covariance` also the covariances and error ellipsoids.

    Columns: id,lon,lat,height,sigma_e,sigma_n,sigma_u,residual_px,rays,flag,convergence_deg,
    weak,rejected. Sigmas hold all stated errors; `rejected` are the products whose rays were
    found wrong and left out.
    """
    points = run.points
    sigma: FloatArray = np.round(points.sigma_enu_m, 6)
    columns: dict[str, Column] = {"id": points.ids}
    columns |= ground_columns(GroundPoints(points.geodetic, points.flag))
    columns |= {f"sigma_{axis}": sigma[:, i] for i, axis in enumerate("enu")}
    columns |= {
        "residual_px": _rounded(points.residual_px, 6),
        "rays": points.rays,
        "flag": flag_labels(points.flag),
        "convergence_deg": _rounded(np.degrees(points.convergence_rad), 5),
        "weak": points.weak.astype(np.int64),
        "rejected": _rejected(run),
    }
    if covariance:
        columns |= _covariance_columns(points)
    write_points(output, columns)


def _rounded(values: FloatArray, digits: int) -> FloatArray:
    return np.asarray(np.round(values, digits), dtype=np.float64)


def _rejected(run: StereoRun) -> Column:
    """Numbers of the products whose rays were left out, by point, separated by blanks."""
    wrong = np.flatnonzero(run.points.rejected)
    texts = [""] * len(run.points.ids)
    for row in wrong:
        at = int(run.points.point[row])
        texts[at] = f"{texts[at]} {run.ties.product[row]}".strip()
    return np.array(texts, dtype=np.str_)


def _covariance_columns(points: IntersectedPoints) -> dict[str, Column]:
    columns: dict[str, Column] = {}
    for prefix, covariance in (("c", points.covariance_enu_m2), ("s", points.systematic_enu_m2)):
        for i, a in enumerate("enu"):
            for j, b in enumerate("enu"):
                if j >= i:
                    columns[f"{prefix}_{a}{b}"] = np.round(covariance[:, i, j], 8)
    ellipsoids = error_ellipsoids(points.covariance_enu_m2)
    for k in range(3):
        columns[f"axis{k + 1}_m"] = np.round(ellipsoids.semi_axis_m[:, k], 6)
        columns[f"azimuth{k + 1}_deg"] = np.round(ellipsoids.azimuth_deg[:, k], 3)
        columns[f"elevation{k + 1}_deg"] = np.round(ellipsoids.elevation_deg[:, k], 3)
    return columns
