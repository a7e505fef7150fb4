"""Propagation against closed forms, each other and a stiff outside integrator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError
from geoposition.rotation import rotation_from_intrinsic_euler
from geoposition.sensors import kinematics

components = st.floats(-2.0, 2.0)
vectors = st.tuples(components, components, components).map(np.array)


def coning_rate(times_s: np.ndarray) -> np.ndarray:
    """Body rate of a spinning, nutating body: no fixed axis."""
    phase = 3.0 * np.asarray(times_s)
    return np.stack([0.4 * np.cos(phase), 0.4 * np.sin(phase), 0.1 + 0.0 * phase], axis=-1)


def coning_attitude(times_s: np.ndarray) -> Rotation:
    """Closed form: seen from a frame that turns with the rate, the rate stands still."""
    times = np.asarray(times_s, dtype=np.float64)[:, None]
    spin = np.array([0.0, 0.0, 3.0])
    steady = np.array([0.4, 0.0, 0.1]) + spin
    return Rotation.from_rotvec(steady * times) * Rotation.from_rotvec(-spin * times)


def angle_between(quat_xyzw: np.ndarray, truth: Rotation) -> float:
    return float(np.max((truth.inv() * Rotation.from_quat(quat_xyzw)).magnitude()))


def test_the_closed_form_truth_is_right() -> None:
    solution = solve_ivp(
        lambda t, q: kinematics.quat_rate_xyzw(q, coning_rate(np.array(t))),
        (0.0, 5.0),
        [0.0, 0.0, 0.0, 1.0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
    )
    assert angle_between(solution.y[:, -1], coning_attitude(np.array([5.0]))) < 1e-11


@given(vectors, vectors, vectors)
def test_products_agree_with_scipy(p: np.ndarray, q: np.ndarray, v: np.ndarray) -> None:
    left, right = kinematics.quat_from_rotvec_xyzw(p), kinematics.quat_from_rotvec_xyzw(q)
    product = Rotation.from_quat(kinematics.quat_product_xyzw(left, right))
    outside = Rotation.from_rotvec(p) * Rotation.from_rotvec(q)
    assert product.apply(v) == pytest.approx(outside.apply(v), abs=1e-13)


@given(vectors)
def test_rotation_vectors_go_to_quaternions_and_back(rotvec: np.ndarray) -> None:
    quat = kinematics.quat_from_rotvec_xyzw(rotvec)
    outside = Rotation.from_rotvec(rotvec).as_rotvec()
    assert kinematics.rotvec_from_quat_xyzw(-quat) == pytest.approx(outside, abs=1e-14)


def test_tiny_turns_keep_their_digits() -> None:
    tiny = np.array([1e-170, -2e-9, 3e-12])
    assert kinematics.quat_from_rotvec_xyzw(tiny)[:3] == pytest.approx(tiny / 2, rel=1e-15)
    back = kinematics.rotvec_from_quat_xyzw(kinematics.quat_from_rotvec_xyzw(tiny))
    assert back == pytest.approx(tiny, rel=1e-15)
    assert np.array_equal(kinematics.quat_from_rotvec_xyzw(np.zeros(3)), [0.0, 0.0, 0.0, 1.0])


@given(vectors, vectors, st.floats(0.0, 5.0))
def test_a_constant_rate_is_propagated_exactly(
    start: np.ndarray, rate: np.ndarray, step: float
) -> None:
    quat = kinematics.quat_from_rotvec_xyzw(start)
    end = kinematics.propagated(quat, rate, step)
    truth = Rotation.from_rotvec(start) * Rotation.from_rotvec(rate * step)
    assert angle_between(end, truth) < 1e-13
    many = kinematics.accumulated(quat, np.tile(rate * step / 50, (50, 1)))
    assert many.shape == (51, 4)
    assert angle_between(many[-1], truth) < 1e-12


def test_runge_kutta_is_of_fourth_order() -> None:
    errors = []
    for steps in (50, 100, 200):
        times = np.linspace(0.0, 2.0, steps + 1)
        quat = np.array([0.0, 0.0, 0.0, 1.0])
        h = times[1]
        for t in times[:-1]:
            rates = coning_rate(np.array([t, t + h / 2, t + h]))
            quat = kinematics.propagated_rk4(quat, *rates, h)
        errors.append(angle_between(quat[None], coning_attitude(times[-1:])))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(4.0, abs=0.2)


def test_magnus_integration_is_of_fourth_order_and_vectorised() -> None:
    times = np.linspace(0.0, 4.0, 41)
    truth = coning_attitude(times)
    errors = [
        angle_between(kinematics.attitude_of_rate(coning_rate, times, [0, 0, 0, 1], m), truth)
        for m in (1, 2, 4)
    ]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(4.0, abs=0.2)
    assert errors[-1] < 1e-7


def test_integrated_rate_of_a_closed_form() -> None:
    times = np.array([0.0, 0.3, 0.5, 1.2])
    phase = 3.0 * times
    exact = np.diff(
        np.stack([0.4 / 3 * np.sin(phase), -0.4 / 3 * np.cos(phase), 0.1 * times], axis=-1), axis=0
    )
    assert kinematics.integrated_rate_rad(coning_rate, times) == pytest.approx(exact, abs=1e-9)


def test_coning_correction_takes_out_the_drift_of_a_cone() -> None:
    times = np.linspace(0.0, 20.0, 2001)
    truth = coning_attitude(times)
    steps = kinematics.integrated_rate_rad(coning_rate, times)
    plain = angle_between(kinematics.accumulated([0, 0, 0, 1], steps)[-1:], truth[-1:])
    fixed = angle_between(
        kinematics.accumulated([0, 0, 0, 1], kinematics.coning_corrected(steps))[-1:], truth[-1:]
    )
    # drift of a plain cone: w^2 f h^2 / 12 per second
    assert plain == pytest.approx(0.4**2 * 3.0 * 0.01**2 / 12 * 20, rel=0.3)
    assert fixed < 2e-2 * plain
    exact = kinematics.accumulated([0, 0, 0, 1], kinematics.relative_rotvec_rad(truth.as_quat()))
    assert angle_between(exact, truth) < 1e-12


def test_runs_are_propagated_side_by_side() -> None:
    rng = np.random.default_rng(0)
    turns = 0.1 * rng.standard_normal((5, 30, 3))
    batch = kinematics.accumulated([0, 0, 0, 1], turns)
    assert batch.shape == (5, 31, 4)
    for run in range(5):
        assert np.array_equal(batch[run], kinematics.accumulated([0, 0, 0, 1], turns[run]))


def test_norms_stay_unit_over_many_steps() -> None:
    quats = kinematics.accumulated([0, 0, 0, 1], np.tile([1e-3, 2e-3, -1e-3], (200_000, 1)))
    assert np.max(np.abs(np.linalg.norm(quats, axis=1) - 1.0)) < 1e-14


def test_euler_kinematics_agree_with_the_quaternion() -> None:
    steps, end = 2000, 2.0
    times = np.linspace(0.0, end, steps + 1)
    angles = np.zeros((2, 3))
    angles[1] = [0.3, 0.2, -0.4]
    start = rotation_from_intrinsic_euler("3-1-2", angles)
    for t in times[:-1]:
        rates = coning_rate(np.array([t, t + 0.5 * times[1], t + times[1]]))
        angles = kinematics.propagated_euler_rk4("3-1-2", angles, *rates, times[1])
    found = rotation_from_intrinsic_euler("3-1-2", angles)
    truth = start * coning_attitude(times[-1:])
    assert np.max((truth.inv() * found).magnitude()) < 1e-10


def test_euler_angles_are_lost_only_at_the_middle_angle() -> None:
    rate = np.array([0.1, 0.2, 0.3])
    near = np.array([[0.0, np.pi / 2, 0.0], [0.0, 0.0, np.pi / 2], [np.pi / 2, 0.0, 0.0]])
    after = kinematics.propagated_euler_rk4("3-1-2", near, rate, rate, rate, 0.01)
    assert np.array_equal(np.isnan(after).any(axis=1), [True, False, False])


def test_misuse_is_refused() -> None:
    with pytest.raises(ArgumentError, match="series"):
        kinematics.accumulated([0, 0, 0, 1], np.zeros(3))
    with pytest.raises(ArgumentError, match="at least 2"):
        kinematics.coning_corrected(np.zeros((1, 3)))
    with pytest.raises(ArgumentError, match="at least 1"):
        kinematics.attitude_of_rate(coning_rate, [0.0, 1.0], [0, 0, 0, 1], 0)
