"""GRACE-FO readers against small products with known contents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.errors import ProductError
from geoposition.sensors.readers import gracefo
from geoposition.sensors.readers.attitude_columns import ColumnMap
from geoposition.sensors.readers.telemetry_source import open_gyro, open_mounting, open_star
from geoposition.sensors.telemetry import Mounting

END = "# End of YAML header\n"


def product(path: Path, kind: str, rows: list[str]) -> Path:
    title = "Star Camera Data" if kind.startswith("SCA") else "IMU Data"
    header = f"header:\n  project: GRACE-FO\n  title: GRACE-FO Level-{kind[-2:]} {title}\n"
    path.write_text(header + END + "\n".join(rows) + "\n")
    return path


def words(quat_xyzw: np.ndarray) -> str:
    x, y, z, w = quat_xyzw.tolist()
    return f"{w!r} {x!r} {y!r} {z!r}"


def test_heads_alignment_and_fused_product_close_the_chain(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    R_inertial_body = Rotation.random(rng=rng)
    R_body_head = Rotation.random(3, rng=rng)
    star = product(
        tmp_path / "SCA1A.txt", "SCA1A",
        [
            f"10 {500000 * t} C {head + 1} P "
            f"{words((R_inertial_body * R_body_head[head]).as_quat())} 0 40 1 0 0 "
            f"{'11000001' if (t, head) != (1, 2) else '11000000'} 11000000"
            for t in (0, 1) for head in range(3)
        ],
    )  # fmt: skip
    lines = [f"5 C {head + 1} {words(R_body_head[head].inv().as_quat())} 0 0" for head in range(3)]
    alignment = tmp_path / "QSA1B.txt"
    alignment.write_text("PRODUCER AGENCY : NASA\nFILENAME : QSA1B_x\nEND OF HEADER\n")
    alignment.write_text(alignment.read_text() + "\n".join(lines) + "\n")
    fused = product(
        tmp_path / "SCA1B.txt", "SCA1B",
        [f"{t} C 7 {words(R_inertial_body.as_quat())} 8.66e-07 00000000" for t in (10, 11)],
    )  # fmt: skip
    heads = open_star(star, ColumnMap()).series
    mounting = open_mounting(alignment).mounting
    body = open_star(fused, ColumnMap())
    assert len(heads) == 5, "the sample a head calls invalid is left out"
    assert heads.heads == ("sca1", "sca2", "sca3")
    for head, name in enumerate(heads.heads):
        mine = heads.where(heads.head == head)
        error = mine.R_inertial_sensor * mounting.rotation(name).inv() * R_inertial_body.inv()
        assert np.max(error.magnitude()) < 1e-12
    assert np.max((body.series.R_inertial_sensor * R_inertial_body.inv()).magnitude()) < 1e-12
    np.testing.assert_allclose(body.series.sigma_cross_rad, 2.0 * 8.66e-7 / np.sqrt(3.0))
    assert body.epoch is not None
    assert body.epoch.utc_iso(0) == "2000-01-01T11:59:47Z"


def test_gyro_angles_give_the_body_rate_across_a_wrap(tmp_path: Path) -> None:
    axes = np.array([[0.1, 1.0, 0.0], [1.0, 0.0, 0.2], [0.0, 0.3, 1.0]])
    rate = np.array([0.02, -0.06, 0.01])  # deg/s
    rows = []
    for k in range(40):
        for gyro in range(3):
            t = 0.125 * k + 0.001 * gyro
            angle = 5757.9 + float(axes[gyro] @ rate) * t * 30.0
            angle = (angle + 5758.0) % 11516.0 - 5758.0
            rows.append(f"{int(t)} {round(1e6 * (t % 1))} G C {gyro + 1} {angle!r} 00000000")
    path = product(tmp_path / "IMU1B.txt", "IMU1B", rows)
    found = gracefo.read_imu(path, axes)
    steps = np.diff(found.times_s)[:, None]
    np.testing.assert_allclose(
        np.degrees(found.increments_rad()), 30.0 * rate * steps, rtol=1e-6, atol=1e-9
    )
    other = product(tmp_path / "SCA1B.txt", "SCA1B", ["1 C 7 1 0 0 0 1e-6 0"])
    with pytest.raises(ProductError, match="gyro samples expected, this is a SCA1B"):
        open_gyro(other, ColumnMap(), Mounting())


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("10 0 C 1 P 1 0 0 0 0 40 1 0 0 11000001", "line 5: 16 columns expected, got 15"),
        ("10 0 C 4 P 1 0 0 0 0 40 1 0 0 11000001 0", "line 5, column 4: a number from 1 to 3"),
        ("10 0 C 1 P 1 x 0 0 0 40 1 0 0 11000001 0", "line 5, column 7: a number expected"),
        ("10 0 C 1 P 1 nan 0 0 0 40 1 0 0 11000001 0", "line 5, column 7: a finite number"),
        ("10 0 C 1 P 2 0 0 0 0 40 1 0 0 11000001 0", "line 5, column 6: a unit quaternion"),
        ("10 0 C 1 P 1 0 0 0 0 40 1 0 0 11000000 0", "no sample is marked valid"),
        ("", "no records"),
    ],
)
def test_broken_products_are_refused_in_place(tmp_path: Path, row: str, expected: str) -> None:
    path = product(tmp_path / "SCA1A.txt", "SCA1A", [row])
    with pytest.raises(ProductError, match=expected) as caught:
        gracefo.read_sca1a(path)
    assert str(path) in str(caught.value)


def test_what_is_no_product_is_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("t_s,q_x,q_y,q_z,q_w\n0,0,0,0,1\n")
    assert gracefo.product_kind(path) is None
    assert gracefo.product_kind(tmp_path / "none") is None
    with pytest.raises(ProductError, match="end of a GRACE-FO header"):
        gracefo.read_sca1a(path)
