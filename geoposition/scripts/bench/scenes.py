"""What the benchmarks work on: real products where they are, else a made-up scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.constants import EARTH_RATE_RAD_S, GM_M3_S2, WGS84_A_M
from geoposition.corrections import ALL_CORRECTIONS, Corrections
from geoposition.ephemeris import Ephemeris
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.model import RpcModel
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers import open_product
from geoposition.sensors.timing import ConstantLineRate
from geoposition.timescale import Epoch

RIGOROUS = {
    "WorldView-2": "linescan/worldview2_pair/wv_mvp_1.xml",
    "Pleiades-1A": "linescan/pleiades1a",
    "SPOT 6": "linescan/spot6",
    "SPOT 5 HRS": "linescan/spot5_hrs",
    "WorldView-1": "linescan/worldview1_tile",
}
"""Rigorous products by name, relative to the folder of real data; the first is the main one."""

_PAIR = "stereo/pleiades_ventoux"
_PAIR_RPC = (
    f"{_PAIR}/RPC_PHR1B_P_201308051042194_SEN_690908101-001.XML",
    f"{_PAIR}/right_image.geom",
)
_DEM, _GEOID = "dem/N44E005.hgt", "dem/egm96_15.gtx"

NO_REFRACTION = Corrections(velocity_aberration=True, light_time=True)
"""What the peers correct for with formulas equal to ours."""


@dataclass(frozen=True, slots=True)
class RigorousScene:
    """A rigorous model and where it is from."""

    name: str
    model: PushbroomModel
    real: bool

    def without_refraction(self) -> RigorousScene:
        """Return the scene with the corrections that peers have too."""
        return replace(self, model=replace(self.model, corrections=NO_REFRACTION))


@dataclass(frozen=True, slots=True)
class RpcScene:
    """A pair of RPCs and a raster of ground heights, real or made up."""

    name: str
    left: RpcModel
    right: RpcModel
    dem: Path
    geoid: Path | None


def product_paths(data: Path | None) -> dict[str, Path]:
    """Products of `RIGOROUS` that are there."""
    if data is None:
        return {}
    return {name: data / part for name, part in RIGOROUS.items() if (data / part).exists()}


def rigorous_scenes(data: Path | None) -> list[RigorousScene]:
    """Real scenes that are there, the main one first; a synthetic one where there is none."""
    scenes = []
    for name, path in product_paths(data).items():
        model = open_product(path).model
        if isinstance(model, PushbroomModel):
            scenes.append(RigorousScene(name, model, real=True))
    return scenes or [RigorousScene("synthetic", synthetic_model(), real=False)]


def rpc_scene(data: Path | None, folder: Path) -> RpcScene:
    """Real pair with its terrain, else a synthetic one whose terrain is written to `folder`."""
    if data is not None:
        paths = [data / part for part in (*_PAIR_RPC, _DEM, _GEOID)]
        if all(path.exists() for path in paths):
            models = [
                open_product(path).vendor_rpc or open_product(path).model for path in paths[:2]
            ]
            left, right = models
            if isinstance(left, RpcModel) and isinstance(right, RpcModel):
                return RpcScene("Pleiades-1B Ventoux", left, right, paths[2], paths[3])
    left, right = synthetic_rpc(-0.35), synthetic_rpc(0.35)
    corners = [[0.0, 0.0], [0.0, 29999.0], [29999.0, 0.0], [29999.0, 29999.0]]
    ground = left.image_to_ground(np.array(corners), 500.0).geodetic
    dem = write_terrain(folder / "rpc_terrain.tif", ground, 0.05)
    return RpcScene("synthetic", left, right, dem, None)


def image_grid(shape: tuple[int, int], points: int, inset_px: float = 0.0) -> FloatArray:
    """About `points` image points (n, 2), row by row over an image, 256 samples a row at least."""
    rows = max(int(np.sqrt(points * shape[0] / shape[1])), 1)
    cols = max(points // rows, 2)
    line = np.linspace(inset_px, shape[0] - 1 - inset_px, rows)
    sample = np.linspace(inset_px, shape[1] - 1 - inset_px, cols)
    return np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1).reshape(-1, 2)


def synthetic_model() -> PushbroomModel:
    """Half-metre camera in a circular orbit at 600 km, 25 000 x 24 000 pixels, 50 Hz attitude.

    The attitude wobbles by some arc-seconds at 0.7 and 9 Hz, so that neither table is trivial.
    """
    lines, samples, gsd_m = 25_000, 24_000, 0.5
    epoch = Epoch.from_utc("2021-06-21T10:30:00Z")
    radius_m = WGS84_A_M + 600e3
    rate = float(np.sqrt(GM_M3_S2 / radius_m**3))
    ground_speed = rate * WGS84_A_M
    period_s = gsd_m / ground_speed
    reach_s = 0.56 * lines * period_s + 4.0
    times = np.arange(-reach_s, reach_s + 0.5, 0.5)
    position, _ = _orbit(times, radius_m, rate)
    ephemeris = Ephemeris.lagrange(epoch, times, position)
    times = np.arange(-reach_s, reach_s + 0.02, 0.02)
    position, velocity = _orbit(times, radius_m, rate)
    down = -position / np.linalg.norm(position, axis=1, keepdims=True)
    right = np.cross(down, velocity)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    nadir = Rotation.from_matrix(np.stack([np.cross(right, down), right, down], axis=-1))
    second = np.deg2rad(1 / 3600)
    wobble = second * np.stack(
        [
            4.0 * np.sin(2 * np.pi * 0.7 * times),
            4.0 * np.sin(2 * np.pi * 0.7 * times + 2.0),
            0.2 * np.sin(2 * np.pi * 9.0 * times),
        ],
        axis=-1,
    )
    body = nadir * Rotation.from_euler("xyz", [0.17, -0.1, 0.02]) * Rotation.from_rotvec(wobble)
    attitude = Attitude.from_samples(epoch, times, body.as_quat(), interpolation="slerp")
    half = 0.5 * (samples - 1)
    ifov = gsd_m / 600e3
    directions = PolynomialDirections(
        np.array([1e-3, 0.0, 3 * ifov]), np.array([0.0, half * ifov, 0.0, 3 * ifov]), half, half
    )
    timing = ConstantLineRate(epoch, -0.5 * (lines - 1) * period_s, period_s)
    camera = LineCamera.single((lines, samples), timing, directions)
    return PushbroomModel(camera, ephemeris, attitude, ALL_CORRECTIONS, (-100.0, 3000.0))


def _orbit(times_s: FloatArray, radius_m: float, rate: float) -> tuple[FloatArray, FloatArray]:
    """Position and inertial velocity on Earth-fixed axes, a circle over 40° N at time 0."""
    tilt, start = np.deg2rad(97.8), np.deg2rad(41.0)
    angle = start + rate * times_s
    node = 0.3 - EARTH_RATE_RAD_S * times_s
    c, s, ci, si = np.cos(angle), np.sin(angle), np.cos(tilt), np.sin(tilt)
    cn, sn = np.cos(node), np.sin(node)
    position = np.stack([cn * c - sn * ci * s, sn * c + cn * ci * s, si * s], axis=-1)
    velocity = np.stack([-cn * s - sn * ci * c, -sn * s + cn * ci * c, si * c], axis=-1)
    return radius_m * position, radius_m * rate * velocity


def synthetic_rpc(lean: float) -> RpcModel:
    """RPC of 30 000 x 30 000 pixels of half a metre; `lean` is the slant of its rays."""
    rng = np.random.default_rng(3)
    line_num, samp_num = rng.normal(0, 2e-6, (2, 20))
    line_den, samp_den = rng.normal(0, 1e-5, (2, 20))
    line_den[0] = samp_den[0] = 1.0
    line_num[:4] = [1e-4, 0.02, -1.0, -0.04 + 0.1 * lean]
    samp_num[:4] = [-2e-4, 1.0, 0.03, 0.15 * lean]
    return RpcModel(
        line_off_px=15000.0, line_scale_px=15000.0, samp_off_px=15000.0, samp_scale_px=15000.0,
        lon_off_deg=5.2, lon_scale_deg=0.095, lat_off_deg=44.2, lat_scale_deg=0.068,
        height_off_m=500.0, height_scale_m=1000.0,
        line_num=line_num, line_den=line_den, samp_num=samp_num, samp_den=samp_den,
        image_shape=(30000, 30000),
    )  # fmt: skip


def write_terrain(path: Path, geodetic: FloatArray, margin_deg: float) -> Path:
    """Write hills up to some 1500 m, nodes each 3 arc-seconds, around `geodetic` (n, 3).

    A sum of waves of many lengths (heights fall with the length): steep enough that a ray
    crosses several cells, and the same everywhere it is made.
    """
    step = 3.0 / 3600.0
    degrees = np.rad2deg(geodetic[:, :2])
    west, south = np.floor((degrees.min(axis=0) - margin_deg) / step) * step
    east, north = np.ceil((degrees.max(axis=0) + margin_deg) / step) * step
    lon = west + step * (0.5 + np.arange(round((east - west) / step)))
    lat = north - step * (0.5 + np.arange(round((north - south) / step)))
    rng = np.random.default_rng(11)
    height: NDArray[np.float32] = np.full((len(lat), len(lon)), 600.0, dtype=np.float32)
    for wave in range(40):
        length_deg = 0.3 * 0.87**wave
        along = rng.uniform(0.0, np.pi)
        phase = rng.uniform(0.0, 2 * np.pi)
        x = 2 * np.pi / length_deg * (np.cos(along) * (lon - west))
        y = 2 * np.pi / length_deg * (np.sin(along) * (lat - south)) + phase
        height += (500.0 * 0.87**wave * 0.5) * np.sin(y[:, None] + x[None, :]).astype(np.float32)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=len(lon),
        height=len(lat),
        count=1,
        dtype="float32",
        crs="EPSG:4326",
        transform=Affine(step, 0.0, west, 0.0, -step, north),
    ) as raster:
        raster.write(height, 1)
    return path
