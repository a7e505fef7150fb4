"""`reimage` as people and scripts meet it: a jittered image in, a steady one with models out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import scenes

from geoposition.calib_fields.synthetic import fractal_field
from geoposition.frames import R_itrs_gcrs
from geoposition.reimage.mapping import map_models
from geoposition.reimage.resample import Resampler
from geoposition.reimage.steady import steady_model
from geoposition.reimage.virtual import ideal_camera, single_ccd
from geoposition.rpc.compare import compare
from geoposition.rpc.formats import read_rpc
from geoposition.scripts.cli import run
from geoposition.scripts.reimage.run import Request
from geoposition.scripts.reimage.run import run as reimage_run
from geoposition.scripts.tables import write_table
from geoposition.sensors.readers import open_product
from geoposition.sensors.writers.attitude_table import attitude_columns
from geoposition.sensors.writers.model_file import write_model_file

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (1100, 700)
JITTER = (scenes.Jitter(0, 1.5e-6, 70.0), scenes.Jitter(1, 1.2e-6, 90.0, 1.0))
HEIGHT_M = 120.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Products with the jittered attitude and with none, an image, and the attitude's table."""
    place = tmp_path_factory.mktemp("reimage")
    settings = {"attitude_step_s": 0.0005, "attitude": "spline", "spare_s": 0.6}
    scene = scenes.build(SHAPE, jitter=JITTER, **settings)  # type: ignore[arg-type]
    taken = scene.model()
    write_model_file(taken, place / "jittered.toml")
    write_model_file(scenes.build(SHAPE, **settings).model(), place / "plain.toml")  # type: ignore[arg-type]
    steady, _ = steady_model(taken)
    texture = 300.0 + 2000.0 * fractal_field(SHAPE, (1.0, 1.0), 4.0, 1.6, np.random.default_rng(2))
    np.save(place / "texture.npy", texture)
    rows = map_models(taken, steady, HEIGHT_M).rows(0, SHAPE[0])
    image, _ = Resampler("lanczos").rows(texture.astype(np.float32)[None], rows, SHAPE[1])
    write_image(place / "image.tif", np.nan_to_num(image[0]).round().astype(np.uint16))
    times = np.asarray(taken.attitude.curve.knots_s)
    inertial = R_itrs_gcrs(taken.attitude.epoch, times).inv() * taken.attitude.rotation(times)
    write_table(place / "fused.csv", attitude_columns(times, inertial.as_quat()))
    return place


