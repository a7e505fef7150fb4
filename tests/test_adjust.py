"""The adjustment as a whole, on a simulated pair of known truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adjust_scene import (
    ARCSEC,
    GPS_M,
    NOISE_PX,
    attitude_blocks,
    common_ground,
    control_points,
    draw,
    measured,
    moved_enu,
    pair,
)
from scipy.stats import chi2

from geoposition.adjust import (
    HeightControl,
    Status,
    adjust,
    attitude_bias,
    attitude_process,
    attitude_spline,
    image_bias,
    look_angles,
    mounting,
    orbit,
    split_control,
    time_offset,
)
from geoposition.adjust.linear import taken
from geoposition.adjust.point_sets import groups, of_control
from geoposition.adjust.run import adjusted_models
from geoposition.adjust.solve import equations_of
from geoposition.attitude import Attitude
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.observations import TiePoints
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.fit import fit_model
from geoposition.sensors.readers import open_product
from geoposition.sensors.writers.csm import write_csm
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.triangulate import triangulate

GROUND = 42


def case(seed: int = 3):  # type: ignore[no-untyped-def]
    return draw(seed, common_ground(GROUND), attitude_blocks())


def ten_and_check(control):  # type: ignore[no-untyped-def]
    return split_control(control, [f"p{i}" for i in range(10, GROUND)])


def test_bias_is_found_and_checks_reach_the_limit_of_image_noise() -> None:
    """T 5.3: ten of 42 control points; what is left at the others is what noise leaves."""
    errors, predicted = [], []
    for seed in range(4):
        drawn = case(seed)
        control, check = ten_and_check(drawn.control)
        done = adjust(pair(), attitude_blocks(), control=control, check=check)
        errors.append(np.mean(done.check.error_enu_m**2, axis=0))
        predicted.append(np.mean(done.check.sigma_enu_m**2, axis=0) + GPS_M**2)
        assert done.check.rmse_m(before=True) > 5.0 * done.check.rmse_m()
        assert np.all(done.check.status == Status.CHECK)
        assert not done.rejected
    ratio = np.sqrt(np.mean(errors, axis=0) / np.mean(predicted, axis=0))
    np.testing.assert_allclose(ratio, 1.0, atol=0.12)


@pytest.mark.parametrize("count", [1, 4, 10])
def test_covariance_is_true(count: int) -> None:
    """NEES of all unknowns, and of one check point per run, within the 95 % band."""
    blocks, ground = attitude_blocks(), common_ground(14)
    runs, unknowns, points = 25, [], []
    for run in range(runs):
        drawn = draw(1000 * count + run, ground, blocks)
        control, check = split_control(drawn.control, [f"p{i}" for i in range(count, 14)])
        done = adjust(pair(), blocks, control=control, check=check)
        off = done.values - drawn.theta
        unknowns.append(off @ np.linalg.solve(done.covariance, off))
        i = run % len(check)
        own = done.check.covariance_enu_m2[i] + GPS_M**2 * np.eye(3)
        points.append(done.check.error_enu_m[i] @ np.linalg.solve(own, done.check.error_enu_m[i]))
    for values, freedom in ((unknowns, 6), (points, 3)):
        low, high = chi2.ppf([0.025, 0.975], freedom * runs)
        assert low <= np.sum(values) <= high


def test_adjusted_models_are_models_like_any_other() -> None:
    drawn = case()
    control, check = ten_and_check(drawn.control)
    done = adjust(pair(), attitude_blocks(), control=control, check=check)
    for image, model in enumerate(done.models):
        assert isinstance(model, PushbroomModel)
        rows = done.control.product == image
        seen = model.ground_to_image(control.geodetic[done.control.point[rows]])
        off = done.control.image_px[rows] - seen.image_px
        np.testing.assert_allclose(off, done.control.residual_px[rows], atol=1e-3)
        around = model.image_to_ground(done.control.image_px[rows], 800.0)
        back = model.ground_to_image(around.geodetic)
        np.testing.assert_allclose(back.image_px, done.control.image_px[rows], atol=1e-6)
    found = triangulate(done.models, check.image, NOISE_PX)
    off = geodetic_to_ecef(found.geodetic) - geodetic_to_ecef(done.check.geodetic)
    assert np.max(np.abs(off)) < 5e-3


def test_adjusted_models_are_written_and_read_back(tmp_path: Path) -> None:
    """Every kind of correction survives our model file and, at its height, a CSM state."""
    blocks = [block for block in full_blocks() if block.kind != "image"]
    theta = np.concatenate([block.prior_sigma for block in blocks])
    ground = common_ground(40, 4)
    ground[:, 2] = 1000.0
    for k, model in enumerate(adjusted_models(pair(False), blocks, theta)):
        assert isinstance(model, PushbroomModel)
        seen = model.ground_to_image(ground).image_px
        write_model_file(model, tmp_path / f"{k}.toml")
        again = open_product(tmp_path / f"{k}.toml").model.ground_to_image(ground).image_px
        assert np.max(np.abs(again - seen)) < 1e-3
        write_csm(model, tmp_path / f"{k}.json", height_m=1000.0)
        again = open_product(tmp_path / f"{k}.json").model.ground_to_image(ground).image_px
        assert np.max(np.abs(again - seen)) < 0.1


def test_rpc_of_an_adjusted_model() -> None:
    """A fitted RPC follows the adjusted model, not the one it came from."""
    drawn = draw(3, common_ground(GROUND), attitude_blocks(), seams=False)
    done = adjust(pair(False), attitude_blocks(), control=drawn.control)
    model = done.models[0]
    rpc = fit_model(model).model
    ground = common_ground(20, 5)
    truth = model.ground_to_image(ground).image_px
    assert np.max(np.abs(rpc.ground_to_image(ground).image_px - truth)) < 0.1
    assert np.max(np.abs(pair(False)[0].ground_to_image(ground).image_px - truth)) > 5.0


def full_blocks():  # type: ignore[no-untyped-def]
    models = pair()
    return [
        attitude_bias("strip", models, [0, 1], degree=2, sigma_rad=10 * ARCSEC),
        attitude_spline("wave", models, [0], knots=5, sigma_rad=2 * ARCSEC),
        mounting("camera", [1], sigma_rad=20 * ARCSEC),
        orbit("orbit", models, [0, 1], sigma_m=3.0, drift_sigma_m_s=0.05),
        time_offset("clock", [0], sigma_s=2e-3),
        look_angles("look", [1], degree=2, sigma_rad=3 * ARCSEC),
        image_bias("shift", [0], degree=1, sigma_px=3.0),
    ]


def test_every_kind_of_unknown_moves_the_model_as_the_equations_say() -> None:
    """Data made by corrected models, without noise, are fitted exactly by the same unknowns."""
    blocks = full_blocks()
    rng = np.random.default_rng(4)
    theta = np.concatenate([b.prior_sigma for b in blocks]) * rng.normal(
        size=sum(len(b) for b in blocks)
    )
    truth = adjusted_models(pair(), blocks, theta)
    ground = common_ground(150, 2)
    control = control_points(ground, measured(truth, ground, rng, 0.0))
    # Tight in the image, so that the priors' pull towards zero is no more than a pinch.
    done = adjust(pair(), blocks, control=control, control_sigma_px=1e-3, robust=None)
    fitted = done.control.residual_px
    assert np.max(np.abs(fitted)) < 0.01
    for image, model in enumerate(done.models):
        off = model.ground_to_image(ground).image_px - truth[image].ground_to_image(ground).image_px
        assert np.max(np.abs(off)) < 0.02


def test_jacobian_against_finite_differences() -> None:
    blocks = full_blocks()
    rng = np.random.default_rng(1)
    ground = common_ground(30, 8)
    control = control_points(ground, measured(pair(), ground, rng))
    equations = equations_of(pair(), blocks)
    points = of_control("control", pair(), control, NOISE_PX)
    sigma = np.concatenate([b.prior_sigma for b in blocks])
    theta = 0.3 * sigma * rng.normal(size=len(sigma))
    (group,) = groups(points, 2)
    for image, equation in enumerate(equations.images):
        rows = group.rows[:, image]
        sights = taken(points.sights, rows)
        at = points.ecef_m[group.points]
        _, by_ground, jacobian = equation.evaluate(sights, at, theta)
        for j, column in enumerate(equation.columns):
            step = np.zeros(len(theta))
            step[column] = 1e-3 * sigma[column]
            high = equation.evaluate(sights, at, theta + step)[0]
            low = equation.evaluate(sights, at, theta - step)[0]
            numeric = (high - low) / 2e-3
            np.testing.assert_allclose(
                jacobian[:, :, j] * sigma[column], numeric, atol=2e-3 + 2e-3 * np.abs(numeric).max()
            )
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = 1.0
            moved = equation.evaluate(sights, at + step, theta)[0]
            np.testing.assert_allclose(
                moved - equation.evaluate(sights, at, theta)[0], -by_ground[:, :, axis], atol=1e-5
            )


def test_null_space_rows_equal_explicit_points() -> None:
    drawn = case()
    ties_ground = common_ground(60, 11)
    rng = np.random.default_rng(0)
    images = measured(drawn.truth, ties_ground, rng)
    ties = TiePoints.of_pair(*images)
    control, _ = split_control(drawn.control, [f"p{i}" for i in range(3, GROUND)])
    blocks = attitude_blocks(degree=1)
    short = adjust(pair(), blocks, control=control, ties=ties, robust=None)
    long = adjust(pair(), blocks, control=control, ties=ties, explicit_points=True)
    np.testing.assert_allclose(short.values / short.sigma, long.values / long.sigma, atol=1e-4)
    np.testing.assert_allclose(short.covariance, long.covariance, rtol=1e-6, atol=1e-25)


def test_same_as_a_plain_least_squares_of_everything() -> None:
    """Unknowns and ground points together, residuals by the models' own projections."""
    ground = common_ground(5, 21)
    blocks = attitude_blocks()
    drawn = draw(8, ground, blocks)
    done = adjust(pair(), blocks, control=drawn.control, robust=None)
    sigma = np.concatenate([b.prior_sigma for b in blocks])
    image = drawn.control.image
    assert image is not None

    def rows(x: np.ndarray) -> np.ndarray:
        models = adjusted_models(pair(), blocks, x[:6] * sigma)
        offset = x[6:].reshape(-1, 3)
        points = moved_enu(drawn.control.geodetic, offset)
        parts = [x[:6], (offset / GPS_M).ravel()]
        for k, model in enumerate(models):
            seen = image.image_px[image.product == k]
            parts.append(((seen - model.ground_to_image(points).image_px) / NOISE_PX).ravel())
        return np.concatenate(parts)

    # Where the adjustment ended, one step of plain least squares leads nowhere.
    at = np.concatenate([done.values / sigma, np.zeros(15)])
    jacobian = np.column_stack([(rows(at + h) - rows(at - h)) / 2e-3 for h in 1e-3 * np.eye(21)])
    step = np.linalg.lstsq(jacobian, -rows(at), rcond=None)[0]
    step += np.linalg.lstsq(jacobian, -rows(at + step), rcond=None)[0]
    covariance = np.linalg.inv(jacobian.T @ jacobian)[:6, :6] * np.outer(sigma, sigma)
    assert np.all(np.abs(step[:6] * sigma) < 5e-3 * done.sigma)
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance)), done.sigma, rtol=2e-3)


