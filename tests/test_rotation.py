"""Quaternion order and sign, Euler sequences, nearest rotations, compiled helpers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError
from geoposition.rotation import (
    continuous_quat,
    euler_rates,
    extrinsic_euler_from_rotation,
    intrinsic_euler_from_rotation,
    nearest_rotation,
    quat_multiply,
    quat_wxyz_from_xyzw,
    quat_xyzw_from_wxyz,
    rotate,
    rotation_difference_rad,
    rotation_from_extrinsic_euler,
    rotation_from_intrinsic_euler,
    skew,
)

SEQUENCES = ["3-1-2", "321", "1-2-3", "ZXZ", "3-1-3", "yzx"]
angle = st.floats(-3.1, 3.1)


def turn(axis: int, a: float) -> np.ndarray:
    """Elementary turn of a vector, by hand: right-handed about axis 1, 2 or 3."""
    c, s = np.cos(a), np.sin(a)
    i, j = {1: (1, 2), 2: (2, 0), 3: (0, 1)}[axis]
    m = np.eye(3)
    m[i, i] = m[j, j] = c
    m[i, j], m[j, i] = -s, s
    return m


def test_quaternion_orders() -> None:
    quat_wxyz = np.arange(8.0).reshape(2, 4)
    assert quat_xyzw_from_wxyz(quat_wxyz).tolist() == [[1, 2, 3, 0], [5, 6, 7, 4]]
    assert np.array_equal(quat_wxyz_from_xyzw(quat_xyzw_from_wxyz(quat_wxyz)), quat_wxyz)
    with pytest.raises(ArgumentError):
        quat_xyzw_from_wxyz([1.0, 2.0, 3.0])


def test_signs_follow_on() -> None:
    rng = np.random.default_rng(2)
    smooth = Rotation.from_rotvec(np.linspace(0, 9, 200)[:, None] * [0.2, -0.6, 0.5])
    quat = smooth.as_quat() * rng.choice([-1.0, 1.0], 200)[:, None]
    followed = continuous_quat(quat)
    assert np.all(np.sum(followed[1:] * followed[:-1], axis=-1) > 0.99)
    assert np.array_equal(followed[0], quat[0])
    assert np.array_equal(np.abs(followed), np.abs(quat))
    with pytest.raises(ArgumentError):
        continuous_quat(np.ones(4))


def test_3_1_2_is_the_textbook_matrix() -> None:
    yaw, roll, pitch = 0.3, -0.7, 1.1
    found = rotation_from_intrinsic_euler("3-1-2", [yaw, roll, pitch]).as_matrix()
    assert np.allclose(found, turn(3, yaw) @ turn(1, roll) @ turn(2, pitch), atol=1e-15)
    # T (2.15) is reference to body; its second row is (−cos sin, cos cos, sin).
    row = [-np.cos(roll) * np.sin(yaw), np.cos(roll) * np.cos(yaw), np.sin(roll)]
    assert np.allclose(found.T[1], row, atol=1e-15)
    extrinsic = rotation_from_extrinsic_euler("3-1-2", [yaw, roll, pitch]).as_matrix()
    assert np.allclose(extrinsic, turn(2, pitch) @ turn(1, roll) @ turn(3, yaw), atol=1e-15)


@given(st.sampled_from(SEQUENCES), angle, angle, angle)
@example("ZXZ", 0.3, -6e-8, 0.0)
def test_euler_round_trip(sequence: str, a: float, b: float, c: float) -> None:
    for forward, back in (
        (rotation_from_intrinsic_euler, intrinsic_euler_from_rotation),
        (rotation_from_extrinsic_euler, extrinsic_euler_from_rotation),
    ):
        rotation = forward(sequence, [a, b, c])
        found = back(sequence, rotation)
        again = forward(sequence, found.angles_rad)
        # Two tilts of at most 1e-7 rad, about any two axes, are at most twice that apart.
        assert np.linalg.norm((again.inv() * rotation).as_rotvec()) < 2.01e-7
        if not found.singular:
            assert np.abs((again.inv() * rotation).as_rotvec()).max() < 2e-9


@pytest.mark.parametrize(
    ("sequence", "middle"), [("3-1-2", np.pi / 2), ("3-2-1", -np.pi / 2), ("3-1-3", 0.0)]
)
def test_the_middle_angle_is_the_singular_one(sequence: str, middle: float) -> None:
    angles = np.array([[0.4, middle, 0.0], [0.4, middle + 1e-3, 0.2], [middle, 0.7, middle]])
    found = intrinsic_euler_from_rotation(sequence, rotation_from_intrinsic_euler(sequence, angles))
    assert found.singular.tolist() == [True, False, False]
    assert found.angles_rad[0] == pytest.approx([0.4, middle, 0.0], abs=1e-7)
    rates = euler_rates(sequence, angles, np.ones((3, 3)))
    assert np.isnan(rates[0]).all()
    assert np.isfinite(rates[1:]).all()


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_rates_are_the_derivatives(sequence: str) -> None:
    angles = np.array([0.3, 0.8, -1.2])
    body_rate = np.array([0.02, -0.05, 0.03])
    rates = euler_rates(sequence, angles, body_rate)
    step = 1e-4
    start = rotation_from_intrinsic_euler(sequence, angles)
    found = [
        intrinsic_euler_from_rotation(
            sequence, start * Rotation.from_rotvec(body_rate * s)
        ).angles_rad
        for s in (-step, step)
    ]
    assert rates == pytest.approx((found[1] - found[0]) / (2 * step), abs=1e-8)


@pytest.mark.parametrize("sequence", ["", "3-3-1", "3-1", "4-1-2", "zxyz"])
def test_odd_sequences_are_refused(sequence: str) -> None:
    with pytest.raises(ArgumentError):
        rotation_from_intrinsic_euler(sequence, [0.0, 0.0, 0.0])


def test_nearest_rotation_reports_how_far() -> None:
    rng = np.random.default_rng(4)
    true = Rotation.from_rotvec(rng.normal(size=(5, 3)))
    found = nearest_rotation(true.as_matrix() * 1.001)
    assert np.abs((found.rotation.inv() * true).as_rotvec()).max() < 1e-14
    assert found.error == pytest.approx(np.full(5, 0.001 * np.sqrt(3)), rel=1e-9)
    assert nearest_rotation(np.eye(3)).error.shape == ()
    for bad in (np.diag([1.0, 1.0, -1.0]), np.zeros((3, 3)), np.full((3, 3), np.nan), np.eye(2)):
        with pytest.raises(ArgumentError):
            nearest_rotation(bad)


def test_nearest_rotation_is_nearest() -> None:
    rng = np.random.default_rng(5)
    matrix = np.eye(3) + 0.1 * rng.normal(size=(3, 3))
    found = nearest_rotation(matrix)
    others = found.rotation * Rotation.from_rotvec(rng.normal(scale=1e-2, size=(200, 3)))
    distances = np.linalg.norm(others.as_matrix() - matrix, axis=(-2, -1))
    assert np.all(distances > found.error)


def test_small_differences_are_about_the_body_axes() -> None:
    reference = Rotation.from_rotvec([0.3, 1.2, -0.4])
    small = np.array([2e-6, -1e-6, 3e-6])
    changed = reference * Rotation.from_rotvec(small)
    assert rotation_difference_rad(changed, reference) == pytest.approx(small, abs=1e-15)


def test_skew_is_the_cross_product() -> None:
    rng = np.random.default_rng(6)
    a, b = rng.normal(size=(2, 7, 3))
    assert np.allclose((skew(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-15)


def test_compiled_helpers_are_scipys() -> None:
    rng = np.random.default_rng(7)
    p, q = Rotation.random(20, rng=rng), Rotation.random(20, rng=rng)
    v = rng.normal(size=(20, 3))
    for i in range(20):
        product = quat_multiply(*p[i].as_quat(), *q[i].as_quat())
        expected = (p[i] * q[i]).as_quat()
        assert np.abs(np.dot(product, expected)) == pytest.approx(1.0, abs=1e-14)
        assert rotate(*p[i].as_quat(), *v[i]) == pytest.approx(p[i].apply(v[i]), abs=1e-14)
        turned = rotate(*product, *v[i])
        assert turned == pytest.approx((p[i] * q[i]).apply(v[i]), abs=1e-14)