def write_image(path: Path, pixels: np.ndarray, **more: object) -> None:
    with rasterio.open(path, "w", driver="GTiff", width=pixels.shape[1], height=pixels.shape[0],
                       count=1, dtype=pixels.dtype, nodata=0, **more) as file:  # fmt: skip
        file.write(pixels, 1)


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    capsys.readouterr()
    assert run([str(argument) for argument in (*arguments, "--json")]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert run([str(argument) for argument in arguments]) == 2
    out = capsys.readouterr()
    assert out.out == ""
    assert out.err.count("\n") == 1, out.err
    return out.err


def test_everything_is_written_and_fits(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "steady"
    result = told(capsys, "reimage", folder / "jittered.toml", folder / "image.tif", "-o", out,
                  "--height", HEIGHT_M)  # fmt: skip
    assert set(result["files"]) == {path.name for path in out.iterdir()}
    assert {
        "steady.tif",
        "steady.toml",
        "steady.RPB",
        "steady_RPC.TXT",
        "steady_RPC.XML",
        "steady_csm.json",
        "steady_valid.tif",
        "steady_displacement.tif",
        "removed_attitude.csv",
        "reimage.json",
        "report.html",
    } <= set(result["files"])
    assert json.loads((out / "reimage.json").read_text()) == result
    after, before = (result["rpc_misfit_px"][name] for name in ("after", "before"))
    assert max(after[axis]["max"] for axis in ("row", "col")) <= 0.002
    assert max(before[axis]["max"] for axis in ("row", "col")) > 0.5
    assert result["mapping"]["error_px"] <= 0.005
    strongest = [result["displacement_px"][axis]["lines"][0] for axis in ("row", "col")]
    assert strongest[0]["frequency_hz"] == pytest.approx(90.0, abs=0.5)
    assert strongest[1]["frequency_hz"] == pytest.approx(70.0, abs=0.5)
    # image, own model file, CSM and every RPC are of one geometry
    model = open_product(out / "steady.toml").model
    assert open_product(out / "steady.toml").image_path == out / "steady.tif"
    for name in ("steady.tif", "steady.RPB", "steady_RPC.TXT", "steady_RPC.XML", "steady_csm.json"):
        other = (
            open_product(out / name).model if name.endswith("csm.json") else read_rpc(out / name)
        )
        found = compare(model, other, heights_m=[0.0, 2000.0])
        assert max(found.row.max, found.col.max) < 0.01, name
    texture = np.load(folder / "texture.npy")
    with rasterio.open(out / "steady.tif") as made, rasterio.open(out / "steady_valid.tif") as seen:
        pixels, valid = made.read(1).astype(float), seen.read(1) != 0
        assert made.profile["tiled"]
        assert made.overviews(1)
        assert made.rpcs is not None
        assert made.tags(ns="IMAGE_STRUCTURE").get("LAYOUT") == "COG"
    valid[:12] = valid[-12:] = False
    valid[:, :12] = valid[:, -12:] = False
    assert np.corrcoef(pixels[valid], texture[valid])[0, 1] > 0.999
    assert abs(pixels[valid].mean() / texture[valid].mean() - 1.0) < 1e-4
    with rasterio.open(folder / "image.tif") as raw:
        before_pixels = raw.read(1).astype(float)
    assert np.corrcoef(before_pixels[valid], texture[valid])[0, 1] < 0.98
    with rasterio.open(out / "steady_displacement.tif") as moved:
        assert moved.count == 2
        assert moved.height == SHAPE[0]
        assert np.nanmax(np.abs(moved.read())) == pytest.approx(
            max(result["displacement_px"][axis]["max"] for axis in ("row", "col")), abs=1e-3
        )
    page = (out / "report.html").read_text()
    assert "Before and after" in page
    assert page.count("data:image/png") == 5


def test_a_fused_attitude_takes_the_products_place(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = told(capsys, "reimage", folder / "jittered.toml", folder / "image.tif", "-o",
               tmp_path / "own", "--height", HEIGHT_M)  # fmt: skip
    given = told(
        capsys,
        "reimage",
        folder / "plain.toml",
        folder / "image.tif",
        "-o",
        tmp_path / "given",
        "--height",
        HEIGHT_M,
        "--attitude",
        folder / "fused.csv",
    )
    none = told(capsys, "reimage", folder / "plain.toml", folder / "image.tif", "-o",
                tmp_path / "none", "--height", HEIGHT_M)  # fmt: skip
    for axis in ("row", "col"):
        rms = [run_["displacement_px"][axis]["rms"] for run_ in (own, given, none)]
        assert rms[1] == pytest.approx(rms[0], rel=1e-3)
        assert rms[2] < 1e-4
    with (
        rasterio.open(tmp_path / "own/steady.tif") as a,
        rasterio.open(tmp_path / "given/steady.tif") as b,
    ):
        assert np.mean(np.abs(a.read(1).astype(int) - b.read(1))) < 1.0


def test_a_cutoff_leaves_slow_motion_in(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = told(capsys, "reimage", folder / "jittered.toml", folder / "image.tif", "-o",
                  tmp_path / "low", "--cutoff", 10, "--method", "bilinear")  # fmt: skip
    assert result["steady"] == "low-pass at 10 Hz"
    assert result["displacement_px"]["col"]["rms"] > 0.5
    assert max(result["mapping"]["height_error_px"]) > 0.0


def test_a_crop_of_the_image_gives_a_crop(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from rasterio.transform import Affine

    with rasterio.open(folder / "image.tif") as raw:
        pixels = raw.read(1)
    crop = tmp_path / "crop.tif"
    write_image(crop, pixels[300:800, 100:600], transform=Affine(1, 0, 100, 0, 1, 300))
    result = told(capsys, "reimage", folder / "jittered.toml", crop, "-o", tmp_path / "out",
                  "--height", HEIGHT_M)  # fmt: skip
    assert result["shape"] == [500, 500]
    texture = np.load(folder / "texture.npy")[300:800, 100:600]
    with rasterio.open(tmp_path / "out/steady.tif") as made:
        inner = made.read(1)[20:-20, 20:-20].astype(float)
    # the crop's own cubic is a little another one than the whole image's
    assert np.corrcoef(inner.ravel(), texture[20:-20, 20:-20].ravel())[0, 1] > 0.98


def test_what_cannot_be_done_is_refused_and_leaves_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, product, out = folder / "image.tif", folder / "jittered.toml", tmp_path / "out"
    assert "no such file" in refused(capsys, "reimage", product, tmp_path / "no.tif", "-o", out)
    wrong = tmp_path / "wrong.tif"
    write_image(wrong, np.ones((2000, 700), np.uint16))
    assert "1100 x 700" in refused(capsys, "reimage", product, wrong, "-o", out)
    doubles = tmp_path / "doubles.tif"
    write_image(doubles, np.ones(SHAPE))
    assert "float64" in refused(capsys, "reimage", product, doubles, "-o", out)
    late = tmp_path / "late.csv"
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (9, 1))
    write_table(late, attitude_columns(np.arange(100.0, 109.0), quat))
    message = refused(capsys, "reimage", product, image, "-o", out, "--attitude", late)
    assert "late.csv" in message
    assert "times over the image" in message
    assert "a positive cut-off" in refused(
        capsys, "reimage", product, image, "-o", out, "--cutoff", -1
    )
    assert "one of them" in refused(
        capsys, "reimage", product, image, "-o", out, "--height", 1, "--dem", image
    )
    assert "rigorous" in refused(capsys, "reimage", write_rpc_only(folder), image, "-o", out)
    assert {path.name for path in tmp_path.iterdir()} == {"wrong.tif", "doubles.tif", "late.csv"}


def test_a_dem_elsewhere_a_missing_attitude_and_a_closed_folder(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, product = folder / "image.tif", folder / "jittered.toml"
    dem = tmp_path / "dem.tif"
    write_image(
        dem, np.full((20, 20), 100.0, np.float32), crs="EPSG:4979",
        transform=rasterio.Affine(0.01, 0.0, -150.0, 0.0, -0.01, -60.0),
    )  # fmt: skip
    for command in (("reimage",), ("ortho",)):
        out = tmp_path / ("out" if command == ("reimage",) else "out.tif")
        message = refused(capsys, *command, product, image, "-o", out, "--dem", dem)
        assert "dem.tif" in message
        assert "heights under the image" in message
    message = refused(capsys, "reimage", product, image, "-o", tmp_path / "out",
                      "--attitude", tmp_path / "none.csv")  # fmt: skip
    assert "none.csv" in message
    inside_a_file = dem / "out"
    assert "writable" in refused(capsys, "reimage", product, image, "-o", inside_a_file)
    assert {path.name for path in tmp_path.iterdir()} == {"dem.tif"}


def test_a_run_broken_off_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    def broken(done: int, total: int) -> None:
        raise KeyboardInterrupt

    request = Request(folder / "image.tif", tmp_path / "out", height_m=HEIGHT_M)
    with pytest.raises(KeyboardInterrupt):
        reimage_run(open_product(folder / "jittered.toml"), request, broken)
    assert list(tmp_path.iterdir()) == []


def write_rpc_only(folder: Path) -> Path:
    from geoposition.rpc.fit import fit_model
    from geoposition.rpc.formats import write_rpc

    path = folder / "plain.RPB"
    write_rpc(fit_model(open_product(folder / "plain.toml").model).model, path)
    return path


FREQUENCY_HZ, AMPLITUDE_PX, GSD_M = 60.0, 0.4, 0.7


@pytest.fixture(scope="module")
def staggered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two CCDs in staggered rows, 120 pixels in common, two bands of bytes with missing pixels."""
    place = tmp_path_factory.mktemp("staggered")
    ifov, lines, samples = GSD_M / 600e3, 1200, 260
    ccds = scenes.focal_plane(2, samples, ifov, overlap_px=120, stagger_px=40)
    jitter = (scenes.Jitter(0, AMPLITUDE_PX * ifov, FREQUENCY_HZ, 0.4),)
    scene = scenes.build(
        (lines, 2 * samples), ccds=ccds, gsd_m=GSD_M, jitter=jitter, attitude_step_s=0.0005,
        attitude="spline", spare_s=1.0,
    )  # fmt: skip
    taken = scene.model()
    write_model_file(taken, place / "scene.toml")
    steady, _ = steady_model(taken)
    wide = replace(steady, camera=ideal_camera(steady.camera)[0])
    ground = fractal_field((lines, wide.shape[1]), (1.0, 1.0), 4.0, 1.6, np.random.default_rng(5))
    texture = np.stack([20.0 + 200.0 * ground, 230.0 - 200.0 * ground]).astype(np.float32)
    np.save(place / "texture.npy", texture)
    halves = []
    for number in range(2):
        mapping = map_models(single_ccd(taken, number), wide, HEIGHT_M)
        pixels, valid = Resampler("lanczos").rows(texture, mapping.rows(0, lines), samples)
        halves.append(np.where(valid != 0, np.nan_to_num(pixels), 0.0))
    image = np.concatenate(halves, axis=2).clip(0, 255).round().astype(np.uint8)
    image[:, 500:520, 420:460] = 0
    with rasterio.open(place / "image.tif", "w", driver="GTiff", width=2 * samples, height=lines,
                       count=2, dtype="uint8", nodata=0) as file:  # fmt: skip
        file.write(image)
    return place


def test_one_straight_line_from_several_ccds(
    staggered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The ideal camera's image is the ground's own, both bands, across the seam of the CCDs."""
    evaluation = tmp_path / "evaluation.json"
    line = {"frequency": FREQUENCY_HZ, "frequency_sigma": 0.5, "unit": "Hz",
            "amplitude_x_px": 0.01, "amplitude_y_px": 0.41, "amplitude_sigma_px": 0.02}  # fmt: skip
    evaluation.write_text(json.dumps({"jitter": [line]}))
    result = told(capsys, "reimage", staggered / "scene.toml", staggered / "image.tif", "-o",
                  tmp_path / "out", "--height", HEIGHT_M, "--camera", "ideal",
                  "--evaluation", evaluation)  # fmt: skip
    assert "ideal" in result["camera"]
    assert result["removed_px"]["col"]["rms"] == pytest.approx(AMPLITUDE_PX / np.sqrt(2), rel=0.02)
    assert result["removed_px"]["row"]["rms"] < 0.01
    texture = np.load(staggered / "texture.npy")
    with (
        rasterio.open(tmp_path / "out/steady.tif") as file,
        rasterio.open(tmp_path / "out/steady_valid.tif") as seen,
    ):
        made, valid = file.read(), seen.read(1) != 0
        assert file.nodata == 0
        assert file.dtypes == ("uint8", "uint8")
    assert made.shape == texture.shape
    assert np.all((made != 0) == valid)
    assert 700 < np.count_nonzero(~valid[60:-60, 250:380]) < 900
    inner = np.zeros_like(valid)
    inner[60:-60, 12:-12] = True
    for band in range(2):
        a, b = made[band][valid & inner].astype(float), texture[band][valid & inner]
        assert np.corrcoef(a, b)[0, 1] > 0.999
        assert abs(a.mean() - b.mean()) < 0.1
    # the same line as the attitude, the CCDs and the match have it, in one table
    table = [entry for entry in result["jitter"] if entry["axis"] == "col"]
    strongest = table[0]["sources"]
    assert set(strongest) == {"attitude", "CCDs 0 and 1", "match"}
    attitude, ccds = strongest["attitude"], strongest["CCDs 0 and 1"]
    assert attitude["frequency_hz"] == pytest.approx(FREQUENCY_HZ, rel=0.005)
    assert ccds["frequency_hz"] == pytest.approx(FREQUENCY_HZ, rel=0.005)
    assert ccds["amplitude_px"] == pytest.approx(attitude["amplitude_px"], rel=0.05)
    turn = ccds["phase_rad"] - attitude["phase_rad"]
    assert np.cos(turn) > np.cos(0.15)
    assert strongest["match"]["amplitude_px"] == 0.41
    assert strongest["match"]["phase_rad"] is None
    assert "CCDs 0 and 1" in (tmp_path / "out/report.html").read_text()


@pytest.mark.parametrize("content", ["{", "[]", '{"jitter": [{"unit": "Hz"}]}'])
def test_an_evaluation_that_is_none_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    wrong = tmp_path / "evaluation.json"
    wrong.write_text(content)
    message = refused(capsys, "reimage", folder / "jittered.toml", folder / "image.tif", "-o",
                      tmp_path / "out", "--evaluation", wrong)  # fmt: skip
    assert "evaluation.json" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("dtype", ["int16", "float32"])
def test_every_type_of_pixel_keeps_its_mean(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], dtype: str
) -> None:
    with rasterio.open(folder / "image.tif") as file:
        pixels = file.read(1)[:400].astype(np.float64) - 1300.0
    write_image(tmp_path / "crop.tif", pixels.astype(dtype))
    out = tmp_path / "out"
    told(capsys, "reimage", folder / "jittered.toml", tmp_path / "crop.tif", "-o", out,
         "--height", HEIGHT_M, "--nodata", -30000, "--compress", "deflate")  # fmt: skip
    with rasterio.open(out / "steady.tif") as file, rasterio.open(out / "steady_valid.tif") as seen:
        assert file.dtypes == (dtype,)
        made, valid = file.read(1).astype(float), seen.read(1) != 0
    texture = np.load(folder / "texture.npy")[:400] - 1300.0
    valid[:12] = valid[-12:] = False
    assert texture.min() < -100.0
    assert abs((made[valid] - texture[valid]).mean()) < 0.15
