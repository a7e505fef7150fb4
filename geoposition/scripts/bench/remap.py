"""Resampling in memory: ours beside OpenCV's remap, and orthoimages beside GDAL's warp.

OpenCV is given the map of places ready made. Beside it stand our resampler with the same map
(the same work), and re-imaging from models to pixels, which finds the places too (more work).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.warp import Resampling, reproject
from rasterio.windows import Window, transform

from geoposition.arrays import FloatArray
from geoposition.calib_fields.synthetic import synthetic_terrain
from geoposition.product import Product
from geoposition.reimage.resample import Method, Resampler
from geoposition.reimage.steady import steady_model
from geoposition.reimage.strips import Part, parts_of, strips
from geoposition.rpc.fit import fit_model
from geoposition.scripts import ortho_run
from geoposition.scripts.bench.machine import cores, installed
from geoposition.scripts.bench.measure import Case, Contender, Missing
from geoposition.scripts.bench.remap_scene import (
    HEIGHT_M,
    STRIP,
    dense_places,
    image_file,
    shaken_model,
    texture,
)
from geoposition.scripts.results import unseen

SIZE: Final = 4096
QUICK_SIZE: Final = 1024
_ORTHO_SIZE: Final = SIZE
_OURS: Final = "geoposition"
_EVERY: Final = slice(None)
_METHODS: Final[tuple[Method, ...]] = ("bilinear", "cubic")
_TARGETS: Final = {"bilinear": 150.0, "cubic": 80.0}
_SAME_GREY: Final = {"bilinear": 1.01, "cubic": 6.0}
"""Rounding; OpenCV's cubic kernel is another (-0.75 for our -0.5), so that noise differs more."""
_MOST_ROWS: Final = 1024


@dataclass(frozen=True, slots=True, eq=False)
class RemapWork:
    """An image (1, rows, cols), the parts of its re-imaging, and its places ready made."""

    image: NDArray[Any]
    parts: tuple[Part, ...]
    line: NDArray[Any]
    sample: NDArray[Any]

    @property
    def points(self) -> int:
        """How many pixels."""
        return self.image.size


def remap_work(size: int) -> RemapWork:
    """Make a square image and the map from the steady camera's to it."""
    taken = shaken_model(size, size)
    steady, _ = steady_model(taken)
    parts = parts_of(steady, taken, HEIGHT_M)
    places = dense_places(parts[0].mapping.rows(0, size), size, size)
    return RemapWork(texture(size, size)[None], parts, *places)


def remap_cases(quick: bool = False) -> Iterator[Case]:
    """Resample with ready places, and re-image from models, by two kernels each."""
    work = remap_work(QUICK_SIZE if quick else SIZE)
    for method in _METHODS:
        yield remap(work, method, _opencv(work, method))
    for method in _METHODS:
        yield reimage(work, method, _opencv(work, method))


def remap(work: RemapWork, method: Method, *peers: Contender | Missing) -> Case:
    """Resample at places that are given."""
    resampler = Resampler(method)

    def run() -> Any:
        return resampler.at(work.image, work.line, work.sample)

    def result(raw: Any) -> FloatArray:
        return _seen(raw[0][0], raw[1])

    return Case(
        key=f"remap-{method}",
        title=f"{method} at ready places, {_size(work.image[0])}",
        points=work.points,
        unit="grey",
        tolerance=_SAME_GREY[method],
        ours=Contender(_OURS, _EVERY, run, result),
        peers=peers,
        bytes_per_point=2 + 2 + 8 + 1,
    )


def reimage(work: RemapWork, method: Method, *peers: Contender | Missing) -> Case:
    """Re-image from models to pixels, strip by strip."""
    resampler = Resampler(method)

    def run() -> Any:
        made = strips(work.parts, lambda a, b: work.image[:, a:b], resampler, STRIP)
        return [(strip.pixels[0], strip.valid) for strip in made]

    def result(raw: Any) -> FloatArray:
        return np.concatenate([_seen(pixels, valid) for pixels, valid in raw])

    return Case(
        key=f"reimage-{method}",
        title=f"{method} re-imaging from the models, {_size(work.image[0])}",
        points=work.points,
        unit="grey",
        tolerance=_SAME_GREY[method],
        share=0.9999,  # where the map's interpolation moves a place over a sharp edge
        ours=Contender(_OURS, _EVERY, run, result, "finds the places too"),
        peers=peers,
        target_mpoint_s=_TARGETS[method],
        bytes_per_point=2 + 2 + 1,
    )


