"""The factor graph: the smoothers' equal on their problem, and the only one on the wider ones."""

from __future__ import annotations

import numpy as np
import pytest
from attitude_scenes import ARCSEC, NOISE, settings, telemetry
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.errors import ArgumentError, GeometryError
from geoposition.sensors.attitude_determination.filters.forward import run_forward
from geoposition.sensors.attitude_determination.graph import factor_graph
from geoposition.sensors.attitude_determination.graph.factor_graph import GraphOptions, RobustNoise
from geoposition.sensors.attitude_determination.preintegration import preintegrate
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.smoothers import smooth
from geoposition.sensors.attitude_determination.timeline import merge
from geoposition.sensors.gyro import draw_parameters
from geoposition.sensors.telemetry import GyroNoise, GyroParameters, Mounting, StarSeries

GYRO_TIMES = np.arange(0.0, 60.05, 0.1)
STAR_TIMES = np.arange(0.03, 60.0, 0.25)
MOUNTING = Mounting(
    {
        "a": Rotation.from_rotvec([0.3, -0.9, 0.2]),
        "b": Rotation.from_rotvec([-0.8, 0.5, 1.1]),
    }
)


def two_heads(star: StarSeries, offsets=lambda head, t: np.zeros((len(t), 3)), bore=40.0 * ARCSEC):
    """Split a series between two heads, with anisotropic noise and an offset (n, 3) of each."""
    rng = np.random.default_rng(77)
    head = np.arange(len(star)) % 2
    quats = np.array(star.quat_xyzw)
    for h, name in enumerate(("a", "b")):
        rows = head == h
        noise = rng.standard_normal((rows.sum(), 3)) * [0.0, 0.0, bore]
        own = Rotation.from_rotvec(offsets(name, star.times_s[rows]))
        turned = Rotation.from_quat(quats[rows]) * MOUNTING.rotation(name)
        quats[rows] = (turned * own * Rotation.from_rotvec(noise)).as_quat()
    bores = np.hypot(star.sigma_cross_rad, bore)
    return StarSeries.of(star.times_s, quats, star.sigma_cross_rad, bores, head, ("a", "b"))


def assert_same(found, other, tolerance=1e-2) -> None:
    np.testing.assert_array_equal(found.times_s, other.times_s)
    sigma = other.sigma_rad
    assert np.abs(found.error_rad(other.R_inertial_body) / sigma).max() < tolerance
    scale = np.sqrt(np.einsum("nii->ni", other.covariance))
    off = (found.bias_rad_s - other.bias_rad_s) / scale[:, 3:6]
    assert np.abs(off).max() < tolerance
    both = scale[:, :, None] * scale[:, None, :]
    assert np.abs((found.covariance - other.covariance) / both).max() < tolerance
    lag = sigma[:-1, :, None] * sigma[1:, None, :]
    assert np.abs((found.lag_one - other.lag_one) / lag).max() < tolerance


@pytest.mark.parametrize("model", ["bias", "general"])
def test_agrees_with_rts_on_two_unlike_heads(model: str) -> None:
    single, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    star = two_heads(single)
    found = factor_graph.smooth(star, gyro, settings(model), MOUNTING)
    assert_same(found, smooth.rts(star, gyro, settings(model), MOUNTING), 2e-3)


@pytest.mark.parametrize(
    ("gyro_times", "star_times"),
    [
        (np.arange(0.0, 20.1, 0.5), np.arange(0.0, 20.0, 0.1)),  # several knots per gyro epoch
        (np.arange(0.0, 20.1, 0.1), np.array([7.04, 12.3])),  # starts late, ends early
        (np.arange(0.0, 20.1, 0.1), np.array([7.04])),  # one fix
        (np.delete(np.arange(0.0, 20.1, 0.1), np.r_[50:90]), np.arange(0.0, 20.0, 1.0)),  # gap
        (np.arange(0.0, 3.1, 1.0), np.array([0.0, 3.0])),  # ends of the gyro
    ],
)
def test_agrees_with_rts_at_any_rates(gyro_times, star_times) -> None:
    star, gyro, _ = telemetry(gyro_times, star_times)
    found = factor_graph.smooth(star, gyro, settings())
    assert_same(found, smooth.rts(star, gyro, settings()), 2e-3)


