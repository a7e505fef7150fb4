"""Steady re-imaging and orthorectification of real products, against their makers and GDAL."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import RPCTransformer
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.flags import Flag
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.mapping import map_models
from geoposition.reimage.ortho import OrthoGrid, OrthoTask, ortho_window
from geoposition.reimage.parallax import measure_parallax
from geoposition.reimage.resample import Resampler
from geoposition.reimage.steady import steady_model
from geoposition.reimage.virtual import cropped_model
from geoposition.rpc.fit import fit_model
from geoposition.sensors.readers import open_product
from geoposition.terrain import RasterTerrain

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

WORLDVIEW = ("wv_mvp_1.xml", "wv_mvp_2.xml")
SIZE = 1024
PIXEL_RAD = 0.5 / 770e3


def worldview(root: Path, name: str) -> PushbroomModel:
    model = open_product(root / "linescan/worldview2_pair" / name).model
    assert isinstance(model, PushbroomModel)
    return model


@pytest.mark.parametrize("name", WORLDVIEW)
def test_an_rpc_fits_worldview_after_steadying(real_data: Path, name: str) -> None:
    taken = worldview(real_data, name)
    steady, removed = steady_model(taken)
    before, after = fit_model(taken).check, fit_model(steady).check
    assert before is not None
    assert after is not None
    assert before.largest_px > 0.1  # attitude motion that no RPC can follow
    assert after.largest_px <= 0.002
    arcsec = np.degrees(removed.removed_rad) * 3600.0
    assert 0.01 < np.sqrt(np.mean(arcsec**2)) < 0.2


def shaken(model: PushbroomModel) -> PushbroomModel:
    """`model` with 1.5 px of roll and 1 px of pitch at 130 and 210 Hz on its real attitude."""
    epoch = model.attitude.epoch
    shift = model.camera.timing.epoch - epoch
    ends = model.camera.timing.time_s(np.array([-110.0, SIZE + 110.0])) + shift
    times = np.linspace(ends.min(), ends.max(), 2000)
    turn = np.zeros((len(times), 3))
    turn[:, 0] = 1.5 * PIXEL_RAD * np.sin(2 * np.pi * 130.0 * times)
    turn[:, 1] = 1.0 * PIXEL_RAD * np.sin(2 * np.pi * 210.0 * times + 1.0)
    rotation = model.attitude.rotation(times) * Rotation.from_rotvec(turn)
    return replace(
        model,
        attitude=Attitude.from_samples(epoch, times, rotation.as_quat(), "itrs", "spline"),
    )


@pytest.mark.parametrize("name", ["img_01.tif", "img_02.tif"])
def test_a_real_image_is_shaken_and_steadied_again(real_data: Path, name: str) -> None:
    with rasterio.open(real_data / "stereo/pleiades_reunion" / name) as file:
        image = np.ascontiguousarray(file.read()[:, :SIZE, :SIZE])
    assert image.shape == (1, SIZE, SIZE)
    # the pictures are Pleiades', the model's orbit, attitude and camera WorldView-2's
    model = cropped_model(worldview(real_data, WORLDVIEW[0]), 12_000, 16_000, (SIZE, SIZE))
    jittered = shaken(model)
    steady, _ = steady_model(jittered)
    there = map_models(jittered, steady, 600.0).rows(0, SIZE)
    taken, _ = Resampler("lanczos").rows(image, there, SIZE)
    back = map_models(steady, jittered, 600.0).rows(0, SIZE)
    again, valid = Resampler("lanczos").rows(taken, back, SIZE)
    inner = np.zeros((SIZE, SIZE), dtype=bool)
    inner[20:-20, 20:-20] = True
    inner &= valid != 0
    assert correlation(taken[0], image[0], inner) < 0.97
    assert correlation(again[0], image[0], inner) >= 0.995
    assert again[0][inner].mean() == pytest.approx(image[0][inner].mean(), rel=2e-4)
    left = measure_parallax(steady, steady, image[0], again[0], 600.0, block_rows=16)
    found = left.shift_px[3:-3]
    assert np.isfinite(found).all()
    assert np.sqrt(np.mean(np.sum(found**2, axis=1))) <= 0.02


def correlation(a: FloatArray, b: FloatArray, where: np.ndarray) -> float:
    return float(np.corrcoef(a[where].astype(float), b[where].astype(float))[0, 1])


def test_ortho_places_are_gdals(real_data: Path) -> None:
    folder = real_data / "stereo/pleiades_reunion"
    image, dem = folder / "img_01.tif", folder / "expected_dsm.tif"
    model = open_product(image).model
    terrain = RasterTerrain(dem)
    grid = OrthoGrid.around(model, terrain, "EPSG:32740", 0.5)
    window = grid.window(100, 100, 500, 500)
    places = ortho_window(OrthoTask(model, terrain), window)
    assert places.error_px <= 0.005
    row, col = np.meshgrid(np.arange(0.0, 500.0, 7), np.arange(0.0, 500.0, 7), indexing="ij")
    lon, lat, _ = np.moveaxis(window.geodetic(row, col, 0.0), -1, 0)
    with rasterio.open(image) as file:
        rpcs = file.rpcs
    with RPCTransformer(rpcs, RPC_DEM=str(dem), RPC_DEM_MISSING_VALUE="-9999") as gdal:
        line, sample = gdal.rowcol(
            np.degrees(lon).ravel(), np.degrees(lat).ravel(), zs=np.zeros(lon.size),
            op=lambda value: value,
        )  # fmt: skip
    # GDAL's pixels begin at their corner
    theirs = np.stack([line, sample], axis=-1).reshape(*lon.shape, 2) - 0.5
    ours = np.stack([places.line, places.sample], axis=-1)[::7, ::7]
    seen = places.flag[::7, ::7] == Flag.OK
    assert seen.mean() > 0.5
    apart = np.abs(ours - theirs)[seen]
    # beside a hole of the DSM GDAL interpolates with what it has, ours has none there
    assert np.nanmax(apart) <= 0.02
