from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from csm_scene import EPOCH, HEIGHTS_M, SAMPLES, grid, orbit, quaternions, scene
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from geoposition.attitude import (
    Attitude,
    EulerCurve,
    ProductCurve,
    QuaternionCurve,
    RotationSplineCurve,
    SlerpCurve,
)
from geoposition.corrections import ALL_CORRECTIONS, Corrections, Refraction
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, MissingFileError, ProductError
from geoposition.frames import R_itrs_gcrs
from geoposition.interpolation import LagrangeCurve, PolynomialCurve, SplineCurve, SumCurve
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.directions import (
    CollinearDirections,
    PolynomialDirections,
    SplineDirections,
    TableDirections,
)
from geoposition.sensors.line_camera import Ccd, Mounting
from geoposition.sensors.readers import model_file
from geoposition.sensors.readers.csm_focal_plane import CubicDirections, FocalPlane
from geoposition.sensors.readers.csm_interpolation import CsmLagrangeCurve
from geoposition.sensors.readers.model_file import read_model_file
from geoposition.sensors.readers.source import Source
from geoposition.sensors.timing import ConstantLineRate, LineTimeTable
from geoposition.sensors.writers.model_file import rewrite_model_file, write_model_file
from geoposition.sensors.writers.model_file_parts import toml

PIXEL = 2e-6
TIMES = np.linspace(0.0, 6.0, 61)
QUATS = quaternions(TIMES, jitter_rad=1e-6)
POSITION, VELOCITY = orbit(TIMES)
EULER = Rotation.from_quat(QUATS).as_euler("ZXY")
SAMPLE_NODES = np.linspace(-400.0, SAMPLES + 400.0, 9)
TANGENTS = np.stack([0.003 + 0 * SAMPLE_NODES, PIXEL * (SAMPLE_NODES - 1500)], axis=-1)
TANGENTS += np.random.default_rng(1).normal(0, 1e-5, TANGENTS.shape)
QUARTER = Rotation.from_euler("y", 0.1)


def attitude(curve) -> dict[str, Attitude]:
    return {"attitude": Attitude(EPOCH, curve)}


def orbit_as(curve) -> dict[str, Ephemeris]:
    return {"ephemeris": Ephemeris(EPOCH, curve)}


