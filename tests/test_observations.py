"""Tie and control points: what is accepted, and how observations are gathered by point."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoposition.errors import ArgumentError
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance


def ties(ids: list[str], product: list[int]) -> TiePoints:
    image = np.arange(2.0 * len(ids)).reshape(-1, 2)
    return TiePoints(np.array(ids), np.array(product), image)


def test_columns_cannot_be_written() -> None:
    points = ties(["a", "b"], [0, 0])
    for column in (points.ids, points.product, points.image_px):
        with pytest.raises(ValueError, match="read-only"):
            column[0] = column[1]


def test_point_given_twice_in_one_product_is_named() -> None:
    with pytest.raises(ArgumentError, match=r"point a is given twice for product 1 \(row 3\)"):
        ties(["a", "a", "b", "a"], [0, 1, 1, 1])


def test_unknown_product_is_named() -> None:
    points = ties(["a", "b"], [0, 2])
    points.require_products(3)
    with pytest.raises(ArgumentError, match=r"product 2 of point b is unknown, 0 \.\. 1"):
        points.require_products(2)
    with pytest.raises(ArgumentError, match="negative"):
        ties(["a"], [-1])


@pytest.mark.parametrize(
    ("ids", "product", "image"),
    [
        (["a"], [0, 1], [[0.0, 0.0], [1.0, 1.0]]),
        (["a", "b"], [0, 1], [[0.0, 0.0]]),
        (["a", "b"], [0.0, 1.0], [[0.0, 0.0], [1.0, 1.0]]),
        ([0.5, 1.5], [0, 1], [[0.0, 0.0], [1.0, 1.0]]),
        (["a", "b"], [0, 1], [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]),
    ],
)
def test_columns_that_do_not_go_together(ids: list, product: list, image: list) -> None:
    with pytest.raises(ArgumentError):
        TiePoints(np.array(ids), np.array(product), np.array(image))


@pytest.mark.parametrize(
    "covariance",
    [
        [[1.0, 0.0], [0.0, -1.0]],
        [[1.0, 2.0], [2.0, 1.0]],
        [[1.0, 0.5], [0.0, 1.0]],
        [[np.nan, 0.0], [0.0, 1.0]],
    ],
)
def test_covariance_that_is_none(covariance: list) -> None:
    with pytest.raises(ArgumentError, match="covariance"):
        TiePoints(np.array(["a"]), np.array([0]), np.zeros((1, 2)), np.array([covariance]))


def test_image_points_that_are_not_finite_are_kept_for_flagging() -> None:
    points = TiePoints(np.array(["a"]), np.array([0]), np.array([[np.nan, 1.0]]))
    assert np.isnan(points.image_px[0, 0])


def test_pair_shift_and_selection() -> None:
    points = TiePoints.of_pair([[1, 2], [3, 4]], [[5, 6], [7, 8]], ids=["p", "q"])
    np.testing.assert_array_equal(points.ids, ["p", "q", "p", "q"])
    moved = points.shifted(1, (0.5, -1.0))
    np.testing.assert_array_equal(moved.image_px, [[1, 2], [3, 4], [5.5, 5], [7.5, 7]])
    np.testing.assert_array_equal(points.of_product(1), [2, 3])
    np.testing.assert_array_equal(points.selected(points.product == 0).image_px, [[1, 2], [3, 4]])
    with pytest.raises(ArgumentError, match="as many points"):
        TiePoints.of_pair([[1, 2]], [[5, 6], [7, 8]])


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 4)), unique=True, max_size=40))
def test_grouping_gathers_each_point_once_in_order_of_appearance(pairs: list) -> None:
    ids = np.array([f"n{i}" for i, _ in pairs], dtype=np.str_)
    product = np.array([k for _, k in pairs], dtype=np.int64)
    points = TiePoints(ids, product, np.zeros((len(pairs), 2)))
    group = points.grouped()
    assert list(group.ids) == list(dict.fromkeys(ids))
    assert sorted(group.order) == list(range(len(pairs)))
    for i, name in enumerate(group.ids):
        rows = group.order[group.start[i] : group.start[i + 1]]
        assert set(ids[rows]) == {name}
        assert np.all(np.diff(product[rows]) > 0)


def test_control_points() -> None:
    place = np.array([[0.1, 0.7, 100.0], [0.1, 0.7001, 120.0]])
    covariance = diagonal_covariance((0.1, 0.2, 0.3), 2, 3)
    measured = TiePoints(np.array(["g2"]), np.array([0]), np.array([[3.0, 4.0]]))
    points = ControlPoints(np.array(["g1", "g2"]), place, covariance, measured)
    np.testing.assert_allclose(points.sigma_enu_m, [[0.1, 0.2, 0.3]] * 2, rtol=1e-15)
    with pytest.raises(ArgumentError, match="g1 is given twice"):
        ControlPoints(np.array(["g1", "g1"]), place, covariance)
    with pytest.raises(ArgumentError, match="finite"):
        ControlPoints(np.array(["g1", "g2"]), place * np.nan, covariance)
    with pytest.raises(ArgumentError, match="radians"):
        ControlPoints(np.array(["g1", "g2"]), np.degrees(place), covariance)
    strange = TiePoints(np.array(["g3"]), np.array([0]), np.array([[3.0, 4.0]]))
    with pytest.raises(ArgumentError, match="g3 is measured"):
        ControlPoints(np.array(["g1", "g2"]), place, covariance, strange)