def test_the_cut_into_segments_does_not_matter() -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    whole = factor_graph.smooth(star, gyro, settings(), options=GraphOptions(segment_knots=10000))
    for knots in (1, 7, 40):
        cut = factor_graph.smooth(star, gyro, settings(), options=GraphOptions(segment_knots=knots))
        assert_same(cut, whole, 1e-5)


def test_a_bias_without_walk() -> None:
    noise = GyroNoise(NOISE.angle_random_walk, 0.0)
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES, noise=noise)
    given = FusionSettings(noise, bias_sigma_rad_s=5e-6)
    assert_same(factor_graph.smooth(star, gyro, given), smooth.rts(star, gyro, given), 2e-3)


@pytest.mark.parametrize("model", ["bias", "general"])
def test_link_is_the_chain_of_its_steps(model: str) -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, np.array([0.0]))
    given = settings(model)
    line = merge(star, gyro, Mounting())
    done = run_forward(line, given)
    last = len(line.times_s) - 1
    noise = given.noise
    links = preintegrate(
        line,
        np.array([0, last]),
        np.zeros((2, 3)),
        np.zeros(9),
        model == "general",
        noise.angle_random_walk,
        noise.rate_random_walk,
    )
    size = given.states
    Phi = np.eye(size)
    Phi[:3, :3], Phi[:3, 3:] = links.E[0], links.F[0]
    Q = np.zeros((size, size))
    Q[:3, :3], Q[:3, 3:6], Q[3:6, :3] = links.Qaa[0], links.Qab[0], links.Qab[0].T
    Q[3:6, 3:6] = links.qbb[0] * np.eye(3)
    expected = Phi @ done.covariance[0] @ Phi.T + Q
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        done.covariance[last] / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-9
    )
    end = Rotation.from_quat(done.quat_xyzw[0]) * Rotation.from_quat(links.quat_xyzw[0])
    off = end.inv() * Rotation.from_quat(done.quat_xyzw[last])
    np.testing.assert_allclose(off.as_rotvec(), 0.0, atol=1e-12)


def test_nees_over_drawn_truths() -> None:
    runs = 40
    rng = np.random.default_rng(3)
    drawn = draw_parameters(rng, runs, 5e-6, 2e-3, 2e-3)
    noise = GyroNoise(NOISE.angle_random_walk, 0.0)
    nees = np.zeros(3)
    for run in range(runs):
        own = GyroParameters.of(
            drawn.bias_rad_s[run], drawn.scale[run], drawn.upper[run], drawn.lower[run]
        )
        star, gyro, truth = telemetry(
            GYRO_TIMES, STAR_TIMES, parameters=own, noise=noise, seed=300 + run
        )
        given = FusionSettings(noise, "general", 5e-6)
        found = factor_graph.smooth(star, gyro, given)
        constants = np.concatenate([own.scale, own.upper, own.lower])
        attitude = found.error_rad(truth)
        for place, k in enumerate((0, 305, 600)):
            error = np.concatenate(
                [
                    attitude[k],
                    own.bias_rad_s - found.bias_rad_s[k],
                    constants - found.parameters[k],
                ]
            )
            sigma = np.sqrt(np.diag(found.covariance[k]))
            unit = found.covariance[k] / np.outer(sigma, sigma)
            nees[place] += (error / sigma) @ np.linalg.solve(unit, error / sigma)
    low, high = chi2.ppf([0.025, 0.975], 15 * runs)
    assert np.all((low < nees) & (nees < high)), nees / (15 * runs)


