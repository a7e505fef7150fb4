"""Sample to direction: closed forms of all kinds, parameters, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from geoposition.errors import ArgumentError
from geoposition.sensors.directions import (
    CollinearDirections,
    Directions,
    PolynomialDirections,
    SplineDirections,
    TableDirections,
)

NODES = np.array([0.0, 100.0, 250.0, 400.0, 600.0])
TABLE = np.stack([1e-4 * np.cos(NODES / 300), np.linspace(-0.01, 0.011, 5)], axis=-1)
SIMPLE = CollinearDirections(8800.0, (0.5, -40.0), (0.0, 0.008))
FULL = CollinearDirections(8800.0, (0.5, -40.0), (1e-4, 0.008), 1e-3, (0.2, -0.1), (0.5, -3.0))

ALL: dict[str, Directions] = {
    "polynomial": PolynomialDirections([0.1, 0.01], [0.0, 0.02, 1e-4], 300.0, 300.0),
    "angles": PolynomialDirections([0.1], [0.0, 0.02, 0, 1e-4], 300.0, 300.0, angles=True),
    "table": TableDirections(NODES, TABLE),
    "spline": SplineDirections(NODES, TABLE),
    "collinear": FULL,
}


def test_polynomials() -> None:
    s = np.array([-5.0, 0.0, 17.0])
    u = (s - 3.0) / 2.0
    tangents = PolynomialDirections([1.0, 2.0], [0.0, 0.0, 0.5], 3.0, 2.0).tangents(s)
    assert np.allclose(tangents, np.stack([1 + 2 * u, 0.5 * u * u], axis=-1), rtol=1e-15)
    # P 9-10: the polynomials of degree 3 give angles, whose tangents are the direction.
    angles = PolynomialDirections([0.1, 1e-3, 0, 1e-5], [0.2], 3.0, 2.0, angles=True).tangents(s)
    expected = np.tan(np.stack([0.1 + 1e-3 * u + 1e-5 * u**3, np.full(3, 0.2)], axis=-1))
    assert np.allclose(angles, expected, rtol=1e-15)


def test_table_is_linear_between_and_beyond() -> None:
    table = ALL["table"]
    assert np.array_equal(table.tangents(NODES), TABLE)
    assert np.allclose(table.tangents(50.0), 0.5 * (TABLE[0] + TABLE[1]), rtol=1e-14)
    assert np.allclose(table.tangents(-100.0), 2 * TABLE[0] - TABLE[1], rtol=1e-13)
    assert np.allclose(table.tangents(800.0), 2 * TABLE[-1] - TABLE[-2], rtol=1e-13)
    assert table.knots_sample.tolist() == [100.0, 250.0, 400.0]


def test_spline_is_smooth_through_its_nodes() -> None:
    spline = ALL["spline"]
    assert np.abs(spline.tangents(NODES) - TABLE).max() < 1e-17
    inner = NODES[1:-1]
    slopes = [
        (spline.tangents(inner + side * 1e-3) - spline.tangents(inner)) / (side * 1e-3)
        for side in (-1, 1)
    ]
    assert np.abs(slopes[0] - slopes[1]).max() < 1e-9
    cubic = np.stack([1e-9 * NODES**3, 1e-5 * NODES], axis=-1)
    at = np.linspace(0, 600, 99)
    expected = np.stack([1e-9 * at**3, 1e-5 * at], axis=-1)
    assert np.abs(SplineDirections(NODES, cubic).tangents(at) - expected).max() < 1e-13


def test_collinear_without_distortion() -> None:
    # T 2.1-2.2: the pixel's place in the focal plane over the focal length.
    s = np.array([0.0, 5000.0, 10000.0])
    expected = np.stack([np.full(3, 0.5), -40.0 + 0.008 * s], axis=-1) / 8800.0
    assert np.allclose(SIMPLE.tangents(s), expected, rtol=1e-15)


def test_collinear_rotation_and_principal_point() -> None:
    angle, s = 1e-3, 700.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    place = np.array([0.5, -40.0]) + turn @ np.array([1e-4, 0.008]) * s - [0.2, -0.1]
    plane = place / 8800.0
    r2 = plane @ plane
    expected = plane * (1 - (0.5 * r2 - 3.0 * r2**2))
    assert np.allclose(FULL.tangents(s), expected, rtol=1e-14)


@pytest.mark.parametrize("name", ALL)
def test_shapes_and_smooth_continuation(name: str) -> None:
    for shape in ((), (0,), (7,), (2, 3)):
        assert ALL[name].tangents(np.full(shape, 5.0)).shape == (*shape, 2)
    assert np.all(np.isfinite(ALL[name].tangents([-150.0, 750.0])))
    assert np.all(np.diff(ALL[name].knots_sample) > 0)


@pytest.mark.parametrize("name", ALL)
def test_parameters(name: str) -> None:
    directions = ALL[name]
    same = directions.with_parameters(dict(directions.parameters))
    s = np.linspace(0, 600, 50)
    assert np.array_equal(same.tangents(s), directions.tangents(s))
    for parameter, value in directions.parameters.items():
        step = 1e-6 * max(abs(value), 1.0)
        moved = directions.with_parameters({parameter: value + step})
        assert type(moved) is type(directions)
        change = np.abs(moved.tangents(s) - directions.tangents(s)).max()
        assert 0 < change < 1e-5
    with pytest.raises(ArgumentError, match="nonsense"):
        directions.with_parameters({"nonsense": 1.0})
    with pytest.raises(ArgumentError, match="finite"):
        directions.with_parameters({next(iter(directions.parameters)): np.nan})


@pytest.mark.parametrize("name", ["table", "spline"])
def test_shifts_of_tables(name: str) -> None:
    moved = ALL[name].with_parameters({"dx": 1e-5, "dy": -2e-5})
    s = np.linspace(-20, 620, 50)
    assert np.abs(moved.tangents(s) - ALL[name].tangents(s) - [1e-5, -2e-5]).max() < 1e-15


def test_collinear_parameters_by_finite_geometry() -> None:
    s = np.array([0.0, 9000.0])
    longer = SIMPLE.with_parameters({"focal_length": 8801.0})
    assert np.allclose(longer.tangents(s) * 8801.0, SIMPLE.tangents(s) * 8800.0, rtol=1e-15)
    moved = SIMPLE.with_parameters({"principal_point_y": 0.008})
    assert np.allclose(moved.tangents(s), SIMPLE.tangents(s - 1.0), rtol=1e-12)
    assert FULL.parameters["k2"] == -3.0
    assert "k1" not in SIMPLE.parameters


@pytest.mark.parametrize(
    ("samples", "table"),
    [
        ([0.0, 1.0, 1.0], np.zeros((3, 2))),
        ([0.0, 2.0, 1.0], np.zeros((3, 2))),
        ([0.0, np.nan, 1.0], np.zeros((3, 2))),
        ([0.0, 1.0, 2.0], np.full((3, 2), np.inf)),
        ([0.0, 1.0, 2.0], np.full((3, 2), 45.0)),
        ([0.0, 1.0, 2.0], np.zeros((2, 2))),
        ([0.0, 1.0, 2.0], np.zeros((3, 3))),
        ([0.0], np.zeros((1, 2))),
        ([], np.zeros((0, 2))),
        (0.0, np.zeros((1, 2))),
    ],
)
def test_unusable_tables(samples: object, table: np.ndarray) -> None:
    for kind in (TableDirections, SplineDirections):
        with pytest.raises(ArgumentError, match="look-angle"):
            kind(samples, table)  # type: ignore[arg-type]


def test_other_misuse() -> None:
    with pytest.raises(ArgumentError, match="at least 4"):
        SplineDirections(NODES[:3], TABLE[:3])
    for bad in ([], [np.nan], [[1.0]], 3.0):
        with pytest.raises(ArgumentError, match="x_coefficients"):
            PolynomialDirections(bad, [0.0])  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="scale"):
        PolynomialDirections([0.0], [0.0], 0.0, 0.0)
    with pytest.raises(ArgumentError, match="offset"):
        PolynomialDirections([0.0], [0.0], np.nan)
    for change in (
        {"focal_length": 0.0},
        {"focal_length": -1.0},
        {"focal_length": np.nan},
        {"pitch": (0.0, 0.0)},
        {"pitch": [0.0, 0.0]},
        {"radial": (np.inf,)},
    ):
        with pytest.raises(ArgumentError, match="collinear camera"):
            CollinearDirections(
                **(
                    {"focal_length": 1.0, "detector_origin": (0.0, 0.0), "pitch": (0.0, 1.0)}
                    | change
                )
            )  # type: ignore[arg-type]
