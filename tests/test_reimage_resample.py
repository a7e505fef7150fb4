"""Resampling against plain formulas: exact where it must be, careful at borders and holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError
from geoposition.reimage.mapping import RowMap
from geoposition.reimage.resample import METHODS, Resampler

SHAPE = (70, 90)


def affine_map(
    rows: int, cols: int, matrix: FloatArray, offset: tuple[float, float], step: int = 32
) -> tuple[RowMap, FloatArray, FloatArray]:
    """A `RowMap` and, for every pixel, its line and sample."""
    nodes = step * np.arange(-(-(cols - 1) // step) + 1, dtype=np.float64)
    row, col = np.meshgrid(np.arange(rows, dtype=np.float64), nodes, indexing="ij")
    places = np.stack([row, col], axis=-1) @ matrix.T + offset
    own = np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), axis=-1)
    exact = own @ matrix.T + offset
    return RowMap(0, step, np.ascontiguousarray(places), 0.0), exact[..., 0], exact[..., 1]


def keys(image: FloatArray, line: float, sample: float) -> float:
    """Cubic convolution, a = -1/2, from its definition."""

    def weight(t: FloatArray) -> FloatArray:
        t = np.abs(t)
        near = 1.5 * t**3 - 2.5 * t**2 + 1.0
        far = -0.5 * t**3 + 2.5 * t**2 - 4.0 * t + 2.0
        return np.where(t <= 1, near, np.where(t < 2, far, 0.0))

    i, j = int(np.floor(line)), int(np.floor(sample))
    a, b = np.arange(i - 1, i + 3), np.arange(j - 1, j + 3)
    return float(weight(line - a) @ image[np.ix_(a, b)] @ weight(sample - b))


MAPS = {
    "shift": (np.eye(2), (3.3, 5.6)),
    "steady": (np.array([[1.0, 2e-3], [1e-4, 1.0 + 3e-4]]), (4.25, 4.5)),
    "turned": (np.array([[0.9, 0.2], [-0.15, 0.8]]), (12.2, 14.1)),
}


@pytest.mark.parametrize("name", MAPS)
def test_bilinear_and_cubic_are_their_definitions(name: str) -> None:
    image = np.random.default_rng(1).uniform(0.0, 1000.0, SHAPE).astype(np.float32)
    places, line, sample = affine_map(30, 60, *MAPS[name])
    found, valid = Resampler("bilinear").rows(image[None], places, 60)
    wanted = ndimage.map_coordinates(image.astype(np.float64), [line, sample], order=1)
    assert valid.all()
    assert found[0] == pytest.approx(wanted, abs=2e-3)
    cubic, valid = Resampler("cubic").rows(image[None], places, 60)
    assert valid.all()
    for row in range(0, 30, 7):
        for col in range(0, 60, 11):
            wanted_here = keys(image.astype(np.float64), line[row, col], sample[row, col])
            assert cubic[0, row, col] == pytest.approx(wanted_here, abs=5e-3)


@settings(max_examples=25)
@given(st.floats(-0.3, 0.3), st.floats(0.6, 1.4), st.floats(-20.0, 40.0), st.floats(-20.0, 40.0))
def test_places_one_by_one_give_what_rows_give(
    turn: float, stretch: float, down: float, right: float
) -> None:
    image = np.random.default_rng(2).integers(1, 4000, SHAPE).astype(np.uint16)
    image[20:24, 30:40] = 0
    matrix = stretch * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    places, line, sample = affine_map(25, 50, matrix, (down, right))
    for method in ("bilinear", "cubic"):
        resampler = Resampler(method, nodata=0.0)  # type: ignore[arg-type]
        rows, valid = resampler.rows(image[None], places, 50)
        ones, seen = resampler.at(image[None], line, sample)
        assert np.mean(valid != seen) < 0.01  # a place on an edge may fall to either side
        both = (valid != 0) & (seen != 0)
        assert np.abs(rows[0][both].astype(int) - ones[0][both].astype(int)).max(initial=0) <= 1


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "float32"])
def test_a_constant_stays_and_the_mean_does_not_drift(method: str, dtype: str) -> None:
    places, _, _ = affine_map(40, 60, *MAPS["steady"])
    constant = np.full((2, *SHAPE), 117, dtype=dtype)
    found, valid = Resampler(method).rows(constant, places, 60)  # type: ignore[arg-type]
    assert found.dtype == dtype
    assert valid.all()
    assert np.all(found == 117) if dtype != "float32" else found == pytest.approx(117, rel=1e-6)


@pytest.mark.parametrize("method", ["bilinear", "cubic"])
def test_linear_grey_values_stay_linear(method: str) -> None:
    line, sample = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in SHAPE), indexing="ij")
    image = (3.0 * line + 2.0 * sample + 10.0).astype(np.float32)
    places, at_line, at_sample = affine_map(30, 60, *MAPS["turned"])
    found, _ = Resampler(method).rows(image[None], places, 60)  # type: ignore[arg-type]
    assert found[0] == pytest.approx(3.0 * at_line + 2.0 * at_sample + 10.0, abs=1e-3)


def test_lanczos_follows_a_smooth_texture() -> None:
    line, sample = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in SHAPE), indexing="ij")

    def grey(y: FloatArray, x: FloatArray) -> FloatArray:
        return 100.0 + 50.0 * np.sin(2 * np.pi * y / 9.0) * np.cos(2 * np.pi * x / 11.0)

    places, at_line, at_sample = affine_map(40, 60, *MAPS["shift"])
    wanted = grey(at_line, at_sample)
    error = {
        method: np.abs(
            Resampler(method).rows(grey(line, sample).astype(np.float32)[None], places, 60)[0][0]  # type: ignore[arg-type]
            - wanted
        ).max()
        for method in ("bilinear", "cubic", "lanczos")
    }
    assert error["lanczos"] < error["cubic"] < error["bilinear"]
    assert error["lanczos"] < 0.6


@pytest.mark.parametrize("method", ["bilinear", "cubic", "lanczos"])
def test_missing_pixels_neither_enter_nor_spread(method: str) -> None:
    image = np.full((1, *SHAPE), 500, dtype=np.uint16)
    image[0, 30:40, 40:50] = 0
    places, line, sample = affine_map(60, 80, np.eye(2), (0.4, 0.4))
    found, valid = Resampler(method, nodata=0.0).rows(image, places, 80)  # type: ignore[arg-type]
    i, j = np.rint(line).astype(int), np.rint(sample).astype(int)
    missing = image[0, i, j] == 0
    assert np.array_equal(valid == 0, missing)
    assert np.all(found[0][~missing] == 500)
    assert np.all(found[0][missing] == 0)
    floats = image.astype(np.float32)
    floats[image == 0] = np.nan
    found, valid = Resampler(method).rows(floats, places, 80)  # type: ignore[arg-type]
    assert np.array_equal(valid == 0, missing)
    assert np.isnan(found[0][missing]).all()
    assert found[0][~missing] == pytest.approx(500.0, rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_half_a_pixel_around_the_image_is_seen_and_no_more(method: str) -> None:
    image = np.full((1, *SHAPE), 7, dtype=np.uint8)
    places, line, sample = affine_map(90, 110, np.eye(2), (-10.25, -10.25))
    found, valid = Resampler(method).rows(image, places, 110)  # type: ignore[arg-type]
    inside = (line >= -0.5) & (line <= SHAPE[0] - 0.5)
    inside &= (sample >= -0.5) & (sample <= SHAPE[1] - 0.5)
    assert np.array_equal(valid != 0, inside)
    assert np.all(found[0][inside] == 7)
    assert np.all(found[0][~inside] == 0)


def test_whole_numbers_stay_in_their_type_and_off_nodata() -> None:
    image = np.zeros((1, *SHAPE), dtype=np.uint8)
    image[0, :, np.arange(SHAPE[1]) // 4 % 2 == 0] = 255
    places, _, _ = affine_map(40, 60, np.eye(2), (5.5, 5.3))
    plain, _ = Resampler("cubic").rows(image, places, 60)
    # a kernel with negative weights leaves 0 .. 255 beside an edge: it must not wrap around
    assert {0, 255} <= set(np.unique(plain))
    assert np.all(np.abs(np.diff(plain[0].astype(int), axis=1)) < 255)
    image[0, :, ::2] = 1
    image[0, :, 1::2] = 200
    kept, valid = Resampler("cubic", nodata=0.0).rows(image, places, 60)
    assert valid.all()
    assert kept.min() >= 1


def test_windows_and_columns_count_from_where_they_begin() -> None:
    image = np.random.default_rng(3).uniform(0, 100, (1, *SHAPE)).astype(np.float32)
    places, _, _ = affine_map(30, 60, *MAPS["steady"])
    whole, _ = Resampler("cubic").rows(image, places, 60)
    window = np.ascontiguousarray(image[:, 2:60, 3:])
    part, valid = Resampler("cubic").rows(window, places, 20, (2, 3), first_col=25)
    assert valid.all()
    assert part[0] == pytest.approx(whole[0][:, 25:45], abs=1e-3)


def test_no_place_no_value() -> None:
    image = np.ones((1, *SHAPE), dtype=np.float32)
    places, _, _ = affine_map(4, 60, np.eye(2), (5.0, 5.0))
    places.places[2] = np.nan
    found, valid = Resampler("cubic").rows(image, places, 60)
    assert not valid[2].any()
    assert np.isnan(found[0, 2]).all()
    assert valid[[0, 1, 3]].all()


def test_what_cannot_be_resampled_is_refused() -> None:
    places, line, sample = affine_map(4, 60, np.eye(2), (5.0, 5.0))
    with pytest.raises(ArgumentError, match="resampling: one of"):
        Resampler("sharp")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="uint8"):
        Resampler().rows(np.ones((1, *SHAPE)), places, 60)
    with pytest.raises(ArgumentError, match="contiguous"):
        Resampler().at(np.ones((1, *SHAPE), np.uint8)[:, ::2], line, sample)
    with pytest.raises(ArgumentError, match="nodata"):
        Resampler(nodata=300.0).rows(np.ones((1, *SHAPE), np.uint8), places, 60)
