"""Telemetry, model and image as files that the commands take."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from rasterio.windows import Window

from geoposition.arrays import FloatArray
from geoposition.calib_fields.synthetic_strip import strip_image
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.experiments.jitter.cases import Case
from geoposition.scripts.experiments.jitter.ground import Ground
from geoposition.scripts.experiments.jitter.scene import Sighting
from geoposition.scripts.tables import whole_file, write_table
from geoposition.sensors.telemetry import Mounting
from geoposition.sensors.writers.attitude_table import attitude_columns, star_columns
from geoposition.sensors.writers.model_file import write_model_file

SENSOR: Final = "simulated 0.5 m satellite of P, {kind}"

_AROUND_S: Final = 2.0
"""Attitude that a table holds before and after the image."""
_DARK: Final = 120.0
_BRIGHT: Final = 1500.0
"""Eleven bits, as the cameras of such satellites have them."""
_NOISE: Final = 8.0


def write_telemetry(sighting: Sighting, folder: Path) -> None:
    """Write star samples, increments, mounting, orbit, on-board attitude, and `times.csv`.

    The last are the sensor's epochs around the image, at which the fused attitude is wanted.
    """
    folder.mkdir(parents=True)
    scene = sighting.scene
    write_table(folder / "star.csv", star_columns(scene.star))
    sensor = scene.sensor
    values = {f"d_{axis}": np.array(sensor.values[:, k]) for k, axis in enumerate("xyz")}
    write_table(folder / "displacement.csv", {"t_s": np.array(sensor.times_s), **values})
    _write_mounting(folder / "mounting.toml", scene.mounting)
    _write_orbit(folder / "ephemeris.csv", sighting)
    times = np.asarray(scene.onboard.curve.knots_s)
    quat = scene.onboard.rotation(times).as_quat()
    write_table(folder / "onboard.csv", attitude_columns(times, quat))
    near = np.abs(sensor.times_s) <= sighting.size.half_s + _AROUND_S
    write_table(folder / "times.csv", {"t_s": np.array(sensor.times_s[near])})


def write_models(sighting: Sighting, true: PushbroomModel, folder: Path, image: Path) -> None:
    """Write the model that comes with the image, and beside it the true one."""
    kinds = {
        "onboard": (sighting.onboard_model(), "on-board attitude"),
        "true": (true, "the truth"),
    }
    for name, (model, kind) in kinds.items():
        path = folder / f"{name}.toml"
        write_model_file(model, path, sensor=SENSOR.format(kind=kind), image=image)


def write_image(
    path: Path,
    case: Case,
    model: PushbroomModel,
    ground: Ground,
    progress: Callable[[int, int], None],
) -> None:
    """Take the image that `model` sees of `ground`, with noise, as 16-bit numbers."""
    lines, samples = model.shape
    rng = np.random.default_rng([case.seed, 1])
    with (
        whole_file(path) as temporary,
        _plain(),
        rasterio.open(
            temporary, "w", driver="GTiff", width=samples, height=lines, count=1, dtype="uint16",
            nodata=0, tiled=True, compress="zstd", zstd_level=1, predictor=2,
            num_threads="all_cpus", bigtiff="if_safer",
        ) as raster,
    ):  # fmt: skip
        for first, bright in strip_image(model, ground.terrain, ground.grid, ground.texture):
            noise = rng.standard_normal(bright.shape, dtype=np.float32)
            grey = np.rint(_DARK + _BRIGHT * bright + _NOISE * noise)
            values = np.clip(grey, 1.0, 65535.0).astype(np.uint16)
            raster.write(values, 1, window=Window(0, first, samples, len(values)))
            progress(first + len(bright), lines)


@contextmanager
def _plain() -> Iterator[None]:
    """Let an image have no map coordinates, which as taken is as it should be."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def _write_mounting(path: Path, mounting: Mounting) -> None:
    parts = []
    for name, rotation in mounting.R_body_sensor.items():
        quat = ", ".join(repr(float(v)) for v in rotation.as_quat())
        parts.append(f'[{name}]\nquat_xyzw = [{quat}]\ndirection = "sensor_to_body"\n')
    path.write_text("\n".join(parts), encoding="utf-8")


def _write_orbit(path: Path, sighting: Sighting) -> None:
    """Positions and Earth-fixed velocities; the remarks say frame and epoch."""
    ephemeris = sighting.ephemeris()
    times: FloatArray = np.asarray(ephemeris.curve.knots_s, dtype=np.float64)
    states = np.hstack([ephemeris.position_m(times), ephemeris.velocity_m_s(times)])
    rows = [",".join(map(repr, row)) for row in np.column_stack([times, states]).tolist()]
    head = ["# frame: itrs", f"# epoch: {sighting.case.epoch_utc}", "t_s,x,y,z,vx,vy,vz"]
    with whole_file(path) as temporary:
        temporary.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
