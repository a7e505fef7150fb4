"""What is fed: every reader, with whole files of its format as seeds."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.attitude import Attitude
from geoposition.calib_fields.field import load_field
from geoposition.corrections import ALL_CORRECTIONS
from geoposition.ephemeris import Ephemeris
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.formats import DIALECTS, read_rpc, write_rpc
from geoposition.scripts.adjust.example import EXAMPLE as ADJUST_EXAMPLE
from geoposition.scripts.adjust.input import read_run
from geoposition.scripts.batch.plan import EXAMPLE as BATCH_EXAMPLE
from geoposition.scripts.batch.plan import read_plan
from geoposition.scripts.bench.scenes import synthetic_rpc
from geoposition.scripts.control_files.formats import read_control_file
from geoposition.scripts.evaluate.settings import Settings, scenes_of
from geoposition.scripts.tables import read_table
from geoposition.scripts.tie_tables import read_ties
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers import open_product
from geoposition.sensors.readers.attitude_tables import PLAIN
from geoposition.sensors.readers.camera_file import read_camera_file
from geoposition.sensors.readers.ephemeris_table import read_ephemeris
from geoposition.sensors.readers.location_grid import read_location_grid
from geoposition.sensors.readers.telemetry_source import open_gyro, open_mounting, open_star
from geoposition.sensors.readers.vector_table import read_vectors
from geoposition.sensors.telemetry import Mounting
from geoposition.sensors.timing import ConstantLineRate
from geoposition.sensors.writers.csm import write_csm
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.sensors.writers.model_file_camera import write_camera_file
from geoposition.terrain import RasterTerrain
from geoposition.timescale import Epoch

_LARGEST_REAL: Final = 150_000
"""Bytes; larger products are for the trial on the command line."""
_REAL: Final = (
    "linescan/**/*.xml", "linescan/**/*.XML", "linescan/**/*.json", "linescan/**/*.[IAEGR]*",
    "rpc/*", "grids/*.XML", "stereo/**/*.geom", "stereo/**/*.XML",
)  # fmt: skip

Read = Callable[[Path], object]


@dataclass(frozen=True, slots=True)
class Seed:
    """A valid input: files by name, of which `main` is read; any of them may be mutated."""

    main: str
    files: dict[str, bytes]


@dataclass(frozen=True, slots=True)
class Target:
    """A reader and its seeds."""

    name: str
    read: Read
    seeds: tuple[Seed, ...]


def targets(data: Path | None) -> list[Target]:
    """All targets; those that need real products only where `data` has them."""
    found = [*_tables(), *_runs(), *_written()]
    if data is not None:
        found += _real(data)
    return found


def _text(name: str, *texts: str) -> tuple[Seed, ...]:
    return tuple(Seed(name, {name: text.encode()}) for text in texts)


def _rows(head: str, *rows: str, count: int = 12) -> str:
    """Return a table: `rows` with {t}, a time, and {k}, a number, `count` times."""
    lines = [row.format(t=0.25 * k, k=k) for k in range(count) for row in rows]
    return "\n".join([head, *lines, ""])


def _tables() -> Iterator[Target]:
    star = _rows(
        "t_s,sensor,q_x,q_y,q_z,q_w,sigma_cross_rad,sigma_bore_rad",
        "{t},A,0.1,0.2,0.3,0.927362,2e-5,2e-4", "{t},B,0,0.6,0,0.8,2e-5,2e-4",
    )  # fmt: skip
    yield Target("star table", lambda p: open_star(p, PLAIN), _text("star.csv", star))
    gyro = (
        _rows("t_s,w_x,w_y,w_z", "{t},1e-3,-2e-6,0"),
        _rows("t_s,d_x,d_y,d_z", "{t},1e-4,-2e-7,0"),
    )
    yield Target("gyro table", lambda p: open_gyro(p, PLAIN, Mounting()), _text("gyro.csv", *gyro))
    vectors = _rows(
        "t_s,sensor,id,body_x,body_y,body_z,ref_x,ref_y,ref_z,sigma_rad",
        "{t},A,s{k},1,0,0,1,0,0,1e-5", "{t},A,r{k},0,1,0,0,1,0,1e-5",
    )  # fmt: skip
    yield Target("vector table", read_vectors, _text("vectors.csv", vectors))
    orbit = "# frame: itrs\n# epoch: 2020-01-01T00:00:00Z\n" + _rows(
        "t_s,x,y,z,vx,vy,vz", "{t},6878137.0,{k},0,0,7500,100"
    )
    yield Target("ephemeris table", read_ephemeris, _text("orbit.csv", orbit))
    mounting = (
        "[A]\nquat_xyzw = [0.0, 0.6, 0.0, 0.8]\n"
        '[gyro]\neuler_deg = [1.0, 2.0, 3.0]\nsequence = "zxy"\n'
    )
    yield Target("mounting", open_mounting, _text("mounting.toml", mounting))
    points = _rows("id,row,col,height", "p{k},{k},{t},100.0")
    yield Target(
        "point table", lambda p: read_table(p, ("row", "col"), ("height",)), _text("p.csv", points)
    )
    ties = _rows("id,product,row,col", "p{k},a,{k},{t}", "p{k},b,{k},{t}")
    both = [Path("a.tif"), Path("b.tif")]
    yield Target("ties", lambda p: read_ties(p, both), _text("ties.csv", ties))
    gcps = (
        _rows("id,lon,lat,height,sigma_e,sigma_n,sigma_u", "g{k},5.{k},44.{k},300,0.1,0.1,0.2"),
        _rows("id,lon,lat,height,product,row,col", "g{k},5.{k},44.{k},300,a,{k},{t}"),
    )
    yield Target("control, CSV", read_control_file, _text("gcps.csv", *gcps))
    asp = _rows("# ASP", "{k} 44.{k} 5.{k} 300 0.1 0.1 0.2 a.tif {k} {t} 1 1")
    yield Target("control, ASP", read_control_file, _text("run.gcp", asp))
    qgis = _rows(
        '#CRS: GEOGCRS["WGS 84"]\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual',
        "5.{k},44.{k},{k},-{t},1,0,0,0",
    )
    yield Target("control, QGIS", read_control_file, _text("image.points", qgis))
    feature = (
        '{{"type":"Feature","properties":{{"id":"g{k}","row":{k},"col":{t}}},'
        '"geometry":{{"type":"Point","coordinates":[5.{k},44.{k},300.0]}}}}'
    )
    inner = ",".join(feature.format(k=k, t=0.25 * k) for k in range(6))
    collection = f'{{"type":"FeatureCollection","features":[{inner}]}}'
    yield Target("control, GeoJSON", read_control_file, _text("gcps.geojson", collection))


def _runs() -> Iterator[Target]:
    known = frozenset({("rpc", "fit"), ("locate",)})
    plan = BATCH_EXAMPLE.rpartition("[[scene]]")[0]
    yield Target("batch plan", lambda p: read_plan(p, known), _text("RUN.toml", plan))
    named = re.findall(r'"([\w./]+\.(?:XML|tif|csv|gtx|toml|points|gcp))"', ADJUST_EXAMPLE)
    files = {"RUN.toml": ADJUST_EXAMPLE.encode()} | dict.fromkeys(named, b"")
    yield Target("adjustment run", read_run, (Seed("RUN.toml", files),))
    scenes = '[defaults]\ndom = "dom.tif"\ndem = "dem.tif"\n[[scene]]\nproduct = "a.tif"\n'
    yield Target("evaluation run", lambda p: scenes_of(p, Settings()), _text("RUN.toml", scenes))
    field = (
        'name = "Songshan"\nepoch = "2014-05"\nlicence = "none"\nplane_datum = "EPSG:32649"\n'
        'height_datum = "ellipsoid"\n[extent]\nwest = 112.6\nsouth = 34.2\neast = 113.4\n'
        'north = 34.8\n[dom]\nfiles = ["dom.tif"]\nsigma_m = 0.5\n[dem]\nfiles = ["dem.tif"]\n'
        "sigma_m = 1.0\n"
    )
    made = Seed("field.toml", {"field.toml": field.encode(), "dom.tif": b"", "dem.tif": b""})
    yield Target("field", load_field, (made,))


def _written() -> Iterator[Target]:
    """Yield formats that this package writes itself, from a scene small enough to read fast."""
    model, rpc = small_model(), synthetic_rpc(0.2)
    names = {
        "rpb": "image.RPB", "rpc_txt": "image_RPC.TXT", "dimap": "image_RPC.XML",
        "dimap_system": "system.XML", "maxar_xml": "maxar.XML", "geotiff": "image.tif",
        "geom": "image.geom", "json": "image.json",
    }  # fmt: skip
    with TemporaryDirectory() as name:
        folder = Path(name)
        for dialect in DIALECTS:
            write_rpc(rpc, folder / names[dialect], dialect)
            main = Seed(names[dialect], {names[dialect]: (folder / names[dialect]).read_bytes()})
            yield Target(f"RPC, {dialect}", read_rpc, (main,))
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_model_file(model, folder / "scene.toml", sensor="synthetic")
        yield Target("model file", open_product, (_seed(folder, "scene.toml"),))
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_csm(model, folder / "state.json", sensor="synthetic")
        yield Target("CSM state", open_product, (_seed(folder, "state.json"),))
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_camera_file(model.camera, folder / "camera.toml")
        yield Target("camera file", read_camera_file, (_seed(folder, "camera.toml"),))


def _real(data: Path) -> Iterator[Target]:
    files = sorted({path for pattern in _REAL for path in data.glob(pattern) if path.is_file()})
    small = [path for path in files if path.stat().st_size <= _LARGEST_REAL]
    for path in small:
        name = f"product {path.relative_to(data).as_posix()}"
        yield Target(name, open_product, (Seed(path.name, {path.name: path.read_bytes()}),))
    for path in sorted((data / "attitude" / "gracefo_c").glob("*.txt")):
        seed = (Seed(path.name, {path.name: path.read_bytes()}),)
        yield Target(f"telemetry {path.name[:5]}", _telemetry, seed)
    grid, dem = data / "grids" / "GRID_P1BP--2017092838284574CP.tif", None
    for dem in sorted((data / "grids").glob("MNT_*.tif"))[:1]:
        yield Target("terrain", RasterTerrain, (Seed(dem.name, {dem.name: dem.read_bytes()}),))
    if grid.exists():
        seed = (Seed(grid.name, {grid.name: grid.read_bytes()}),)
        yield Target("location grid", read_location_grid, seed)


def _telemetry(path: Path) -> object:
    kind = path.name[:3]
    if kind == "SCA":
        return open_star(path, PLAIN)
    return open_mounting(path) if kind == "QSA" else open_gyro(path, PLAIN, Mounting())


def _seed(folder: Path, main: str) -> Seed:
    return Seed(main, {path.name: path.read_bytes() for path in folder.iterdir()})


def small_model() -> PushbroomModel:
    """Return a rigorous model of few samples: 500 km over the equator, a second of lines."""
    epoch = Epoch.from_utc("2021-06-21T10:30:00Z")
    times = np.arange(-3.0, 4.0, 0.5)
    angle = times * 1.1e-3
    radius_m = 6_878_137.0
    circle = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    ephemeris = Ephemeris.lagrange(epoch, times, radius_m * circle)
    # x along the flight (north), y east, z down.
    nadir = Rotation.from_matrix(np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]))
    body = Rotation.from_rotvec(np.stack([0 * angle, -angle, 0 * angle], axis=-1)) * nadir
    attitude = Attitude.from_samples(epoch, times, body.as_quat(), interpolation="slerp")
    camera = LineCamera.single(
        (4000, 3000),
        ConstantLineRate(epoch, 0.0, 2.5e-4),
        PolynomialDirections(np.zeros(2), np.array([0.0, 3e-3]), 1499.5, 1499.5),
    )
    return PushbroomModel(camera, ephemeris, attitude, ALL_CORRECTIONS, (-100.0, 3000.0))
