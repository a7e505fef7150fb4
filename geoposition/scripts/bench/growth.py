"""How speed and memory change with the size of the work: points, rows, images, cores."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numba
import numpy as np

from geoposition.scripts.bench import adjustment, cases
from geoposition.scripts.bench.adjustment_block import block_problem
from geoposition.scripts.bench.machine import PeakMemory, cores
from geoposition.scripts.bench.measure import Case, Spread, best_rate
from geoposition.scripts.bench.remap import reimage as reimage_case
from geoposition.scripts.bench.remap import remap_work
from geoposition.scripts.bench.scenes import RigorousScene, RpcScene, image_grid

_POINTS: Final = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
_ROWS: Final = (2_048, 8_192, 32_768)
_SAMPLES: Final = 2_048
_IMAGES: Final = (2, 4, 8, 16)
_TIES: Final = 5_000
"""For each image."""


@dataclass(frozen=True, slots=True)
class Growth:
    """One table: `rows` of figures by name, one for each of the `sizes`."""

    title: str
    size: str
    sizes: tuple[int, ...]
    rows: dict[str, tuple[float, ...]]


def by_points(scenes: Sequence[RigorousScene], quick: bool) -> Growth:
    """Direct location with more and more points a call."""
    sizes = _POINTS[:2] if quick else _POINTS
    rows = {}
    for scene in scenes:
        rates = []
        for size in sizes:
            image = image_grid(scene.model.shape, size)

            def direct(scene: RigorousScene = scene, image: Any = image) -> Any:
                return scene.model.image_to_ground(image, 100.0)

            repeats = 2 if quick else int(np.clip(1_000_000 // size, 3, 200))
            rates.append(best_rate(direct, len(image), repeats))
        rows[scene.name] = tuple(rates)
    return Growth("direct, ellipsoid: best Mpoint/s", "points a call", sizes, rows)


def by_rows(quick: bool) -> Growth:
    """Re-imaging from file to file of longer and longer images, each in a new process."""
    sizes = (256, 512) if quick else _ROWS
    samples = 256 if quick else _SAMPLES
    found = []
    for rows in sizes:
        command = [sys.executable, "-m", "geoposition.scripts.bench.reimage"]
        command += ["--rows", str(rows), "--samples", str(samples)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        found.append(json.loads(done.stdout))
    return Growth(
        f"re-imaging from file to file, {samples:,} samples",
        "rows",
        sizes,
        {
            "Mpx/s": tuple(float(one["file_mpx_s"]) for one in found),
            "peak of the process, MB": tuple(1073.7 * float(one["peak_gib"]) for one in found),
        },
    )


def by_images(quick: bool) -> Growth:
    """Adjust blocks of more and more images, three biases each, as many ties an image."""
    sizes = _IMAGES[:2] if quick else _IMAGES
    ties = 100 if quick else _TIES
    seconds, memory = [], []
    for images in sizes:
        case = block_problem(images, ties * images)
        adjustment.ours(case)
        with PeakMemory() as peak:
            begin = time.perf_counter()
            adjustment.ours(case)
            seconds.append(time.perf_counter() - begin)
        memory.append(float("nan") if peak.bytes is None else peak.bytes / 1e6)
    return Growth(
        f"adjustment, {ties:,} ties an image",
        "images",
        sizes,
        {"s": tuple(seconds), "peak MB": tuple(memory)},
    )


def by_cores(scene: RigorousScene, pair: RpcScene, quick: bool) -> Growth:
    """Speed-up of compiled loops by more threads, interleaved: medians of ours over one thread."""
    sizes = tuple(sorted({1, *(2**k for k in range(1, 8) if 2**k <= cores()), cores()}))
    points = 20_000 if quick else 1_000_000
    rigorous, rpc = cases.rigorous_work(scene, points), cases.rpc_work(pair, points)
    work = (
        cases.direct(rigorous),
        cases.inverse(rigorous),
        cases.rpc_project(rpc, pair.name),
        cases.rpc_locate(rpc, pair.name),
        cases.rpc_on_dem(rpc, pair),
        cases.pair_rays(cases.pair_work(pair, rpc)),
        reimage_case(remap_work(512 if quick else 4096), "cubic"),
    )
    rows = {case.title: _speed_ups(case, sizes, 2 if quick else 7) for case in work}
    return Growth("times as fast as one thread", "threads", sizes, rows)


def _speed_ups(case: Case, sizes: Sequence[int], repeats: int) -> tuple[float, ...]:
    before = numba.get_num_threads()
    taken = np.empty((repeats + 1, len(sizes)))
    try:
        for repeat in range(repeats + 1):
            for k, threads in enumerate(sizes):
                numba.set_num_threads(threads)
                begin = time.perf_counter()
                case.ours.run()
                taken[repeat, k] = time.perf_counter() - begin
    finally:
        numba.set_num_threads(before)
    by_threads = taken[1:, :1] / taken[1:]  # the first round compiles
    return tuple(Spread.of(column).median for column in by_threads.T)
