"""Real telemetry through the command line: GRACE-FO, MRO, Fermi, Chandrayaan-2."""

from __future__ import annotations

import csv
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.attitude import SlerpCurve
from geoposition.scripts.cli import run
from geoposition.sensors.attitude_determination.checks.axis_angle import axis_angles
from geoposition.sensors.readers import gracefo
from geoposition.sensors.readers.attitude_columns import column_map
from geoposition.sensors.readers.attitude_tables import read_star
from geoposition.sensors.telemetry import StarSeries

ARCSEC = np.pi / 648000.0


@pytest.fixture
def telemetry(real_data: Path) -> Path:
    return real_data / "attitude"


def done(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    assert run(["attitude", *(str(argument) for argument in arguments), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def product(folder: Path, kind: str) -> Path:
    (path,) = (folder / "gracefo_c").glob(f"{kind}_*.txt")
    return path


def fused(path: Path) -> tuple[np.ndarray, Rotation]:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    quat = [[float(row[f"q_{axis}"]) for axis in "xyzw"] for row in rows]
    return np.array([float(row["t_s"]) for row in rows]), Rotation.from_quat(quat)


# GRACE-FO -----------------------------------------------------------------------------------


def test_gracefo_axis_angles(telemetry: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = done(capsys, "axis-angle", product(telemetry, "SCA1A"))
    assert [pair["sensors"] for pair in found["pairs"]] == [
        ["sca1", "sca2"], ["sca1", "sca3"], ["sca2", "sca3"],
    ]  # fmt: skip
    expected = ((80.969, 4.0), (80.211, 3.5), (100.075, 2.8))
    for pair, (mean_deg, std_arcsec) in zip(found["pairs"], expected, strict=True):
        assert pair["mean_deg"] == pytest.approx(mean_deg, abs=6e-4)
        assert pair["std_arcsec"] == pytest.approx(std_arcsec, abs=0.1)
        assert pair["n"] == 33


def test_gracefo_products_close_the_chain(telemetry: Path) -> None:
    heads = gracefo.read_sca1a(product(telemetry, "SCA1A"))
    mounting = gracefo.read_qsa1b(product(telemetry, "QSA1B"))
    body = gracefo.read_sca1b(product(telemetry, "SCA1B"))
    curve = SlerpCurve.through(body.times_s, body.quat_xyzw)
    for head, name in enumerate(heads.heads):
        mine = heads.where(heads.head == head)
        turned = mine.R_inertial_sensor * mounting.rotation(name).inv()
        apart = (curve.rotation(mine.times_s).inv() * turned).magnitude()
        # The heads' alignment errors, and the clocks' 0.1 s at 228 arcsec/s.
        assert np.degrees(np.median(apart)) < 0.06
    gyro = gracefo.read_imu(product(telemetry, "IMU1B"))
    rate = gyro.increments_rad().sum(axis=0) / (gyro.times_s[-1] - gyro.times_s[0])
    truth = (body.R_inertial_sensor[0].inv() * body.R_inertial_sensor[4]).as_rotvec() / 4.0
    assert rate[1] == pytest.approx(truth[1], rel=5e-4)


def test_gracefo_heads_fused_apart(
    telemetry: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The gyro covers 4 s: the angles' scatter shrinks from raw to smoothed, and no more."""
    raw = gracefo.read_sca1a(product(telemetry, "SCA1A"))
    mounting = gracefo.read_qsa1b(product(telemetry, "QSA1B"))
    std: dict[str, list[float]] = {}
    for method in ("ekf", "rts", "two-filter"):
        times, quats, index = [], [], []
        for head, name in enumerate(raw.heads):
            out = tmp_path / f"{name}.csv"
            done(
                capsys, "fuse", "--star", product(telemetry, "SCA1A"), "--sensor", name,
                "--gyro", product(telemetry, "IMU1A"), "--mounting", product(telemetry, "QSA1B"),
                "--method", method, "--angle-random-walk", 1e-7, "--rate-random-walk", 1e-10,
                "--bias-sigma", 20, "-o", out,
            )  # fmt: skip
            at, rotation = fused(out)
            seen = raw.times_s[(raw.head == head) & (raw.times_s > 0)]
            seen = seen[(seen >= at[0]) & (seen <= at[-1])]
            turned = SlerpCurve.through(at, rotation.as_quat()).rotation(seen)
            quats.append((turned * mounting.rotation(name)).as_quat())
            times.append(seen)
            index.append(np.full(len(seen), head))
        order = np.argsort(np.concatenate(times), kind="stable")
        series = StarSeries.of(
            np.concatenate(times)[order], np.concatenate(quats)[order], 1e-5, None,
            np.concatenate(index)[order], raw.heads,
        )  # fmt: skip
        std[method] = [pair.std_rad / ARCSEC for pair in axis_angles(series)]
        if method == "rts":
            span = (raw.times_s >= series.times_s[0]) & (raw.times_s <= series.times_s[-1])
            std["raw"] = [pair.std_rad / ARCSEC for pair in axis_angles(raw.where(span))]
    assert np.all(np.array(std["rts"]) < 0.5 * np.array(std["raw"]))
    assert np.mean(std["rts"]) < np.mean(std["ekf"]) < np.mean(std["raw"])
    np.testing.assert_allclose(std["two-filter"], std["rts"], rtol=1e-3)


# MRO ----------------------------------------------------------------------------------------


def thinned(source: Path, target: Path, step_s: float) -> None:
    """Copy a table with one row per `step_s`; the remarks go along."""
    with gzip.open(source, "rt") as file:
        lines = file.read().splitlines()
    kept, due = [], -np.inf
    for line in lines:
        time = line.split(",")[0]
        if line.startswith("#") or not time[0].isdigit():
            kept.append(line)
        elif float(time) >= due:
            kept.append(line)
            due = float(time) + step_s
    target.write_text("\n".join(kept) + "\n")


@pytest.mark.parametrize("year", ["2007", "2009"])
def test_mro_smoothed_beats_filtered_and_interpolated(
    telemetry: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], year: str
) -> None:
    source = telemetry / f"mro_{year}" / "decoded.csv.gz"
    star = tmp_path / "star.csv"
    thinned(source, star, 10.0)
    truth = read_star(source, column_map(preset="mro")).series
    known = read_star(star, column_map(preset="mro")).series
    withheld = ~np.isin(truth.times_s, known.times_s)
    withheld &= (truth.times_s > known.times_s[1]) & (truth.times_s < known.times_s[-1])
    rms = {}
    for method in ("ekf", "rts", "two-filter"):
        out = tmp_path / "fused.csv"
        done(
            capsys, "fuse", "--star", star, "--gyro", source, "--preset", "mro", "-o", out,
            "--method", method, "--star-sigma-arcsec", 0.3,
            "--angle-random-walk", 4e-6, "--rate-random-walk", 1e-9,
        )  # fmt: skip
        at, rotation = fused(out)
        place = np.searchsorted(at, truth.times_s[withheld])
        np.testing.assert_allclose(at[place], truth.times_s[withheld], atol=1e-9)
        apart = (rotation[place].inv() * truth.R_inertial_sensor[withheld]).magnitude()
        rms[method] = float(np.sqrt(np.mean(apart**2)) / ARCSEC)
    line = SlerpCurve.through(known.times_s, known.quat_xyzw).rotation(truth.times_s[withheld])
    apart = (line.inv() * truth.R_inertial_sensor[withheld]).magnitude()
    rms["interpolated"] = float(np.sqrt(np.mean(apart**2)) / ARCSEC)
    assert rms["rts"] < 0.8 * rms["ekf"]
    assert rms["rts"] < 0.5 * rms["interpolated"]
    assert rms["two-filter"] == pytest.approx(rms["rts"], rel=1e-3)
    assert rms["rts"] < 3.0


# Fermi --------------------------------------------------------------------------------------


def test_fermi_gyro_errors(
    telemetry: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (source,) = (telemetry / "fermi").glob("*.csv.gz")
    star = tmp_path / "star.csv"
    thinned(source, star, 10.0)
    found = done(
        capsys, "fuse", "--star", star, "--gyro", source, "--preset", "fermi",
        "-o", tmp_path / "f.parquet", "--gyro-model", "general", "--star-sigma-arcsec", 1,
        "--angle-random-walk", 1.7e-5, "--rate-random-walk", 1e-10, "--bias-sigma", 0.4,
        "--scale-sigma", 5000, "--misalignment-sigma", 5000,
    )  # fmt: skip
    bias = np.array([found["bias_deg_h"][axis] for axis in "xyz"])
    # A degree per hour is an arc second per second; known are the corrections, minus the bias.
    np.testing.assert_allclose(-bias, [0.017, 0.115, -0.202], atol=0.03)
    ppm = np.array([one["value"] for one in found["parameters_ppm"].values()])
    assert 2200.0 < np.max(np.abs(ppm)) < 2600.0


# Chandrayaan-2 ------------------------------------------------------------------------------


def test_chandrayaan_spectrum(
    telemetry: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "jitter.html"
    found = done(
        capsys, "jitter", telemetry / "chandrayaan2" / "decoded.csv.gz",
        "--preset", "chandrayaan2", "--report", page,
    )  # fmt: skip
    assert found["samples"] == 10189
    pitch = {round(line["frequency_hz"], 2): line for line in found["axes"]["pitch"]}
    # The same line in two axes is a line of the spacecraft's.
    roll = [line["frequency_hz"] for line in found["axes"]["roll"]]
    assert 3.05 in pitch
    assert any(abs(f - pitch[3.05]["frequency_hz"]) < 1e-3 for f in roll)
    for line in pitch.values():
        assert line["amplitude_arcsec"] > 5.0 * line["sigma_amplitude_arcsec"]
    assert page.read_text().count("data:image/png") == 2
