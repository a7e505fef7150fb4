"""A dense run: ties, relative bias, coarse surface, points, gridded surface, comparison."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.datum import utm_epsg
from geoposition.dense import (
    HeightField,
    Tally,
    View,
    coarse_surface,
    dense_points,
    level_field,
    shifted_models,
    terrain_field,
)
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import has_result
from geoposition.longitudes import middle_of
from geoposition.matching import ImageSource, MatchOptions, match_images
from geoposition.observations import TiePoints
from geoposition.product import Product
from geoposition.scripts.dsm_agreement import Agreement, agree, require_own_images
from geoposition.scripts.product_images import image_of
from geoposition.scripts.results import Progress
from geoposition.scripts.tables import whole_file
from geoposition.surface import (
    DsmGrid,
    PointCloud,
    Surface,
    compare_surface,
    is_geographic,
    map_extent,
    near_degrees,
    to_map,
)
from geoposition.terrain import RasterTerrain

_MATCHING: Final = {"tile_px": 384, "max_tiles": 12, "tile_features": 1500}
"""Ties for the bias and the heights' range: some thousands are plenty."""
_FIELD_STEP_PX: Final = 64.0
_HEIGHT_MARGIN_M: Final = 20.0
_HEIGHT_MARGIN_SHARE: Final = 0.25
_EDGE_PX: Final = 64.0
_EDGE_CELLS: Final = 16
_DEGREE_M: Final = 111320.0
_MOST_NODES: Final = 100_000


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of a run; `None` is left to it."""

    output: Path
    points: Path | None = None
    resolution: float | None = None
    crs: str | None = None
    heights_m: tuple[float, float] | None = None
    dem: Path | None = None
    dem_geoid: Path | None = None
    remove_bias: bool = False
    fill: bool = False
    reference: Path | None = None
    geoid: Path | None = None


def run(
    products: Sequence[Product],
    images: Sequence[Path],
    request: Request,
    progress: Progress,
    ties: TiePoints | None = None,
) -> dict[str, object]:
    """Make the surface, and the point cloud if asked for; returns facts fit for JSON.

    `ties`, found by matching unless given, say how the images lie to each other and how high
    the ground is.
    """
    begin = perf_counter()
    if request.heights_m is not None and not request.heights_m[0] < request.heights_m[1]:
        raise ArgumentError(f"--heights: low to high expected, got {request.heights_m}")
    if request.crs is not None:
        is_geographic(_crs_name(request.crs))
    sources = _sources(products, images)
    models = [product.model for product in products]
    if ties is None:
        options = MatchOptions(heights_m=request.heights_m, **_MATCHING)
        ties = match_images(sources, models, options, progress)
    agreement = agree(models, ties)
    require_own_images(products, models, ties, agreement)
    reference = _reference(request, agreement)
    matching = shifted_models(models, agreement.shifts_px)
    views = [
        View(source, mended if request.remove_bias else model, mended)
        for source, model, mended in zip(sources, models, matching, strict=True)
    ]
    start = starting_field(views[0], agreement, request)
    somewhere = np.median(agreement.first_px, axis=0)
    coarse = coarse_surface(views, start, somewhere, progress=progress)
    crs, resolution = _system(views[0], agreement, request)
    low, high = _extent(views, coarse, crs)
    edge = _EDGE_CELLS * resolution
    grid = DsmGrid.around(crs, resolution, low - edge, high + edge)
    matched = perf_counter()
    facts = {
        "products": [str(product.path) for product in products],
        "ties": int(np.sum(ties.product == 0)),
        "relative_bias_px": _biases(agreement, request.remove_bias),
        "residual_px": dict(zip(("as_is", "bias_removed"), agreement.residual_px, strict=True)),
    }
    facts |= _written(views, coarse, grid, agreement, request, reference, facts, progress)
    facts["seconds"] = {
        "ties_and_coarse": round(matched - begin, 2),
        "dense_to_surface": round(perf_counter() - matched, 2),
    }
    return facts | {"output": str(request.output)}


def _reference(request: Request, agreement: Agreement) -> RasterTerrain | None:
    """Open the reference; one that lies elsewhere is refused before the long work begins."""
    if request.reference is None:
        return None
    terrain = RasterTerrain(request.reference, request.geoid)
    if not has_result(terrain.height_at(agreement.geodetic).flag).any():
        raise GeometryError(
            f"{request.reference}: the reference has no heights where the images are"
        )
    return terrain


def starting_field(first: View, agreement: Agreement, request: Request) -> HeightField:
    """Heights to start from, and how far from them the ground may lie."""
    extent, heights = first.source.extent, agreement.geodetic[:, 2]
    if request.heights_m is not None:
        low, high = request.heights_m
        middle = 0.5 * (low + high)
        return level_field(extent, middle, _FIELD_STEP_PX).within(low - middle, high - middle)
    if request.dem is not None:
        terrain = RasterTerrain(request.dem, request.dem_geoid)
        try:
            field = terrain_field(first.matching, terrain, extent, _FIELD_STEP_PX)
        except GeometryError as error:
            raise GeometryError(f"{request.dem}: {error}") from None
    else:
        field = level_field(extent, float(np.median(heights)), _FIELD_STEP_PX)
    beside = np.percentile(heights - field.at(agreement.first_px), [0.5, 99.5])
    margin = max(_HEIGHT_MARGIN_M, _HEIGHT_MARGIN_SHARE * float(beside[1] - beside[0]))
    return field.within(float(beside[0]) - margin, float(beside[1]) + margin)


def _written(
    views: Sequence[View],
    coarse: HeightField,
    grid: DsmGrid,
    agreement: Agreement,
    request: Request,
    reference: RasterTerrain | None,
    facts: dict[str, object],
    progress: Progress,
) -> dict[str, object]:
    """Match all tiles, write the surface and the cloud: whole or not at all."""
    tally = Tally()
    degrees = is_geographic(grid.crs)
    middle = middle_of(agreement.geodetic)
    with ExitStack() as stack:
        target = stack.enter_context(whole_file(request.output))
        scratch = stack.enter_context(TemporaryDirectory(prefix=".dsm-", dir=request.output.parent))
        surface = stack.enter_context(Surface(grid, scratch, float(middle[2])))
        cloud_path = request.points and stack.enter_context(whole_file(request.points))
        with ExitStack() as open_files:
            cloud = None
            if cloud_path:
                origin = to_map(grid.crs, middle[None])[0]
                cloud = open_files.enter_context(PointCloud(cloud_path, grid.crs, origin))
            for points in dense_points(views, coarse, tally=tally, progress=progress):
                place = to_map(grid.crs, points.geodetic, degrees)
                if degrees:
                    place = near_degrees(place, grid.west)
                surface.add(place, points.sigma_m)
                if cloud is not None:
                    cloud.add(place, points.sigma_m, points.grey, points.rays)
        if surface.points == 0:
            raise GeometryError("dsm: no pixel of the images could be matched")
        surface.write(target, fill=request.fill, tags=_tags(facts))
        comparison = None
        if reference is not None:
            comparison = compare_surface(target, reference).as_dict()
    top, left, bottom, right = surface.bounds
    return {
        "crs": grid.crs,
        "resolution": grid.resolution,
        "shape": [bottom - top, right - left],
        "points": surface.points,
        "matched_share": tally.points / max(tally.tried, 1),
        "pixels_tried": tally.tried,
        "epipolar_residual_px": tally.epipolar_residual_px,
        "disparities_px": float(np.median(tally.disparities)),
        "points_file": None if request.points is None else str(request.points),
        "comparison": comparison,
    }


def _sources(products: Sequence[Product], images: Sequence[Path]) -> list[ImageSource]:
    if images and len(images) != len(products):
        raise ArgumentError(f"--image: one for each of {len(products)} products expected")
    return [image_of(product, images[i] if images else None) for i, product in enumerate(products)]


def _biases(agreement: Agreement, removed: bool) -> list[dict[str, object]]:
    return [
        {"product": k, "row_col": shift.tolist(), "removed": removed}
        for k, shift in enumerate(agreement.shifts_px)
    ]


def _tags(facts: dict[str, object]) -> dict[str, str]:
    products = facts["products"]
    assert isinstance(products, list)
    return {
        "PRODUCTS": ", ".join(Path(product).name for product in products),
        "RELATIVE_BIAS_PX": str(facts["relative_bias_px"]),
        "BANDS": "height; count of points; error: standard deviation from matching alone",
    }


def _crs_name(crs: str) -> str:
    return f"EPSG:{crs}" if crs.isdecimal() else crs


def _system(first: View, agreement: Agreement, request: Request) -> tuple[str, float]:
    """Coordinate system and cell size: as asked, else the UTM zone and the image's own."""
    middle = middle_of(agreement.geodetic)
    crs = f"EPSG:{utm_epsg(middle[0], middle[1])}" if request.crs is None else request.crs
    crs = _crs_name(crs)
    if request.resolution is not None:
        return crs, request.resolution
    place = np.median(agreement.first_px, axis=0) + np.array([[0, 0], [1, 0], [0, 1]])
    ground = geodetic_to_ecef(first.model.image_to_ground(place, middle[2]).geodetic)
    sample_m = float(np.mean(np.linalg.norm(ground[1:] - ground[0], axis=1)))
    return crs, float(f"{sample_m / (_DEGREE_M if is_geographic(crs) else 1.0):.2g}")


def _extent(views: Sequence[View], coarse: HeightField, crs: str) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest map coordinates (2,) of the ground that several images show."""
    nodes = coarse.node_px().reshape(-1, 2)
    step = max(1, len(nodes) // _MOST_NODES)
    nodes, height = nodes[::step], coarse.height_m.reshape(-1)[::step].astype(np.float64)
    ranges = (float(np.percentile(coarse.low_m, 0.5)), float(np.percentile(coarse.high_m, 99.5)))
    found = []
    for off in (0.0, *ranges):
        ground = views[0].matching.image_to_ground(nodes, height + off)
        seen = np.zeros(len(nodes), dtype=np.bool_)
        for view in views[1:]:
            image, box = view.matching.ground_to_image(ground.geodetic), view.source.extent
            low = np.array([box.line, box.sample]) - _EDGE_PX
            high = low + (box.lines, box.samples) + 2.0 * _EDGE_PX
            inside = np.all((image.image_px >= low) & (image.image_px <= high), axis=1)
            seen |= has_result(image.flag) & inside
        found.append(ground.geodetic[seen & has_result(ground.flag)])
    try:
        return map_extent(crs, np.concatenate(found))
    except GeometryError as error:
        raise GeometryError(f"dsm: {error}") from None