def _opencv(work: RemapWork, method: Method) -> Contender | Missing:
    version = installed("opencv-python-headless") or installed("opencv-python")
    name = f"cv2.remap {version}" if version else "cv2.remap"
    try:
        import cv2
    except ImportError as error:
        return Missing(name, f"not installed ({error})")
    kernel = {"bilinear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC}[method]
    image = work.image[0]
    height, width = image.shape
    reach = 1 if method == "bilinear" else 2
    inside = (work.line >= reach) & (work.line < height - 1 - reach)
    inside &= (work.sample >= reach) & (work.sample < width - 1 - reach)

    def run() -> Any:
        return cv2.remap(image, work.sample, work.line, kernel)

    def result(raw: Any) -> FloatArray:
        return _seen(raw, inside)

    return Contender(name, _EVERY, run, result, f"{cv2.getNumThreads()} threads, places given")


def ortho_cases(folder: Path, quick: bool = False) -> Iterator[Case]:
    """Make an orthoimage with an RPC and a DEM; beside it GDAL's exact and approximate warp."""
    size = QUICK_SIZE if quick else _ORTHO_SIZE
    steady, _ = steady_model(shaken_model(size, size))
    rpc = fit_model(steady).model
    centre = steady.image_to_ground([0.5 * size, 0.5 * size], HEIGHT_M).geodetic
    reach = 0.75 * size + 2000.0
    synthetic_terrain(
        centre[0], centre[1], reach, reach, lowest_m=100.0, highest_m=600.0,
        step_rad=float(np.radians(1.0 / 3600.0)),
    ).write(folder / "dem.tif")  # fmt: skip
    source = folder / "ortho_image.tif"
    image_file(source, size, size, rpc)
    request = ortho_run.Request(
        source, folder / "ortho.tif", folder / "dem.tif", resolution=0.5,
        method="bilinear", compress="none",
    )  # fmt: skip
    product = Product(source, "simulated", "simulated", rpc)

    def run() -> Any:
        return ortho_run.run(product, request, unseen)

    def result(raw: Any) -> FloatArray:
        with rasterio.open(request.output) as raster:
            pixels = raster.read(1)
        return _seen(pixels, pixels != 0)

    run()
    with rasterio.open(request.output) as raster:
        shape = raster.shape
    yield Case(
        key="ortho-bilinear",
        title=f"bilinear orthoimage with RPC and DEM, {shape[0]:,} x {shape[1]:,}",
        points=shape[0] * shape[1],
        unit="grey",
        tolerance=_SAME_GREY["cubic"],
        share=0.999,  # a tenth of a pixel, GDAL's tolerance, on noise
        ours=Contender(_OURS, _EVERY, run, result, "from file to file, with flags"),
        peers=[
            _warp(request, name, tolerance_px, quick)
            for name, tolerance_px in (("exact", 0.0), ("approximate", 0.125))
        ],
        bytes_per_point=2 + 2 + 1,
    )


def _warp(request: ortho_run.Request, name: str, tolerance_px: float, quick: bool) -> Contender:
    """GDAL's warp of full rows in the middle of the same map, in memory."""
    with rasterio.open(request.image) as source, rasterio.open(request.output) as target:
        rows, cols = target.shape
        most = 64 if quick else _MOST_ROWS
        some = min(rows, most if tolerance_px else most // 4)
        first = (rows - some) // 2
        pixels = source.read(1)
        given = {
            "rpcs": source.rpcs,
            "src_crs": "EPSG:4326",
            "dst_crs": target.crs,
            "dst_transform": transform(Window(0, first, cols, some), target.transform),
        }

    # GDAL would take few rows of a turned image for a smaller one, and smooth
    plain = {"XSCALE": 1.0, "YSCALE": 1.0}

    def run() -> Any:
        out = np.zeros((some, cols), dtype=np.uint16)
        reproject(
            pixels, out, **given, resampling=Resampling.bilinear, num_threads=cores(),
            tolerance=tolerance_px, RPC_DEM=str(request.dem), **plain,
        )  # fmt: skip
        return out

    return Contender(
        f"GDAL {rasterio.__gdal_version__} warp, {name}",
        slice(first * cols, (first + some) * cols),
        run,
        lambda raw: _seen(raw, raw != 0),
        f"{cores()} threads, in memory",
    )


def _seen(pixels: NDArray[Any], valid: NDArray[Any]) -> FloatArray:
    """Grey values (n, 1), NaN where there are none."""
    values = np.where(valid != 0, pixels, np.float32(np.nan)).astype(np.float32)
    return np.asarray(values.reshape(-1, 1))


def _size(image: NDArray[Any]) -> str:
    return f"{image.shape[0]:,} x {image.shape[1]:,}"
