"""P's case: what jitter compensation leaves, against the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jitter_scenes import Telling

from geoposition.arrays import FloatArray
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.mapping import map_models
from geoposition.reimage.steady import steady_model
from geoposition.rpc.fit import fit_model
from geoposition.sensors.jitter_scene import (
    PAPER_LINES,
    ZY3_LINE,
    JitterSceneOptions,
    simulate_jitter_scene,
)

SHAPE = (30_000, 6000)
PIXEL_ARCSEC = np.degrees(0.5 / 490e3) * 3600.0


@pytest.fixture(scope="module", params=["paper", "zy3"])
def telling(request: pytest.FixtureRequest) -> Telling:
    lines = PAPER_LINES if request.param == "paper" else (*PAPER_LINES, ZY3_LINE)
    options = replace(JitterSceneOptions(), lines=lines)
    return Telling(simulate_jitter_scene(options, seed=11), SHAPE)


def grid() -> FloatArray:
    rows, cols = np.arange(0.0, 30_000, 11), np.array([0.0, 3000.0, 5999.0])
    return np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)


def steady_error_px(true: PushbroomModel, believed: PushbroomModel) -> FloatArray:
    """Where the ground that a steady pixel holds belongs, less where it is, (n, 2)."""
    steady, _ = steady_model(believed)
    image = grid()
    places = map_models(steady, believed, 300.0).places(image[:, 0, 0], image[0, :, 1])
    ground = true.image_to_ground(places, 300.0).geodetic
    return (steady.ground_to_image(ground).image_px - image).reshape(-1, 2)


def rms_2d(error: FloatArray) -> float:
    """Two-dimensional RMS after one shift for the scene has been removed."""
    away = error - np.nanmean(error, axis=0)
    return float(np.sqrt(np.nanmean(np.sum(away**2, axis=1))))


def test_compensation_of_the_papers_case(telling: Telling) -> None:
    true = telling.true()
    image = grid()
    ground = true.image_to_ground(image, 300.0).geodetic
    onboard = telling.onboard()
    raw = (onboard.ground_to_image(ground).image_px - image).reshape(-1, 2)
    assert 3.0 < rms_2d(raw) < 4.0  # P table 1 before compensation: 3.1 to 4.0
    fused, sigma_rad = telling.fused()
    error = steady_error_px(true, fused)
    assert np.isfinite(error).all()
    assert rms_2d(error) <= 0.10
    # what is left for the scene as a whole is star noise, as the covariance says
    sigma_px = np.degrees(sigma_rad[:2]) * 3600.0 / PIXEL_ARCSEC
    assert np.all(np.abs(error.mean(axis=0)) < 3.5 * sigma_px)
    assert np.all(sigma_px < 1.0)


def test_with_the_true_attitude_only_the_mapping_is_left(telling: Telling) -> None:
    true = telling.true()
    assert rms_2d(steady_error_px(true, true)) < 1e-6
    steady, _ = steady_model(true)
    mapping = map_models(steady, true, 300.0)
    rows = mapping.rows(0, SHAPE[0])
    assert rows.error_px <= 0.005
    image = grid()
    exact = mapping.places(image[:, 0, 0], image[0, :, 1])
    place = rows.displacement_px(image[0, :, 1])[::11] + image
    assert np.abs(place - exact).max() <= 0.01


def test_the_rpc_misses_the_jitter_and_not_the_steady_model(telling: Telling) -> None:
    true = telling.true()
    before = fit_model(true, limit_px=np.inf, direct=False).check
    after = fit_model(steady_model(true)[0]).check
    assert before is not None
    assert after is not None
    assert before.row.rms > 0.05
    assert before.col.rms > 0.1
    assert after.largest_px <= 0.002
