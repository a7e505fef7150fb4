"""A stereo run: ties from the images, intersection, relative bias, check points, table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoposition.accuracy import point_statistics
from geoposition.errors import ArgumentError, GeometryError, ProductError
from geoposition.flags import Flag, flag_labels, has_result
from geoposition.matching import match_pair
from geoposition.matching_image import ImageSource, open_image
from geoposition.observations import TiePoints
from geoposition.product import Product
from geoposition.rpc.model import RpcModel
from geoposition.scripts.point_tables import flag_counts, ground_columns
from geoposition.scripts.results import Progress
from geoposition.scripts.tables import PARQUET_SUFFIXES, VECTOR_DRIVERS, Column, write_points
from geoposition.scripts.tie_tables import Checks, common
from geoposition.sensor_model import GroundPoints
from geoposition.triangulate import IntersectedPoints, triangulate
from geoposition.triangulate_bias import RelativeBias, relative_bias

SUFFIXES = tuple(sorted({".csv", *PARQUET_SUFFIXES, *VECTOR_DRIVERS}))


@dataclass(frozen=True, slots=True)
class StereoRun:
    """Intersected points and what there is to say about them, fit for JSON."""

    points: IntersectedPoints
    summary: dict[str, object]


def match_products(
    products: Sequence[Product], images: Sequence[Path], progress: Progress
) -> TiePoints:
    """Tie points of each product with the first; points of several pairs stay apart."""
    if images and len(images) != len(products):
        raise ArgumentError(f"--image: one for each of {len(products)} products expected")
    sources = [
        _image(product, images[i] if images else None) for i, product in enumerate(products)
    ]
    parts = []
    for second in range(1, len(products)):
        pair = match_pair(
            sources[0], products[0].model, sources[second], products[second].model, None, progress
        )
        parts.append((second, pair))
    ids = [
        np.char.add(f"{second}-" if len(products) > 2 else "", pair.ids.astype(np.str_))
        for second, pair in parts
    ]
    return TiePoints(
        np.concatenate(ids),
        np.concatenate([np.where(pair.product == 0, 0, second) for second, pair in parts]),
        np.concatenate([pair.image_px for _, pair in parts]),
    )


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
    sigma_px: float,
    checks: Checks | None,
    progress: Progress,
) -> StereoRun:
    """Triangulate the ties and describe the result."""
    models = [product.model for product in products]
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
        "convergence_deg": float(np.degrees(np.nanmedian(points.convergence_rad))),
        "height_m": {
            "median": float(np.nanmedian(points.geodetic[:, 2])),
            "min": float(np.nanmin(points.geodetic[:, 2])),
            "max": float(np.nanmax(points.geodetic[:, 2])),
        },
        "relative_bias_px": [_bias(bias) for bias in relative_bias(ties, points)],
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
    sigma = np.sqrt(np.diagonal(points.covariance_enu_m2, axis1=-2, axis2=-1))
    columns: dict[str, Column] = {"id": np.asarray(points.ids)}
    columns |= ground_columns(GroundPoints(points.geodetic, points.flag))
    columns |= {f"sigma_{axis}": np.round(sigma[:, i], 6) for i, axis in enumerate("enu")}
    columns |= {
        "residual_px": np.round(points.residual_px, 6),
        "rays": points.rays,
        "flag": flag_labels(points.flag),
    }
    write_points(output, columns)
