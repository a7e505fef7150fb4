"""A re-imaging run: steady attitude, new image, its models and what was taken out."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import GeometryError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.raster_files import opened_image
from geoposition.reimage.resample import Resampler
from geoposition.reimage.steady import SteadyAttitude
from geoposition.reimage.strips import block_rows
from geoposition.rpc.fit import fit_model
from geoposition.rpc.fit_build import RpcFit
from geoposition.scripts.product_images import nodata_of
from geoposition.scripts.reimage.facts import (
    displacement_facts,
    height_error,
    misfit_facts,
    moved_facts,
    removed_facts,
)
from geoposition.scripts.reimage.files import (
    STEM,
    Rows,
    rows_made,
    write_image,
    write_models,
    write_removed,
)
from geoposition.scripts.reimage.jitter import (
    ATTITUDE,
    JitterTable,
    attitude_displacement,
    displacement_lines,
    jitter_table,
    match_lines,
    parallax_lines,
)
from geoposition.scripts.reimage.models import Request, models_of
from geoposition.scripts.results import Progress, plain
from geoposition.scripts.row_windows import settings_of, windows_rows, written_window
from geoposition.scripts.scratch import publish_folder, require_folder, scratch_beside

__all__ = ["Request", "Run", "run"]

_SUMMARY: Final = "reimage.json"
_ARRAYS: Final = ("pixels", "valid", "moved", "error")
_CAMERAS: Final = ("the same interior orientation", "one ideal straight line of pixels")


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
    """Make everything in a folder beside `request.output`, then put it in its place.

    With a window in `request.split` only its rows are made, and `request.output` is left alone.
    """
    if request.split.window is not None:
        return _window(product, request, progress)
    target = request.output
    require_folder(target)
    with scratch_beside(target) as scratch:
        made = _made(product, request, scratch, progress)
        publish_folder(scratch, target, _SUMMARY)
    return made


def _made(
    product: Product, request: Request, folder: Path, progress: Progress
) -> dict[str, object]:
    begin = perf_counter()
    with opened_image(request.image) as image:
        models = models_of(product, request, image)
        jittered, own, steady, removed = models.jittered, models.own, models.steady, models.removed
        terrain, parts = models.terrain, models.parts
        matched = None if request.evaluation is None else match_lines(request.evaluation, own)
        heights = jittered.height_range_m
        before = _fitted(jittered)
        after = fit_model(steady, limit_px=np.inf)
        rpc = replace(after.model, satellite=_name(product))
        prepared = perf_counter()
        resampler = Resampler(request.method, nodata_of(image, request.nodata))
        rows = rows_made(parts, image, resampler, request.strip_rows)
        if request.split.folders:
            rows = _rows_of_windows(product, request, steady.shape)
        tags = {"STEADY_ATTITUDE": request.steady.words, "RESAMPLING": request.method}
        made = write_image(
            folder, image, steady.shape, rows, resampler, rpc, tags, request.compress, progress
        )
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
        from geoposition.scripts.reimage.report import write

        write(folder / "report.html", found)
    files = [path.name for path in folder.iterdir() if not path.name.startswith(".")]
    summary["files"] = [*sorted(files), _SUMMARY]
    (folder / _SUMMARY).write_text(
        json.dumps(plain(summary), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    return summary


def _window(product: Product, request: Request, progress: Progress) -> dict[str, object]:
    """Make the rows of one window of the new image."""
    window, folder = request.split.window, request.split.folders[0]
    assert window is not None
    with opened_image(request.image) as image:
        models = models_of(product, request, image)
        shape = models.steady.shape
        first, end = window.rows(shape[0], block_rows(request.strip_rows))
        resampler = Resampler(request.method, nodata_of(image, request.nodata))
        with written_window(folder, _settings(product, request, shape), (first, end)) as put:
            span = first, end
            for rows in rows_made(models.parts, image, resampler, request.strip_rows, span):
                error = np.array(rows.error_px)
                arrays = rows.pixels, rows.valid, rows.moved_px, error
                put(rows.first_row, dict(zip(_ARRAYS, arrays, strict=True)))
                progress(rows.first_row + len(rows.valid) - first, end - first)
    return {
        "product": str(product.path),
        "image": str(request.image),
        "shape": list(shape),
        "window": [window.number, window.count],
        "rows": [first, end],
        "output": str(folder),
    }


def _rows_of_windows(product: Product, request: Request, shape: tuple[int, int]) -> Iterator[Rows]:
    """Take the rows of the new image from windows that were made before."""
    settings = _settings(product, request, shape)
    for first, arrays in windows_rows(request.split.folders, settings, shape[0], _ARRAYS):
        pixels, valid, moved, error = (arrays[name] for name in _ARRAYS)
        yield Rows(first, pixels, valid, moved, float(error))


def _settings(product: Product, request: Request, shape: tuple[int, int]) -> dict[str, object]:
    attitude = request.attitude
    given = None if attitude is None else attitude.path
    files = product.path, request.image, request.dem, request.geoid, given
    return settings_of(files, shape, {
        "attitude": str(attitude),
        "steady": request.steady.words,
        "ideal": request.ideal,
        "method": request.method,
        "bound_px": request.bound_px,
        "nodata": request.nodata,
        "height_m": request.height_m,
        "strip_rows": request.strip_rows,
    })  # fmt: skip


def _name(product: Product) -> str:
    return "" if product.sensor == "unknown" else product.sensor


def _fitted(model: PushbroomModel) -> RpcFit | None:
    """RPC of the jittered model, to compare; none where no RPC fits at all."""
    try:
        return fit_model(model, limit_px=np.inf, direct=False)
    except GeometryError:
        return None
