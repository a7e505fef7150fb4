"""An orthoimage run: grid, rows of windows, files."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Final

import numpy as np

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
from geoposition.scripts.scratch import scratch_beside
from geoposition.sensor_model import SensorModel
from geoposition.surface import is_geographic
from geoposition.terrain import RasterTerrain

_DEGREE_M: Final = 111320.0


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


def run(product: Product, request: Request, progress: Progress) -> dict[str, object]:
    """Make the orthoimage and its flags; returns facts fit for JSON."""
    begin = perf_counter()
    terrain = RasterTerrain(request.dem, request.geoid)
    own = isinstance(product.model, RpcModel) and request.image == product.path
    flags_path = request.output.with_name(f"{request.output.stem}_flags.tif")
    with (
        opened_image(request.image, crop=not own) as image,
        scratch_beside(request.output) as scratch,
    ):
        check_size(product.model, image)
        grid = _grid(product.model, terrain, request)
        task = OrthoTask(product.model, terrain, request.occlusion, request.bound_px)
        tally = _written(task, grid, image, request, scratch, progress)
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


_PIXELS: Final = "ortho.tif"
_FLAGS: Final = "flags.tif"


def _written(
    task: OrthoTask,
    grid: OrthoGrid,
    image: ImageFile,
    request: Request,
    folder: Path,
    progress: Progress,
) -> Tally:
    """Write image and flags into `folder`; while rows are made, those before are coded."""
    fill = nodata_of(image, request.nodata)
    if fill is None and image.dtype.kind != "f":
        fill = 0.0
    tally, rows = Tally(), grid.shape[0]
    maker = OrthoMaker(task, image, request.method, fill)
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
        for first in range(0, rows, ROWS):
            pixels, flags = maker.rows(grid, first, tally)
            for job in pending:
                job.result()
            pending = [
                writer.submit(pixels_file.write, pixels),
                writer.submit(flags_file.write, flags[None]),
            ]
            progress(min(first + ROWS, rows), rows)
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
