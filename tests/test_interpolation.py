"""Curves through samples: exact where theory says so, their rates, and no extrapolation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from geoposition.errors import ArgumentError, GeopositionError, SpanError
from geoposition.interpolation import (
    Curve,
    LagrangeCurve,
    PolynomialCurve,
    SplineCurve,
    within_span,
)

UNEVEN = np.array([0.0, 0.7, 1.1, 2.4, 3.0, 4.9, 5.0, 6.3, 7.7, 8.1, 9.6, 11.0])


def polynomial(degree: int, seed: int = 1) -> np.polynomial.Polynomial:
    return np.polynomial.Polynomial(np.random.default_rng(seed).normal(0, 1, degree + 1) / 5)


def columns(p: np.polynomial.Polynomial, t: np.ndarray) -> np.ndarray:
    return np.stack([p(t), 2 * p(t) - 1, np.ones_like(t)], axis=-1)


def smooth(t: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(t), np.cos(0.7 * t)], axis=-1)


def smooth_rate(t: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(t), -0.7 * np.sin(0.7 * t)], axis=-1)


MAKERS: dict[str, Callable[[np.ndarray], Curve]] = {
    "lagrange 8": lambda t: LagrangeCurve(t, smooth(t), 8),
    "lagrange 7": lambda t: LagrangeCurve(t, smooth(t), 7),
    "lagrange 2": lambda t: LagrangeCurve(t, smooth(t), 2),
    "spline": lambda t: SplineCurve.through(t, smooth(t)),
    "hermite": lambda t: SplineCurve.hermite(t, smooth(t), smooth_rate(t)),
    "polynomial": lambda t: PolynomialCurve.fit(t, smooth(t), 9),
}


@pytest.mark.parametrize("points", [2, 3, 4, 5, 6, 7, 8, 9, 12])
def test_lagrange_is_exact_for_polynomials(points: int) -> None:
    t = np.linspace(0, 11, 400)
    p = polynomial(points - 1)
    curve = LagrangeCurve(UNEVEN, columns(p, UNEVEN), points)
    scale = np.abs(columns(p, t)).max()
    assert np.abs(curve.value(t) - columns(p, t)).max() < 1e-11 * scale
    rate = np.stack([p.deriv()(t), 2 * p.deriv()(t), 0 * t], axis=-1)
    assert np.abs(curve.rate(t) - rate).max() < 1e-10 * scale
    # One degree more is not represented: the test above can fail.
    q = polynomial(points)
    other = LagrangeCurve(UNEVEN, columns(q, UNEVEN), points)
    if points < len(UNEVEN):
        assert np.abs(other.value(t) - columns(q, t)).max() > 1e-4


@pytest.mark.parametrize("points", [2, 3, 4, 5, 8])
def test_lagrange_stencil_is_the_nearest_samples(points: int) -> None:
    # A spike at one sample is felt only where it is among the `points` of the centred stencil.
    t = np.arange(20.0)
    values = np.zeros((20, 1))
    values[10] = 1.0
    at = np.linspace(0, 19, 1901)
    felt = np.abs(LagrangeCurve(t, values, points).value(at)[:, 0]) > 1e-12
    assert at[felt].min() == pytest.approx(10 - points / 2, abs=0.011)
    assert at[felt].max() == pytest.approx(10 + points / 2, abs=0.011)


def test_lagrange_with_fewer_samples_than_points() -> None:
    t = np.array([0.0, 1.0, 3.0])
    p = polynomial(2)
    curve = LagrangeCurve(t, columns(p, t), 8)
    assert curve.points == 3
    assert len(curve.knots_s) == 0
    assert np.allclose(curve.value([0.5, 2.0]), columns(p, np.array([0.5, 2.0])), atol=1e-13)


@pytest.mark.parametrize("points", [3, 4, 7, 8])
def test_lagrange_jumps_only_at_its_knots(points: int) -> None:
    rng = np.random.default_rng(2)
    curve = LagrangeCurve(UNEVEN, rng.normal(0, 1, (12, 2)), points)
    assert np.array_equal(
        curve.knots_s, UNEVEN if points % 2 == 0 else 0.5 * (UNEVEN[1:] + UNEVEN[:-1])
    )
    edges = np.union1d(curve.knots_s, UNEVEN[[0, -1]])
    for part in (0.01, 0.5, 0.99):
        t = edges[:-1] + part * np.diff(edges)
        jump = curve.rate(t + 1e-10) - curve.rate(t - 1e-10)
        assert np.abs(jump).max() < 1e-3
    inner = curve.knots_s[points // 2 + 1 : -points // 2 - 1]
    # Even: the neighbours' polynomials share the sample they meet at. Odd: they share none there.
    gap = np.abs(curve.value(inner + 1e-10) - curve.value(inner - 1e-10)).max(axis=1)
    turn = np.abs(curve.rate(inner + 1e-10) - curve.rate(inner - 1e-10)).max(axis=1)
    if points % 2 == 0:
        assert gap.max() < 1e-6
        assert turn.min() > 0.01
    else:
        assert gap.min() > 0.01


@pytest.mark.parametrize("name", MAKERS)
def test_rate_is_the_derivative(name: str) -> None:
    curve = MAKERS[name](UNEVEN)
    knots = np.union1d(curve.knots_s, UNEVEN[[0, -1]])
    t = (knots[:-1] + 0.37 * np.diff(knots))[:, None] + np.array([0.0])
    step = 1e-5
    differences = (curve.value(t + step) - curve.value(t - step)) / (2 * step)
    assert np.abs(curve.rate(t) - differences).max() < 1e-8


@pytest.mark.parametrize("name", [name for name in MAKERS if name != "polynomial"])
def test_passes_through_its_samples(name: str) -> None:
    curve = MAKERS[name](UNEVEN)
    assert np.abs(curve.value(UNEVEN) - smooth(UNEVEN)).max() < 1e-14


def test_cubics() -> None:
    t = np.linspace(0, 11, 300)
    p = polynomial(3)
    rates = np.stack([p.deriv()(UNEVEN), 2 * p.deriv()(UNEVEN), 0 * UNEVEN], axis=-1)
    for curve in (
        SplineCurve.through(UNEVEN, columns(p, UNEVEN)),
        SplineCurve.hermite(UNEVEN, columns(p, UNEVEN), rates),
    ):
        assert np.abs(curve.value(t) - columns(p, t)).max() < 1e-11
        assert np.abs(curve.rate(t)[:, 0] - p.deriv()(t)).max() < 1e-11
    assert np.allclose(
        SplineCurve.hermite(UNEVEN, smooth(UNEVEN), smooth_rate(UNEVEN)).rate(UNEVEN),
        smooth_rate(UNEVEN),
        atol=1e-13,
    )


def test_hermite_error_falls_with_the_fourth_power() -> None:
    errors = []
    for n in (20, 40):
        t = np.linspace(0, 6, n + 1)
        curve = SplineCurve.hermite(t, smooth(t), smooth_rate(t))
        at = np.linspace(0, 6, 999)
        errors.append(np.abs(curve.value(at) - smooth(at)).max())
    assert 14 < errors[0] / errors[1] < 18


@pytest.mark.parametrize("degree", [0, 1, 2, 5])
def test_polynomial_fit_recovers(degree: int) -> None:
    p = polynomial(degree)
    curve = PolynomialCurve.fit(UNEVEN + 1e5, columns(p, UNEVEN), degree)
    t = np.linspace(0, 11, 100)
    # Seconds of day leave 1.5e-11 s of the time.
    steepest = 2 * np.abs(p.deriv()(t)).max() + 1
    assert np.abs(curve.value(t + 1e5) - columns(p, t)).max() < 1e-11 * steepest
    rate = curve.rate(t + 1e5)
    assert rate.shape == (100, 3)
    assert np.abs(rate[:, 0] - p.deriv()(t)).max() < 1e-10 * steepest


def test_polynomial_offset_and_scale() -> None:
    curve = PolynomialCurve([[1.0, 0.0], [2.0, -1.0], [3.0, 0.5]], 10.0, 4.0, (5.0, 20.0))
    s = (12.0 - 10.0) / 4.0
    assert curve.value(12.0).tolist() == [1 + 2 * s + 3 * s * s, -s + 0.5 * s * s]
    assert curve.rate(12.0).tolist() == [(2 + 6 * s) / 4, (-1 + s) / 4]


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("bad", [-1e-6, 11.0 + 1e-6, -1e300, np.inf, -np.inf, np.nan])
def test_never_extrapolates(name: str, bad: float) -> None:
    curve = MAKERS[name](UNEVEN)
    assert curve.span_s == (0.0, 11.0)
    for ask in (curve.value, curve.rate):
        for times in (bad, [1.0, bad, 2.0], [[bad]]):
            with pytest.raises(SpanError, match=r"outside the span 0\.0+ \.\. 11\.0+ s") as caught:
                ask(times)
            assert caught.value.span == (0.0, 11.0)
            assert isinstance(caught.value, (GeopositionError, ValueError))


@pytest.mark.parametrize("name", MAKERS)
def test_rounding_at_the_ends_is_forgiven(name: str) -> None:
    curve = MAKERS[name](UNEVEN)
    assert np.array_equal(curve.value([-5e-10, 11 + 5e-10]), curve.value([0.0, 11.0]))


@pytest.mark.parametrize("name", MAKERS)
def test_shapes(name: str) -> None:
    curve = MAKERS[name](UNEVEN)
    for shape in ((), (0,), (5,), (2, 3), (2, 0)):
        assert curve.value(np.full(shape, 2.0)).shape == (*shape, 2)
        assert curve.rate(np.full(shape, 2.0)).shape == (*shape, 2)
    assert curve.value(2).shape == (2,)


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([0.0, 1.0, 1.0, 2.0], np.zeros((4, 2)), "increasing times expected, entry 2"),
        ([0.0, 2.0, 1.0, 3.0], np.zeros((4, 2)), "increasing times expected, entry 2"),
        ([0.0, np.nan, 1.0, 3.0], np.zeros((4, 2)), "finite numbers expected, entry 1"),
        ([0.0, 1.0, 2.0, np.inf], np.zeros((4, 2)), "finite numbers expected, entry 3"),
        ([0.0, 1.0, 2.0, 3.0], [[0], [1], [np.nan], [2]], "finite numbers expected, entry 2"),
        ([0.0, 1.0, 2.0, 3.0], np.zeros((3, 2)), "shape \\(4, k\\) expected"),
        ([0.0, 1.0, 2.0, 3.0], np.zeros(4), "shape \\(4, k\\) expected"),
        ([], np.zeros((0, 2)), "non-empty"),
        ([[0.0, 1.0]], np.zeros((1, 2)), "list of times"),
        (0.0, np.zeros((1, 2)), "list of times"),
        ([0.0], np.zeros((1, 2)), "at least"),
    ],
)
def test_unusable_samples_are_refused(times: object, values: object, message: str) -> None:
    for make in (
        lambda: LagrangeCurve(times, values),  # type: ignore[arg-type]
        lambda: SplineCurve.through(times, values),  # type: ignore[arg-type]
        lambda: SplineCurve.hermite(times, values, values),  # type: ignore[arg-type]
        lambda: PolynomialCurve.fit(times, values, 2),  # type: ignore[arg-type]
    ):
        with pytest.raises(ArgumentError, match=message):
            make()


def test_other_misuse_is_refused() -> None:
    with pytest.raises(ArgumentError, match="points"):
        LagrangeCurve(UNEVEN, smooth(UNEVEN), 1)
    with pytest.raises(ArgumentError, match="rates"):
        SplineCurve.hermite(UNEVEN, smooth(UNEVEN), smooth(UNEVEN)[:-1])
    with pytest.raises(ArgumentError, match="rates"):
        SplineCurve.hermite(UNEVEN, smooth(UNEVEN), np.full((12, 2), np.nan))
    with pytest.raises(ArgumentError, match="scale"):
        PolynomialCurve([[1.0]], 0.0, 0.0, (0.0, 1.0))
    with pytest.raises(ArgumentError, match="offset"):
        PolynomialCurve([[1.0]], np.nan, 1.0, (0.0, 1.0))
    with pytest.raises(ArgumentError, match="coefficients"):
        PolynomialCurve(np.zeros((0, 2)), 0.0, 1.0, (0.0, 1.0))
    with pytest.raises(ArgumentError, match="at least 4"):
        PolynomialCurve.fit(UNEVEN[:3], smooth(UNEVEN[:3]), 3)


@pytest.mark.parametrize("span", [(1.0, 0.0), (np.nan, 1.0), (0.0, np.nan)])
def test_a_polynomial_needs_a_span(span: tuple[float, float]) -> None:
    with pytest.raises(ArgumentError, match="span"):
        PolynomialCurve([[1.0]], 0.0, 1.0, span)


def test_samples_are_copied_and_frozen() -> None:
    t, v = UNEVEN.copy(), smooth(UNEVEN)
    curve = LagrangeCurve(t, v)
    v[:] = 99.0
    t[:] = 99.0
    assert np.abs(curve.value(UNEVEN) - smooth(UNEVEN)).max() < 1e-14
    with pytest.raises(ValueError):
        curve.values[0] = 1.0


@given(
    npst.arrays(np.float64, st.integers(4, 20), elements=st.floats(0.01, 10.0)),
    st.integers(2, 9),
    st.floats(0.0, 1.0),
    st.integers(0, 1000),
)
def test_lagrange_reproduces_cubics_on_any_times(
    steps: np.ndarray, points: int, part: float, seed: int
) -> None:
    t = np.cumsum(steps)
    p = polynomial(min(points, len(t)) - 1 if points < 4 else 3, seed)
    curve = LagrangeCurve(t, columns(p, t), points)
    at = t[0] + part * (t[-1] - t[0])
    scale = np.abs(columns(p, np.linspace(t[0], t[-1], 50))).max() + 1
    # Uneven samples amplify rounding by the ratio of their steps, to the stencil's power.
    worst = np.max(steps[1:]) / np.min(steps[1:])
    if worst < 5:
        assert np.abs(curve.value(at) - columns(p, at)).max() < 1e-9 * scale


def test_within_span() -> None:
    assert within_span([], (0.0, 1.0), "x").shape == (0,)
    assert within_span(0.5, (0.0, 1.0), "x").shape == ()
    with pytest.raises(SpanError, match=r"attitude: 2\.0"):
        within_span(2.0, (0.0, 1.0), "attitude")
