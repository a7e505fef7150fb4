"""A re-imaging run: steady attitude, new image, its models and what was taken out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import mkdtemp
from time import perf_counter
from typing import Any, Final

import numpy as np
from rasterio.rpc import RPC

from geoposition.arrays import FloatArray
from geoposition.errors import GeometryError, GeopositionError, ProductError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.mapping import DEFAULT_BOUND_PX
from geoposition.reimage.raster_files import (
    ImageFile,
    Layout,
    opened_image,
    to_cog,
    write_rows,
    written_raster,
)
from geoposition.reimage.resample import Method, Resampler
from geoposition.reimage.sinusoids import Sinusoid
from geoposition.reimage.steady import SteadyAttitude, SteadyOptions, steady_model
from geoposition.reimage.strips import STRIP_ROWS, Part, Strip, displacement_px, parts_of, strips
from geoposition.reimage.virtual import Segment, ideal_camera
from geoposition.rpc.fit import fit_model
from geoposition.rpc.fit_build import RpcFit
from geoposition.rpc.formats import write_rpc
from geoposition.rpc.formats._fields import COEFFICIENT_FIELDS, SCALAR_FIELDS
from geoposition.rpc.model import RpcModel
from geoposition.scripts.reimage_facts import (
    displacement_facts,
    height_error,
    misfit_facts,
    removed_facts,
    strongest_lines,
)
from geoposition.scripts.reimage_input import AttitudeInput, jittered_model
from geoposition.scripts.results import Progress, plain
from geoposition.scripts.tables import write_table
from geoposition.sensors.writers.csm import write_csm
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.terrain import RasterTerrain, Terrain

STEM: Final = "steady"
_PLACES: Final = 5
"""Columns at which displacements are followed."""


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
    compress: str = "zstd"
    strip_rows: int = STRIP_ROWS
    report: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a run found, for its report.

    `displacement_px` (lines, k, 2) at the columns `columns`; `lines_px` are the strongest lines
    of its mean over the columns, for rows and columns of the image, in pixels.
    """

    product: Product
    request: Request
    jittered: PushbroomModel
    steady: PushbroomModel
    removed: SteadyAttitude
    before: RpcFit | None
    after: RpcFit
    columns: FloatArray
    displacement_px: FloatArray
    lines_px: tuple[tuple[Sinusoid, ...], tuple[Sinusoid, ...]]
    files: dict[str, Path]
    summary: dict[str, object]


def run(product: Product, request: Request, progress: Progress) -> dict[str, object]:
    """Make everything in a folder beside `request.output`, then put it in its place."""
    target = request.output
    if target.exists() and not target.is_dir():
        raise ProductError(target, "", "a folder for the outputs expected, this is a file")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise ProductError(target, "", f"a writable place expected ({error.strerror})") from None
    try:
        made = _made(product, request, scratch, progress)
        target.mkdir(exist_ok=True)
        for path in sorted(scratch.iterdir()):
            path.replace(target / path.name)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return made


