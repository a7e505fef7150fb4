"""Raw telemetry as it comes down: star, gyro, GPS tables, with blunders and gaps; mounting."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.ephemeris import Ephemeris
from geoposition.scripts.experiments.thesis.telemetry import Instruments, Telemetry
from geoposition.scripts.tables import whole_file, write_table
from geoposition.sensors.simulate import ARCSEC_RAD
from geoposition.sensors.telemetry import GyroSeries, StarSeries
from geoposition.sensors.writers.attitude_table import star_columns

BLUNDER_SHARE: Final = 0.015
BLUNDER_ARCSEC: Final = (60.0, 3000.0)
LOG_BLUNDER: Final = (float(np.log(BLUNDER_ARCSEC[0])), float(np.log(BLUNDER_ARCSEC[1])))
DUPLICATES: Final = 6
SHORT_GAP_S: Final = (62.0, 63.6)
LONG_GAP_S: Final = (-100.0, -92.0)
GYRO_GAP_S: Final = (80.0, 80.5)
VELOCITY_SIGMA_M_S: Final = 0.005


@dataclass(frozen=True, slots=True)
class Spoilt:
    """What was done to the star table."""

    blunders: int
    duplicates: int
    lost: int


def write_telemetry(
    folder: Path, data: Telemetry, flown: Instruments, rng: np.random.Generator
) -> Spoilt:
    """Write star_raw.csv, gyro.csv, ephemeris.csv and mounting.toml."""
    spoilt = _write_star(folder / "star_raw.csv", data.star, rng)
    _write_gyro(folder / "gyro.csv", data.gyro)
    _write_ephemeris(folder / "ephemeris.csv", data.ephemeris, rng)
    parts = [
        f"[{head.name}]\nquat_xyzw = {head.R_body_sensor.as_quat().tolist()}\n"
        for head in flown.heads
    ]
    with whole_file(folder / "mounting.toml") as temporary:
        temporary.write_text("\n".join(parts), encoding="utf-8")
    return spoilt


def _write_star(path: Path, star: StarSeries, rng: np.random.Generator) -> Spoilt:
    times = star.times_s
    lost = np.zeros(len(star), dtype=np.bool_)
    for low, high in (SHORT_GAP_S, LONG_GAP_S):
        lost |= (times > low) & (times < high)
    columns = star_columns(star)
    wrong = rng.uniform(size=len(star)) < BLUNDER_SHARE
    axis = rng.standard_normal((len(star), 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    size = ARCSEC_RAD * np.exp(rng.uniform(*LOG_BLUNDER, len(star)))
    turned = star.R_inertial_sensor * Rotation.from_rotvec(
        np.where(wrong[:, None], axis * size[:, None], 0.0)
    )
    quats = turned.as_quat() * rng.choice([-1.0, 1.0], (len(star), 1))
    columns |= {f"q_{name}": quats[:, k] for k, name in enumerate("xyzw")}
    kept = np.flatnonzero(~lost)
    again = np.sort(rng.choice(kept, DUPLICATES, replace=False))
    rows = np.sort(np.concatenate([kept, again]), kind="stable")
    write_table(path, {name: values[rows] for name, values in columns.items()})
    return Spoilt(int(np.sum(wrong & ~lost)), DUPLICATES, int(lost.sum()))


def _write_gyro(path: Path, gyro: GyroSeries) -> None:
    """Write increments; after a gap the next one holds all that was turned."""
    low, high = GYRO_GAP_S
    kept = np.flatnonzero(~((gyro.times_s > low) & (gyro.times_s < high)))
    total = np.cumsum(gyro.values, axis=0)
    since = np.concatenate([gyro.values[:1], np.diff(total[kept], axis=0)])
    columns = {f"d_{axis}": since[:, k] for k, axis in enumerate("xyz")}
    write_table(path, {"t_s": gyro.times_s[kept], **columns})


def _write_ephemeris(path: Path, ephemeris: Ephemeris, rng: np.random.Generator) -> None:
    times = ephemeris.curve.knots_s
    position = ephemeris.position_m(times)
    velocity = ephemeris.velocity_m_s(times)
    velocity = velocity + VELOCITY_SIGMA_M_S * rng.standard_normal(velocity.shape)
    columns = {f"{axis}_itrs": position[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"v{axis}_itrs": velocity[:, k] for k, axis in enumerate("xyz")}
    write_table(path, {"t_s": np.asarray(times), **columns})
