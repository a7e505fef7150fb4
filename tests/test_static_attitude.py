"""Five methods, one attitude; its covariance is what Monte Carlo finds; bad epochs survive."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.sensors.attitude_determination.static import methods as static

OPTIMAL = (static.davenport_q, static.svd, static.quest, static.foam)
ALL = (*OPTIMAL, static.triad)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def scene(
    rng: np.random.Generator,
    truth: Rotation,
    m: int,
    sigma: np.ndarray | float,
    half_field: float = np.pi,
) -> tuple[np.ndarray, np.ndarray]:
    """Directions within a cone about the body's z, with noise across them."""
    n = len(truth)
    z = 1.0 - rng.uniform(0.0, 1.0 - np.cos(half_field), (n, m))
    angle = rng.uniform(0.0, 2.0 * np.pi, (n, m))
    across = np.sqrt(1.0 - z**2)
    true = np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=-1)
    reference = np.einsum("nij,nmj->nmi", truth.as_matrix(), true)
    noise = np.asarray(sigma)[..., None] * rng.standard_normal((n, m, 3))
    noise -= np.sum(noise * true, axis=-1, keepdims=True) * true
    return unit(true + noise), reference


def angles(found: static.StaticAttitude, truth: Rotation) -> np.ndarray:
    return np.asarray((found.R_reference_body.inv() * truth).as_rotvec())


@pytest.mark.parametrize("method", ALL)
def test_exact_vectors_give_the_exact_attitude(method) -> None:
    truth = Rotation.random(200, rng=np.random.default_rng(1))
    body, reference = scene(np.random.default_rng(2), truth, 5, 0.0)
    found = method(body, reference, 1e-5)
    assert np.abs(angles(found, truth)).max() < 1e-10
    assert np.all(found.vectors == (2 if method is static.triad else 5))
    assert found.loss.max() < 1e-8


@pytest.mark.parametrize("method", OPTIMAL)
def test_optimal_methods_agree_with_scipy(method) -> None:
    rng = np.random.default_rng(3)
    truth = Rotation.random(100, rng=rng)
    sigma = rng.uniform(1e-5, 1e-2, (100, 6))
    body, reference = scene(rng, truth, 6, sigma)
    found = method(body, reference, sigma)
    for k in range(100):
        outside, _ = Rotation.align_vectors(reference[k], body[k], weights=sigma[k] ** -2.0)
        assert (outside.inv() * Rotation.from_quat(found.quat_xyzw[k])).magnitude() < 1e-9


@pytest.mark.parametrize("method", OPTIMAL)
def test_a_narrow_field_costs_few_digits(method) -> None:
    truth = Rotation.random(200, rng=np.random.default_rng(4))
    body, reference = scene(np.random.default_rng(5), truth, 8, 2e-5, np.radians(5.0))
    best = static.svd(body, reference, 2e-5)
    found = method(body, reference, 2e-5)
    apart = (best.R_reference_body.inv() * found.R_reference_body).magnitude()
    assert apart.max() < 1e-7  # 0.5 % of the noise about the most uncertain axis


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("axis", ["x", "y", "z", "diagonal"])
@pytest.mark.parametrize("off_rad", [0.0, 1e-9, 1e-6, -1e-3])
def test_half_turns_are_no_singularity(method, axis: str, off_rad: float) -> None:
    directions = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1], "diagonal": [1, -1, 1]}
    turn = unit(np.array(directions[axis], dtype=float)) * (np.pi + off_rad)
    truth = Rotation.from_rotvec(turn[None])
    body, reference = scene(np.random.default_rng(6), truth, 4, 1e-5)
    expected = static.svd(body, reference, 1e-5)
    found = method(body, reference, 1e-5)
    if method is static.triad:
        assert np.abs(angles(found, truth)).max() < 1e-4
    else:
        apart = found.R_reference_body.inv() * expected.R_reference_body
        assert apart.magnitude().max() < 1e-10


