"""A re-imaging run: steady attitude, new image, its models and what was taken out."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import GeometryError, ProductError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.cog import Compression
from geoposition.reimage.mapping import DEFAULT_BOUND_PX
from geoposition.reimage.raster_files import opened_image
from geoposition.reimage.resample import Method, Resampler
from geoposition.reimage.steady import SteadyAttitude, SteadyOptions, steady_model
from geoposition.reimage.strips import STRIP_ROWS, Part, parts_of
from geoposition.reimage.virtual import Segment, ideal_camera
from geoposition.rpc.fit import fit_model
from geoposition.rpc.fit_build import RpcFit
from geoposition.scripts.product_images import nodata_of
from geoposition.scripts.reimage_facts import (
    displacement_facts,
    height_error,
    misfit_facts,
    moved_facts,
    removed_facts,
)
from geoposition.scripts.reimage_files import STEM, write_image, write_models, write_removed
from geoposition.scripts.reimage_input import AttitudeInput, jittered_model
from geoposition.scripts.reimage_jitter import (
    ATTITUDE,
    JitterTable,
    attitude_displacement,
    displacement_lines,
    jitter_table,
    match_lines,
    parallax_lines,
)
from geoposition.scripts.results import Progress, plain
from geoposition.scripts.scratch import publish_folder, scratch_beside
from geoposition.terrain import RasterTerrain, Terrain

_SUMMARY: Final = "reimage.json"
_CAMERAS: Final = ("the same interior orientation", "one ideal straight line of pixels")


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of a run."""

    image: Path
    output: Path
    attitude: AttitudeInput | None = None
    dem: Path | None = None
    geoid: Path | None = None
    height_m: float | None = None
    steady: SteadyOptions = field(default_factory=SteadyOptions)
    ideal: bool = False
    method: Method = "cubic"
    bound_px: float = DEFAULT_BOUND_PX
    nodata: float | None = None
    compress: Compression = "zstd"
    strip_rows: int = STRIP_ROWS
    evaluation: Path | None = None
    report: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a run found, for its report.

    `moved_px` (lines, 2) is how far the attitude taken out moves the rows at `times_s` (lines,);
    `jitter` are its strongest lines, beside those that others saw.
    """

    product: Product
    request: Request
    jittered: PushbroomModel
    steady: PushbroomModel
    removed: SteadyAttitude
    before: RpcFit | None
    after: RpcFit
    times_s: FloatArray
    moved_px: FloatArray
    jitter: JitterTable
    files: dict[str, Path]
    summary: dict[str, object]


def run(product: Product, request: Request, progress: Progress) -> dict[str, object]:
    """Make everything in a folder beside `request.output`, then put it in its place."""
    target = request.output
    if target.exists() and not target.is_dir():
        raise ProductError(target, "", "a folder for the outputs expected, this is a file")
    with scratch_beside(target) as scratch:
        made = _made(product, request, scratch, progress)
        publish_folder(scratch, target, _SUMMARY)
    return made


def _made(
    product: Product, request: Request, folder: Path, progress: Progress
) -> dict[str, object]:
    begin = perf_counter()
    cutoff = request.steady.cutoff_hz
    with opened_image(request.image) as image:
        jittered = jittered_model(product, image, request.attitude, cutoff)
        steady, removed = steady_model(jittered, request.steady)
        own = steady
        matched = None if request.evaluation is None else match_lines(request.evaluation, own)
        segments: Sequence[Segment] = ()
        if request.ideal:
            camera, segments = ideal_camera(steady.camera)
            steady = replace(steady, camera=camera)
        terrain = _terrain(product, request, jittered)
        parts = _parts(steady, jittered, terrain, segments, request)
        heights = jittered.height_range_m
        before = _fitted(jittered)
        after = fit_model(steady, limit_px=np.inf)
        rpc = replace(after.model, satellite=_name(product))
        prepared = perf_counter()
        resampler = Resampler(request.method, nodata_of(image, request.nodata))
        tags = {"STEADY_ATTITUDE": request.steady.words, "RESAMPLING": request.method}
        made = write_image(
            folder, image, parts, resampler, rpc, tags, request.compress, request.strip_rows,
            progress,
        )  # fmt: skip
        imaged = perf_counter()
        sources = [parallax_lines(image, own, terrain)]
    write_models(steady, rpc, product, folder)
    write_removed(removed, folder)
    times, moved = attitude_displacement(jittered, own, terrain)
    lines = displacement_lines(times, moved)
    sources.insert(0, ({ATTITUDE: lines[0]}, {ATTITUDE: lines[1]}))
    if matched is not None:
        sources.append(matched)
    jitter = jitter_table(steady, sources)
    summary: dict[str, object] = {
        "product": str(product.path),
        "image": str(request.image),
        "attitude": "the product's" if request.attitude is None else str(request.attitude.path),
        "steady": request.steady.words,
        "camera": _CAMERAS[request.ideal],
        "shape": list(steady.shape),
        "resampling": request.method,
        "valid_share": made.valid / (steady.shape[0] * steady.shape[1]),
        "removed": removed_facts(removed),
        "removed_px": moved_facts(moved),
        "displacement_px": displacement_facts(made.displacement_px, lines),
        "mapping": {
            "error_px": made.error_px,
            "bound_px": request.bound_px,
            "node_step_px": parts[0].mapping.node_step,
            "terrain": "; ".join(terrain.provenance)
            if not isinstance(terrain, float)
            else f"mean height {terrain:.1f} m",
            "height_error_px": height_error(parts, terrain, heights),
        },
        "rpc_misfit_px": {
            "before": None if before is None else misfit_facts(before),
            "after": misfit_facts(after),
        },
        "jitter": jitter.facts(),
        "output": str(request.output),
    }
    summary["seconds"] = {
        "models": round(prepared - begin, 2),
        "image": round(imaged - prepared, 2),
        "mpx_per_s": round(steady.shape[0] * steady.shape[1] / 1e6 / (imaged - prepared), 1),
    }
    found = Run(
        product, request, jittered, steady, removed, before, after, times,
        moved, jitter, {"image": request.image, "steady": folder / f"{STEM}.tif"},
        summary,
    )  # fmt: skip
    if request.report:
        from geoposition.scripts.reimage_report import write

        write(folder / "report.html", found)
    files = [path.name for path in folder.iterdir() if not path.name.startswith(".")]
    summary["files"] = [*sorted(files), _SUMMARY]
    (folder / _SUMMARY).write_text(
        json.dumps(plain(summary), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    return summary


def _parts(
    steady: PushbroomModel,
    jittered: PushbroomModel,
    terrain: Terrain | float,
    segments: Sequence[Segment],
    request: Request,
) -> tuple[Part, ...]:
    try:
        return parts_of(steady, jittered, terrain, segments, request.bound_px)
    except GeometryError as error:
        if request.dem is None:
            raise
        raise ProductError(request.dem, "", f"heights under the image expected ({error})") from None


def _terrain(product: Product, request: Request, model: PushbroomModel) -> Terrain | float:
    if request.dem is not None:
        return RasterTerrain(request.dem, request.geoid)
    if request.height_m is not None:
        return request.height_m
    if product.vendor_rpc is not None:
        return float(product.vendor_rpc.height_off_m)
    return 0.5 * (model.height_range_m[0] + model.height_range_m[1])


def _name(product: Product) -> str:
    return "" if product.sensor == "unknown" else product.sensor


def _fitted(model: PushbroomModel) -> RpcFit | None:
    """RPC of the jittered model, to compare; none where no RPC fits at all."""
    try:
        return fit_model(model, limit_px=np.inf, direct=False)
    except GeometryError:
        return None
