"""Telemetry tables: every convention comes out the same, every hostile file is refused in place."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError, MissingFileError, ProductError
from geoposition.sensors.readers.attitude_columns import column_map, read_column_map
from geoposition.sensors.readers.attitude_tables import read_gyro, read_raw_star, read_star
from geoposition.sensors.readers.ephemeris_table import read_ephemeris
from geoposition.sensors.readers.mounting_file import read_mounting
from geoposition.sensors.readers.table_file import load_table
from geoposition.sensors.readers.vector_table import read_vectors
from geoposition.sensors.telemetry import Mounting
from geoposition.sensors.writers.attitude_table import star_columns
from geoposition.sensors.writers.table_file import write_table
from geoposition.timescale import Epoch

RNG = np.random.default_rng(20261122)
TIMES = np.array([0.0, 0.1, 0.3, 0.4, 0.6])
TRUTH = Rotation.from_rotvec(0.3 * RNG.standard_normal((5, 3)))
RATE_BODY = 1e-3 * RNG.standard_normal((5, 3))


def csv(path: Path, header: str, rows: np.ndarray) -> Path:
    lines = [",".join(repr(float(cell)) for cell in row) for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def star_csv(path: Path, quat: np.ndarray | None = None, times: np.ndarray = TIMES) -> Path:
    quat = TRUTH.as_quat() if quat is None else quat
    return csv(path, "t_s,q_x,q_y,q_z,q_w", np.column_stack([times, quat]))


def same_rotation(found: Rotation, expected: Rotation) -> None:
    assert np.max((found.inv() * expected).magnitude()) < 1e-12


# Conventions --------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
@pytest.mark.parametrize("direction", ["sensor_to_inertial", "inertial_to_sensor"])
def test_every_quaternion_convention_reads_the_same(
    tmp_path: Path, order: str, direction: str
) -> None:
    rotation = TRUTH if direction == "sensor_to_inertial" else TRUTH.inv()
    quat = rotation.as_quat()
    quat = quat if order == "xyzw" else quat[:, [3, 0, 1, 2]]
    path = csv(tmp_path / "s.csv", "tm,a,b,c,d", np.column_stack([TIMES * 1e3, quat]))
    mapping = tmp_path / "columns.toml"
    mapping.write_text(
        f"""
        [time]
        column = "tm"
        unit = "ms"
        [quaternion]
        columns = ["a", "b", "c", "d"]
        order = "{order}"
        direction = "{direction}"
        [noise]
        sigma_cross_rad = 1e-5
        sigma_bore_rad = 4e-5
        """
    )
    found = read_star(path, read_column_map(mapping))
    same_rotation(found.series.R_inertial_sensor, TRUTH)
    np.testing.assert_allclose(found.series.times_s, TIMES, atol=1e-12)
    assert found.sigma_stated
    assert found.series.sigma_bore_rad[0] == 4e-5


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("rad/s", 1.0),
        ("deg/s", np.pi / 180),
        ("arcsec/s", np.pi / 648000),
        ("deg/h", np.pi / 648e3),
    ],
)
def test_gyro_units(tmp_path: Path, unit: str, size: float) -> None:
    path = csv(tmp_path / "g.csv", "t_s,w_x,w_y,w_z", np.column_stack([TIMES, RATE_BODY / size]))
    mapping = tmp_path / "columns.toml"
    mapping.write_text(f'[gyro]\nunit = "{unit}"\nrate = "mean"\n')
    found = read_gyro(path, read_column_map(mapping)).series
    np.testing.assert_allclose(found.values, RATE_BODY, rtol=1e-12)
    assert found.kind == "mean-rate"


def test_rates_in_the_reference_frame_are_turned_with_their_own_quaternion(tmp_path: Path) -> None:
    # As a C-kernel has it: scalar first, C(q) reference to body, rate in the reference frame.
    quat = TRUTH.inv().as_quat()[:, [3, 0, 1, 2]]
    rate = TRUTH.apply(RATE_BODY)
    header = "# t_s,q_s,q_x,q_y,q_z,w_ref_x,w_ref_y,w_ref_z"
    path = csv(tmp_path / "d.csv", "# sclk=1\n" + header, np.column_stack([TIMES, quat, rate]))
    preset = column_map(preset="mro")
    same_rotation(read_star(path, preset).series.R_inertial_sensor, TRUTH)
    np.testing.assert_allclose(read_gyro(path, preset).series.values, RATE_BODY, atol=1e-16)


def test_increments_and_accumulated_angles(tmp_path: Path) -> None:
    turn = 1e-4 * RNG.standard_normal((5, 3))
    path = csv(tmp_path / "g.csv", "t_s,d_x,d_y,d_z", np.column_stack([TIMES, turn]))
    plain = read_gyro(path).series
    assert plain.kind == "increment"
    np.testing.assert_allclose(plain.increments_rad(), turn[1:], atol=0)
    total = np.degrees(np.cumsum(turn, axis=0)) + 123.0
    path = csv(tmp_path / "a.csv", "t_s,ax,ay,az", np.column_stack([TIMES, total]))
    mapping = tmp_path / "columns.toml"
    mapping.write_text('[gyro]\ncolumns = ["ax", "ay", "az"]\nunit = "deg"\naccumulated = true\n')
    found = read_gyro(path, read_column_map(mapping)).series
    np.testing.assert_allclose(found.increments_rad(), turn[1:], atol=1e-14)


def test_utc_counts_leap_seconds(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    stamps = ["2016-12-31T23:59:59.5Z", "2016-12-31T23:59:60.25Z", "2017-01-01T00:00:00.125"]
    quat = TRUTH.as_quat()
    rows = [f"{stamp}," + ",".join(map(repr, quat[k].tolist())) for k, stamp in enumerate(stamps)]
    path.write_text("utc,q_x,q_y,q_z,q_w\n" + "\n".join(rows) + "\n")
    mapping = tmp_path / "columns.toml"
    mapping.write_text('[time]\ncolumn = "utc"\nformat = "utc"\n')
    found = read_star(path, read_column_map(mapping))
    np.testing.assert_allclose(found.series.times_s, [0.0, 0.75, 1.625], atol=1e-9)
    assert found.epoch == Epoch.from_utc(stamps[0])
    path.write_text("utc,q_x,q_y,q_z,q_w\n" + rows[0] + "\n" + "soon,0,0,0,1\n")
    with pytest.raises(ProductError, match=r"s\.csv: line 3, column utc.*'soon'"):
        read_star(path, read_column_map(mapping))


def test_heads_may_come_block_by_block(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    quat = TRUTH.as_quat()
    rows = [
        f"{TIMES[k]},{name}," + ",".join(map(repr, quat[k].tolist()))
        for name in ("b", "a")
        for k in range(5)
    ]
    path.write_text("t_s,sensor,q_x,q_y,q_z,q_w\n" + "\n".join(rows) + "\n")
    found = read_star(path).series
    assert found.heads == ("a", "b")
    assert np.all(np.diff(found.times_s) >= 0.0)
    for head in (0, 1):
        same_rotation(found.where(found.head == head).R_inertial_sensor, TRUTH)


def test_gyro_is_turned_by_its_mounting(tmp_path: Path) -> None:
    path = csv(tmp_path / "g.csv", "t_s,w_x,w_y,w_z", np.column_stack([TIMES, RATE_BODY]))
    turn = Rotation.from_euler("XYZ", [0.1, 0.2, 0.3])
    found = read_gyro(path, mounting=Mounting({"gyro": turn})).series
    np.testing.assert_allclose(found.values, turn.apply(RATE_BODY), atol=1e-18)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
def test_written_tables_read_back_to_the_last_bit(tmp_path: Path, suffix: str) -> None:
    star = read_star(star_csv(tmp_path / "s.csv")).series
    path = tmp_path / f"out{suffix}"
    write_table(path, star_columns(star))
    back = read_star(path).series
    np.testing.assert_array_equal(back.times_s, star.times_s)
    np.testing.assert_array_equal(back.quat_xyzw, star.quat_xyzw)
    np.testing.assert_array_equal(back.sigma_bore_rad, star.sigma_bore_rad)
    assert back.heads == star.heads


# Hostile files ------------------------------------------------------------------------------

ROW = "0,0,0,1"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "empty"),
        ("t_s,q_x,q_y,q_z,q_w\n", "header only"),
        ("t_s,q_x,q_y,q_w\n0,0,0,1\n", r"header: column\(s\) q_z missing"),
        (f"t_s,q_x,q_y,q_z,q_w\n0,{ROW}\n1,nan,0,0,1\n", "line 3, column q_x.*finite"),
        (f"t_s,q_x,q_y,q_z,q_w\n0,{ROW}\n1,0,word,0,1\n", "line 3, column q_y.*'word'"),
        (f"t_s,q_x,q_y,q_z,q_w\n0,{ROW}\n,{ROW}\n", "line 3, column t_s.*finite"),
        (f"t_s,q_x,q_y,q_z,q_w\n0,{ROW}\n1,0,0,0,0\n", "line 3, column q_x.*unit.*norm is 0"),
        (f"t_s,q_x,q_y,q_z,q_w\n0,{ROW}\n1,0,0,0,1.2\n", "line 3, column q_x.*norm is 1.2"),
        (f"t_s,q_x,q_y,q_z,q_w\n1,{ROW}\n0.5,{ROW}\n", "line 3, column t_s.*never go back"),
        (f"t_s,q_x,q_y,q_z,q_w\n0,{ROW}\n1,0,0,1\n", "Expected 5 columns, got 4"),
        (f"t_s,q_x,q_x,q_z,q_w\n0,{ROW}\n", "each column once"),
        (
            f"t_s,q_x,q_y,q_z,q_w,sigma_cross_rad\n0,{ROW},1e-5\n1,{ROW},-1\n",
            "line 3, column sigma_cross_rad.*positive",
        ),
    ],
)
def test_hostile_star_tables_are_refused_in_place(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "star.csv"
    path.write_text(content)
    with pytest.raises(ProductError, match=words) as caught:
        read_star(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t_s,a,b,c\n0,0,0,0\n", r"w_x,w_y,w_z \(rad/s\) or d_x,d_y,d_z"),
        ("t_s,w_x,w_y\n0,0,0\n", r"column\(s\) w_z missing"),
        ("t_s,w_x,w_y,w_z\n0,0,0,0\n0,0,0,0\n", "line 3, column t_s.*increase"),
        ("t_s,w_x,w_y,w_z\n0,0,0,0\n1,0,0,inf\n", "line 3, column w_z.*finite"),
        ("t_s,w_x,w_y,w_z\n0,0,0,0\n", "at least 2 samples"),
    ],
)
def test_hostile_gyro_tables_are_refused_in_place(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text(content)
    with pytest.raises(ProductError, match=words) as caught:
        read_gyro(path)
    assert str(caught.value).startswith(str(path))


def test_a_missing_file_and_broken_gzip(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no such file"):
        load_table(tmp_path / "none.csv")
    path = tmp_path / "cut.csv.gz"
    whole = gzip.compress(b"t_s,q_x\n" + b"1,2\n" * 4000)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ProductError, match=r"cut\.csv\.gz"):
        load_table(path)
    path.write_bytes(b"no gzip at all")
    with pytest.raises(ProductError, match=r"cut\.csv\.gz.*gzip"):
        load_table(path)


def test_raw_samples_let_broken_ones_through(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    path.write_text(f"t_s,q_x,q_y,q_z,q_w\n0,{ROW}\n3,,0,0,1\n2,0,0,0,0\nlate,{ROW}\n")
    raw = read_raw_star(path)
    assert np.isnan(raw.quat_xyzw[1, 0])
    assert np.all(raw.quat_xyzw[2] == 0.0)
    assert raw.times_s[:3].tolist() == [0.0, 3.0, 2.0]
    assert np.isnan(raw.times_s[3])
    assert not raw.sigma_stated


# Column maps and mountings ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('[quaternion]\nordre = "xyzw"', r"quaternion\.ordre: there is no such key"),
        ('[quaternion]\norder = "zyxw"', r"quaternion\.order: one of xyzw, wxyz"),
        ('[quaternion]\ncolumns = ["a", "b"]', "a list of 4 names"),
        ('[gyro]\nunit = "furlong"', r"gyro\.unit: one of rad/s"),
        ("[gyro]\naccumulated = true", r"gyro\.accumulated: it belongs to a unit of angle"),
        ('[time]\nepoch_utc = "noon"', r"time\.epoch_utc"),
        ('[tiem]\nunit = "s"', "tiem: there is no such key"),
        ("[time", "well-formed TOML"),
    ],
)
def test_column_maps_name_what_is_wrong(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "columns.toml"
    path.write_text(content)
    with pytest.raises(ProductError, match=words):
        read_column_map(path)


def test_one_of_columns_and_preset() -> None:
    with pytest.raises(ArgumentError, match="not both"):
        column_map(Path("x.toml"), "mro")
    with pytest.raises(ArgumentError, match="one of contract"):
        column_map(None, "voyager")


def test_mountings_in_every_form_agree(tmp_path: Path) -> None:
    turn = Rotation.from_euler("ZXY", [0.4, -0.3, 1.1])
    x, y, z, w = turn.as_quat()
    inverse = turn.inv().as_quat().tolist()
    matrix = turn.as_matrix()
    off = matrix + 1e-4 * RNG.standard_normal((3, 3))
    degrees = np.degrees([0.4, -0.3, 1.1]).tolist()
    path = tmp_path / "mounting.toml"
    path.write_text(
        f"""
        [sensors.a]
        quat_xyzw = [{x}, {y}, {z}, {w}]
        [sensors.b]
        quat_wxyz = [{w}, {x}, {y}, {z}]
        [sensors.c]
        matrix = {matrix.tolist()}
        [sensors.d]
        sequence = "3-1-2"
        euler_deg = {degrees}
        [sensors.e]
        quat_xyzw = {inverse}
        direction = "body_to_sensor"
        [sensors.gyro]
        matrix = {off.tolist()}
        """
    )
    found = read_mounting(path)
    for name in "abcde":
        assert (found.mounting.rotation(name).inv() * turn).magnitude() < 1e-12
    assert found.matrix_error["c"] < 1e-12
    # The nearest rotation is nearer than the one that was disturbed, and not further than it.
    assert 0.0 < found.matrix_error["gyro"] <= np.linalg.norm(off - matrix)
    assert (found.mounting.rotation("gyro").inv() * turn).magnitude() < 3e-4


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "a table for each sensor"),
        ("[a]\nquat_xyzw = [0, 0, 0, 2]", r"a\.quat_xyzw: a unit quaternion"),
        ("[a]\nquat_xyzw = [0, 0, 1]", r"a\.quat_xyzw: a list of 4 numbers"),
        ("[a]\nmatrix = [[1,0,0],[0,1,0]]", r"a\.matrix: three rows"),
        ("[a]\nmatrix = [[1,0,0],[0,1,0],[0,0,-1]]", r"a\.matrix: .*mirrors"),
        ("[a]\nmatrix = [[1,0,0],[0.3,1,0],[0,0,1]]", r"a\.matrix: .*from the nearest"),
        ("[a]\neuler_deg = [1, 2, 3]", r"a\.sequence: this key is missing"),
        ('[a]\neuler_deg = [1, 2, 3]\nsequence = "9-1-2"', r"a\.sequence"),
        ("[a]\nspin = 3", r"a\.quat_xyzw: one of"),
        ("[a]\nquat_xyzw=[0,0,0,1]\nmatrix=[[1,0,0],[0,1,0],[0,0,1]]", "one of"),
    ],
)
def test_bad_mountings_are_refused_in_place(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "m.toml"
    path.write_text(content)
    with pytest.raises(ProductError, match=words):
        read_mounting(path)


# Ephemeris and vectors ----------------------------------------------------------------------

EPH_ROWS = "0,7e6,0,0,0,7500,0\n1,7e6,7500,0,0,7500,0\n"


@pytest.mark.parametrize(
    ("header", "given", "frame"),
    [
        ("# frame: itrs\nt_s,x,y,z,vx,vy,vz", None, "itrs"),
        ("# made by me, frame=J2000\nt_s,x,y,z,vx,vy,vz", None, "gcrs"),
        ("t_s,x_ecef,y_ecef,z_ecef,vx_ecef,vy_ecef,vz_ecef", None, "itrs"),
        ("t_s,x,y,z,vx,vy,vz", "gcrs", "gcrs"),
    ],
)
def test_the_frame_of_an_ephemeris(
    tmp_path: Path, header: str, given: str | None, frame: str
) -> None:
    path = tmp_path / "eph.csv"
    path.write_text(header + "\n" + EPH_ROWS)
    found = read_ephemeris(path, given)  # type: ignore[arg-type]
    assert found.frame == frame
    assert found.velocity_m_s[0, 1] == 7500.0


def test_an_ephemeris_without_or_against_its_frame(tmp_path: Path) -> None:
    path = tmp_path / "eph.csv"
    path.write_text("t_s,x,y,z,vx,vy,vz\n" + EPH_ROWS)
    with pytest.raises(ProductError, match="--frame expected"):
        read_ephemeris(path)
    path.write_text("# frame: itrs\nt_s,x,y,z,vx,vy,vz\n" + EPH_ROWS)
    with pytest.raises(ProductError, match="the file says its frame is itrs, not gcrs"):
        read_ephemeris(path, "gcrs")
    path.write_text("t_s,x,y,z,vx,vy,vz\n0,7000,0,0,0,7.5,0\n1,7000,7,0,0,7.5,0\n")
    with pytest.raises(ProductError, match="line 2, column x: a position in metres"):
        read_ephemeris(path, "gcrs")


def test_vectors_are_grouped_and_mounted(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 2.0])
    path = tmp_path / "v.csv"
    path.write_text(
        "t_s,sensor,id,body_x,body_y,body_z,ref_x,ref_y,ref_z,sigma_rad\n"
        "1,s,1,1,0,0,0,0,1,1e-5\n0,s,1,1,0,0,0,1,0,1e-5\n1,s,2,0,0,1,1,0,0,2e-5\n"
    )
    found = read_vectors(path, Mounting({"s": turn}))
    assert found.times_s.tolist() == [0.0, 1.0]
    assert found.first.tolist() == [0, 1, 3]
    np.testing.assert_allclose(found.body[0], [0.0, 1.0, 0.0], atol=1e-15)
    assert found.sigma_rad.tolist() == [1e-5, 1e-5, 2e-5]
    path.write_text(
        "t_s,body_x,body_y,body_z,ref_x,ref_y,ref_z,sigma_rad\n0,1,0,0,0,0,1,1e-5\n"
        "0,0,0,0,0,1,0,1e-5\n"
    )
    with pytest.raises(ProductError, match="line 3, column body_x: a unit vector"):
        read_vectors(path)


def test_parquet_names_the_row(tmp_path: Path) -> None:
    path = tmp_path / "s.parquet"
    columns = {name: [0.0, 0.0] for name in ("q_x", "q_y", "q_z")}
    pq.write_table(pa.table({"t_s": [0.0, 1.0], **columns, "q_w": [1.0, None]}), path)
    with pytest.raises(ProductError, match="row 2, column q_w"):
        read_star(path)


# Samples that were made -----------------------------------------------------------------------


def test_made_samples_are_left_out_and_counted(tmp_path: Path) -> None:
    quat = TRUTH.as_quat()
    labels = ["ok", "Gap", "outlier_replaced", "ok", "good"]
    rows = [
        ",".join([*(repr(float(c)) for c in (t, *q)), label])
        for t, q, label in zip(TIMES, quat, labels, strict=True)
    ]
    path = tmp_path / "clean.csv"
    path.write_text("\n".join(["t_s,q_x,q_y,q_z,q_w,flag", *rows]) + "\n")
    found = read_star(path)
    assert found.made == 2
    np.testing.assert_array_equal(found.series.times_s, TIMES[[0, 3, 4]])
    same_rotation(found.series.R_inertial_sensor, TRUTH[[0, 3, 4]])
    path.write_text(
        "\n".join(["t_s,q_x,q_y,q_z,q_w,flag", *(r for r in rows if "Gap" in r)]) + "\n"
    )
    with pytest.raises(ProductError, match="measured samples expected"):
        read_star(path)
