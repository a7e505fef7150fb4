"""Steady re-imaging and ortho: speed in memory beside OpenCV, from file to file beside GDAL.

Run it as `python -m geoposition.scripts.bench.reimage --size 8192`: one JSON object. Memory is
that of this process from its start, libraries and compilation included; `--only files` leaves
out what holds whole images in memory.
"""

from __future__ import annotations

import argparse
import json
import resource
import warnings
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any, Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning
from rasterio.warp import Resampling, reproject

from geoposition.attitude import Attitude
from geoposition.calib_fields.synthetic import synthetic_terrain
from geoposition.corrections import ALL_CORRECTIONS
from geoposition.ephemeris import Ephemeris
from geoposition.frames import R_itrs_gcrs, itrs_from_gcrs
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.cog import Compression, Layout, written_cog
from geoposition.reimage.mapping import RowMap
from geoposition.reimage.resample import Method, Resampler
from geoposition.reimage.steady import steady_model
from geoposition.reimage.strips import parts_of, strips
from geoposition.rpc.fit import fit_model
from geoposition.rpc.formats.geotiff import gdal_rpc
from geoposition.rpc.model import RpcModel
from geoposition.scripts import ortho_run, reimage_run
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.jitter_scene import JitterSceneOptions, simulate_jitter_scene
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.timing import ConstantLineRate

GROUPS: Final = ("files", "memory", "ortho")
TARGETS: Final = {"bilinear_mpx_s": 150.0, "cubic_mpx_s": 80.0, "file_mpx_s": 40.0, "peak_gib": 1.0}

_IFOV_RAD: Final = 0.5 / 490e3
_LINE_S: Final = 7e-5
_HEIGHT_M: Final = 300.0
_REPEATS: Final = 3
_STRIP: Final = 512
_MOST_PEER: Final = 2048


def scene(size: int) -> PushbroomModel:
    """P's satellite over a square image, its true attitude with the jitter of P figure 4."""
    told = simulate_jitter_scene(JitterSceneOptions(duration_s=12.0), seed=1)
    epoch, half_s = told.orbit.epoch, 0.5 * size * _LINE_S
    reach = 1.1 * half_s + 0.05
    times = np.arange(-reach, reach, 1e-4)
    rotation = R_itrs_gcrs(epoch, times) * told.R_inertial_body(times)
    attitude = Attitude.from_samples(epoch, times, rotation.as_quat(), "itrs", "spline")
    knots = np.arange(-12.0, 12.5, 0.5)
    position, _ = itrs_from_gcrs(*told.orbit.states(knots), epoch, knots)
    middle = 0.5 * (size - 1)
    directions = PolynomialDirections(
        np.zeros(1), np.array([0.0, middle * _IFOV_RAD]), middle, middle
    )
    timing = ConstantLineRate(epoch, -half_s, _LINE_S)
    camera = LineCamera.single((size, size), timing, directions)
    ephemeris = Ephemeris.lagrange(epoch, knots, position)
    return PushbroomModel(camera, ephemeris, attitude, ALL_CORRECTIONS, (-100.0, 1500.0))


def in_memory(size: int) -> dict[str, object]:
    """Map and resample a uint16 image in memory; beside it OpenCV's remap with ready maps."""
    taken = scene(size)
    steady, _ = steady_model(taken)
    parts = parts_of(steady, taken, _HEIGHT_M)
    image = _texture(size, size)[None]
    result: dict[str, object] = {}
    methods: tuple[Method, ...] = ("nearest", "bilinear", "cubic", "lanczos")
    for method in methods:
        resampler = Resampler(method)

        def whole(resampler: Resampler = resampler) -> None:
            for _ in strips(parts, lambda a, b: image[:, a:b], resampler, _STRIP):
                pass

        result[f"{method}_mpx_s"] = _speed(whole, size * size)
    return result | _opencv(image[0], parts[0].mapping.rows(0, size))


