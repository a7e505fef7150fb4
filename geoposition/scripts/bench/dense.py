"""Dense matching to a surface: speed, peak memory and error on a pair with known heights.

Run it as `python -m geoposition.scripts.bench.dense --size 10000`: one JSON object. Memory is
that of this process from its start, ties and compilation included.
"""

from __future__ import annotations

import argparse
import json
import resource
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Final

import numpy as np
import rasterio

from geoposition.datum import from_crs
from geoposition.product import Product
from geoposition.scripts import dsm_run
from geoposition.scripts.bench.dense_scene import DenseScene, dense_scene, true_height_m
from geoposition.scripts.results import unseen

TARGET_MPX_S: Final = 1.0
TARGET_GIB: Final = 2.0

_MOST_CHECKED: Final = 20_000
_INNER_PX: Final = 64


def measure(size: int, folder: Path) -> dict[str, object]:
    """Make a pair of `size` × `size` pixels in `folder` and run it; facts fit for JSON."""
    small = folder / "warm"
    small.mkdir()
    _run(dense_scene(small, 1024), small)  # compiles
    scene = dense_scene(folder, size)
    begin, worked = perf_counter(), process_time()
    facts = _run(scene, folder)
    wall, cpu = perf_counter() - begin, process_time() - worked
    seconds = facts["seconds"]
    assert isinstance(seconds, dict)
    mega = 1e-6 * size * size
    return {
        "size": [size, size],
        "mpx_s": mega / seconds["dense_to_surface"],
        "mpx_s_with_ties": mega / wall,
        "cpu_s_per_mpx": cpu / mega,
        "wall_s": wall,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "matched_share": facts["matched_share"],
        "error_m": errors(folder / "dsm.tif", scene, size),
        "target": {"mpx_s": TARGET_MPX_S, "peak_gib": TARGET_GIB},
    }


def errors(surface: Path, scene: DenseScene, size: int) -> dict[str, float]:
    """Surface less truth at some cells: median, NMAD, and the normalised one by the error band."""
    rng = np.random.default_rng(0)
    with rasterio.open(surface) as raster:
        row = rng.integers(0, raster.height, _MOST_CHECKED)
        column = rng.integers(0, raster.width, _MOST_CHECKED)
        x, y = raster.transform * (column + 0.5, row + 0.5)
        found = np.array(list(raster.sample(np.column_stack([x, y]), indexes=[1, 3])))
        crs = raster.crs.to_wkt()
    good = np.isfinite(found[:, 0])
    place = from_crs(crs, np.column_stack([x, y, found[:, 0]])[good])
    seen = scene.models[1].ground_to_image(place).image_px
    inside = np.all((seen >= _INNER_PX) & (seen < size - _INNER_PX), axis=1)
    line, sample = np.rint(seen[inside]).astype(int).T
    truth = np.array([true_height_m(v, 1, size)[0, u] for v, u in zip(line, sample, strict=True)])
    off = found[good][inside, 0] - truth
    ratio = off / found[good][inside, 1]
    spread = [1.4826 * float(np.median(np.abs(v - np.median(v)))) for v in (off, ratio)]
    return {
        "median": float(np.median(off)),
        "nmad": spread[0],
        "nmad_over_stated": spread[1],
        "beyond_1_m": float(np.mean(np.abs(off) > 1.0)),
    }


def _run(scene: DenseScene, folder: Path) -> dict[str, object]:
    products = [
        Product(source.path, "synthetic", "bench", model, image_path=source.path)
        for source, model in zip(scene.sources, scene.models, strict=True)
    ]
    request = dsm_run.Request(output=folder / "dsm.tif", resolution=0.5, remove_bias=True)
    return dsm_run.run(products, [], request, unseen)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=4000)
    parser.add_argument("--folder", type=Path, default=None)
    arguments = parser.parse_args()
    with TemporaryDirectory(dir=arguments.folder) as folder:
        print(json.dumps(measure(arguments.size, Path(folder)), indent=1))


if __name__ == "__main__":
    main()
