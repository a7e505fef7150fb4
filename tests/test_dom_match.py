"""Matching with an orthophoto: a hundredth of a pixel, and every loss with its cause."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from field_scene import IFOV_RAD, FieldScene, make_field, scene, write_image
from rasterio.transform import Affine
from scenes import Jitter

from geoposition.arrays import FloatArray
from geoposition.calib_fields.evaluate import EvaluationOptions, evaluate
from geoposition.calib_fields.geometry import Dom
from geoposition.calib_fields.match import DomMatches, DomMatchOptions, match_dom
from geoposition.calib_fields.refine import Searched, Template, refine
from geoposition.calib_fields.synthetic_dom import synthetic_dom
from geoposition.errors import ArgumentError, GeometryError, ProductError
from geoposition.matching import open_image
from geoposition.reimage.ortho import OrthoGrid

SHAPE = (2048, 640)


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> FieldScene:
    """Planted: 3″ of pitch, 2″ of roll, a bow of 2 px, 0.3 px at 2 Hz, 2 grey values of noise."""
    true = scene(
        SHAPE,
        bias_arcsec=(2.0, 3.0),
        bow_px=(1.0, 2.0),
        jitter=(Jitter(1, 0.3 * IFOV_RAD, 2.0, 0.7),),
    )
    return make_field(tmp_path_factory.mktemp("field"), SHAPE, true, noise=2.0)


@pytest.fixture(scope="module")
def matches(field: FieldScene) -> DomMatches:
    return match_dom(field.source, field.believed, field.dom, field.terrain)


def test_matches_are_right(field: FieldScene, matches: DomMatches) -> None:
    used = matches.used
    assert used.sum() > 500
    missed = matches.error_px[used] - field.true_error_px(matches.ground[used])
    assert np.all(np.sqrt(np.mean(missed**2, axis=0)) < 0.03)
    assert np.all(np.abs(missed.mean(axis=0)) < 0.003)
    sigma = np.sqrt(np.diagonal(matches.covariance_px2[used], axis1=1, axis2=2))
    # stated within a factor of two: windows of a bow are no longer only shifted
    ratio = np.sqrt(np.mean(missed**2, axis=0) / np.mean(sigma**2, axis=0))
    assert np.all((ratio > 0.6) & (ratio < 2.0))
    assert sum(matches.counts.values()) == len(matches.cause)


def test_planted_errors_are_reported(field: FieldScene, matches: DomMatches) -> None:
    found = evaluate(matches, field.believed)
    truth = field.true_error_px(matches.ground[matches.used])
    values = found.estimates
    bias = [values["bias_line_px"].value, values["bias_sample_px"].value]
    assert np.allclose(bias, truth.mean(axis=0), atol=0.03)
    relative = float(np.sqrt(np.sum((truth - truth.mean(axis=0)) ** 2) / len(truth)))
    assert values["relative_px"].value == pytest.approx(relative, rel=0.03)
    line = found.spectrum.lines[0]
    assert found.spectrum.unit == "Hz"
    assert line.frequency == pytest.approx(2.0, abs=0.05)
    assert line.amplitude_px[0] == pytest.approx(0.3, rel=0.1)


def test_attitude_bias_is_no_relative_error(field: FieldScene, matches: DomMatches) -> None:
    shift, attitude = (
        evaluate(matches, field.believed, EvaluationOptions(kind)).estimates["relative_px"].value
        for kind in ("shift", "attitude")
    )
    assert attitude <= shift


def test_clouds_are_counted_and_the_rest_reported(field: FieldScene, tmp_path: Path) -> None:
    grey = np.array(field.source.read(field.source.extent))
    grey[:700] = 255.0 + np.random.default_rng(0).standard_normal((700, SHAPE[1]))
    grey[1500:] = np.nan
    write_image(tmp_path / "cloud.tif", grey)
    source = open_image(tmp_path / "cloud.tif", first_pixel=(0, 0))
    found = match_dom(source, field.believed, field.dom, field.terrain)
    assert found.counts["used"] > 100
    assert found.counts["low_correlation"] + found.counts["no_texture"] > 50
    assert found.counts["nodata"] > 50
    used = found.used
    assert np.all(found.model_px[used, 0] > 660)
    missed = found.error_px[used] - field.true_error_px(found.ground[used])
    assert np.sqrt(np.mean(missed**2)) < 0.04


def test_useless_input_is_refused(field: FieldScene, tmp_path: Path) -> None:
    grid = field.dom.grid

    def dom(name: str, values: FloatArray | None = None, east: float = 0.0, crs: str = "") -> Dom:
        path = tmp_path / name
        with rasterio.open(
            path, "w", driver="GTiff", width=grid.shape[1], height=grid.shape[0], count=1,
            dtype="uint8", nodata=0, crs=crs or grid.crs,
            transform=Affine(grid.resolution, 0, grid.left + east, 0, -grid.resolution, grid.top),
        ) as file:  # fmt: skip
            if values is not None:
                file.write(values.astype(np.uint8), 1)
        return Dom.open(path)

    def matched(reference: Dom) -> None:
        match_dom(field.source, field.believed, reference, field.terrain)

    with pytest.raises(GeometryError, match="no overlap"):
        matched(dom("far.tif", east=300e3))
    with pytest.raises(GeometryError, match="no overlap"):
        matched(dom("zone.tif", crs="EPSG:32643"))
    with pytest.raises(GeometryError, match="no data"):
        matched(dom("empty.tif"))
    with pytest.raises(GeometryError, match="featureless"):
        matched(dom("flat.tif", np.full(grid.shape, 7.0)))
    write_image(tmp_path / "flat_image.tif", np.full(SHAPE, 9.0))
    source = open_image(tmp_path / "flat_image.tif", first_pixel=(0, 0))
    with pytest.raises(GeometryError, match="featureless"):
        match_dom(source, field.believed, field.dom, field.terrain)
    write_image(tmp_path / "bare.tif", np.zeros((50, 50)))
    with pytest.raises(ProductError, match="coordinate system"):
        Dom.open(tmp_path / "bare.tif")
    with pytest.raises(ArgumentError):
        DomMatchOptions(window_px=4)


def test_tiles_read_as_one(field: FieldScene, tmp_path: Path) -> None:
    whole, half = field.dom, field.dom.grid.shape[1] // 2
    paths = []
    with rasterio.open(field.dom_path) as file:
        grey, transform, crs = file.read(1), file.transform, file.crs
    for k, (first, last) in enumerate(((0, half), (half, grey.shape[1]))):
        paths.append(tmp_path / f"tile{k}.tif")
        with rasterio.open(
            paths[-1], "w", driver="GTiff", width=last - first, height=len(grey), count=1,
            dtype="float32", crs=crs, transform=transform * Affine.translation(first, 0),
        ) as file:  # fmt: skip
            file.write(grey[:, first:last], 1)
    tiles = Dom.open(paths)
    assert tiles.grid.shape == whole.grid.shape
    for factor in (1, 4):
        window = whole.coarser(factor).window(3, half // factor - 20, 40, 40)
        read = tiles.read(window)
        # a coarse pixel across the seam is left out
        assert np.isnan(read).any(axis=0).sum() == (half % factor != 0)
        known = np.isfinite(read)
        assert np.allclose(read[known], whole.read(window)[known])
    outside = replace(window, left=window.left - 1e6)
    assert np.isnan(tiles.read(outside)).all()


def shifted_pair(noise: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Texture, the same moved by Fourier's theorem, and by how much."""
    rng = np.random.default_rng(seed)
    grey = synthetic_dom(OrthoGrid("EPSG:32633", 0.0, 0.0, 1.0, (512, 512)), seed).grey
    shift = rng.uniform(-0.5, 0.5, 2)
    k_row, k_col = np.fft.fftfreq(512)[:, None], np.fft.fftfreq(512)[None]
    turn = np.exp(-2j * np.pi * (k_row * shift[0] + k_col * shift[1]))
    moved = np.fft.ifft2(np.fft.fft2(grey) * turn).real
    first, second = (g + noise * rng.standard_normal(grey.shape) for g in (grey, 1.4 * moved - 9.0))
    return first, second, shift


@pytest.mark.parametrize(("noise", "bound_px"), [(0.0, 0.02), (4.0, 0.05)])
def test_precision_of_the_refinement(noise: float, bound_px: float) -> None:
    corners = np.stack(np.meshgrid(np.arange(60, 390, 33), np.arange(60, 390, 33)), -1).reshape(
        -1, 2
    )
    errors, ratios = [], []
    for seed in range(4):
        first, second, shift = shifted_pair(noise, seed)
        found = refine(
            Template.of(first), Searched.of(second), corners, np.zeros((len(corners), 2))
        )
        assert found.converged.all()
        error = found.shift_px - shift
        errors.append(error)
        ratios.append(error**2 / np.diagonal(found.covariance_px2, axis1=1, axis2=2))
    assert np.sqrt(np.mean(np.square(errors))) < bound_px
    if noise:
        assert 0.8 < np.sqrt(np.mean(ratios)) < 1.25


def test_a_start_too_far_off_does_not_converge_quietly() -> None:
    first, second, _ = shifted_pair(0.0, 0)
    found = refine(
        Template.of(first), Searched.of(second), np.array([[200, 200]]), np.array([[9.0, -9.0]])
    )
    assert not found.converged[0]
