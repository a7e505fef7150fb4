"""Line timing, both ways, forward and reverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from scenes import EPOCH

from geoposition.errors import ArgumentError
from geoposition.sensors.timing import ConstantLineRate, LineTimeTable


@pytest.mark.parametrize("period_s", [1e-4, -1e-4, 7e-5, -0.3])
def test_constant_rate(period_s: float) -> None:
    timing = ConstantLineRate(EPOCH, 12.5, period_s)
    assert timing.time_s(0) == 12.5
    assert timing.time_s([[0, 10], [-3, 0.5]]).shape == (2, 2)
    assert timing.time_s(1000.0) == pytest.approx(12.5 + 1000 * period_s, abs=1e-12)
    lines = np.linspace(-500, 40_000, 999)
    assert np.abs(timing.line_at(timing.time_s(lines)) - lines).max() < 1e-7
    assert len(timing.knots_line) == 0
    assert timing.epoch is EPOCH


def test_table_is_linear_between_and_beyond() -> None:
    timing = LineTimeTable(EPOCH, [0.0, 100.0, 300.0], [1.0, 2.0, 6.0])
    assert timing.time_s([0, 50, 100, 200, 300]).tolist() == [1.0, 1.5, 2.0, 4.0, 6.0]
    assert timing.time_s([-100, 400]).tolist() == [0.0, 8.0]
    assert timing.line_at([0.0, 1.5, 4.0, 8.0]).tolist() == [-100.0, 50.0, 200.0, 400.0]
    assert timing.knots_line.tolist() == [100.0]
    assert timing.time_s(50).shape == ()


def test_reverse_table() -> None:
    timing = LineTimeTable(EPOCH, [0.0, 100.0, 300.0], [6.0, 5.0, 1.0])
    assert timing.time_s([-100, 0, 50, 200, 300, 400]).tolist() == [7.0, 6.0, 5.5, 3.0, 1.0, -1.0]
    assert timing.line_at([7.0, 6.0, 5.5, 3.0, 1.0, -1.0]).tolist() == [-100, 0, 50, 200, 300, 400]


@given(
    npst.arrays(np.float64, st.integers(2, 30), elements=st.floats(0.5, 2.0)),
    st.booleans(),
    st.floats(-1e5, 1e5),
)
def test_there_and_back(steps: np.ndarray, reverse: bool, start_s: float) -> None:
    times = start_s + np.cumsum(steps) * 1e-2 * (-1 if reverse else 1)
    timing = LineTimeTable(EPOCH, 100.0 * np.arange(len(steps)), times)
    lines = np.linspace(-250, 100.0 * len(steps) + 250, 77)
    assert np.abs(timing.line_at(timing.time_s(lines)) - lines).max() < 1e-5
    assert np.all(np.diff(timing.time_s(lines)) * (-1 if reverse else 1) > 0)


@pytest.mark.parametrize(
    ("lines", "times", "message"),
    [
        ([0, 1, 1], [0.0, 1.0, 2.0], "increasing lines"),
        ([0, 2, 1], [0.0, 1.0, 2.0], "increasing lines"),
        ([0, 1, 2], [0.0, 1.0, 1.0], "monotonic"),
        ([0, 1, 2], [0.0, 2.0, 1.0], "monotonic"),
        ([0, 1, 2], [0.0, np.nan, 1.0], "finite numbers expected, entry 1"),
        ([0, np.inf, 2], [0.0, 1.0, 2.0], "finite"),
        ([0, 1], [0.0, 1.0, 2.0], "pairs"),
        ([0], [0.0], "two or more"),
        ([], [], "two or more"),
        (0.0, 1.0, "two or more"),
        (np.nan, 1.0, "finite|two or more"),
        ([[0, 1]], [[0.0, 1.0]], "pairs"),
    ],
)
def test_unusable_tables(lines: object, times: object, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        LineTimeTable(EPOCH, lines, times)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("first", "period"), [(0.0, 0.0), (np.nan, 1.0), (0.0, np.nan), (np.inf, 1.0), (0.0, np.inf)]
)
def test_unusable_rates(first: float, period: float) -> None:
    with pytest.raises(ArgumentError):
        ConstantLineRate(EPOCH, first, period)


def test_tables_are_copied_and_frozen() -> None:
    lines, times = np.arange(3.0), np.arange(3.0)
    timing = LineTimeTable(EPOCH, lines, times)
    lines[:] = 7
    assert timing.time_s(1) == 1.0
    with pytest.raises(ValueError):
        timing.times_s[0] = 1.0
