"""Attitude curves against closed forms, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import EPOCH
from scipy.spatial.transform import Rotation

from geoposition.attitude import (
    Attitude,
    EulerCurve,
    ProductCurve,
    QuaternionCurve,
    RotationSplineCurve,
    SlerpCurve,
    continuous_unit_quaternions,
)
from geoposition.errors import ArgumentError, SpanError
from geoposition.interpolation import LagrangeCurve, PolynomialCurve, SplineCurve
from geoposition.rotation import rotation_from_intrinsic_euler

TIMES = np.arange(0.0, 10.5, 0.5)
MAKERS = {
    "slerp": SlerpCurve.through,
    "spline": RotationSplineCurve.through,
    "lagrange": QuaternionCurve.lagrange,
}


def tumbling(t: np.ndarray) -> Rotation:
    angles = np.stack([0.3 + 0.1 * t, 0.2 * np.sin(0.4 * t), 0.15 * np.cos(0.3 * t)], axis=-1)
    return Rotation.from_euler("ZXY", angles)


def angle(a: Rotation, b: Rotation) -> float:
    return float(np.max((a.inv() * b).magnitude()))


def test_slerp_closed_form() -> None:
    # q(u) = (sin((1 - u) a) q0 + sin(u a) q1) / sin a, a half the turn between them.
    q0, q1 = (Rotation.random(rng=np.random.default_rng(i)).as_quat() for i in (1, 2))
    if q0 @ q1 < 0:
        q1 = -q1
    half = np.arccos(q0 @ q1)
    u = np.linspace(0, 1, 33)[:, None]
    expected = (np.sin((1 - u) * half) * q0 + np.sin(u * half) * q1) / np.sin(half)
    curve = SlerpCurve.through([10.0, 14.0], [q0, q1])
    assert angle(curve.rotation(10 + 4 * u[:, 0]), Rotation.from_quat(expected)) < 1e-15 * 30


def test_steady_rotation_is_exact() -> None:
    axis = np.array([1.0, 2.0, -0.5])
    quat = Rotation.from_rotvec(0.2 * TIMES[:, None] * axis).as_quat()
    at = np.linspace(0, 10, 301)
    truth = Rotation.from_rotvec(0.2 * at[:, None] * axis)
    for name in ("slerp", "spline"):
        assert angle(MAKERS[name](TIMES, quat).rotation(at), truth) < 1e-13


@pytest.mark.parametrize(
    ("name", "error_rad"), [("slerp", 5e-3), ("spline", 4e-5), ("lagrange", 1e-8)]
)
def test_accuracy_on_a_tumbling_body(name: str, error_rad: float) -> None:
    curve = MAKERS[name](TIMES, tumbling(TIMES).as_quat())
    at = np.linspace(2, 8, 301)
    assert angle(curve.rotation(at), tumbling(at)) < error_rad
    assert angle(curve.rotation(TIMES), tumbling(TIMES)) < 1e-14
    assert curve.span_s == (0.0, 10.0)


def test_spline_has_a_continuous_rate_and_slerp_a_constant_one() -> None:
    quat, step = tumbling(TIMES).as_quat(), 1e-4

    def rate(curve: object, t: np.ndarray) -> np.ndarray:
        a, b = curve.rotation(t - step), curve.rotation(t + step)  # type: ignore[attr-defined]
        return (a.inv() * b).as_rotvec() / (2 * step)

    slerp, spline = SlerpCurve.through(TIMES, quat), RotationSplineCurve.through(TIMES, quat)
    knots = TIMES[3:-3]
    jump = rate(spline, knots + 2 * step) - rate(spline, knots - 2 * step)
    assert np.abs(jump).max() < 1e-3
    assert np.abs(rate(slerp, knots + 0.1) - rate(slerp, knots + 0.4)).max() < 1e-9
    assert np.abs(rate(slerp, knots + 2 * step) - rate(slerp, knots - 2 * step)).max() > 1e-3


@settings(max_examples=30)
@given(st.lists(st.booleans(), min_size=21, max_size=21))
def test_sign_flips_are_harmless(flips: list[bool]) -> None:
    quat = tumbling(TIMES).as_quat()
    flipped = quat * np.where(flips, -1.0, 1.0)[:, None]
    at = np.linspace(0, 10, 57)
    for make in (*MAKERS.values(), lambda t, q: QuaternionCurve.polynomial_fit(t, q, 6)):
        assert angle(make(TIMES, flipped).rotation(at), make(TIMES, quat).rotation(at)) < 1e-13
    steps = np.diff(continuous_unit_quaternions(TIMES, flipped), axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 0.5


def test_norms_rounded_by_a_product_are_mended() -> None:
    quat = tumbling(TIMES).as_quat()
    at = np.linspace(0, 10, 57)
    # 4 decimals: 1e-4 rad, and no more.
    for make in MAKERS.values():
        assert (
            angle(make(TIMES, np.round(quat, 4)).rotation(at), make(TIMES, quat).rotation(at))
            < 4e-4
        )
    unit = continuous_unit_quaternions(TIMES, 1.0009 * quat)
    assert np.abs(np.linalg.norm(unit, axis=1) - 1).max() < 1e-15
    with pytest.raises(ValueError):
        unit[0] = 0.0


@pytest.mark.parametrize("name", MAKERS)
def test_unusable_samples_are_refused(name: str) -> None:
    make, quat = MAKERS[name], tumbling(TIMES).as_quat()
    bad = {
        "unit norm expected, entry 4": quat * np.where(np.arange(21) == 4, 1.002, 1.0)[:, None],
        "unit norm expected, entry 0 has 0": quat * np.where(np.arange(21) == 0, 0.0, 1.0)[:, None],
        "finite numbers expected, entry 7": np.where(np.arange(21)[:, None] == 7, np.nan, quat),
        "shape \\(21, 4\\)": quat[:, :3],
    }
    for message, values in bad.items():
        with pytest.raises(ArgumentError, match=message):
            make(TIMES, values)
    with pytest.raises(ArgumentError, match="shape"):
        make(TIMES, quat[:-1])
    for entry, times in ((5, np.where(np.arange(21) == 5, TIMES[4], TIMES)), (1, TIMES[::-1])):
        with pytest.raises(ArgumentError, match=f"attitude times: .* entry {entry}"):
            make(times, quat)
    with pytest.raises(ArgumentError, match="finite"):
        make(np.where(np.arange(21) == 5, np.nan, TIMES), quat)
    with pytest.raises(ArgumentError, match="at least 2"):
        make([0.0], quat[:1])
    with pytest.raises(ArgumentError, match="non-empty"):
        make([], np.empty((0, 4)))


@pytest.mark.parametrize("name", MAKERS)
def test_never_extrapolates(name: str) -> None:
    curve = MAKERS[name](TIMES, tumbling(TIMES).as_quat())
    for bad in (-1e-6, 10.0 + 1e-6, np.nan, np.inf):
        with pytest.raises(SpanError):
            curve.rotation(np.array([1.0, bad]))
    ends = curve.rotation(np.array([-5e-10, 10.0 + 5e-10]))
    assert angle(ends, tumbling(np.array([0.0, 10.0]))) < 1e-8


def test_euler_curve_is_3_1_2() -> None:
    # R = R3(yaw) R1(roll) R2(pitch), each about the axis as it is by then.
    angles = np.array([[0.3, -0.2, 0.5]])
    curve = EulerCurve(PolynomialCurve(angles, 0.0, 1.0, (0.0, 1.0)))
    z, x, y = (
        Rotation.from_rotvec(a * np.eye(3)[i]) for a, i in zip(angles[0], (2, 0, 1), strict=True)
    )
    assert angle(curve.rotation(np.array([0.5])), z * x * y) < 1e-15
    same = rotation_from_intrinsic_euler("3-1-2", angles)
    assert angle(curve.rotation(np.array([0.5])), same) < 1e-15
    assert len(curve.knots_s) == 0


@pytest.mark.parametrize("sequence", ["ZXY", "XYZ", "ZYX", "ZXZ"])
def test_euler_curve_follows_its_angles(sequence: str) -> None:
    angles = np.stack([0.1 * TIMES, 0.5 + 0.02 * TIMES**2, -0.05 * TIMES], axis=-1)
    at = np.linspace(0, 10, 77)
    expected = np.stack([0.1 * at, 0.5 + 0.02 * at**2, -0.05 * at], axis=-1)
    for curve in (LagrangeCurve(TIMES, angles, 4), SplineCurve.through(TIMES, angles)):
        euler = EulerCurve(curve, sequence)
        assert angle(euler.rotation(at), Rotation.from_euler(sequence, expected)) < 1e-13
        assert euler.span_s == (0.0, 10.0)
        with pytest.raises(SpanError):
            euler.rotation(np.array([10.1]))


def test_polynomial_quaternion_is_normalised() -> None:
    # Pleiades: four polynomials, whose value is not of unit norm.
    coefficients = np.array([[0.1, 0.2, 0.3, 0.9], [0.01, -0.02, 0.0, 0.0]])
    curve = QuaternionCurve(PolynomialCurve(coefficients, 5.0, 2.0, (0.0, 10.0)))
    value = coefficients[0] + coefficients[1] * (7.0 - 5.0) / 2.0
    truth = Rotation.from_quat(value / np.linalg.norm(value))
    assert angle(curve.rotation(np.array([7.0])), truth) < 1e-15


def test_polynomial_fit() -> None:
    truth = tumbling(TIMES)
    curve = QuaternionCurve.polynomial_fit(TIMES, truth.as_quat(), 9)
    assert angle(curve.rotation(TIMES), truth) < 1e-5
    with pytest.raises(ArgumentError, match="at least"):
        QuaternionCurve.polynomial_fit(TIMES[:4], truth.as_quat()[:4], 4)


def test_product() -> None:
    quat = tumbling(TIMES).as_quat()
    outer = SlerpCurve.through(TIMES, quat)
    inner = SlerpCurve.through(TIMES[2:] + 0.25, quat[2:])
    product = ProductCurve(outer, inner)
    assert product.span_s == (1.25, 10.0)
    assert product.knots_s[0] == 1.25
    assert product.knots_s[-1] == 10.0
    assert np.all(np.diff(product.knots_s) == 0.25)
    at = np.linspace(1.25, 10.0, 99)
    v = np.array([1.0, 2.0, 3.0])
    expected = outer.rotation(at).apply(inner.rotation(at).apply(v))
    assert np.abs(product.rotation(at).apply(v) - expected).max() < 1e-14
    with pytest.raises(SpanError):
        product.rotation(np.array([1.0]))


def test_attitude_from_samples() -> None:
    quat = tumbling(TIMES).as_quat()
    for kind, curve in (("slerp", SlerpCurve), ("spline", RotationSplineCurve)):
        attitude = Attitude.from_samples(EPOCH, TIMES, quat, "gcrs", kind)  # type: ignore[arg-type]
        assert isinstance(attitude.curve, curve)
        assert attitude.frame == "gcrs"
        assert attitude.span_s == (0.0, 10.0)
        assert len(attitude.rotation(2.0)) == 1
        assert len(attitude.rotation([2.0, 3.0])) == 2
    # Body to frame: the vector's body components go in.
    turned = attitude.rotation(0.0).apply([1.0, 0.0, 0.0])[0]
    assert np.allclose(turned, tumbling(np.zeros(1)).as_matrix()[0][:, 0])


def test_an_unknown_interpolation_is_refused() -> None:
    with pytest.raises(ArgumentError, match="interpolation"):
        Attitude.from_samples(EPOCH, TIMES, tumbling(TIMES).as_quat(), interpolation="cubic")  # type: ignore[arg-type]