EXACT = {
    "slerp and hermite": {},
    "rotation spline": attitude(RotationSplineCurve.through(TIMES, QUATS)),
    "quaternion lagrange": attitude(QuaternionCurve.lagrange(TIMES, QUATS)),
    "quaternion polynomial": attitude(QuaternionCurve.polynomial_fit(TIMES, QUATS, 5)),
    "quaternion spline": attitude(QuaternionCurve(SplineCurve.through(TIMES, QUATS))),
    "quaternion hermite": attitude(
        QuaternionCurve(SplineCurve.hermite(TIMES, QUATS, np.gradient(QUATS, TIMES, axis=0)))
    ),
    "equal steps": attitude(QuaternionCurve(CsmLagrangeCurve(0.0, 0.1, QUATS, 8)))
    | orbit_as(CsmLagrangeCurve(0.0, 0.1, POSITION, 4)),
    "euler lagrange": attitude(EulerCurve(LagrangeCurve(TIMES, EULER, 6), "ZXY")),
    "euler polynomial": attitude(EulerCurve(PolynomialCurve.fit(TIMES, EULER, 3), "ZXY")),
    "product": attitude(
        ProductCurve(
            SlerpCurve.through([0.0, 6.0], [QUARTER.as_quat(), QUARTER.as_quat()]),
            QuaternionCurve.lagrange(TIMES, (QUARTER.inv() * Rotation.from_quat(QUATS)).as_quat()),
        )
    ),
    "lagrange orbit": orbit_as(LagrangeCurve(TIMES, POSITION, 7)),
    "spline orbit": orbit_as(SplineCurve.through(TIMES, POSITION)),
    "polynomial orbit": orbit_as(PolynomialCurve.fit(TIMES, POSITION, 6)),
    # As an adjusted orbit is; noise in the samples makes it too rough for a dense table.
    "corrected orbit": orbit_as(
        SumCurve(
            LagrangeCurve(TIMES, POSITION + 0.05 * (-1.0) ** np.arange(len(TIMES))[:, None], 8),
            PolynomialCurve(np.array([[1.0, 2.0, 3.0], [0.1, 0.0, -0.1]]), 2.0, 1.0, (0.0, 6.0)),
        )
    ),
    "line table": {"timing": LineTimeTable(EPOCH, [0.0, 999.5, 3999.0], [1.0, 2.0, 5.0001])},
    "reverse scan": {"timing": ConstantLineRate(EPOCH + 0.25, 4.75, -1e-3)},
    "angles": {
        "directions": PolynomialDirections([0.1, 1e-4], [0.0, 3e-3, 1e-6], 1500.0, 1500.0, True)
    },
    "look-angle table": {"directions": TableDirections(SAMPLE_NODES, TANGENTS)},
    "look-angle spline": {"directions": SplineDirections(SAMPLE_NODES, TANGENTS)},
    "collinear": {
        "directions": CollinearDirections(
            10.0, (-0.03, 0.001), (2e-5, 3e-7), 1e-3, (0.001, 2e-4), (2e-2, 1e-1)
        )
    },
    "cubic": {
        "directions": CubicDirections(
            FocalPlane(np.array([-1500.0, 3.0]), np.array([1.0, 0.01]), 5e5, (-1.0, 1.0)),
            np.array([0.1, 1e-3, 1e-6, 1e-10]),
            np.array([-0.1, 2e-3, -1e-6, 2e-10]),
        )
    },
    "two ccds": {
        "ccds": (
            Ccd(1500, PolynomialDirections([0.003], [-0.003, PIXEL])),
            Ccd(1501, TableDirections([1500.0, 3000.0], [[0.0031, 0.0], [0.0032, 0.003]])),
        )
    },
    "corrections": {"corrections": ALL_CORRECTIONS},
    "other refraction": {"corrections": Corrections(True, False, Refraction(3e-4, 8000.0))},
    "no mounting": {"mounting": Mounting()},
}


def same_rays(a: PushbroomModel, b: PushbroomModel) -> None:
    points = grid(*a.shape, count=1500)
    ours, theirs = a.rays(points, 300.0), b.rays(points, 300.0)
    np.testing.assert_array_equal(ours.flag, theirs.flag)
    np.testing.assert_array_equal(ours.origin_ecef_m, theirs.origin_ecef_m)
    np.testing.assert_array_equal(ours.direction_ecef, theirs.direction_ecef)


@pytest.mark.parametrize("name", EXACT)
def test_reads_back_to_the_same_bits(name: str, tmp_path: Path) -> None:
    model = scene(**EXACT[name])
    report = write_model_file(model, tmp_path / "scene.toml", sensor='Sat "1"\n\\ü')
    product = read_model_file(tmp_path / "scene.toml")
    assert isinstance(product.model, PushbroomModel)
    same_rays(model, product.model)
    assert report.attitude_error_rad == 0.0
    assert product.sensor == 'Sat "1"\n\\ü'
    assert product.model.corrections == model.corrections
    assert product.model.height_range_m == HEIGHTS_M
    assert product.model.camera.timing.epoch == model.camera.timing.epoch
    assert product.start == model.camera.timing.epoch + float(model.camera.timing.time_s(0.0))
    assert sorted(tmp_path.iterdir()) == sorted([*report.tables, report.path])
    # And the copy of the copy is the same text.
    write_model_file(product.model, tmp_path / "scene.toml", sensor=product.sensor)
    same_rays(model, read_model_file(tmp_path / "scene.toml").model)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(2, 40))