def test_heights_hold_the_base_of_a_pair_without_control() -> None:
    """Matches leave the parallax of two shifts open; known heights of the matches close it."""
    ground = common_ground(300, 31)
    rng = np.random.default_rng(2)
    blocks = [image_bias("shift", [1], sigma_px=50.0)]
    truth = adjusted_models(pair(), blocks, np.array([12.0, -5.0]))
    ties = TiePoints.of_pair(*measured(truth, ground, rng))
    open_ = adjust(pair(), blocks, ties=ties)
    assert len(open_.weak) == 1
    assert open_.weak[0].gain < 0.05
    assert "shift.line" in str(open_.weak[0])
    heights = HeightControl(np.arange(len(ground)), ground[:, 2], np.full(len(ground), 2.0))
    closed = adjust(pair(), blocks, ties=ties, heights=heights)
    assert not closed.weak
    assert np.all(np.abs(closed.values - [12.0, -5.0]) < 4.0 * closed.sigma)
    assert closed.sigma.max() < 0.2


def test_bias_beside_mounting_is_said_to_rest_on_priors() -> None:
    drawn = case()
    blocks = [*attitude_blocks(), mounting("camera", [0], sigma_rad=10 * ARCSEC)]
    done = adjust(pair(), blocks, control=drawn.control)
    # Turning body or camera about Y and the axes across is the same thing, seen by one camera.
    assert len(done.weak) == 3
    named = {name for weak in done.weak for name, _ in weak.parts}
    assert all(name.startswith(("forward.", "camera.")) for name in named)
    assert all(weak.gain < 0.51 for weak in done.weak)
    assert any({"forward.pitch_0", "camera.y"} == {a, b} for a, b, _ in done.correlated)
    assert not adjust(pair(), attitude_blocks(), control=drawn.control).weak


