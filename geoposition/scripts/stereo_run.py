"""A stereo run: ties from the images, intersection, relative bias, check points, table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoposition.accuracy import point_statistics
from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError, ProductError
from geoposition.flags import Flag, flag_labels, has_result
from geoposition.matching import match_images
from geoposition.matching.image import ImageSource, open_image
from geoposition.observations import TiePoints
from geoposition.product import Product
from geoposition.rpc.model import RpcModel
from geoposition.scripts.point_tables import flag_counts, ground_columns
from geoposition.scripts.results import Progress
from geoposition.scripts.tables import PARQUET_SUFFIXES, VECTOR_DRIVERS, Column, write_points
from geoposition.scripts.tie_tables import Checks, common
from geoposition.sensor_model import GroundPoints
from geoposition.triangulate import IntersectedPoints, triangulate
from geoposition.triangulate.bias import RelativeBias, relative_bias

SUFFIXES = tuple(sorted({".csv", *PARQUET_SUFFIXES, *VECTOR_DRIVERS}))

_FIRST_SIGMA_PX = 0.5
_LEAST_SIGMA_PX = 0.01
"""No measurement of image points is better, however well synthetic ones agree."""


@dataclass(frozen=True, slots=True)
class StereoRun:
    """Intersected points and what there is to say about them, fit for JSON."""

    points: IntersectedPoints
    summary: dict[str, object]


def match_products(
    products: Sequence[Product], images: Sequence[Path], progress: Progress
) -> TiePoints:
    """Tie points of all products, found in their images."""
    if images and len(images) != len(products):
        raise ArgumentError(f"--image: one for each of {len(products)} products expected")
    sources = [_image(product, images[i] if images else None) for i, product in enumerate(products)]
    return match_images(sources, [product.model for product in products], progress=progress)


def _image(product: Product, path: Path | None) -> ImageSource:
    if path is None and product.image_path is None:
        raise ProductError(product.path, "", "no image lies beside it: name it with --image")
    path = path or product.image_path
    assert path is not None
    if path == product.path and isinstance(product.model, RpcModel):
        # The RPC read from an image is in that image's own pixels, crop or not.
        return open_image(path, first_pixel=(0, 0))
    return open_image(path)


def intersect(
    products: Sequence[Product],
    ties: TiePoints,
    sigma_px: float | None,
    checks: Checks | None,
    progress: Progress,
) -> StereoRun:
    """Triangulate the ties and describe the result.

    Without `sigma_px` the image points' standard deviation is taken from the scatter of the
    residuals about each image's bias.
    """
    models = [product.model for product in products]
    points = triangulate(models, ties, sigma_px or _FIRST_SIGMA_PX, progress=progress)
    biases = relative_bias(ties, points)
    if sigma_px is None:
        noise = [bias.noise_px for bias in biases if np.isfinite(bias.noise_px)]
        sigma_px = float(np.sqrt(np.mean(np.square(noise)))) if noise else 0.0
        sigma_px = max(sigma_px, _LEAST_SIGMA_PX)
        points = triangulate(models, ties, sigma_px, progress=progress)
    good = points.flag == Flag.OK
    if not np.any(has_result(points.flag)):
        reasons = ", ".join(f"{n} {name}" for name, n in flag_counts(points.flag).items())
        raise GeometryError(f"intersect: no point has a result ({reasons})")
    residual = points.residual_px[good]
    summary: dict[str, object] = {
        "products": [str(product.path) for product in products],
        "matches": len(points.ids),
        "intersected": int(good.sum()),
        "flags": flag_counts(points.flag),
        "residual_px": {
            "median": float(np.median(residual)) if good.any() else None,
            "p95": float(np.percentile(residual, 95)) if good.any() else None,
        },
        "sigma_px": sigma_px,
        "convergence_deg": float(np.degrees(np.nanmedian(points.convergence_rad))),
        "height_m": {
            "median": float(np.nanmedian(points.geodetic[:, 2])),
            "min": float(np.nanmin(points.geodetic[:, 2])),
            "max": float(np.nanmax(points.geodetic[:, 2])),
        },
        "relative_bias_px": [_bias(bias) for bias in biases],
    }
    if checks is not None:
        summary |= _check(points, checks)
    return StereoRun(points, summary)


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


def _check(points: IntersectedPoints, checks: Checks) -> dict[str, object]:
    rows, check_rows = common(points.ids, checks)
    used = has_result(points.flag[rows])
    rows, check_rows = rows[used], check_rows[used]
    if not len(rows):
        raise GeometryError("--gcps: none of its points is among the intersected ones (by id)")
    found = point_statistics(points.geodetic[rows], checks.geodetic[check_rows])
    axes = found.axes
    return {
        "checked": len(rows),
        "rmse_m": {name: axis.rmse for name, axis in axes.items()},
        "check": found.as_dict(),
    }


def write(output: Path, run: StereoRun) -> None:
    """Write id,lon,lat,height,sigma_e,sigma_n,sigma_u,residual_px,rays,flag."""
    points = run.points
    sigma: FloatArray = np.round(points.sigma_enu_m, 6)
    columns: dict[str, Column] = {"id": points.ids}
    columns |= ground_columns(GroundPoints(points.geodetic, points.flag))
    columns |= {f"sigma_{axis}": sigma[:, i] for i, axis in enumerate("enu")}
    columns |= {
        "residual_px": np.round(points.residual_px, 6),
        "rays": points.rays,
        "flag": flag_labels(points.flag),
    }
    write_points(output, columns)