def _opencv(image: NDArray[Any], places: RowMap) -> dict[str, object]:
    try:
        import cv2
    except ImportError:
        return {}
    rows, cols = min(image.shape[0], 8192), min(image.shape[1], 8192)
    own = np.arange(cols, dtype=np.float64)
    place = places.part(0, rows).displacement_px(own).astype(np.float32)
    place[..., 0] += np.arange(rows, dtype=np.float32)[:, None]
    place[..., 1] += own.astype(np.float32)
    line, sample = np.ascontiguousarray(place[..., 0]), np.ascontiguousarray(place[..., 1])
    small = np.ascontiguousarray(image[:rows, :cols])
    kinds = {"bilinear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC}
    return {
        f"opencv_{name}_mpx_s": _speed(
            lambda kind=kind: cv2.remap(small, sample, line, kind),  # type: ignore[misc]
            rows * cols,
        )
        for name, kind in kinds.items()
    }


def files(size: int, folder: Path, compress: Compression) -> dict[str, object]:
    """Re-imaging from file to file, all products but the report."""
    warm = scene(1024)
    _image_file(folder / "warm.tif", 1024)
    _reimage(warm, folder / "warm.tif", folder / "warm", compress)
    taken = scene(size)
    _image_file(folder / "image.tif", size)
    begin, busy = perf_counter(), process_time()
    facts = _reimage(taken, folder / "image.tif", folder / "steady", compress)
    seconds, busy = perf_counter() - begin, process_time() - busy
    return {
        "file_mpx_s": 1e-6 * size * size / seconds,
        "file_mpx_per_core_s": 1e-6 * size * size / busy,
        "file_s": seconds,
        "parts_s": facts["seconds"],
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def _reimage(
    model: PushbroomModel, image: Path, output: Path, compress: Compression
) -> dict[str, object]:
    product = Product(image, "simulated", "simulated", model)
    request = reimage_run.Request(
        image, output, height_m=_HEIGHT_M, compress=compress, report=False
    )
    return reimage_run.run(product, request, lambda done, total: None)


def ortho(size: int, folder: Path) -> dict[str, object]:
    """Make an orthoimage with an RPC and a DEM; beside it GDAL's exact and approximate warp."""
    steady, _ = steady_model(scene(size))
    rpc = fit_model(steady).model
    centre = steady.image_to_ground([0.5 * size, 0.5 * size], _HEIGHT_M).geodetic
    reach = 0.75 * size + 2000.0
    synthetic_terrain(
        centre[0], centre[1], reach, reach, lowest_m=100.0, highest_m=600.0,
        step_rad=float(np.radians(1.0 / 3600.0)),
    ).write(folder / "dem.tif")  # fmt: skip
    _image_file(folder / "ortho_image.tif", size, rpc)
    product = Product(folder / "ortho_image.tif", "simulated", "simulated", rpc)
    result: dict[str, object] = {}
    for method in ("bilinear", "cubic"):
        request = ortho_run.Request(
            product.path, folder / f"{method}.tif", folder / "dem.tif", resolution=0.5,
            method=method, compress="none",
        )  # fmt: skip
        ortho_run.run(product, request, lambda done, total: None)
        facts = ortho_run.run(product, request, lambda done, total: None)
        result[f"ortho_{method}_mpx_s"] = facts["mpx_per_s"]
    grid = folder / "bilinear.tif"
    for name, tolerance in (("exact", 0.0), ("approximate", 0.125)):
        result[f"gdalwarp_{name}_mpx_s"] = _gdal(product.path, grid, folder / "dem.tif", tolerance)
    return result


def _gdal(image: Path, like: Path, dem: Path, tolerance: float) -> float:
    """Speed of GDAL's warp with RPC and DEM, of the middle of the same map."""
    with rasterio.open(image) as source, rasterio.open(like) as target:
        size = min(target.height, target.width, _MOST_PEER)
        window = rasterio.windows.Window(
            (target.width - size) // 2, (target.height - size) // 2, size, size
        )
        out = np.zeros((size, size), dtype=np.uint16)
        transform = target.window_transform(window)
        begin = perf_counter()
        reproject(
            source.read(1), out, rpcs=source.rpcs, src_crs="EPSG:4326", dst_crs=target.crs,
            dst_transform=transform, resampling=Resampling.bilinear, num_threads=2,
            tolerance=tolerance, RPC_DEM=str(dem),
        )  # fmt: skip
    return float(1e-6 * size * size / (perf_counter() - begin))


def _texture(rows: int, cols: int, first_row: int = 0) -> NDArray[np.uint16]:
    """Hills and noise of some grey values: compresses as a satellite's image does."""
    rng = np.random.default_rng(first_row)
    knots = np.arange(0, cols + 16, 16)
    across = np.interp(np.arange(cols), knots, rng.normal(0.0, 90.0, len(knots)))
    along = 60.0 * np.sin(2e-2 * np.arange(first_row, first_row + rows))
    level = (700.0 + across + along[:, None]).astype(np.uint16)
    noise = rng.integers(0, 13, (2, rows, cols), dtype=np.uint8).sum(axis=0, dtype=np.uint16)
    return np.asarray(level + noise)


def _image_file(path: Path, size: int, rpc: RpcModel | None = None) -> None:
    """Write an image of any size, holding some rows of it."""
    layout = Layout((size, size), 1, "uint16", rpc=None if rpc is None else gdal_rpc(rpc))
    with written_cog(path, layout, "none", "none") as raster:
        for row in range(0, size, _STRIP):
            raster.write(_texture(min(_STRIP, size - row), size, row)[None])


def _speed(work: Callable[[], object], pixels: int) -> float:
    work()
    best = np.inf
    for _ in range(_REPEATS):
        begin = perf_counter()
        work()
        best = min(best, perf_counter() - begin)
    return 1e-6 * pixels / float(best)


def measured(
    size: int,
    folder: Path | None = None,
    groups: tuple[str, ...] = GROUPS,
    compress: Compression = "zstd",
) -> dict[str, object]:
    """Measure the `groups` on images of `size` x `size`, their files in a part of `folder`."""
    result: dict[str, object] = {"size": [size, size], "targets": TARGETS}
    with TemporaryDirectory(dir=folder) as place, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        if "files" in groups:
            result |= files(size, Path(place), compress)
        if "memory" in groups:
            result |= in_memory(size)
        if "ortho" in groups:
            result |= ortho(min(size, 4096), Path(place))
    return result


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=8192, help="lines and samples of the image")
    parser.add_argument("--only", choices=GROUPS, default=None)
    parser.add_argument("--compress", default="zstd", help="of the steady image")
    parser.add_argument("--folder", type=Path, default=None, help="for the files; a scratch one")
    given = parser.parse_args()
    groups = GROUPS if given.only is None else (given.only,)
    print(json.dumps(measured(given.size, given.folder, groups, given.compress), indent=1))


if __name__ == "__main__":
    main()
