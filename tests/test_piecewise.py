"""Tabulated cubics: the promised error holds everywhere, and hopeless curves are refused fast."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geoposition.errors import ConvergenceError
from geoposition.pushbroom.piecewise import PiecewiseCubic, merge_knots, tabulate


def look_up(table: PiecewiseCubic, x: np.ndarray) -> np.ndarray:
    k = np.clip(np.searchsorted(table.knots, x, side="right") - 1, 0, len(table.coefficients) - 1)
    s = (x - table.knots[k]) / (table.knots[k + 1] - table.knots[k])
    powers = s[:, None] ** np.arange(4)
    return np.einsum("nj,njk->nk", powers, table.coefficients[k])


def waves(x: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(x), 100 * np.cos(0.3 * x), np.exp(-((x - 3) ** 2))], axis=-1)


def bent(x: np.ndarray) -> np.ndarray:
    return np.stack([np.abs(x - 2.0) + np.sin(3 * x), np.maximum(x - 7.5, 0.0) ** 2], axis=-1)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9, 1e-12])
def test_error_bound_off_the_nodes(tolerance: float) -> None:
    # It is checked at three points of each segment; between them the quartic that is left can
    # be larger by a factor that stays below 1.3.
    limits = np.array([tolerance, 100 * tolerance, tolerance])
    table = tabulate(waves, np.array([0.0, 10.0]), limits)
    x = np.random.default_rng(1).uniform(0, 10, 50_000)
    assert np.all(np.abs(look_up(table, x) - waves(x)).max(axis=0) < 1.3 * limits)
    assert np.all(np.diff(table.knots) > 0)
    assert table.knots[0] == 0.0
    assert table.knots[-1] == 10.0
    # A cubic's error falls with the fourth power: no more segments than needed by far.
    assert len(table.coefficients) < 6 * 10 * (0.03 / tolerance) ** 0.25 + 8


def test_cubics_need_one_segment() -> None:
    def cubic(x: np.ndarray) -> np.ndarray:
        return np.stack([1 + x - 2 * x**2 + 0.1 * x**3], axis=-1)

    table = tabulate(cubic, np.array([-3.0, 8.0]), np.array([1e-12]))
    assert len(table.coefficients) == 1
    x = np.linspace(-3, 8, 999)
    assert np.abs(look_up(table, x) - cubic(x)).max() < 1e-12


def test_kinks_on_knots_are_followed() -> None:
    table = tabulate(bent, np.array([0.0, 2.0, 7.5, 10.0]), np.full(2, 1e-10))
    x = np.linspace(0, 10, 20_001)
    assert np.abs(look_up(table, x) - bent(x)).max() < 1.3e-10
    assert {2.0, 7.5} <= set(table.knots)


def test_segments_meet() -> None:
    table = tabulate(waves, np.array([0.0, 4.0, 10.0]), np.full(3, 1e-8))
    ends = table.coefficients.sum(axis=1)[:-1]
    assert np.abs(ends - table.coefficients[1:, 0]).max() < 1e-13 * 100


def test_a_kink_off_a_knot_is_refused() -> None:
    with pytest.raises(ConvergenceError, match="off a knot"):
        tabulate(lambda x: np.abs(x - 1 / 3)[..., None], np.array([0.0, 10.0]), np.array([1e-12]))


def test_a_jump_is_refused() -> None:
    with pytest.raises(ConvergenceError):
        tabulate(lambda x: (x > 1 / 3)[..., None] * 1.0, np.array([0.0, 1.0]), np.array([1e-6]))


def test_noise_is_refused_before_it_fills_the_memory() -> None:
    # Halved to the end it would need 2^24 segments for each of the 100: 1 TB.
    rng = np.random.default_rng(2)
    start = time.perf_counter()
    with pytest.raises(ConvergenceError):
        tabulate(
            lambda x: np.sin(x)[..., None] + rng.normal(0, 1e-5, (*x.shape, 1)),
            np.linspace(0, 100, 101),
            np.array([1e-6]),
        )
    assert time.perf_counter() - start < 20.0


def test_nan_is_refused() -> None:
    with pytest.raises(ConvergenceError):
        tabulate(lambda x: np.full((*x.shape, 1), np.nan), np.array([0.0, 1.0]), np.array([1.0]))


@settings(max_examples=40)
@given(
    st.lists(st.floats(-50, 50), min_size=2, max_size=40, unique=True),
    st.floats(1e-12, 1e-2),
)
def test_bins_lead_to_the_segment(knots: list[float], tolerance: float) -> None:
    edges = np.sort(np.array(knots))
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-3])]
    if len(edges) < 2:
        return
    table = tabulate(lambda x: np.sin(x)[..., None], edges, np.array([tolerance]))
    x = np.linspace(edges[0], edges[-1], 500)
    cell = ((x - table.bin_origin) * table.bin_scale).astype(int)
    start = table.bins[np.clip(cell, 0, len(table.bins) - 1)]
    right = np.clip(
        np.searchsorted(table.knots, x, side="right") - 1, 0, len(table.coefficients) - 1
    )
    # The segment at the cell's lower end, but for rounding: the search goes a little either way.
    assert np.all(start <= right + 1)
    assert start.min() >= 0
    assert start.max() < len(table.coefficients)
    if len(table.coefficients) > 1:
        even = np.ptp(np.diff(table.knots)) < 1e-9
        assert not even or np.all(right - start <= 1)


def test_merge_knots() -> None:
    some = np.array([3.0, 1.0, 1.0 + 1e-9, 1.0, -5.0, 9.0, 0.0, 2.0, 5.0])
    assert merge_knots(some, 0.0, 5.0, 1e-6).tolist() == [0.0, 1.0, 2.0, 3.0, 5.0]
    assert merge_knots(np.array([1e-9, 5 - 1e-9, 2.0]), 0.0, 5.0, 1e-6).tolist() == [0.0, 2.0, 5.0]
    assert merge_knots(np.empty(0), -1.0, 1.0, 1e-6).tolist() == [-1.0, 1.0]
    crowd = merge_knots(np.linspace(0, 1, 100_001), 0.0, 1.0, 1e-3)
    assert np.diff(crowd).min() > 0.999e-3
    assert np.diff(crowd).max() < 2.1e-3


def test_merge_knots_of_a_long_strip_is_quick() -> None:
    start = time.perf_counter()
    assert len(merge_knots(np.arange(1_000_000.0), -0.5, 1e6, 1e-6)) == 1_000_002
    assert time.perf_counter() - start < 20.0
