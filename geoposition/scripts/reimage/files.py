"""The files that a re-imaging run writes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import FlagArray, FloatArray
from geoposition.errors import GeometryError, GeopositionError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.cog import CogWriter, Compression, Layout, written_cog
from geoposition.reimage.raster_files import ImageFile
from geoposition.reimage.resample import Resampler
from geoposition.reimage.steady import SteadyAttitude
from geoposition.reimage.strips import Part, displacement_px, strips
from geoposition.rpc.formats import write_rpc
from geoposition.rpc.formats.geotiff import gdal_rpc
from geoposition.rpc.model import RpcModel
from geoposition.scripts.results import Progress
from geoposition.scripts.tables import write_table
from geoposition.sensors.writers.csm import write_csm
from geoposition.sensors.writers.model_file import write_model_file

STEM: Final = "steady"
_PLACES: Final = 5
"""Columns at which displacements are followed."""


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """What was found while the image was made.

    `displacement_px` (lines, k, 2) at `columns`; the mapping's largest error; pixels seen.
    """

    columns: FloatArray
    displacement_px: FloatArray
    error_px: float
    valid: int


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows from `first_row` on as they are written: `pixels` (bands, rows, cols) and `valid`.

    `moved_px` (rows, k, 2) are the displacements at `followed_columns`.
    """

    first_row: int
    pixels: NDArray[Any]
    valid: FlagArray
    moved_px: FloatArray
    error_px: float


def followed_columns(samples: int) -> FloatArray:
    """Columns (k,) at which displacements are followed."""
    return np.unique(np.linspace(0, samples - 1, _PLACES).round())


def rows_made(
    parts: Sequence[Part],
    image: ImageFile,
    resampler: Resampler,
    strip_rows: int,
    span: tuple[int, int] | None = None,
) -> Iterator[Rows]:
    """Make the rows of the new image, or those of `span`."""
    cols = followed_columns(parts[0].mapping.target.shape[1])
    for strip in strips(parts, image.lines, resampler, strip_rows, span):
        moved = displacement_px(parts, strip, cols)
        yield Rows(strip.first_row, strip.pixels, strip.valid, moved, strip.error_px)


def write_image(
    folder: Path,
    image: ImageFile,
    shape: tuple[int, int],
    made: Iterable[Rows],
    resampler: Resampler,
    rpc: RpcModel,
    tags: dict[str, str],
    compression: Compression,
    progress: Progress,
) -> Made:
    """Write image, mask and displacements, strip by strip: reading, making, coding overlap."""
    lines, samples = shape
    cols = followed_columns(samples)
    moved = np.empty((lines, len(cols), 2))
    error, valid = 0.0, 0
    layout = Layout(
        (lines, samples), image.bands, image.dtype.name, resampler.nodata,
        rpc=gdal_rpc(rpc), tags=tags, bands_named=image.band_names,
    )  # fmt: skip
    mask = Layout((lines, samples), 1, "uint8")
    with (
        written_cog(folder / f"{STEM}.tif", layout, compression) as pixels,
        written_cog(folder / f"{STEM}_valid.tif", mask, "zstd", "nearest") as seen,
        ThreadPoolExecutor(max_workers=1) as writer,
    ):
        pending: Future[None] | None = None
        for strip in made:
            rows = slice(strip.first_row, strip.first_row + len(strip.valid))
            moved[rows] = strip.moved_px
            error, valid = max(error, strip.error_px), valid + int(np.count_nonzero(strip.valid))
            if pending is not None:
                pending.result()
            pending = writer.submit(_store, strip, pixels, seen)
            progress(rows.stop, lines)
        if pending is not None:
            pending.result()
        if valid == 0:
            raise GeometryError("re-imaging: no pixel of the steady image is seen in the image")
    _displacement_file(folder / f"{STEM}_displacement.tif", moved, cols)
    return Made(cols, moved, error, valid)


def _store(strip: Rows, pixels: CogWriter, seen: CogWriter) -> None:
    pixels.write(strip.pixels)
    seen.write(strip.valid[None])


def _displacement_file(path: Path, moved: FloatArray, cols: FloatArray) -> None:
    """Write displacements as two bands; a pixel is a line and a span of columns."""
    lines, count, _ = moved.shape
    step = float(cols[-1] - cols[0]) / max(count - 1, 1) or 1.0
    layout = Layout(
        (lines, count), 2, "float32", float("nan"),
        transform=(cols[0] - 0.5 * step, step, 0.0, -0.5, 0.0, 1.0),
        bands_named=("source line - line, px", "source sample - sample, px"),
    )  # fmt: skip
    with written_cog(path, layout, overviews="none") as raster:
        raster.write(np.ascontiguousarray(np.moveaxis(moved, -1, 0), dtype=np.float32))


def write_models(steady: PushbroomModel, rpc: RpcModel, product: Product, folder: Path) -> None:
    """Write the steady model as our own file and as CSM, and its RPC in three dialects."""
    image = folder / f"{STEM}.tif"
    write_model_file(steady, folder / f"{STEM}.toml", sensor=product.sensor, image=image)
    try:
        write_csm(steady, folder / f"{STEM}_csm.json", sensor=product.sensor, image=image.name)
    except GeopositionError as error:
        note = f"No CSM state was written: {error}\n"
        (folder / f"{STEM}_csm.txt").write_text(note, encoding="utf-8")
    for name in (f"{STEM}.RPB", f"{STEM}_RPC.TXT", f"{STEM}_RPC.XML"):
        write_rpc(rpc, folder / name)


def write_removed(removed: SteadyAttitude, folder: Path) -> None:
    """Write the rotation taken out, about the body's axes."""
    columns = {"t_s": np.asarray(removed.times_s)}
    columns |= {f"{axis}_rad": np.array(removed.removed_rad[:, k]) for k, axis in enumerate("xyz")}
    write_table(folder / "removed_attitude.csv", columns)
