"""An orthoimage run: grid, windows, files."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window

from geoposition.arrays import FlagArray
from geoposition.datum import utm_epsg
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError, GeometryError, ProductError
from geoposition.flags import Flag, flag_labels, has_result
from geoposition.locate import locate
from geoposition.product import Product
from geoposition.reimage.ortho import (
    DEFAULT_BOUND_PX,
    OrthoGrid,
    OrthoPlaces,
    OrthoTask,
    block_means,
    ortho_window,
)
from geoposition.reimage.raster_files import (
    ImageFile,
    Layout,
    opened_image,
    to_cog,
    written_raster,
)
from geoposition.reimage.resample import Resampler
from geoposition.rpc.model import RpcModel
from geoposition.scripts.results import Progress
from geoposition.scripts.tables import whole_file
from geoposition.sensor_model import SensorModel
from geoposition.surface import is_geographic
from geoposition.terrain import RasterTerrain

OrthoMethod = Literal["nearest", "bilinear", "cubic", "lanczos", "area"]

_WINDOW: Final = (1024, 2048)
_DEGREE_M: Final = 111320.0
_MOST_FACTOR: Final = 16


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
    compress: str = "zstd"


@dataclass(slots=True)
class _Tally:
    """What the windows add up to; one for each run."""

    error_px: float = 0.0
    flags: Any = None

    def add(self, places: OrthoPlaces, flag: FlagArray) -> None:
        self.error_px = max(self.error_px, places.error_px)
        counts = np.bincount(flag.ravel(), minlength=len(Flag))
        self.flags = counts if self.flags is None else self.flags + counts


def run(product: Product, request: Request, progress: Progress) -> dict[str, object]:
    """Make the orthoimage and its flags; returns facts fit for JSON."""
    begin = perf_counter()
    terrain = RasterTerrain(request.dem, request.geoid)
    own = isinstance(product.model, RpcModel) and request.image == product.path
    tally = _Tally()
    with opened_image(request.image, crop=not own) as image:
        _check_size(product.model, image)
        grid = _grid(product.model, terrain, request)
        task = OrthoTask(product.model, terrain, request.occlusion, request.bound_px)
        flags_path = request.output.with_name(f"{request.output.stem}_flags.tif")
        with ExitStack() as stack:
            target = stack.enter_context(whole_file(request.output))
            flags = stack.enter_context(whole_file(flags_path))
            folder = Path(
                stack.enter_context(TemporaryDirectory(prefix=".ortho-", dir=request.output.parent))
            )
            raw, raw_flags = folder / "raw.tif", folder / "flags.tif"
            _windows(task, grid, image, request, raw, raw_flags, tally, progress)
            if not tally.flags[Flag.OK]:
                raise GeometryError("ortho: no pixel of the map is seen in the image")
            to_cog(raw, target, request.compress)
            to_cog(raw_flags, flags, "deflate", "nearest")
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


def _windows(
    task: OrthoTask,
    grid: OrthoGrid,
    image: ImageFile,
    request: Request,
    raw: Path,
    raw_flags: Path,
    tally: _Tally,
    progress: Progress,
) -> None:
    rows, cols = grid.shape
    fill = request.nodata if request.nodata is not None else image.nodata
    if fill is None and image.dtype.kind != "f":
        fill = 0.0
    maker = _Maker(task, image, request, fill)
    layout = Layout(
        grid.shape, image.bands, image.dtype.name,
        float("nan") if fill is None else fill, grid.crs, _transform(grid),
    )  # fmt: skip
    flag_layout = Layout(grid.shape, 1, "uint8", None, grid.crs, _transform(grid))
    corners = [(r, c) for r in range(0, rows, _WINDOW[0]) for c in range(0, cols, _WINDOW[1])]
    pending: Future[None] | None = None
    with (
        ThreadPoolExecutor(max_workers=1) as writer,
        written_raster(raw, layout) as pixels_file,
        written_raster(raw_flags, flag_layout) as flags_file,
    ):
        for done, (row, col) in enumerate(corners):
            size = min(_WINDOW[0], rows - row), min(_WINDOW[1], cols - col)
            pixels, flag, places = maker.window(grid.window(row, col, *size))
            tally.add(places, flag)
            if pending is not None:
                pending.result()
            window = Window(col, row, size[1], size[0])
            pending = writer.submit(_store, window, pixels, flag, pixels_file, flags_file)
            progress(done + 1, len(corners))
        if pending is not None:
            pending.result()


def _store(
    window: Window, pixels: NDArray[Any], flag: FlagArray, pixels_file: Any, flags_file: Any
) -> None:
    pixels_file.write(pixels, window=window)
    flags_file.write(flag, 1, window=window)


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes the pixels of one window after the other."""

    task: OrthoTask
    image: ImageFile
    request: Request
    fill: float | None

    def window(self, grid: OrthoGrid) -> tuple[NDArray[Any], FlagArray, OrthoPlaces]:
        """Pixels (bands, rows, cols) and flags (rows, cols) of `grid`, and their places."""
        if self.request.method == "area":
            return self._means(grid)
        places = ortho_window(self.task, grid)
        resampler = Resampler(self.request.method, self.fill)
        pixels, valid = self._values(resampler, places)
        flag = np.where((places.flag == Flag.OK) & (valid == 0), Flag.OUTSIDE_MODEL, places.flag)
        return pixels, flag.astype(np.uint8), places

    def _means(self, grid: OrthoGrid) -> tuple[NDArray[Any], FlagArray, OrthoPlaces]:
        """Mean of so many values within each pixel that none of the image's is passed over."""
        rough = ortho_window(self.task, grid)
        factor = _stretch(rough)
        if factor == 1:
            return _Maker(self.task, self.image, _bilinear(self.request), self.fill).window(grid)
        fine = ortho_window(self.task, grid.finer(factor))
        values, valid = self._values(Resampler("bilinear", self.fill), fine)
        mean, seen = block_means(values, valid, factor)
        whole = self.image.dtype.kind != "f"
        pixels = np.where(seen != 0, np.rint(mean) if whole else mean, _number(self.fill))
        flag = np.where((rough.flag == Flag.OK) & (seen == 0), Flag.OUTSIDE_MODEL, rough.flag)
        flag[seen != 0] = Flag.OK
        return pixels.astype(self.image.dtype), flag.astype(np.uint8), fine

    def _values(self, resampler: Resampler, places: OrthoPlaces) -> tuple[NDArray[Any], FlagArray]:
        lines, samples = self.image.shape
        first = np.array([self.image.first_line, self.image.first_sample])
        known = np.isfinite(places.line)
        empty = np.zeros(places.line.shape, dtype=np.uint8)
        if known.any():
            low = [float(np.nanmin(p)) for p in (places.line, places.sample)] - first
            high = [float(np.nanmax(p)) for p in (places.line, places.sample)] - first
            start = np.clip(np.floor(low).astype(int) - resampler.reach, 0, (lines, samples))
            end = np.clip(np.ceil(high).astype(int) + resampler.reach + 1, 0, (lines, samples))
            if np.all(end > start):
                pixels = self.image.window(*start.tolist(), *(end - start).tolist())
                origin = (int(start[0] + first[0]), int(start[1] + first[1]))
                return resampler.at(pixels, places.line, places.sample, origin)
        shape = (self.image.bands, *places.line.shape)
        return np.full(shape, _number(self.fill)).astype(self.image.dtype), empty