def _made(
    product: Product, request: Request, folder: Path, progress: Progress
) -> dict[str, object]:
    begin = perf_counter()
    cutoff = request.steady.cutoff_hz
    with opened_image(request.image) as image:
        jittered = jittered_model(product, image, request.attitude, cutoff)
        steady, removed = steady_model(jittered, request.steady)
        segments: Sequence[Segment] = ()
        if request.ideal:
            camera, segments = ideal_camera(steady.camera)
            steady = replace(steady, camera=camera)
        terrain = _terrain(product, request, jittered)
        parts = parts_of(steady, jittered, terrain, segments, request.bound_px)
        heights = jittered.height_range_m
        before = _fitted(jittered)
        after = fit_model(steady, limit_px=np.inf)
        rpc = replace(after.model, satellite=_name(product))
        prepared = perf_counter()
        resampler = Resampler(request.method, _nodata(image, request))
        made = _image(image, parts, resampler, rpc, request, folder, progress)
    imaged = perf_counter()
    _models(steady, rpc, product, folder)
    _tables(removed, made, folder)
    times = _line_times(steady)
    mean = np.nanmean(made.displacement_px, axis=1)
    lines = (strongest_lines(times, mean[:, 0]), strongest_lines(times, mean[:, 1]))
    summary: dict[str, object] = {
        "product": str(product.path),
        "image": str(request.image),
        "attitude": "the product's" if request.attitude is None else str(request.attitude.path),
        "steady": request.steady.words,
        "camera": "ideal" if request.ideal else "the same interior orientation",
        "shape": list(steady.shape),
        "resampling": request.method,
        "valid_share": made.valid / (steady.shape[0] * steady.shape[1]),
        "removed": removed_facts(removed),
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
        "output": str(request.output),
    }
    summary["seconds"] = {
        "models": round(prepared - begin, 2),
        "image": round(imaged - prepared, 2),
        "mpx_per_s": round(steady.shape[0] * steady.shape[1] / 1e6 / (imaged - prepared), 1),
    }
    found = Run(
        product, request, jittered, steady, removed, before, after, made.columns,
        made.displacement_px, lines, {"image": request.image, "steady": folder / f"{STEM}.tif"},
        summary,
    )  # fmt: skip
    if request.report:
        from geoposition.scripts.reimage_report import write

        write(folder / "report.html", found)
    summary["files"] = sorted(path.name for path in folder.iterdir()) + ["reimage.json"]
    (folder / "reimage.json").write_text(
        json.dumps(plain(summary), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    return summary


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    columns: FloatArray
    displacement_px: FloatArray
    error_px: float
    valid: int


def _image(
    image: ImageFile,
    parts: Sequence[Part],
    resampler: Resampler,
    rpc: RpcModel,
    request: Request,
    folder: Path,
    progress: Progress,
) -> _Made:
    """Write the image, its mask and its displacements, strip by strip, then as COG."""
    lines, samples = parts[0].mapping.target.shape
    cols = np.unique(np.linspace(0, samples - 1, _PLACES).round())
    moved = np.empty((lines, len(cols), 2))
    error, valid = 0.0, 0
    raw, mask = folder / "raw.tif", folder / "mask.tif"
    layout = Layout((lines, samples), image.bands, image.dtype.name, resampler.nodata)
    with (
        ThreadPoolExecutor(max_workers=1) as writer,
        written_raster(raw, layout) as pixels,
        written_raster(mask, Layout((lines, samples), 1, "uint8")) as seen,
    ):
        pixels.rpcs = gdal_rpc(rpc)
        pixels.update_tags(STEADY_ATTITUDE=request.steady.words, RESAMPLING=request.method)
        pending: Future[None] | None = None
        for strip in strips(parts, image.lines, resampler, request.strip_rows):
            rows = slice(strip.first_row, strip.first_row + len(strip.valid))
            moved[rows] = displacement_px(parts, strip, cols)
            error, valid = max(error, strip.error_px), valid + int(np.count_nonzero(strip.valid))
            if pending is not None:
                pending.result()
            pending = writer.submit(_store, strip, pixels, seen)
            progress(rows.stop, lines)
        if pending is not None:
            pending.result()
    to_cog(raw, folder / f"{STEM}.tif", request.compress)
    to_cog(mask, folder / f"{STEM}_valid.tif", "deflate", "none")
    raw.unlink()
    mask.unlink()
    if valid == 0:
        raise GeometryError("re-imaging: no pixel of the steady image is seen in the image")
    _displacement_file(folder / f"{STEM}_displacement.tif", moved, cols)
    return _Made(cols, moved, error, valid)


def _store(strip: Strip, pixels: Any, seen: Any) -> None:
    write_rows(pixels, strip.first_row, strip.pixels)
    write_rows(seen, strip.first_row, strip.valid[None])


def gdal_rpc(rpc: RpcModel) -> RPC:
    """Return `rpc` as GDAL's metadata has it."""
    return RPC(
        **{key.lower(): getattr(rpc, name) for key, name in SCALAR_FIELDS.items()},
        **{key.lower(): getattr(rpc, name).tolist() for key, name in COEFFICIENT_FIELDS.items()},
        err_bias=rpc.err_bias_m,
        err_rand=rpc.err_rand_m,
    )


def _displacement_file(path: Path, moved: FloatArray, cols: FloatArray) -> None:
    """Write displacements as two bands; a pixel is a line and a span of columns."""
    lines, count, _ = moved.shape
    step = float(cols[-1] - cols[0]) / max(count - 1, 1) or 1.0
    layout = Layout(
        (lines, count), 2, "float32", float("nan"),
        transform=(cols[0] - 0.5 * step, step, 0.0, -0.5, 0.0, 1.0),
    )  # fmt: skip
    with written_raster(path, layout) as raster:
        write_rows(raster, 0, np.moveaxis(moved, -1, 0).astype(np.float32))
        raster.set_band_description(1, "source line - line, px")
        raster.set_band_description(2, "source sample - sample, px")


def _models(steady: PushbroomModel, rpc: RpcModel, product: Product, folder: Path) -> None:
    image = folder / f"{STEM}.tif"
    write_model_file(steady, folder / f"{STEM}.toml", sensor=product.sensor, image=image)
    try:
        write_csm(steady, folder / f"{STEM}_csm.json", sensor=product.sensor, image=image.name)
    except GeopositionError as error:
        note = f"No CSM state was written: {error}\n"
        (folder / f"{STEM}_csm.txt").write_text(note, encoding="utf-8")
    for name in (f"{STEM}.RPB", f"{STEM}_RPC.TXT", f"{STEM}_RPC.XML"):
        write_rpc(rpc, folder / name)


def _tables(removed: SteadyAttitude, made: _Made, folder: Path) -> None:
    columns = {"t_s": np.asarray(removed.times_s)}
    columns |= {f"{axis}_rad": np.array(removed.removed_rad[:, k]) for k, axis in enumerate("xyz")}
    write_table(folder / "removed_attitude.csv", columns)


def _terrain(product: Product, request: Request, model: PushbroomModel) -> Terrain | float:
    if request.dem is not None:
        return RasterTerrain(request.dem, request.geoid)
    if request.height_m is not None:
        return request.height_m
    if product.vendor_rpc is not None:
        return float(product.vendor_rpc.height_off_m)
    return 0.5 * (model.height_range_m[0] + model.height_range_m[1])


def _nodata(image: ImageFile, request: Request) -> float | None:
    return request.nodata if request.nodata is not None else image.nodata


def _name(product: Product) -> str:
    return "" if product.sensor == "unknown" else product.sensor


def _fitted(model: PushbroomModel) -> RpcFit | None:
    """RPC of the jittered model, to compare; none where no RPC fits at all."""
    try:
        return fit_model(model, limit_px=np.inf, direct=False)
    except GeometryError:
        return None


def _line_times(model: PushbroomModel) -> FloatArray:
    return model.camera.timing.time_s(np.arange(model.shape[0], dtype=np.float64))