def test_quaternions_of_a_slerp_are_found_again(seed: int, count: int) -> None:
    from geoposition.sensors.writers.model_file_parts import slerp_quaternions

    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.01, 1.0, count))
    rough = Rotation.random(rng=rng) * Rotation.from_rotvec(rng.normal(0, 1e-3, (count, 3)))
    curve = SlerpCurve.through(times, rough.as_quat())
    rotations = Rotation(slerp_quaternions(curve), normalize=False)
    again = (rotations[:-1].inv() * rotations[1:]).as_rotvec()
    assert np.max(np.abs(again - curve.interpolant.rotvecs)) < 1e-16
    np.testing.assert_array_equal(rotations[:-1].as_quat(), curve.interpolant.rotations.as_quat())


class Wobble:
    """A rotation curve that the schema does not know."""

    span_s = (0.0, 6.0)
    knots_s = np.empty(0)

    def rotation(self, times_s: np.ndarray) -> Rotation:
        base = Rotation.from_quat(quaternions(np.array([3.0]), 0.0)[0])
        wobble = 1e-4 * np.sin(2 * np.pi * np.asarray(times_s))
        rate = -1.1e-3 * (np.asarray(times_s) - 3.0)
        return base * Rotation.from_rotvec(np.stack([wobble, rate, 0 * rate], axis=-1))


class Arc:
    """An orbit that the schema does not know."""

    span_s = (0.0, 6.0)
    knots_s = np.empty(0)

    def value(self, times_s: np.ndarray) -> np.ndarray:
        flat = np.ravel(times_s)
        return orbit(flat)[0].reshape(*np.shape(times_s), 3)

    def rate(self, times_s: np.ndarray) -> np.ndarray:
        return orbit(np.ravel(times_s))[1].reshape(*np.shape(times_s), 3)


class Sine(PolynomialDirections):
    """Directions that the schema does not know."""

    __slots__ = ()

    def tangents(self, sample) -> np.ndarray:
        s = np.asarray(sample, dtype=float)
        return np.stack([1e-3 * np.sin(s / 500.0), PIXEL * (s - 1500)], axis=-1)


def test_unknown_curves_become_dense_tables_of_stated_error(tmp_path: Path) -> None:
    model = scene(attitude=Attitude(EPOCH, Wobble()), ephemeris=Ephemeris(EPOCH, Arc()))
    report = write_model_file(model, tmp_path / "scene.toml")
    assert 0.0 < report.attitude_error_rad <= 1e-10
    stated = tomllib.loads((tmp_path / "scene.toml").read_text())["attitude"]
    assert stated["tabulated_error_rad"] == report.attitude_error_rad
    back = read_model_file(tmp_path / "scene.toml").model
    points = grid(count=1500)
    ours, theirs = model.rays(points, 300.0), back.rays(points, 300.0)
    np.testing.assert_allclose(ours.direction_ecef, theirs.direction_ecef, rtol=0, atol=1.1e-10)
    np.testing.assert_allclose(ours.origin_ecef_m, theirs.origin_ecef_m, rtol=0, atol=3e-6)
    nested = ProductCurve(SlerpCurve.through([0.0, 6.0], [[0, 0, 0, 1.0]] * 2), Wobble())
    report = write_model_file(scene(**attitude(nested)), tmp_path / "nested.toml")
    assert 0.0 < report.attitude_error_rad <= 1e-10
    read_model_file(tmp_path / "nested.toml")


