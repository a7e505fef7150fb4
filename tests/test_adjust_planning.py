"""Accuracy predicted before anything is measured is the accuracy found afterwards."""

from __future__ import annotations

import numpy as np
from adjust_scene import GPS_M, attitude_blocks, common_ground, draw, pair

from geoposition.adjust import adjust, best_layout, measured_without_error, predict, split_control

BLOCKS = {"sigma_arcsec": 20.0}


def test_prediction_is_the_covariance_of_the_adjustment_made_later() -> None:
    ground, blocks = common_ground(30), attitude_blocks(**BLOCKS)
    plan = predict(pair(), blocks, ground[:6], ground[6:], sigma_enu_m=GPS_M)
    drawn = draw(1, ground, blocks)
    control, check = split_control(drawn.control, [f"p{i}" for i in range(6, 30)])
    done = adjust(pair(), blocks, control=control, check=check)
    np.testing.assert_allclose(plan.sigma, done.sigma, rtol=0.01)
    np.testing.assert_allclose(plan.sigma_enu_m, done.check.sigma_enu_m, rtol=0.01)


def test_more_and_better_points_help_as_they_should() -> None:
    ground, blocks = common_ground(60), attitude_blocks(**BLOCKS)
    rms = [predict(pair(), blocks, ground[:count], ground[40:]).rms_enu_m for count in (1, 4, 16)]
    assert np.all(np.diff(rms, axis=0) < 0.0)
    coarse = predict(pair(), blocks, ground[:4], ground[40:], sigma_enu_m=3.0).rms_enu_m
    assert np.all(coarse > rms[1])
    # Four coarse points leave about 3 m / sqrt(4) of a common shift.
    assert 1.0 < np.hypot(coarse[0], rms[0][0]) < 4.0


def test_layout_is_chosen_by_what_it_is_good_for() -> None:
    candidates, check = common_ground(25, 2), common_ground(40, 3)
    blocks = attitude_blocks(sigma_arcsec=20.0, degree=1)
    chosen, rmse_m = best_layout(pair(), blocks, candidates, check, 4)
    assert len(set(chosen.tolist())) == 4
    assert np.all(np.diff(rmse_m) < 0.0)
    best = predict(pair(), blocks, candidates[chosen], check)
    assert np.hypot(*[np.hypot(*best.rms_enu_m[:2]), best.rms_enu_m[2]]) < 1.02 * rmse_m[-1]
    rng = np.random.default_rng(0)
    for _ in range(5):
        other = predict(pair(), blocks, candidates[rng.choice(25, 4, replace=False)], check)
        assert np.sum(best.rms_enu_m**2) <= 1.02 * np.sum(other.rms_enu_m**2)


def test_points_without_error_are_where_the_models_show_them() -> None:
    ground = common_ground(5)
    control = measured_without_error(pair(), ground, 0.1)
    assert control.image is not None
    assert len(control.image) == 10
    for image, model in enumerate(pair()):
        rows = control.image.of_product(image)
        np.testing.assert_allclose(
            control.image.image_px[rows], model.ground_to_image(ground).image_px
        )
