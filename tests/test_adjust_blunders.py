"""Blunders are found, explained, and cost nothing; typical mistakes are recognised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adjust_scene import (
    ARCSEC,
    NOISE_PX,
    attitude_blocks,
    common_ground,
    control_points,
    draw,
    measured,
    moved_enu,
    pair,
)

from geoposition.adjust import (
    Status,
    adjust,
    attitude_bias,
    diagnose,
    explain_rejections,
    selected_control,
    split_control,
)
from geoposition.observations import ControlPoints, TiePoints

POINTS = 42
BAD = 8


def spoiled(control: ControlPoints, seed: int) -> tuple[ControlPoints, set[str]]:
    """A fifth of the points wrong by 10 to 1000 px in one image, or as much on the ground."""
    rng = np.random.default_rng(seed)
    bad = rng.choice(POINTS, BAD, replace=False)
    assert control.image is not None
    image, offset = control.image.image_px.copy(), np.zeros((POINTS, 3))
    for point in bad:
        size_px = 10.0 ** rng.uniform(1.0, 3.0)
        if rng.random() < 0.5:
            direction = rng.normal(size=2)
            image[point + POINTS * rng.integers(2)] += size_px * direction / np.hypot(*direction)
        else:
            direction = rng.normal(size=3)
            offset[point] = 3.5 * size_px * direction / np.linalg.norm(direction)
    table = TiePoints(control.image.ids, control.image.product, image)
    ground = moved_enu(control.geodetic, offset)
    return replace(control, geodetic=ground, image=table), {f"p{i}" for i in bad}


@pytest.mark.parametrize("seed", range(12))
def test_a_fifth_of_gross_errors_is_found_and_none_of_the_good_lost(seed: int) -> None:
    ground, blocks = common_ground(POINTS), attitude_blocks()
    drawn = draw(seed, ground, blocks)
    dirty, bad = spoiled(drawn.control, seed)
    done = adjust(pair(), blocks, control=dirty)
    assert {rejection.id for rejection in done.rejected} == bad
    good = np.array([name not in bad for name in dirty.ids.tolist()])
    clean = adjust(pair(), blocks, control=selected_control(drawn.control, good), robust=None)
    np.testing.assert_allclose(done.values, clean.values, atol=0.05 * clean.sigma.min())
    assert done.sigma0 == pytest.approx(clean.sigma0, rel=0.01)
    assert np.sum(done.control.status == Status.REJECTED) == BAD


def test_false_matches_are_found_by_where_rays_do_not_meet() -> None:
    ground, blocks = common_ground(400, 6), attitude_blocks()
    drawn = draw(5, common_ground(8), blocks)
    images = measured(drawn.truth, ground, np.random.default_rng(1))
    # Across the epipolar lines, which here run along the lines: in the samples.
    images[1][:80, 1] += np.random.default_rng(2).choice([-1, 1], 80) * np.geomspace(5, 500, 80)
    done = adjust(pair(), blocks, control=drawn.control, ties=TiePoints.of_pair(*images))
    assert {int(r.id) for r in done.rejected if r.role == "tie"} == set(range(80))
    off = (done.values - drawn.theta) / done.sigma
    assert np.all(np.abs(off) < 4.5)


def test_clean_data_lose_nothing_where_noise_is_understated() -> None:
    blocks = attitude_blocks()
    drawn = draw(9, common_ground(POINTS), blocks)
    done = adjust(pair(), blocks, control=drawn.control, control_sigma_px=NOISE_PX / 4.0)
    assert not done.rejected
    assert done.scale["control"] == pytest.approx(4.0, rel=0.25)
    assert done.sigma0 == pytest.approx(4.0, rel=0.25)


def test_reasons_of_single_blunders() -> None:
    blocks = attitude_blocks()
    drawn = draw(2, common_ground(20), blocks)
    control = drawn.control
    assert control.image is not None
    image, ground = control.image.image_px.copy(), control.geodetic.copy()
    n = len(control)
    image[[0, n]] = image[[0, n]][:, ::-1]
    ground[1, 2] += 32.0
    image[2 + n] += 40.0
    image[[3, 3 + n]] = image[[4, 4 + n]] + 0.2
    ground[5] = moved_enu(ground[5:6], np.array([[80.0, 0.0, 0.0]]))[0]
    table = TiePoints(control.image.ids, control.image.product, image)
    dirty = replace(control, geodetic=ground, image=table)
    done = adjust(pair(), blocks, control=dirty)
    said = {
        r.id: r.reason
        for r in explain_rejections(
            done, dirty, undulation_m=lambda points: np.full(len(points), -32.0)
        )
    }
    assert set(said) == {f"p{i}" for i in (0, 1, 2, 3, 5)} or set(said) == {
        f"p{i}" for i in (1, 2, 3, 5)
    }
    assert "geoid" in said["p1"]
    assert "image 1" in said["p2"]
    assert "p4" in said["p3"]
    assert "ground position" in said["p5"]


TIGHT = 0.1


def tables() -> dict[str, ControlPoints]:
    """A good table, and the same with each typical mistake made."""
    ground = common_ground(15)
    good = control_points(ground, measured(pair(), ground, np.random.default_rng(0)))
    assert good.image is not None

    def with_px(image_px: np.ndarray) -> ControlPoints:
        return replace(good, image=TiePoints(good.image.ids, good.image.product, image_px))

    lon, lat, height = good.geodetic.T
    other = TiePoints(good.image.ids, 1 - good.image.product, good.image.image_px)
    return {
        "good": good,
        "swapped-row-col": with_px(good.image.image_px[:, ::-1]),
        "pixel-origin-0.5": with_px(good.image.image_px + 0.5),
        "pixel-origin-1": with_px(good.image.image_px + 1.0),
        "orthometric-heights": replace(good, geodetic=np.column_stack([lon, lat, height + 27.0])),
        "wrong-image": replace(good, image=other),
    }


@pytest.mark.parametrize("mistake", tables().keys())
def test_typical_mistakes_of_a_whole_table(mistake: str) -> None:
    blocks = [
        attitude_bias(name, pair(), [image], sigma_rad=TIGHT * ARCSEC)
        for image, name in enumerate(("forward", "backward"))
    ]
    found = diagnose(
        pair(),
        blocks,
        tables()[mistake],
        undulation_m=lambda points: np.full(len(points), -27.0),
    )
    if mistake == "good":
        assert not found
    else:
        assert found[0].name == mistake
        assert found[0].cost_mended < 0.5 * found[0].cost


def test_exchanged_longitude_and_latitude() -> None:
    """East of 90 degrees no latitude can be a longitude; in Europe both pass."""
    from scenes import build

    scene = build((3000, 2000), gsd_m=2.0)
    model = scene.model()
    px = np.random.default_rng(0).uniform(100, 1900, (12, 2))
    ground = model.image_to_ground(px, 300.0).geodetic
    image = TiePoints([f"p{i}" for i in range(12)], [0] * 12, px)
    good = ControlPoints(image.ids, ground, np.repeat(0.01 * np.eye(3)[None], 12, 0), image)
    wrong = replace(good, geodetic=ground[:, [1, 0, 2]])
    blocks = [attitude_bias("a", [model], [0])]
    assert diagnose([model], blocks, wrong)[0].name == "swapped-lon-lat"
    assert not diagnose([model], blocks, good)


def test_check_points_never_touch_the_solution() -> None:
    blocks = attitude_blocks()
    drawn = draw(4, common_ground(20), blocks)
    control, check = split_control(drawn.control, [f"p{i}" for i in range(5, 20)])
    alone = adjust(pair(), blocks, control=control)
    ruined = replace(check, geodetic=moved_enu(check.geodetic, np.full((15, 3), 50.0)))
    beside = adjust(pair(), blocks, control=control, check=ruined)
    np.testing.assert_array_equal(alone.values, beside.values)
    np.testing.assert_allclose(beside.check.rmse_enu_m(), 50.0, rtol=0.1)