def test_inertial_attitude_and_ephemeris_are_turned_when_read(tmp_path: Path) -> None:
    model = scene(**attitude(QuaternionCurve.lagrange(TIMES, QUATS)))
    turn = R_itrs_gcrs(EPOCH, TIMES).inv()
    inertial = Attitude(
        EPOCH,
        QuaternionCurve.lagrange(TIMES, (turn * Rotation.from_quat(QUATS)).as_quat()),
    )
    write_model_file(scene(attitude=inertial), tmp_path / "m.toml")
    write_model_file(
        scene(**orbit_as(LagrangeCurve(TIMES, turn.apply(POSITION)))), tmp_path / "o.toml"
    )
    # The model files say itrs of what is inertial: say so.
    text = (tmp_path / "m.toml").read_text()
    parts = text.split("[attitude]")
    (tmp_path / "m.toml").write_text(
        parts[0] + "[attitude]" + parts[1].replace('"itrs"', '"gcrs"', 1)
    )
    orbit_text = (tmp_path / "o.toml").read_text().split("[ephemeris]")
    (tmp_path / "o.toml").write_text(
        orbit_text[0] + "[ephemeris]" + orbit_text[1].replace('"itrs"', '"gcrs"', 1)
    )
    points = grid(count=1000)
    expected = model.rays(points, 0.0)
    turned = read_model_file(tmp_path / "m.toml").model.rays(points, 0.0)
    np.testing.assert_allclose(turned.direction_ecef, expected.direction_ecef, atol=1e-10)
    moved = read_model_file(tmp_path / "o.toml").model.rays(points, 0.0)
    reference = scene(**orbit_as(LagrangeCurve(TIMES, POSITION))).rays(points, 0.0)
    np.testing.assert_allclose(moved.origin_ecef_m, reference.origin_ecef_m, atol=5e-6)


def test_covariance_goes_along(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    covariance, lag = rng.normal(size=(5, 3, 3)), rng.normal(size=(4, 3, 3))
    curve = SlerpCurve.through(TIMES, QUATS)
    given_attitude = Attitude(EPOCH, curve, "itrs", TIMES[:5], covariance, lag)
    write_model_file(scene(attitude=given_attitude), tmp_path / "m.toml")
    found = read_model_file(tmp_path / "m.toml").model.attitude
    np.testing.assert_array_equal(found.covariance_times_s, TIMES[:5])
    np.testing.assert_array_equal(found.covariance_rad2, covariance)
    np.testing.assert_array_equal(found.lag_one_rad2, lag)


def test_image_and_rewriting_a_product(tmp_path: Path) -> None:
    image = tmp_path / "images" / "scene.tif"
    image.parent.mkdir()
    image.write_bytes(b"II*\0")
    (tmp_path / "models").mkdir()
    write_model_file(scene(), tmp_path / "models" / "m.toml", sensor="S", image=image)
    product = read_model_file(tmp_path / "models" / "m.toml")
    assert product.image_path is not None
    assert product.image_path.resolve() == image
    rewrite_model_file(product, tmp_path / "copy.toml")
    assert read_model_file(tmp_path / "copy.toml").image_path == image
    image.unlink()
    assert read_model_file(tmp_path / "copy.toml").image_path is None


def test_recognises_its_own(tmp_path: Path) -> None:
    write_model_file(scene(), tmp_path / "m.toml")
    assert model_file.recognises(Source.of(tmp_path / "m.toml"))
    assert model_file.read(Source.of(tmp_path / "m.toml")).is_rigorous
    (tmp_path / "other.toml").write_text('[project]\nname = "geoposition model"\n')
    assert not model_file.recognises(Source.of(tmp_path / "other.toml"))
    assert not model_file.recognises(Source.of(tmp_path / "m_attitude.csv"))


def test_writing_is_all_or_nothing(tmp_path: Path) -> None:
    write_model_file(scene(), tmp_path / "m.toml")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "m_ccd0.csv").mkdir()
    table = {"directions": TableDirections(SAMPLE_NODES, TANGENTS)}
    with pytest.raises(ProductError, match=r"m_ccd0\.csv: a writable place"):
        write_model_file(scene(**table), tmp_path / "m.toml")
    (tmp_path / "m_ccd0.csv").rmdir()
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    with pytest.raises(ProductError, match="writable place"):
        write_model_file(scene(), tmp_path / "none" / "m.toml")
    with pytest.raises(ArgumentError, match=r"ending in \.toml"):
        write_model_file(scene(), tmp_path / "m.json")