def test_alignment_of_a_head_is_recovered() -> None:
    truth = np.array([60.0, -35.0, 90.0]) * ARCSEC
    single, gyro, attitude = telemetry(GYRO_TIMES, STAR_TIMES)
    star = two_heads(single, lambda name, t: np.tile(truth * (name == "b"), (len(t), 1)))
    options = GraphOptions(alignment_sigma_rad={"b": 200.0 * ARCSEC})
    found = factor_graph.solve(star, gyro, settings(), MOUNTING, options)
    offset = found.offsets["b"]
    assert set(found.offsets) == {"b"}
    assert np.all(np.abs(offset.alignment_rad - truth) < 3.5 * offset.alignment_sigma_rad)
    assert np.all(offset.alignment_sigma_rad < 8.0 * ARCSEC)
    error = found.estimate.error_rad(attitude) / found.estimate.sigma_rad
    blind = factor_graph.smooth(star, gyro, settings(), MOUNTING)
    assert np.sqrt(np.mean(error**2)) < 1.6
    assert np.sqrt(np.mean((blind.error_rad(attitude) / blind.sigma_rad) ** 2)) > 5.0


def test_periodic_errors_of_heads_are_recovered() -> None:
    period = 40.0
    sine, cosine = np.array([20.0, -15.0, 30.0]) * ARCSEC, np.array([-10.0, 25.0, 5.0]) * ARCSEC

    def offsets(name, t):
        phase = 2.0 * np.pi * t[:, None] / period
        return (name == "a") * (sine * np.sin(phase) + cosine * np.cos(phase))

    single, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    star = two_heads(single, offsets, bore=10.0 * ARCSEC)
    options = GraphOptions(periodic_sigma_rad={"a": 40.0 * ARCSEC}, period_s=period)
    found = factor_graph.solve(star, gyro, settings(), MOUNTING, options).offsets["a"]
    assert np.all(np.abs(found.sine_rad - sine) < 3.5 * found.sine_sigma_rad)
    assert np.all(np.abs(found.cosine_rad - cosine) < 3.5 * found.cosine_sigma_rad)
    assert np.all(found.sine_sigma_rad < 5.0 * ARCSEC)
    np.testing.assert_array_equal(found.alignment_rad, 0.0)


def spoilt(star: StarSeries) -> tuple[StarSeries, np.ndarray]:
    wrong = np.arange(0, len(star), 9)
    quats = np.array(star.quat_xyzw)
    turn = Rotation.from_rotvec(np.radians([0.4, -0.3, 0.2]) * (-1.0) ** wrong[:, None])
    quats[wrong] = (Rotation.from_quat(quats[wrong]) * turn).as_quat()
    return StarSeries.of(star.times_s, quats, star.sigma_cross_rad), wrong


def test_a_gate_becomes_the_truncated_loss() -> None:
    clean, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    star, wrong = spoilt(clean)
    found = factor_graph.solve(star, gyro, settings(gate_probability=1.0 - 1e-6))
    kept = np.ones(len(star), dtype=bool)
    kept[wrong] = False
    np.testing.assert_array_equal(found.weight > 0.5, kept)
    assert_same(found.estimate, smooth.rts(star.where(kept), gyro, settings()), 5e-3)


@pytest.mark.parametrize("kind", ["huber", "cauchy"])
def test_robust_losses_bound_the_damage(kind) -> None:
    clean, gyro, truth = telemetry(GYRO_TIMES, STAR_TIMES)
    star, _ = spoilt(clean)
    options = GraphOptions(robust=RobustNoise(kind))
    robust = factor_graph.smooth(star, gyro, settings(), options=options)
    plain = factor_graph.smooth(star, gyro, settings())
    worst, blind = (np.abs(found.error_rad(truth)).max() for found in (robust, plain))
    assert worst < 6.0 * ARCSEC
    assert blind > 10.0 * worst


def test_refuses_misuse() -> None:
    star, gyro, _ = telemetry(GYRO_TIMES, STAR_TIMES)
    with pytest.raises(ArgumentError, match="no head 'c'"):
        factor_graph.smooth(
            star, gyro, settings(), options=GraphOptions(alignment_sigma_rad={"c": 1e-4})
        )
    with pytest.raises(ArgumentError, match="period_s"):
        GraphOptions(periodic_sigma_rad=1e-4)
    with pytest.raises(ArgumentError, match="huber, cauchy or truncated"):
        RobustNoise("tukey")
    late = StarSeries.of(star.times_s + 1000.0, star.quat_xyzw, star.sigma_cross_rad)
    with pytest.raises(GeometryError, match="never overlaps"):
        factor_graph.smooth(late, gyro, settings())
