"""A block of images from one camera pair: strips side by side, tied to each other, by the million.

Run it with `python -m geoposition.scripts.bench.adjustment_block [images] [ties] [overlap]`. The
more the strips overlap, the more images show a tie: with a tenth of a strip 2.5 image points come
to a tie, with a fifth 3.1, and time and memory go with the image points.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from geoposition.adjust import adjusted_models, attitude_bias
from geoposition.arrays import FloatArray, IntArray
from geoposition.flags import Flag
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.scripts.bench.adjustment import (
    CONTROL,
    GPS_M,
    NOISE_PX,
    STILL,
    Problem,
    ours,
)
from geoposition.sensor_model import SensorModel
from geoposition.sensors.simulate import ARCSEC_RAD, simulate_scene, zy3_cameras

IMAGES: Final = 50
TIES: Final = 1_000_000
TARGET_S: Final = 60.0
TARGET_GIB: Final = 4.0
OVERLAP: Final = 0.1
"""Of a strip's width and length, with its neighbours'."""
_WIDE_DEG: Final = 0.5625
_LONG_DEG: Final = 0.525
"""A strip, in degrees of longitude and latitude where the block lies."""
_COLUMNS: Final = 8


def block_problem(
    images: int = IMAGES, ties: int = TIES, overlap: float = OVERLAP, seed: int = 0
) -> Problem:
    """Forward and backward images of `images` / 2 strips; every tie is seen in two to four."""
    forward, _, backward = zy3_cameras()
    models: list[SensorModel] = []
    for strip in range(max(images // 2, 1)):
        column, row = strip % _COLUMNS, strip // _COLUMNS
        place = replace(
            STILL,
            lon_deg=110.0 + _WIDE_DEG * (1.0 - overlap) * column,
            lat_deg=33.0 + _LONG_DEG * (1.0 - overlap) * row,
        )
        scene = simulate_scene(place, 1, (forward, backward))
        models += [scene.true["forward"], scene.true["backward"]]
    blocks = tuple(
        attitude_bias(f"image {k}", models, [k], sigma_rad=20.0 * ARCSEC_RAD)
        for k in range(len(models))
    )
    rng = np.random.default_rng(seed)
    theta = rng.normal(0.0, 10.0 * ARCSEC_RAD, 3 * len(models))
    truth = adjusted_models(models, blocks, theta)
    ground = _ground(truth, CONTROL, rng)
    control = ControlPoints(
        np.arange(len(ground)),
        ground,
        diagonal_covariance(GPS_M, len(ground), 3),
        _seen(truth, ground, rng),
    )
    return Problem(
        tuple(models), blocks, control, _seen(truth, _ground(truth, ties, rng), rng), theta
    )


def _ground(models: Sequence[SensorModel], count: int, rng: np.random.Generator) -> FloatArray:
    """Ground points (count, 3) spread over all strips, as their forward images show them."""
    parts = []
    shares = np.array_split(np.arange(count), len(models) // 2)
    for model, share in zip(models[::2], shares, strict=True):
        image = rng.uniform(800.0, np.array(model.shape) - 800.0, (len(share), 2))
        height = rng.uniform(600.0, 1500.0, len(share))
        parts.append(model.image_to_ground(image, height).geodetic)
    return np.concatenate(parts)


def _seen(models: Sequence[SensorModel], ground: FloatArray, rng: np.random.Generator) -> TiePoints:
    """Noisy image points of `ground` in all images that show it."""
    ids: list[IntArray] = []
    images: list[FloatArray] = []
    for model in models:
        found = model.ground_to_image(ground)
        rows = np.flatnonzero(found.flag == Flag.OK)
        ids.append(rows)
        images.append(found.image_px[rows] + rng.normal(0.0, NOISE_PX, (len(rows), 2)))
    product = np.repeat(np.arange(len(models)), [len(rows) for rows in ids])
    return TiePoints(np.concatenate(ids), product, np.concatenate(images))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print time, peak memory, and how far the biases are from the planted ones."""
    given = sys.argv[1:] if arguments is None else arguments
    words = (*given, *map(str, (IMAGES, TIES, OVERLAP)[len(given) :]))
    images, ties, overlap = int(words[0]), int(words[1]), float(words[2])
    ours(block_problem(4, 2000))  # compiles
    case = block_problem(images, ties, overlap)
    begin = time.perf_counter()
    found = ours(case)
    elapsed = time.perf_counter() - begin
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    worst = np.max(np.abs(found - case.theta)) / ARCSEC_RAD
    print(
        f"{len(case.models)} images overlapping by {overlap:g}, {ties} ties, "
        f"{len(case.ties)} image points: {elapsed:.1f} s "
        f"(target {TARGET_S:g} s at {IMAGES} and {TIES}), {peak_gib:.2f} GiB "
        f"(target {TARGET_GIB:g}), largest error of a bias {worst:.2f} arcsec"
    )


if __name__ == "__main__":
    main()