Spoil = Callable[[Path, str], str]


def line(key: str, new: str, nth: int = 0) -> Spoil:
    """Replace the nth line of `key`."""

    def spoil(folder: Path, text: str) -> str:
        rows = text.splitlines()
        found = [i for i, row in enumerate(rows) if row.split("=")[0].strip() == key]
        rows[found[nth]] = new
        return "\n".join(rows) + "\n"

    return spoil


def cells(name: str, row: int, new: str) -> Spoil:
    """Replace one line of a table."""

    def spoil(folder: Path, text: str) -> str:
        rows = (folder / name).read_text().splitlines()
        rows[row] = new
        (folder / name).write_text("\n".join(rows) + "\n")
        return text

    return spoil


def swap(folder: Path, text: str) -> str:
    rows = (folder / "m_attitude.csv").read_text().splitlines()
    rows[3], rows[4] = rows[4], rows[3]
    (folder / "m_attitude.csv").write_text("\n".join(rows) + "\n")
    return text


def cut(folder: Path, text: str) -> str:
    (folder / "m_ephemeris.csv").write_text("t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s\n")
    return text


def link(folder: Path, text: str) -> str:
    outside = folder.parent / "outside.csv"
    outside.write_text((folder / "m_attitude.csv").read_text())
    (folder / "m_attitude.csv").unlink()
    (folder / "m_attitude.csv").symlink_to(outside)
    return text


def gone(folder: Path, text: str) -> str:
    (folder / "m_attitude.csv").unlink()
    return text