@settings(max_examples=50)
@given(st.integers(0, 10**9), st.integers(2, 9))
def test_turning_either_frame_turns_the_answer(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    truth, left, right = (Rotation.random(1, rng=rng) for _ in range(3))
    body, reference = scene(rng, truth, m, 1e-3)
    for method in ALL:
        plain = method(body, reference, 1e-3)
        turned = method(right.inv().apply(body[0])[None], left.apply(reference[0])[None], 1e-3)
        if plain.flag[0] != Flag.OK or turned.flag[0] != Flag.OK:
            assert plain.flag[0] == turned.flag[0]
            continue
        expected = left * plain.R_reference_body * right
        # two nearly parallel vectors lose digits as their angle squared
        tolerance = 1e-13 * np.trace(plain.covariance_rad2[0]) / 1e-6 + 1e-9
        assert (expected.inv() * turned.R_reference_body).magnitude()[0] < tolerance


@pytest.mark.parametrize("method", ALL)
def test_the_covariance_is_what_monte_carlo_finds(method) -> None:
    rng = np.random.default_rng(7)
    n = 8000
    sigma = np.array([1e-4, 3e-4, 2e-4, 5e-4])
    truth = Rotation.random(n, rng=rng)
    body, reference = scene(rng, truth, 4, np.tile(sigma, (n, 1)), np.radians(25.0))
    found = method(body, reference, sigma)
    error = angles(found, truth)
    nees = np.einsum(
        "ni,ni->n", error, np.linalg.solve(found.covariance_rad2, error[..., None])[..., 0]
    )
    low, high = chi2.ppf([0.0005, 0.9995], 3 * n) / n
    assert low < nees.mean() < high
    if method is not static.triad:
        low, high = chi2.ppf([0.0005, 0.9995], 5 * n) / n
        assert low < found.loss.mean() < high


def test_triad_has_the_covariance_of_its_two_vectors() -> None:
    rng = np.random.default_rng(8)
    truth = Rotation.from_quat(np.tile([0.1, 0.2, 0.3, 0.9], (20_000, 1)))
    true = unit(np.array([[1.0, 0.2, 0.1], [0.3, 1.0, -0.2]]))
    reference = np.einsum("nij,mj->nmi", truth.as_matrix(), true)
    sigma = np.array([1e-4, 4e-4])
    noise = sigma[:, None] * rng.standard_normal((20_000, 2, 3))
    noise -= np.sum(noise * true, axis=-1, keepdims=True) * true
    found = static.triad(unit(true + noise), reference, sigma)
    error = angles(found, truth)
    expected = found.covariance_rad2.mean(axis=0)
    assert np.cov(error.T) == pytest.approx(expected, abs=0.03 * np.trace(expected))
    # an optimal method is nowhere worse
    best = static.svd(unit(true + noise), reference, sigma).covariance_rad2.mean(axis=0)
    assert np.linalg.eigvalsh(expected - best).min() > -1e-12


@pytest.mark.parametrize("method", ALL)
def test_a_batch_survives_its_bad_epochs(method) -> None:
    truth = Rotation.random(8, rng=np.random.default_rng(9))
    body, reference = scene(np.random.default_rng(10), truth, 4, 1e-5)
    sigma = np.full((8, 4), 1e-5)
    body[1, 1:] = np.nan  # one vector
    body[2] = np.nan  # none
    body[3], reference[3] = body[3, :1], reference[3, :1]  # all along one line
    body[4, 1], reference[4, 1] = -body[4, 0], -reference[4, 0]
    body[4, 2:] = np.nan  # two, opposite
    body[5, 3] = 0.0  # three good ones
    sigma[6, 0], sigma[6, 1] = np.nan, -1.0  # two good ones
    reference[7, 2] = np.inf  # three good ones
    found = method(body, reference, sigma)
    expected = [Flag.OK, Flag.TOO_FEW_RAYS, Flag.TOO_FEW_RAYS, Flag.WEAK_GEOMETRY]
    expected += [Flag.WEAK_GEOMETRY, Flag.OK, Flag.OK, Flag.OK]
    assert found.flag.tolist() == expected
    ok = found.flag == Flag.OK
    assert np.array_equal(np.isfinite(found.quat_xyzw).all(axis=-1), ok)
    assert np.array_equal(np.isfinite(found.covariance_rad2).all(axis=(1, 2)), ok)
    assert np.array_equal(np.isfinite(found.loss), ok)
    error = (Rotation.from_quat(found.quat_xyzw[ok]).inv() * truth[np.nonzero(ok)[0]]).magnitude()
    assert error.max() < 1e-3
    with pytest.raises(ArgumentError, match="flag"):
        _ = found.R_reference_body


def test_any_leading_shape_and_named_methods() -> None:
    truth = Rotation.random(6, rng=np.random.default_rng(11))
    body, reference = scene(np.random.default_rng(12), truth, 3, 1e-5)
    flat = static.quest(body, reference, 1e-5).quat_xyzw
    shaped = static.solve("quest", body.reshape(2, 3, 3, 3), reference.reshape(2, 3, 3, 3), 1e-5)
    assert np.array_equal(shaped.quat_xyzw, flat.reshape(2, 3, 4))
    one = static.solve("triad", body[0], reference[0], 1e-5)
    assert one.quat_xyzw.shape == (4,)
    with pytest.raises(ArgumentError, match="static method"):
        static.solve("wahba", body, reference, 1e-5)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="alike"):
        static.svd(body, reference[:, :2], 1e-5)
    with pytest.raises(ArgumentError, match="sigma"):
        static.svd(body, reference, [1e-5, 1e-5])
