"""Scenes for the batch's trial: a camera with jitter over made-up ground, seen with many attitudes.

One image is made; each scene believes in an attitude of its own, so that no two give the same.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from scipy.spatial.transform import Rotation

from geoposition.attitude import Attitude
from geoposition.calib_fields.synthetic import synthetic_terrain
from geoposition.calib_fields.synthetic_dom import synthetic_dom, synthetic_image
from geoposition.calib_fields.synthetic_strip import footprint, lattice_around
from geoposition.datum import utm_epsg
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.bench.remap_scene import shaken_model
from geoposition.scripts.tables import Column, write_table
from geoposition.sensors.simulate import ARCSEC_RAD
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.terrain import RasterTerrain

KINDS: Final = ("evaluate", "reimage", "locate", "rpc")
"""Of work, the longest first: so the last ones to be done are short, and no worker waits long."""
SIGMA_RAD: Final = 3.0 * ARCSEC_RAD
"""Of what the scenes' attitudes are off, about each axis: some 7 m on the ground."""

_STEPS: Final = """\
[batch]
output = "out"
retries = 3

[[step]]
name = "rpc"
command = "rpc fit {product} -o {out}/image_RPC.TXT"

[[step]]
name = "locate"
command = "locate {product} {points} -o {out}/ground.parquet --dem {dem}"

[[step]]
name = "reimage"
command = "reimage {product} {image} -o {out}/steady --dem {dem}"

[[step]]
name = "evaluate"
command = "evaluate {product} --image {image} --dom {dom} --dem {dem} -o {out}/report --search 40"

[defaults]
image = "image.tif"
points = "points.parquet"
dom = "dom.tif"
dem = "dem.tif"
"""
_RESOLUTION_M: Final = 0.5
_MARGIN_M: Final = 80.0
_POINTS: Final = 400_000


def write_scenes(folder: Path, count: int, size: int) -> Path:
    """Write `count` scenes of `size` x `size` pixels and what they need; returns their RUN.toml.

    Each kind of work has its share.
    """
    true = shaken_model(size, size)
    centre = true.image_to_ground([0.5 * size, 0.5 * size], 300.0).geodetic
    reach = 0.75 * size + 2000.0
    synthetic_terrain(
        centre[0], centre[1], reach, reach, lowest_m=100.0, highest_m=600.0,
        step_rad=float(np.radians(1.0 / 3600.0)),
    ).write(folder / "dem.tif")  # fmt: skip
    terrain = RasterTerrain(folder / "dem.tif")
    crs = f"EPSG:{utm_epsg(centre[0], centre[1])}"
    texture = synthetic_dom(
        lattice_around([footprint(true, terrain)], crs, _RESOLUTION_M, _MARGIN_M)
    )
    texture.write(folder / "dom.tif")
    grey = synthetic_image(true, terrain, texture, noise=2.0, gain=8.0)
    _write_image(folder / "image.tif", np.nan_to_num(grey).round().clip(1).astype(np.uint16))
    rng = np.random.default_rng(0)
    places = rng.uniform(0.0, size - 1.0, (_POINTS, 2))
    columns: dict[str, Column] = {
        "id": np.arange(_POINTS, dtype=np.int64), "row": places[:, 0], "col": places[:, 1],
    }  # fmt: skip
    write_table(folder / "points.parquet", columns)
    text = _STEPS
    for number in range(count):
        kind, product = KINDS[number * len(KINDS) // count], f"scene{number:03d}.toml"
        model = _turned(true, rng.normal(0.0, SIGMA_RAD, 3))
        write_model_file(model, folder / product, sensor="simulated", image=folder / "image.tif")
        text += f'\n[[scene]]\nid = "s{number:03d}-{kind}"\nproduct = "{product}"\n'
        text += f'steps = ["{kind}"]\n'
    run = folder / "RUN.toml"
    run.write_text(text, encoding="utf-8")
    return run


def _turned(model: PushbroomModel, error_rad: np.ndarray) -> PushbroomModel:
    """Return `model` with an attitude that is off by a constant turn of the body."""
    curve = model.attitude
    times = np.asarray(curve.curve.knots_s)
    turned = curve.rotation(times) * Rotation.from_rotvec(error_rad)
    attitude = Attitude.from_samples(curve.epoch, times, turned.as_quat(), "itrs", "spline")
    return replace(model, attitude=attitude)


def _write_image(path: Path, pixels: np.ndarray) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path, "w", driver="GTiff", width=pixels.shape[1], height=pixels.shape[0], count=1,
            dtype=pixels.dtype, nodata=0,
        ) as file:  # fmt: skip
            file.write(pixels, 1)