HOSTILE = [
    (lambda _, text: text[: len(text) // 2] + "[[[", "well-formed TOML"),
    (lambda _, text: "", "format: this key is missing"),
    (line("format", 'format = "else"'), 'format: "geoposition model" expected'),
    (line("version", "version = 2"), "version: 1 expected"),
    (line("lines", "lines = 0"), "lines: a whole number"),
    (line("lines", "lines = 12.5"), "lines: a whole number"),
    (line("lines", "lins = 12"), "lines: this key is missing"),
    (line("lines", "lines = 12\nlins = 12"), "lins: there is no such key"),
    (line("height_range_m", "height_range_m = [0.0]"), "height_range_m: a list of 2"),
    (line("height_range_m", "height_range_m = [5.0, 1.0]"), "height_range_m: .*low to high"),
    (line("height_range_m", "height_range_m = [nan, 1.0]"), r"height_range_m\[0\]: a finite"),
    (line("epoch_tai_s", "epoch_tai_s = 1.5"), "timing.epoch_tai_s: a whole number"),
    (line("epoch_tai_s", 'epoch_utc = "yesterday"'), "timing.epoch_utc: .*yesterday"),
    (line("epoch_tai_s", "epoch_tai_s = 5"), "timing: .*cover lines"),
    (line("epoch_fraction", "epoch_fraction = 1.0"), "timing.epoch_fraction: a number from 0"),
    (line("line_period_s", "line_period_s = 0.0"), "timing.line_period_s: .*other than 0"),
    (line("line_period_s", "line_period_s = true"), "timing.line_period_s: a number expected"),
    (line("line_period_s", "line_period_s = inf"), "timing.line_period_s: a finite number"),
    (
        line("R_body_camera_xyzw", "R_body_camera_xyzw = [0, 0, 0, 2]"),
        "mounting.R_body_camera_xyzw: a quaternion of unit length",
    ),
    (line("lever_arm_body_m", "lever_arm_body_m = 3"), "mounting.lever_arm_body_m: a list of 3"),
    (line("samples", "samples = -1"), r"ccd\[0\].samples: a whole number"),
    (line("x", "x = []"), r"ccd\[0\].x: a list of numbers"),
    (line("scale", "scale = 0.0"), r"ccd\[0\].kind: .*scale other than 0"),
    (line("angles", 'angles = "no"'), r"ccd\[0\].angles: true or false"),
    (line("kind", 'kind = "magic"', 2), "ephemeris.kind: one of"),
    (line("frame", 'frame = "teme"', 1), "attitude.frame: one of itrs, gcrs"),
    (line("velocity_aberration", "velocity_aberration = 1"), "corrections.velocity_aberration"),
    (line("table", 'table = "../m_attitude.csv"', 1), "attitude.table: a path within"),
    (line("table", 'table = "/etc/passwd"', 1), "attitude.table: a path within"),
    (line("table", 'table = "C:\\\\x.csv"', 1), "attitude.table: a path within"),
    (line("table", 'table = ""', 1), "attitude.table: a path within"),
    (link, "attitude.table: a path within"),
    (gone, "attitude.table: there is no file m_attitude.csv"),
    (
        cells("m_attitude.csv", 0, "t_s,q_w,q_x,q_y,q_z"),
        "m_attitude.csv: line 1: the header t_s,q_x",
    ),
    (cells("m_attitude.csv", 5, "0.1,nan,0,0,1"), "m_attitude.csv: line 6: finite numbers"),
    (cells("m_attitude.csv", 5, "0.1,0,0,1"), "m_attitude.csv: line 6: 5 numbers expected, got 4"),
    (cells("m_attitude.csv", 5, "0.1,a,0,0,1"), "m_attitude.csv: line 6: numbers expected"),
    (cells("m_attitude.csv", 5, "0.08,9,0,0,1"), "attitude.table: .*unit norm"),
    (swap, "attitude.table: .*strictly increasing"),
    (cut, "m_ephemeris.csv: 1 rows or more"),
    (line("light_time", "light_time = false\n[extra]\na = 1"), "extra: there is no such key"),
]


@pytest.mark.parametrize(("spoil", "message"), HOSTILE)
def test_hostile_file_is_one_error_that_names_the_key(
    spoil: Spoil, message: str, tmp_path: Path
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    path = folder / "m.toml"
    write_model_file(scene(), path)
    path.write_text(spoil(folder, path.read_text()))
    with pytest.raises(ProductError, match=message) as caught:
        read_model_file(path)
    assert "\n" not in str(caught.value)


def test_no_file_at_all(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError):
        read_model_file(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ProductError, match="UTF-8"):
        read_model_file(tmp_path / "bytes.toml")


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_survives_toml(text: str) -> None:
    assert tomllib.loads(toml({"key": text}))["key"] == text


def test_example_in_the_documentation_is_read(tmp_path: Path) -> None:
    """The schema's first example, with its tables, is a model."""
    text = model_file.__doc__.split("::\n")[1].split("In hermite tables")[0]
    text = "\n".join(row[4:] for row in text.splitlines())
    for drop in ('table = "lines.csv"', "tabulated_error_rad", "covariance =", "lag_one ="):
        text = "\n".join(row for row in text.splitlines() if not row.startswith(drop))
    epoch = "2020-01-31T12:00:00Z"
    assert text.count(epoch) == 3
    times = np.linspace(0.0, 30.0, 31)
    rows = np.column_stack([times, orbit(times)[0]])
    (tmp_path / "ephemeris.csv").write_text(
        "t_s,x_m,y_m,z_m\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    )
    rows = np.column_stack([times, quaternions(times)])
    (tmp_path / "attitude.csv").write_text(
        "t_s,q_x,q_y,q_z,q_w\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    )
    (tmp_path / "m.toml").write_text(text)
    product = read_model_file(tmp_path / "m.toml")
    assert product.model.shape == (20000, 30000)
    assert product.model.corrections == ALL_CORRECTIONS
    assert np.all(product.model.image_to_ground([[0.0, 0.0], [1e4, 2e4]], 100.0).flag == 0)