def _number(fill: float | None) -> float:
    return float("nan") if fill is None else fill


def _bilinear(request: Request) -> Request:
    return replace(request, method="bilinear")


def _stretch(places: OrthoPlaces) -> int:
    """Image pixels that a new pixel spans, in its longer direction, rounded up."""
    longest = 1.0
    for values in (places.line, places.sample):
        for axis in (0, 1):
            steps = np.abs(np.diff(values, axis=axis))
            steps = steps[np.isfinite(steps)]
            if steps.size:
                longest = max(longest, float(np.median(steps)))
    return int(min(np.ceil(longest - 0.05), _MOST_FACTOR))


def _transform(grid: OrthoGrid) -> tuple[float, ...]:
    return grid.left, grid.resolution, 0.0, grid.top, 0.0, -grid.resolution


def _check_size(model: SensorModel, image: ImageFile) -> None:
    if isinstance(model, RpcModel) and not model.shape_known:
        return
    end = image.first_line + image.shape[0], image.first_sample + image.shape[1]
    if end[0] > model.shape[0] or end[1] > model.shape[1]:
        raise ProductError(
            image.path, "size",
            f"an image of {model.shape[0]} x {model.shape[1]} or a crop of it expected, this one "
            f"ends at line {end[0] - 1} and sample {end[1] - 1}",
        )  # fmt: skip


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
        return OrthoGrid.around(model, terrain, crs, resolution)
    left, bottom, right, top = request.extent
    if not (right > left and top > bottom and resolution > 0.0):
        raise ArgumentError("--extent: left, bottom, right, top expected, and a positive --res")
    shape = round((top - bottom) / resolution), round((right - left) / resolution)
    return OrthoGrid(crs, left, top, resolution, shape)
