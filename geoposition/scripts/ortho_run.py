"""An orthoimage run: grid, rows of windows, files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import FlagArray
from geoposition.datum import utm_epsg
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError, GeometryError, ProductError
from geoposition.flags import Flag, flag_labels, has_result
from geoposition.locate import locate
from geoposition.product import Product
from geoposition.reimage.cog import Compression, Layout, written_cog
from geoposition.reimage.ortho import DEFAULT_BOUND_PX, OrthoTask
from geoposition.reimage.ortho_grid import OrthoGrid
from geoposition.reimage.raster_files import ImageFile, opened_image
from geoposition.rpc.model import RpcModel
from geoposition.scripts.ortho_windows import ROWS, OrthoMaker, OrthoMethod, Tally
from geoposition.scripts.product_images import check_size, nodata_of
from geoposition.scripts.results import Progress
from geoposition.scripts.row_windows import Split, settings_of, windows_rows, written_window
from geoposition.scripts.scratch import scratch_beside
from geoposition.sensor_model import SensorModel
from geoposition.surface import is_geographic
from geoposition.terrain import RasterTerrain

_DEGREE_M: Final = 111320.0
_PIXELS: Final = "ortho.tif"
_FLAGS: Final = "flags.tif"
_ARRAYS: Final = ("pixels", "flags", "error")


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of a run; `None` is left to it. `extent` is left, bottom, right, top."""

    image: Path
    output: Path
    dem: Path
    geoid: Path | None = None
    crs: str | None = None
    resolution: float | None = None
    extent: tuple[float, float, float, float] | None = None
    method: OrthoMethod = "cubic"
    occlusion: bool = False
    bound_px: float = DEFAULT_BOUND_PX
    nodata: float | None = None
    compress: Compression = "zstd"
    split: Split = field(default_factory=Split)


