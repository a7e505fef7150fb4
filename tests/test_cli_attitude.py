"""`geoposition attitude ...` as people and scripts meet it: tables, JSON, one-line refusals."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import attitude_scene
import numpy as np
import pytest
from attitude_scene import ARCSEC, BIAS, SIGMA_STAR, SIGMA_U, SIGMA_V, Scene
from scipy.spatial.transform import Rotation

from geoposition.frames import R_itrs_gcrs, itrs_from_gcrs
from geoposition.orbit_frame import R_inertial_orbit
from geoposition.orbit_frame import R_orbit_body as orbit_body
from geoposition.scripts.cli import run
from geoposition.sensors.simulate_orbit import Orbit
from geoposition.timescale import Epoch

EPOCH_UTC = "2015-10-13T04:00:00Z"
EPOCH = Epoch.from_utc(EPOCH_UTC)
WALKS = ("--angle-random-walk", SIGMA_V, "--rate-random-walk", SIGMA_U)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return attitude_scene.write(tmp_path_factory.mktemp("scene"))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def numbers(path: Path, *names: str) -> np.ndarray:
    return np.array([[float(row[name]) for name in names] for row in rows(path)])


def attitude(path: Path) -> Rotation:
    return Rotation.from_quat(numbers(path, "q_x", "q_y", "q_z", "q_w"))


def done(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """Run with --json, expect success; return the one object."""
    assert run(["attitude", *(str(argument) for argument in arguments), "--json"]) == 0
    out = capsys.readouterr()
    assert out.err == ""
    found: dict[str, Any] = json.loads(out.out)
    return found


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run, expect exit 2 and one line; return the line."""
    assert run(["attitude", *(str(argument) for argument in arguments)]) == 2
    out = capsys.readouterr()
    assert out.out == ""
    assert out.err.count("\n") == 1, out.err
    assert "Traceback" not in out.err
    return out.err


def telemetry(scene: Scene) -> tuple[object, ...]:
    return ("--star", scene.star, "--gyro", scene.gyro, "--mounting", scene.mounting)


# fuse ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["ekf", "ukf", "rts", "two-filter", "graph"])
def test_fuse_finds_the_attitude_and_the_bias(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str
) -> None:
    out = tmp_path / "fused.csv"
    found = done(capsys, "fuse", *telemetry(scene), *WALKS, "-o", out, "--method", method)
    names = ["t_s", "q_x", "q_y", "q_z", "q_w"]
    names += [f"sigma_{axis}_rad" for axis in "xyz"] + [f"bias_{axis}" for axis in "xyz"]
    assert list(rows(out)[0])[:11] == names
    np.testing.assert_allclose(numbers(out, "t_s")[:, 0], scene.times_s, atol=1e-9)
    error = (attitude(out).inv() * scene.R_inertial_body).as_rotvec()
    sigma = numbers(out, *(f"sigma_{axis}_rad" for axis in "xyz"))
    # 400 epochs of two heads: far below one sample's 5 arcsec, and as large as it says.
    assert np.all(np.sqrt(np.mean(error[200:] ** 2, axis=0)) < 0.4 * SIGMA_STAR)
    assert 0.4 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.8
    bias = numbers(out, "bias_x", "bias_y", "bias_z")[-1]
    bias_sigma = numbers(out, *(f"sigma_bias_{axis}" for axis in "xyz"))[-1]
    assert np.all(np.abs(bias - BIAS) < 4.0 * bias_sigma)
    assert found["method"] == method
    assert found["noise"]["estimated"] == []


