"""Evaluation of matches whose errors are known: numbers, intervals, vibration, options."""

from __future__ import annotations

import json

import numpy as np
import pytest
from field_scene import GSD_M, scene

from geoposition.accuracy import enu_errors_m
from geoposition.arrays import FloatArray
from geoposition.calib_fields.evaluate import KEYS, EvaluationOptions, evaluate
from geoposition.calib_fields.intervals import Cells, Estimate
from geoposition.calib_fields.match import Cause, DomMatches
from geoposition.calib_fields.profiles import profile, residual_spectrum
from geoposition.calib_fields.relative import fitted, relative_terms
from geoposition.calib_fields.smooth import robust_polynomial
from geoposition.errors import ArgumentError, GeometryError
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts import cli

SHAPE = (4000, 2000)
LINE_S = GSD_M / 6900.0
NOISE_PX = 0.05


@pytest.fixture(scope="module")
def model() -> PushbroomModel:
    return scene(SHAPE).model()


def true_error(place: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A shift, a cubic bow and a vibration, of sizes drawn anew."""
    u = place / np.array(SHAPE) * 2.0 - 1.0
    error = rng.uniform(-2.0, 2.0, 2) * np.ones((len(place), 1))
    error = error + rng.uniform(-1.5, 1.5, 2) * u[:, 1:] ** 3 + rng.uniform(-0.5, 0.5, 2) * u
    phase = 2 * np.pi * (place[:, :1] / 350.0 + rng.uniform())
    return np.asarray(error + rng.uniform(0.0, 0.4, 2) * np.sin(phase))


def matches_of(
    model: PushbroomModel,
    rng: np.random.Generator,
    noise_px: float = NOISE_PX,
    share: float = 0.9,
) -> tuple[DomMatches, FloatArray, FloatArray]:
    """Matches on a lattice, some missing; the true errors in the image and shifts on the ground."""
    lattice = np.stack(
        np.meshgrid(np.arange(40, 3960, 64.0), np.arange(40, 1960, 64.0), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    place = lattice[rng.random(len(lattice)) < share]
    n = len(place)
    truth = true_error(place, rng)
    ground = model.image_to_ground(place, 400.0).geodetic
    observed = place + truth + noise_px * rng.standard_normal((n, 2))

    def shift(image_px: FloatArray) -> FloatArray:
        located = model.image_to_ground(image_px, ground[:, 2]).geodetic
        return np.asarray(-enu_errors_m(located, ground)[:, :2])

    one = np.broadcast_to(np.eye(2), (n, 2, 2))
    matches = DomMatches(
        ground=ground,
        model_px=place,
        image_px=observed,
        covariance_px2=noise_px**2 * one,
        shift_en_m=shift(observed),
        covariance_m2=(noise_px * GSD_M) ** 2 * one,
        correlation=np.full(n, 0.9),
        cause=np.full(n, Cause.USED, dtype=np.uint8),
        pixel_m=GSD_M,
        ground_sample_m=(GSD_M, GSD_M),
        window_px=64,
        spacing_px=64,
        lines_per_pixel=(1.0, 0.0),
    )
    return matches, truth, shift(place + truth)


def truths(error: FloatArray, shift: FloatArray) -> dict[str, float]:
    centred = error - error.mean(axis=0)
    m = np.sqrt(np.mean(centred**2, axis=0))
    rmse = np.sqrt(np.mean(shift**2, axis=0))
    return {
        "bias_e_m": float(shift[:, 0].mean()),
        "bias_n_m": float(shift[:, 1].mean()),
        "rmse_e_m": float(rmse[0]),
        "rmse_n_m": float(rmse[1]),
        "ce90_m": float(np.quantile(np.hypot(*shift.T), 0.9)),
        "relative_px": float(np.hypot(*m)),
        "v_x": 0.0,
        "v_y": 0.0,
        "m_x": float(m[0]),
        "m_y": float(m[1]),
    }


def test_numbers_are_those_of_the_planted_errors(model: PushbroomModel) -> None:
    matches, error, shift = matches_of(model, np.random.default_rng(1), noise_px=1e-6)
    found = evaluate(matches, model)
    true = truths(error, shift)
    assert set(true) == set(KEYS)
    for name in KEYS:
        if name not in ("v_x", "v_y"):
            # half a per mille: the degrees of freedom of the shift
            assert found.estimates[name].value == pytest.approx(true[name], rel=1e-3)
    m = (found.estimates["m_x"].value, found.estimates["m_y"].value)
    assert found.estimates["relative_px"].value == pytest.approx(np.hypot(*m), rel=1e-9)
    assert np.allclose(
        [found.estimates["bias_line_px"].value, found.estimates["bias_sample_px"].value],
        error.mean(axis=0),
        atol=1e-5,
    )


def test_intervals_hold_the_truth(model: PushbroomModel) -> None:
    held = []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        matches, error, shift = matches_of(model, rng, share=rng.uniform(0.3, 1.0))
        found, true = evaluate(matches, model).estimates, truths(error, shift)
        for name in KEYS:
            low, high = found[name].interval
            held.append(low <= true[name] <= high)
            assert low <= found[name].value <= high
    assert np.mean(held) >= 0.93


def test_intervals_say_something(model: PushbroomModel) -> None:
    matches, *_ = matches_of(model, np.random.default_rng(3))
    found = evaluate(matches, model).estimates
    low, high = found["bias_e_m"].interval
    # 0.05 px of noise and what the vibration leaves, over 1600 points
    assert 0.0 < high - low < 1.0
    low, high = found["relative_px"].interval
    assert (high - low) / found["relative_px"].value < 0.2


def test_reference_accuracy_widens_only_absolute_numbers(model: PushbroomModel) -> None:
    matches, *_ = matches_of(model, np.random.default_rng(4))
    plain = evaluate(matches, model).estimates
    wide = evaluate(matches, model, EvaluationOptions(reference_sigma_m=5.0)).estimates
    low, high = wide["bias_n_m"].interval
    assert high - low == pytest.approx(2 * 1.96 * 5.0, rel=0.05)
    for name in ("relative_px", "m_x", "v_y"):
        assert wide[name].interval == plain[name].interval


@pytest.mark.parametrize("kind", ["shift", "affine", "attitude"])
def test_what_is_removed_leaves_nothing_of_itself(model: PushbroomModel, kind: str) -> None:
    matches, *_ = matches_of(model, np.random.default_rng(5))
    terms = relative_terms(kind, model, matches.ground, matches.model_px)  # type: ignore[arg-type]
    assert terms.shape[-1] == {"shift": 2, "affine": 6, "attitude": 3}[kind]
    planted = terms @ np.arange(1.0, terms.shape[-1] + 1.0)
    left = planted - fitted(terms, planted, np.ones(len(planted), dtype=np.bool_))
    assert np.max(np.abs(left)) < 1e-9


def test_attitude_terms_are_those_of_the_model(model: PushbroomModel) -> None:
    matches, *_ = matches_of(model, np.random.default_rng(6))
    turned = scene(SHAPE, bias_arcsec=(20.0, -30.0)).model()
    moved = turned.ground_to_image(matches.ground).image_px - matches.model_px
    terms = relative_terms("attitude", model, matches.ground, matches.model_px)
    left = moved - fitted(terms, moved, np.ones(len(moved), dtype=np.bool_))
    # 30 arcseconds are 9 px here
    assert np.max(np.abs(moved)) > 5.0
    assert np.max(np.abs(left)) < 2e-3


def test_vibration_is_found() -> None:
    rng = np.random.default_rng(7)
    time, sample = rng.uniform(0.0, 6.0, 3000), rng.uniform(0.0, 2000.0, 3000)
    wave = np.sin(2 * np.pi * 2.0 * time + 0.3)
    residual = np.stack([0.3 * wave, 0.1 * wave], axis=1) * np.sinc(2.0 * 0.1)
    residual += 2.0 * ((sample / 1000.0 - 1.0) ** 3)[:, None] + 0.05 * rng.standard_normal(
        (3000, 2)
    )
    found = residual_spectrum(
        time, sample, residual, detector=np.zeros(3000, dtype=np.int64), window=(0.1, 0.0)
    )
    assert len(found.lines) == 1
    line = found.lines[0]
    assert line.frequency == pytest.approx(2.0, abs=5 * line.sigma_frequency)
    assert line.sigma_frequency < 0.005
    assert line.amplitude_px[0] == pytest.approx(0.3, abs=4 * line.sigma_amplitude_px)
    assert line.amplitude_px[1] == pytest.approx(0.1, abs=4 * line.sigma_amplitude_px)


def test_noise_is_no_vibration() -> None:
    rng = np.random.default_rng(8)
    found = 0
    for _ in range(20):
        time, sample = rng.uniform(0.0, 6.0, 400), rng.uniform(0.0, 2000.0, 400)
        noise = rng.standard_normal((400, 2))
        detector = np.zeros(400, dtype=np.int64)
        found += len(
            residual_spectrum(time, sample, noise, detector=detector, window=(0.05, 0.0)).lines
        )
    assert found <= 1


def test_profiles_average() -> None:
    line = np.arange(1000.0)
    residual = np.stack([line, -line], axis=1)
    found = profile(line, residual, 10)
    assert np.allclose(found.mean_px[:, 0], 49.5 + 100.0 * np.arange(10))
    assert found.count.sum() == 1000


def test_smooth_fit_keeps_out_a_third_of_blunders() -> None:
    rng = np.random.default_rng(9)
    place = rng.uniform(0.0, 1000.0, (600, 2))
    u = place / 500.0 - 1.0
    error = np.stack([3.0 + u[:, 0] - 2.0 * u[:, 1] ** 3, -5.0 + 0.5 * u[:, 0] * u[:, 1]], axis=1)
    error += 0.1 * rng.standard_normal(error.shape)
    blunder = rng.random(600) < 0.35
    error[blunder] += rng.uniform(-30.0, 30.0, (blunder.sum(), 2))
    fit = robust_polynomial(place, error, 3)
    clean = ~blunder
    assert fit.good[clean].mean() > 0.98
    assert fit.good[blunder].mean() < 0.03
    assert np.all(fit.scale_px < 0.15)


def test_cells_tell_the_scatter_of_a_mean() -> None:
    rng = np.random.default_rng(10)
    place = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0)), axis=-1).reshape(-1, 2)
    cells = Cells.of(place, 4.0)
    ratios = []
    for _ in range(200):
        # alike within squares of four
        common = np.repeat(np.repeat(rng.standard_normal((10, 10)), 4, axis=0), 4, axis=1)
        found = cells.mean(common.T.ravel())
        ratios.append(found.mean / found.sigma)
    assert np.std(ratios) == pytest.approx(1.0, abs=0.15)


def test_squares_are_told_as_roots() -> None:
    found = Estimate(4.0, 0.5, 1e6, squared=True)
    assert found.value == 2.0
    assert found.interval == pytest.approx((np.sqrt(4 - 0.98), np.sqrt(4 + 0.98)), abs=1e-3)
    assert Estimate(0.1, 1.0, 10.0, squared=True).interval[0] == 0.0


def test_what_cannot_be_evaluated_is_refused(model: PushbroomModel) -> None:
    matches, *_ = matches_of(model, np.random.default_rng(11), share=0.003)
    with pytest.raises(GeometryError, match="at least"):
        evaluate(matches, model)
    with pytest.raises(ArgumentError):
        EvaluationOptions(reference_sigma_m=-1.0)


def test_the_experiment_counts_intervals(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["experiment", "intervals", "--runs", "3", "--seed", "5", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found["coverage"]) == set(KEYS)
    assert found["pooled"] == pytest.approx(np.mean(list(found["coverage"].values())))
    assert found["pooled"] >= 0.9
    assert "hold" in found["finding"]