def run(product: Product, request: Request, progress: Progress) -> dict[str, object]:
    """Make the orthoimage and its flags; returns facts fit for JSON.

    With a window in `request.split` only its rows are made, and `request.output` is left alone.
    """
    if request.split.window is not None:
        return _window(product, request, progress)
    begin = perf_counter()
    terrain = RasterTerrain(request.dem, request.geoid)
    flags_path = request.output.with_name(f"{request.output.stem}_flags.tif")
    with (
        _opened(product, request) as image,
        scratch_beside(request.output) as scratch,
    ):
        maker = _maker(product, terrain, image, request)
        grid = _grid(product.model, terrain, request)
        made = _rows(maker, grid, (0, grid.shape[0]))
        if request.split.folders:
            made = _rows_of_windows(product, request, grid)
        tally = _write(made, maker, grid, request, scratch, progress)
        # the image last: where it is, all is
        (scratch / _FLAGS).replace(flags_path)
        (scratch / _PIXELS).replace(request.output)
    seconds = perf_counter() - begin
    rows, cols = grid.shape
    return {
        "product": str(product.path),
        "image": str(request.image),
        "crs": grid.crs,
        "resolution": grid.resolution,
        "shape": [rows, cols],
        "left_top": [grid.left, grid.top],
        "resampling": request.method,
        "interpolation_error_px": tally.error_px,
        "flags": {
            str(name): int(tally.flags[flag])
            for flag, name in zip(Flag, flag_labels(np.array(Flag, dtype=np.uint8)), strict=True)
            if tally.flags[flag]
        },
        "terrain": list(terrain.provenance),
        "seconds": round(seconds, 2),
        "mpx_per_s": round(rows * cols / 1e6 / seconds, 1),
        "output": str(request.output),
        "flags_file": str(flags_path),
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Rows of the map from `first` on: `pixels` (bands, rows, cols) and `flags` (rows, cols)."""

    first: int
    pixels: NDArray[Any]
    flags: FlagArray
    error_px: float


def _rows(maker: OrthoMaker, grid: OrthoGrid, span: tuple[int, int]) -> Iterator[_Rows]:
    for first in range(*span, ROWS):
        tally = Tally()
        pixels, flags = maker.rows(grid, first, tally)
        yield _Rows(first, pixels, flags, tally.error_px)


def _window(product: Product, request: Request, progress: Progress) -> dict[str, object]:
    """Make the rows of one window of the map."""
    window, folder = request.split.window, request.split.folders[0]
    assert window is not None
    terrain = RasterTerrain(request.dem, request.geoid)
    with _opened(product, request) as image:
        grid = _grid(product.model, terrain, request)
        maker = _maker(product, terrain, image, request)
        span = window.rows(grid.shape[0], ROWS)
        with written_window(folder, _settings(product, request, grid), span) as put:
            for rows in _rows(maker, grid, span):
                arrays = rows.pixels, rows.flags, np.array(rows.error_px)
                put(rows.first, dict(zip(_ARRAYS, arrays, strict=True)))
                progress(rows.first + len(rows.flags) - span[0], span[1] - span[0])
    return {
        "product": str(product.path),
        "image": str(request.image),
        "crs": grid.crs,
        "shape": list(grid.shape),
        "window": [window.number, window.count],
        "rows": list(span),
        "output": str(folder),
    }


def _rows_of_windows(product: Product, request: Request, grid: OrthoGrid) -> Iterator[_Rows]:
    """Take the rows of the map from windows that were made before."""
    settings = _settings(product, request, grid)
    for first, arrays in windows_rows(request.split.folders, settings, grid.shape[0], _ARRAYS):
        pixels, flags, error = (arrays[name] for name in _ARRAYS)
        yield _Rows(first, pixels, flags, float(error))


def _settings(product: Product, request: Request, grid: OrthoGrid) -> dict[str, object]:
    files = product.path, request.image, request.dem, request.geoid
    return settings_of(files, grid.shape, {
        "map": [grid.crs, grid.left, grid.top, grid.resolution],
        "method": request.method,
        "occlusion": request.occlusion,
        "bound_px": request.bound_px,
        "nodata": request.nodata,
    })  # fmt: skip


def _opened(product: Product, request: Request) -> AbstractContextManager[ImageFile]:
    own = isinstance(product.model, RpcModel) and request.image == product.path
    return opened_image(request.image, crop=not own)


def _maker(
    product: Product, terrain: RasterTerrain, image: ImageFile, request: Request
) -> OrthoMaker:
    check_size(product.model, image)
    fill = nodata_of(image, request.nodata)
    if fill is None and image.dtype.kind != "f":
        fill = 0.0
    task = OrthoTask(product.model, terrain, request.occlusion, request.bound_px)
    return OrthoMaker(task, image, request.method, fill)


def _write(
    made: Iterable[_Rows],
    maker: OrthoMaker,
    grid: OrthoGrid,
    request: Request,
    folder: Path,
    progress: Progress,
) -> Tally:
    """Write image and flags into `folder`; while rows are made, those before are coded."""
    tally, image, fill = Tally(), maker.image, maker.fill
    layout = Layout(
        grid.shape, image.bands, image.dtype.name, float("nan") if fill is None else fill,
        grid.crs, _transform(grid), bands_named=image.band_names,
    )  # fmt: skip
    codes = Layout(grid.shape, 1, "uint8", None, grid.crs, _transform(grid))
    with (
        written_cog(folder / _PIXELS, layout, request.compress) as pixels_file,
        written_cog(folder / _FLAGS, codes, "zstd", "nearest") as flags_file,
        ThreadPoolExecutor(max_workers=1) as writer,
    ):
        pending: list[Future[None]] = []
        for rows in made:
            tally.add(rows.error_px, rows.flags)
            for job in pending:
                job.result()
            pending = [
                writer.submit(pixels_file.write, rows.pixels),
                writer.submit(flags_file.write, rows.flags[None]),
            ]
            progress(rows.first + len(rows.flags), grid.shape[0])
        for job in pending:
            job.result()
        if not tally.flags[Flag.OK]:
            raise GeometryError("ortho: no pixel of the map is seen in the image")
    return tally


def _transform(grid: OrthoGrid) -> tuple[float, ...]:
    return grid.left, grid.resolution, 0.0, grid.top, 0.0, -grid.resolution


def _grid(model: SensorModel, terrain: RasterTerrain, request: Request) -> OrthoGrid:
    """Choose the map: as asked, else the UTM zone and the image's own pixel size."""
    lines, samples = model.shape
    middle = np.array([0.5 * (lines - 1), 0.5 * (samples - 1)])
    near = middle + np.array([[0, 0], [1, 0], [0, 1]])
    ground = locate(model, near, terrain)
    if not has_result(ground.flag).all():
        height = 0.5 * (model.height_range_m[0] + model.height_range_m[1])
        ground = model.image_to_ground(near, height)
    crs = request.crs
    if crs is None:
        crs = str(utm_epsg(ground.geodetic[0, 0], ground.geodetic[0, 1]))
    crs = f"EPSG:{crs}" if crs.isdecimal() else crs
    degrees = is_geographic(crs)
    resolution = request.resolution
    if resolution is None:
        place = geodetic_to_ecef(ground.geodetic)
        metres = float(np.mean(np.linalg.norm(place[1:] - place[0], axis=1)))
        resolution = float(f"{metres / (_DEGREE_M if degrees else 1.0):.2g}")
    if request.extent is None:
        try:
            return OrthoGrid.around(model, terrain, crs, resolution)
        except GeometryError as error:
            raise ProductError(
                request.dem, "", f"heights under the image expected ({error})"
            ) from None
    left, bottom, right, top = request.extent
    if not (right > left and top > bottom and resolution > 0.0):
        raise ArgumentError("--extent: left, bottom, right, top expected, and a positive --res")
    shape = round((top - bottom) / resolution), round((right - left) / resolution)
    return OrthoGrid(crs, left, top, resolution, shape)