def test_fused_attitude_brings_its_correlated_errors() -> None:
    """A prior of long correlation lets few control points mend a whole image."""
    base = pair()[0]
    assert isinstance(base, PushbroomModel)
    low, high = base.attitude.span_s
    times = np.arange(low, high, 0.25)
    sigma, tau = 5 * ARCSEC, 30.0
    own = np.repeat((sigma**2 * np.eye(3))[None], len(times), axis=0)
    lag = own[:-1] * np.exp(-0.25 / tau)
    fused = Attitude(base.attitude.epoch, base.attitude.curve, "itrs", times, own, lag)
    models = [replace(base, attitude=fused)]
    block = attitude_process("fused", models, [0], spacing_s=2.0)
    covariance = block.covariance.reshape(len(block) // 3, 3, -1, 3)
    assert block.basis is not None
    knots = block.basis.knots_s
    expected = sigma**2 * np.exp(-np.abs(knots[:, None] - knots) / tau)
    np.testing.assert_allclose(covariance[:, 0, :, 0], expected, rtol=0.02)
    ground = common_ground(6, 3)
    rng = np.random.default_rng(0)
    image = TiePoints([f"p{i}" for i in range(6)], [0] * 6, measured(models, ground, rng)[0])
    control = replace(control_points(ground, measured(pair(), ground, rng)), image=image)
    done = adjust(models, [block], control=control)
    pitch = done.sigma.reshape(-1, 3)[:, 1]
    assert np.all(pitch < 0.6 * sigma)


def test_mixed_graph_of_a_rigorous_model_and_an_rpc() -> None:
    drawn = draw(3, common_ground(GROUND), attitude_blocks(), seams=False)
    rpc = fit_model(pair(False)[1]).model
    models = [pair(False)[0], rpc]
    blocks = [attitude_blocks()[0], image_bias("rpc", [1], degree=1)]
    control, check = ten_and_check(drawn.control)
    done = adjust(models, blocks, control=control, check=check)
    assert done.check.rmse_m() < 1.3 * np.sqrt(np.nanmean(np.sum(done.check.sigma_enu_m**2, 1)))
    assert type(done.models[1]) is type(rpc)


def test_misuse_is_refused() -> None:
    drawn = case()
    with pytest.raises(ArgumentError, match="control points or tie points"):
        adjust(pair(), attitude_blocks())
    with pytest.raises(ArgumentError, match="each block's name once"):
        adjust(pair(), [*attitude_blocks(), *attitude_blocks()], control=drawn.control)
    with pytest.raises(ArgumentError, match="image 2 is unknown"):
        adjust(pair(), [image_bias("x", [2])], control=drawn.control)
    rpc = fit_model(pair(False)[0]).model
    with pytest.raises(ArgumentError, match="no rigorous model"):
        adjust([rpc, pair()[1]], [mounting("m", [0])], control=drawn.control)
    with pytest.raises(ArgumentError, match="knots from line 0"):
        attitude_spline("s", pair(), [0], knots_line=[100.0, 5000.0, 9000.0, 16000.0])