def test_smoothers_agree_and_beat_the_filter(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rms = {}
    for method in ("ekf", "rts", "two-filter", "graph"):
        out = tmp_path / f"{method}.csv"
        done(capsys, "fuse", *telemetry(scene), *WALKS, "-o", out, "--method", method)
        error = (attitude(out).inv() * scene.R_inertial_body).as_rotvec()
        rms[method] = float(np.sqrt(np.mean(error**2)))
    assert rms["rts"] < 0.8 * rms["ekf"]
    assert rms["two-filter"] == pytest.approx(rms["rts"], rel=1e-2)
    assert rms["graph"] == pytest.approx(rms["rts"], rel=1e-2)


def test_fuse_at_other_epochs(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "fused.csv"
    found = done(capsys, "fuse", *telemetry(scene), *WALKS, "-o", out, "--rate", 4)
    times = numbers(out, "t_s")[:, 0]
    np.testing.assert_allclose(times, np.arange(801) / 4.0, atol=1e-9)
    assert found["epochs"] == 801
    asked = tmp_path / "at.csv"
    asked.write_text("t_s\n17.3\n18.05\n")
    done(capsys, "fuse", *telemetry(scene), *WALKS, "-o", out, "--at", asked)
    assert numbers(out, "t_s")[:, 0].tolist() == [17.3, 18.05]
    # Half-way between two gyro epochs the attitude is half-way too.
    middle = scene.R_inertial_body[180] * Rotation.from_rotvec(
        0.5 * (scene.R_inertial_body[180].inv() * scene.R_inertial_body[181]).as_rotvec()
    )
    assert (attitude(out)[1].inv() * middle).magnitude() < SIGMA_STAR
    asked.write_text("t_s\n500\n")
    line = refused(capsys, "fuse", *telemetry(scene), *WALKS, "-o", out, "--at", asked)
    assert "outside the span" in line


def test_fuse_with_the_general_model_and_a_report(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, page = tmp_path / "fused.parquet", tmp_path / "fused.html"
    found = done(
        capsys, "fuse", *telemetry(scene), *WALKS, "-o", out,
        "--gyro-model", "general", "--report", page, "--gate", 0.9999,
    )  # fmt: skip
    assert set(found["parameters_ppm"]) == {
        f"{kind}_{i}" for kind in ("scale", "upper", "lower") for i in (1, 2, 3)
    }
    for one in found["parameters_ppm"].values():
        assert abs(one["value"]) < 4.0 * one["sigma"]
    import pyarrow.parquet as pq

    assert {"scale_x", "upper_1", "lower_3", "sigma_scale_x"} <= set(pq.read_schema(out).names)
    html = page.read_text()
    assert html.count("data:image/png") >= 5
    for word in ("Gyro drift", "Innovations", "Spectra", "Scale factors"):
        assert word in html
    assert "http://" not in html
    assert "https://" not in html


def test_noise_is_estimated_when_not_given(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    star = tmp_path / "star.csv"
    lines = [",".join(line.split(",")[:6]) for line in scene.star.read_text().splitlines()]
    star.write_text("\n".join(lines) + "\n")
    found = done(
        capsys, "fuse", "--star", star, "--gyro", scene.gyro, "--mounting", scene.mounting,
        "-o", tmp_path / "f.csv",
    )  # fmt: skip
    noise = found["noise"]
    assert "angle_random_walk" in noise["estimated"]
    assert noise["star_sigma_arcsec"]["a"][0] == pytest.approx(5.0, rel=0.15)
    assert noise["angle_random_walk"] == pytest.approx(SIGMA_V, rel=1.0)


def test_a_wrong_mounting_is_warned_of(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    off = (attitude_scene.R_body_b * Rotation.from_rotvec([0.01, 0.0, 0.0])).as_matrix()
    mounting = tmp_path / "m.toml"
    mounting.write_text(f"[b]\nmatrix = {off.tolist()}\n")
    found = done(
        capsys, "fuse", "--star", scene.star, "--gyro", scene.gyro, "--mounting", mounting,
        *WALKS, "-o", tmp_path / "f.csv",
    )  # fmt: skip
    assert "times the stated noise" in found["warning"]


def test_one_head_alone(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "f.csv"
    found = done(capsys, "fuse", *telemetry(scene), *WALKS, "-o", out, "--sensor", "b")
    assert found["heads"] == ["b"]
    error = (attitude(out).inv() * scene.R_inertial_body).as_rotvec()
    assert np.sqrt(np.mean(error**2)) < SIGMA_STAR
    line = refused(capsys, "fuse", *telemetry(scene), *WALKS, "-o", out, "--sensor", "c")
    assert "one of a, b expected, got 'c'" in line


# Refusals -----------------------------------------------------------------------------------


def test_wrong_conventions_are_said(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "f.csv"
    mapping = tmp_path / "columns.toml"
    mapping.write_text('[quaternion]\ndirection = "inertial_to_sensor"\n')
    fuse = ("fuse", *telemetry(scene), *WALKS, "-o", out)
    line = refused(capsys, *fuse, "--columns", mapping)
    assert f"{scene.star}: star and gyro contradict each other" in line
    assert "inertial -> sensor" in line
    degrees = tmp_path / "degrees.csv"
    table = np.loadtxt(scene.gyro, delimiter=",", skiprows=1)
    table[:, 1:] = np.degrees(table[:, 1:])
    np.savetxt(degrees, table, delimiter=",", header="t_s,d_x,d_y,d_z", comments="", fmt="%.17g")
    line = refused(
        capsys, "fuse", "--star", scene.star, "--gyro", degrees, "--mounting", scene.mounting,
        "-o", out,
    )  # fmt: skip
    assert "gyro values are in degrees" in line
    assert not out.exists()


def test_star_that_never_overlaps_the_gyro(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gyro, out = tmp_path / "late.csv", tmp_path / "f.csv"
    gyro.write_text("t_s,d_x,d_y,d_z\n1000,0,0,0\n1001,0,0,0\n")
    line = refused(capsys, "fuse", "--star", scene.star, "--gyro", gyro, "-o", out)
    assert f"{scene.star}: star samples (0.000 .. 200.000 s) that overlap" in line
    assert "1000.000 .. 1001.000" in line
    assert not out.exists()


def test_usage_is_refused_before_any_work(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "f.csv"
    fuse = ("fuse", *telemetry(scene), "-o", out)
    assert "--rate and --at" in refused(capsys, *fuse, "--rate", 1, "--at", scene.star)
    assert "--robust" in refused(capsys, *fuse, "--robust")
    assert "no such file" in refused(
        capsys, "fuse", "--star", tmp_path / "no.csv", "--gyro", scene.gyro, "-o", out
    )
    assert "folder does not exist" in refused(
        capsys, "fuse", *telemetry(scene), "-o", tmp_path / "no" / "f.csv"
    )
    assert "--preset: one of" in refused(capsys, *fuse, "--preset", "voyager")
    assert not out.exists()


def test_a_broken_cell_is_named(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    star, out = tmp_path / "star.csv", tmp_path / "f.csv"
    lines = scene.star.read_text().splitlines()
    cells = lines[7].split(",")
    lines[7] = ",".join([*cells[:3], "nan", *cells[4:]])
    star.write_text("\n".join(lines) + "\n")
    line = refused(capsys, "fuse", "--star", star, "--gyro", scene.gyro, "-o", out)
    assert f"{star}: line 8, column q_y: a finite number expected" in line
    assert not out.exists()


# Checks -------------------------------------------------------------------------------------


def test_axis_angle(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, page = tmp_path / "angles.csv", tmp_path / "angles.html"
    found = done(
        capsys, "axis-angle", scene.star, "-o", table, "--error-split", "--report", page
    )  # fmt: skip
    (pair,) = found["pairs"]
    assert pair["sensors"] == ["a", "b"]
    mounted = np.degrees(np.arccos(attitude_scene.R_body_b.as_matrix()[2, 2]))
    # Two boresights of 5 arcsec each: 7.1 arcsec, over 401 epochs 0.35 arcsec on the mean.
    assert abs(pair["mean_deg"] - mounted) * 3600.0 < 4.0 * 7.07 / np.sqrt(401)
    assert pair["std_arcsec"] == pytest.approx(7.07, rel=0.15)
    assert pair["error_split"]["random_arcsec"] == pytest.approx(7.07, rel=0.15)
    assert len(rows(table)) == 401
    assert "Parts of the error" in page.read_text()
    (pair,) = done(capsys, "axis-angle", scene.star, "--mounting", scene.mounting)["pairs"]
    assert pair["mounted_deg"] == pytest.approx(mounted, abs=1e-9)
    assert pair["offset_arcsec"] == pytest.approx((pair["mean_deg"] - mounted) * 3600.0)
    line = refused(capsys, "axis-angle", scene.star, "--sensor", "a")
    assert "two star heads expected" in line


def test_determine_by_every_method(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(8)
    truth = Rotation.random(30, rng=rng)
    sigma = 10.0 * ARCSEC
    lines = ["t_s,sensor,id,body_x,body_y,body_z,ref_x,ref_y,ref_z,sigma_rad"]
    for k in range(30):
        count = 1 if k == 29 else 3 + k % 3
        reference = rng.standard_normal((count, 3))
        reference /= np.linalg.norm(reference, axis=1, keepdims=True)
        for i in range(count):
            body = truth[k].inv().apply(reference[i]) + sigma * rng.standard_normal(3)
            body /= np.linalg.norm(body)
            cells = [*body.tolist(), *reference[i].tolist(), sigma]
            lines.append(f"{k},s,{i}," + ",".join(map(repr, cells)))
    vectors = tmp_path / "v.csv"
    vectors.write_text("\n".join(lines) + "\n")
    out = tmp_path / "q.csv"
    for method in ("triad", "q", "svd", "quest", "foam"):
        found = done(capsys, "determine", vectors, "-o", out, "--method", method)
        assert found["flags"] == {"ok": 29, "too_few_rays": 1}
        table = rows(out)
        assert table[-1]["q_x"] == ""
        good = [row for row in table if row["flag"] == "ok"]
        quat = np.array([[float(row[f"q_{axis}"]) for axis in "xyzw"] for row in good])
        stated = np.array([[float(row[f"sigma_{a}_rad"]) for a in "xyz"] for row in good])
        error = (Rotation.from_quat(quat).inv() * truth[:29]).as_rotvec()
        assert 0.7 < np.sqrt(np.mean((error / stated) ** 2)) < 1.4
    page = tmp_path / "q.html"
    done(capsys, "determine", vectors, "-o", out, "--report", page)
    assert page.read_text().count("data:image/png") == 2


def test_preprocess_flags_what_it_did(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [
        line.replace(",a,", ",").rsplit(",", 2)[0]
        for line in scene.star.read_text().splitlines()
        if ",a," in line
    ]
    del lines[100:102]
    lines[50] = lines[50].split(",")[0] + ",0,0,0,0"
    t, *q = lines[70].split(",")
    off = Rotation.from_quat([float(c) for c in q]) * Rotation.from_rotvec([0.01, 0.0, 0.0])
    lines[70] = ",".join([t, *map(repr, off.as_quat().tolist())])
    lines.insert(150, lines[149])
    raw, out = tmp_path / "raw.csv", tmp_path / "star.csv"
    raw.write_text("t_s,q_x,q_y,q_z,q_w\n" + "\n".join(lines) + "\n")
    found = done(capsys, "preprocess", raw, "-o", out, "--report", tmp_path / "p.html")
    counts = found["heads"]["star"]
    assert (counts["broken"], counts["outlier_replaced"]) == (1, 1)
    assert (counts["gap"], counts["duplicate"]) == (2, 1)
    table = rows(out)
    assert len(table) == 401
    flags = {row["t_s"]: row["flag"] for row in table if row["flag"] != "ok"}
    assert flags == {"25": "broken", "35": "outlier_replaced", "50": "gap", "50.5": "gap"}
    error = (attitude(out).inv() * scene.R_inertial_body[::5]).magnitude()
    assert np.max(error) < 5.0 * SIGMA_STAR * np.sqrt(3.0)
    # What comes out goes in: the strict reader takes it.
    done(capsys, "fuse", "--star", out, "--gyro", scene.gyro, *WALKS, "-o", tmp_path / "f.csv",
         "--star-sigma-arcsec", 5)  # fmt: skip


def test_gyro_check(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = done(
        capsys, "gyro-check", *telemetry(scene), "-o", tmp_path / "g.csv",
        "--report", tmp_path / "g.html",
    )  # fmt: skip
    for bias, sigma, truth in zip(
        found["bias_deg_h"], found["bias_sigma_deg_h"], np.degrees(BIAS) * 3600.0, strict=True
    ):
        assert abs(bias - truth) < 4.0 * sigma
    table = rows(tmp_path / "g.csv")
    assert list(table[0]) == ["t_s", "d_x", "d_y", "d_z", "flag"]
    assert {row["flag"] for row in table} == {"ok"}
    assert "Star minus gyro" in (tmp_path / "g.html").read_text()
    wild = tmp_path / "wild.csv"
    lines = scene.gyro.read_text().splitlines()
    cells = lines[900].split(",")
    lines[900] = ",".join([cells[0], "0.02", *cells[2:]])
    wild.write_text("\n".join(lines) + "\n")
    found = done(
        capsys, "gyro-check", "--star", scene.star, "--gyro", wild, "--mounting", scene.mounting
    )
    assert not found["valid"]
    assert found["messages"]
    assert 1 <= found["suspicious_gyro_samples"] < 5


# Jitter -------------------------------------------------------------------------------------


def ephemeris(path: Path, frame: str, span_s: float) -> Orbit:
    orbit = Orbit.over(EPOCH, 0.3, 0.6, 500e3, np.radians(97.4))
    times = np.arange(-30.0, span_s + 31.0, 10.0)
    position, velocity = orbit.states(times)
    if frame == "itrs":
        position, velocity = itrs_from_gcrs(position, velocity, EPOCH, times)
    np.savetxt(
        path, np.column_stack([times, position, velocity]), delimiter=",", fmt="%.17g",
        header=f"# frame: {frame}\nt_s,x,y,z,vx,vy,vz", comments="",
    )  # fmt: skip
    return orbit


LINES = ((0.73, 3.0, "roll"), (1.35, 1.5, "pitch"))


def shaking(path: Path, orbit: Orbit, rng: np.random.Generator) -> None:
    """Attitude near the orbit frame, 5 Hz with alternating steps, two lines and noise."""
    times = np.cumsum(np.tile([0.1, 0.2], 1000))
    angle = {axis: np.radians(0.5) * np.ones(len(times)) for axis in ("roll", "pitch", "yaw")}
    for frequency, amplitude, axis in LINES:
        angle[axis] = angle[axis] + amplitude * ARCSEC * np.sin(2.0 * np.pi * frequency * times)
    position, velocity = orbit.states(times)
    attitude = R_inertial_orbit(position, velocity) * orbit_body(
        angle["roll"], angle["pitch"], angle["yaw"]
    )
    noise = Rotation.from_rotvec(0.3 * ARCSEC * rng.standard_normal((len(times), 3)))
    np.savetxt(
        path, np.column_stack([times, (attitude * noise).as_quat()]), delimiter=",", fmt="%.17g",
        header="t_s,q_x,q_y,q_z,q_w", comments="",
    )  # fmt: skip


@pytest.mark.parametrize("frame", ["gcrs", "itrs", "none"])
def test_jitter_finds_the_lines_and_no_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frame: str
) -> None:
    eph, series, page = tmp_path / "eph.csv", tmp_path / "q.csv", tmp_path / "j.html"
    orbit = ephemeris(eph, "gcrs" if frame == "none" else frame, 301.0)
    shaking(series, orbit, np.random.default_rng(11))
    more = () if frame == "none" else ("--ephemeris", eph, "--epoch", EPOCH_UTC)
    found = done(capsys, "jitter", series, *more, "-o", tmp_path / "angles.csv", "--report", page)
    assert found["angles"] == ("body axes" if frame == "none" else "orbit frame")
    assert set(found["axes"]) == {"roll", "pitch", "yaw"}
    assert found["axes"]["yaw"] == []
    for frequency, amplitude, axis in LINES:
        (line,) = found["axes"][axis]
        assert line["frequency_hz"] == pytest.approx(frequency, abs=5e-4)
        assert line["amplitude_arcsec"] == pytest.approx(amplitude, rel=0.03)
        assert line["phase_rad"] == pytest.approx(
            np.angle(np.exp(2j * np.pi * frequency * found["reference_s"])), abs=0.1
        )
    assert page.read_text().count("data:image/png") == 2
    assert list(rows(tmp_path / "angles.csv")[0]) == ["t_s", "roll_rad", "pitch_rad", "yaw_rad"]


def test_jitter_of_a_gyro(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(3)
    times = np.arange(4000) / 20.0
    rate = 1e-8 * rng.standard_normal((4000, 3))
    omega = 2.0 * np.pi * 3.1
    rate[:, 2] += 0.8 * ARCSEC * omega * np.cos(omega * times)
    np.savetxt(
        tmp_path / "g.csv", np.column_stack([times, rate]), delimiter=",", fmt="%.17g",
        header="t_s,w_x,w_y,w_z", comments="",
    )  # fmt: skip
    found = done(capsys, "jitter", tmp_path / "g.csv")
    (line,) = found["axes"]["yaw"]
    assert line["frequency_hz"] == pytest.approx(3.1, abs=1e-3)
    assert line["amplitude_arcsec"] == pytest.approx(0.8, rel=0.01)
    line_said = refused(capsys, "jitter", tmp_path / "g.csv", "--ephemeris", tmp_path / "g.csv")
    assert "this is gyro data" in line_said


def test_jitter_refusals(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "choose one with --sensor" in refused(capsys, "jitter", scene.star)
    short = tmp_path / "short.csv"
    short.write_text("t_s,q_x,q_y,q_z,q_w\n0,0,0,0,1\n1,0,0,0,1\n")
    assert "at least 64 samples" in refused(capsys, "jitter", short)
    short.write_text("t_s,a\n0,0\n")
    assert "header: columns q_x,q_y,q_z,q_w of an attitude" in refused(capsys, "jitter", short)


# convert ------------------------------------------------------------------------------------


def test_convert_to_the_earth_and_back(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fused, fixed, back = (tmp_path / f"{name}.csv" for name in ("fused", "fixed", "back"))
    done(capsys, "fuse", *telemetry(scene), *WALKS, "-o", fused)
    turn = ("--epoch", EPOCH_UTC)
    done(capsys, "convert", fused, "-o", fixed, "--from", "inertial", "--to", "itrs", *turn)
    expected = R_itrs_gcrs(EPOCH, scene.times_s) * attitude(fused)
    assert np.max((attitude(fixed).inv() * expected).magnitude()) < 1e-12
    np.testing.assert_array_equal(
        numbers(fixed, "sigma_x_rad", "bias_z"), numbers(fused, "sigma_x_rad", "bias_z")
    )
    done(capsys, "convert", fixed, "-o", back, "--from", "itrs", "--to", "inertial", *turn)
    assert np.max((attitude(back).inv() * attitude(fused)).magnitude()) < 1e-12
    line = refused(capsys, "convert", fused, "-o", back, "--from", "inertial", "--to", "itrs")
    assert "--epoch" in line


@pytest.mark.parametrize("frame", ["gcrs", "itrs"])
@pytest.mark.parametrize("source", ["inertial", "itrs"])
def test_convert_to_the_orbit_frame_and_back(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str], frame: str, source: str
) -> None:
    eph, plain, turned, back = (tmp_path / f"{n}.csv" for n in ("eph", "plain", "turned", "back"))
    orbit = ephemeris(eph, frame, 200.0)
    truth = scene.R_inertial_body
    given = truth if source == "inertial" else R_itrs_gcrs(EPOCH, scene.times_s) * truth
    np.savetxt(
        plain, np.column_stack([scene.times_s, given.as_quat()]), delimiter=",", fmt="%.17g",
        header="t_s,q_x,q_y,q_z,q_w", comments="",
    )  # fmt: skip
    more = ["--ephemeris", eph]
    if (frame == "itrs") != (source == "itrs"):
        more += ["--epoch", EPOCH_UTC]
    done(capsys, "convert", plain, "-o", turned, "--from", source, "--to", "orbit", *more)
    position, velocity = orbit.states(scene.times_s)
    expected = R_inertial_orbit(position, velocity).inv() * truth
    # 2 mm/s of 7.6 km/s: the nominal Earth rate where no epoch is given.
    assert np.max((attitude(turned).inv() * expected).magnitude()) < 3e-7
    angles = numbers(turned, "roll_rad", "pitch_rad", "yaw_rad")
    again = orbit_body(*angles.T)
    assert np.max((again.inv() * attitude(turned)).magnitude()) < 1e-12
    done(capsys, "convert", turned, "-o", back, "--from", "orbit", "--to", source, *more)
    assert np.max((attitude(back).inv() * given).magnitude()) < 1e-12


def test_convert_turns_heads_to_the_body(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "body.csv"
    done(
        capsys, "convert", scene.star, "-o", out, "--from", "inertial", "--to", "itrs",
        "--epoch", EPOCH_UTC, "--mounting", scene.mounting,
    )  # fmt: skip
    assert {row["sensor"] for row in rows(out)} == {"a", "b"}
    expected = R_itrs_gcrs(EPOCH, scene.times_s) * scene.R_inertial_body
    apart = attitude(out).inv() * expected[np.repeat(np.arange(0, 2001, 5), 2)]
    assert np.max(apart.magnitude()) < 6.0 * SIGMA_STAR


def test_convert_refusals(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    eph, out = tmp_path / "eph.csv", tmp_path / "out.csv"
    asked = ("convert", scene.star, "-o", out, "--from", "inertial", "--to", "orbit")
    assert "--ephemeris" in refused(capsys, *asked)
    ephemeris(eph, "gcrs", 100.0)
    assert "an ephemeris over 0.000 .. 200.000 s" in refused(capsys, *asked, "--ephemeris", eph)
    lines = eph.read_text().splitlines()
    swapped = [line.split(",") for line in lines[2:]]
    eph.write_text(
        "\n".join([*lines[:2], *(",".join([*r[:4], r[5], r[4], r[6]]) for r in swapped)]) + "\n"
    )
    short = ("convert", scene.star, "-o", out, "--from", "inertial", "--to", "orbit")
    ephemeris_200 = tmp_path / "e200.csv"
    ephemeris(ephemeris_200, "gcrs", 200.0)
    broken = ephemeris_200.read_text().splitlines()
    cells = [line.split(",") for line in broken[2:]]
    ephemeris_200.write_text(
        "\n".join([*broken[:2], *(",".join([*r[:4], r[5], r[4], r[6]]) for r in cells)]) + "\n"
    )
    line = refused(capsys, *short, "--ephemeris", ephemeris_200)
    assert "velocities must be the rate of the positions" in line
    assert not out.exists()


# All ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    ["preprocess", "determine", "axis-angle", "gyro-check", "jitter", "convert", "fuse"],
)
def test_help_has_an_example(capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert run(["attitude", command, "--help"]) == 0
    assert f"Example: geoposition attitude {command}" in " ".join(capsys.readouterr().out.split())


def test_the_command_line_starts_without_the_heavy_libraries() -> None:
    code = (
        "import sys; from geoposition.scripts.cli import build; build(); "
        "print([m for m in ('numpy', 'scipy', 'pyarrow', 'numba', 'matplotlib') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
