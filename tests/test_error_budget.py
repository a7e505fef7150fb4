"""Error influence in closed form against the models themselves, by finite differences."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scenes
from error_models import late, moved_in_ecef, turned_in_body, turned_in_ecef
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from stereo_scenes import views
from synthetic_models import ParallelModel

from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.error_budget import (
    ModelError,
    image_budget,
    image_error_covariance,
    image_scale_at,
    influence,
    intersection_gains,
    pair_budget,
)
from geoposition.error_budget.influence import ARCSEC_RAD
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.observations import TiePoints
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.line_camera import Mounting
from geoposition.sensors.readers import open_product
from geoposition.triangulate import triangulate

PARTS = np.array([[0.5, 0.5], [0.03, 0.04], [0.95, 0.07], [0.3, 0.96]])


def located(model: PushbroomModel, image: np.ndarray, height: np.ndarray) -> np.ndarray:
    found = model.image_to_ground(image, height)
    assert np.all(found.flag == Flag.OK)
    return geodetic_to_ecef(found.geodetic)


def between(
    changed: Callable[[PushbroomModel, float], PushbroomModel],
    model: PushbroomModel,
    half: float,
    image: np.ndarray,
    height: np.ndarray,
) -> np.ndarray:
    """Central difference per unit of the change."""
    ahead, behind = (located(changed(model, s * half), image, height) for s in (1.0, -1.0))
    return (ahead - behind) / (2.0 * half)


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    """To 1e-3 of the movement's size."""
    assert np.linalg.norm(found - expected) <= 1e-3 * np.linalg.norm(expected)


def assert_influence(model: PushbroomModel, height_m: float) -> None:
    lines, samples = model.shape
    image = PARTS * (np.array([lines, samples]) - 1.0)
    heights = np.full(len(image), height_m)
    found = influence(model, image, heights)
    for axis in range(3):
        unit = np.eye(3)[axis]

        def body(m: PushbroomModel, s: float, unit: np.ndarray = unit) -> PushbroomModel:
            return turned_in_body(m, s * unit)

        moved = between(body, model, 10.0 * ARCSEC_RAD, image, heights)
        for i in range(len(image)):
            assert_close(found.turn_body_m[i, :, axis], moved[i])
    # The orbit's axes at the first point, for all points.
    first = found.R_ecef_orbit[0]
    turn = found.turn_orbit_m @ found.R_ecef_orbit.transpose(0, 2, 1) @ first
    position = found.position_m @ found.R_ecef_orbit.transpose(0, 2, 1) @ first
    for axis in range(3):
        unit = first[:, axis]

        def orbit(m: PushbroomModel, s: float, unit: np.ndarray = unit) -> PushbroomModel:
            return turned_in_ecef(m, s * unit)

        def place(m: PushbroomModel, s: float, unit: np.ndarray = unit) -> PushbroomModel:
            return moved_in_ecef(m, s * unit)

        turned = between(orbit, model, 10.0 * ARCSEC_RAD, image, heights)
        moved = between(place, model, 20.0, image, heights)
        for i in range(len(image)):
            assert_close(turn[i, :, axis], turned[i])
            assert_close(position[i, :, axis], moved[i])
    moved = between(late, model, 5e-4, image, heights)
    for i in range(len(image)):
        assert_close(found.time_m[i], moved[i])
    ahead, behind = (located(model, image, heights + s) for s in (1.0, -1.0))
    for i in range(len(image)):
        assert_close(found.height_m[i], 0.5 * (ahead[i] - behind[i]))


SYNTHETIC = {
    "nadir": scenes.build((2000, 1500)),
    "agile": scenes.build((2000, 1500), roll_deg=25.0, pitch_deg=-18.0, pitch_rate_rad_s=4e-3),
    "lever arm": scenes.build(
        (2000, 1500),
        roll_deg=-12.0,
        yaw_deg=40.0,
        mounting=Mounting(
            Rotation.from_rotvec([0.02, -0.1, 0.05]), np.array([300.0, -200.0, 90.0])
        ),
        attitude="spline",
    ),
}


@pytest.mark.parametrize("name", SYNTHETIC)
def test_influence_is_what_the_model_does(name: str) -> None:
    assert_influence(SYNTHETIC[name].model(), 800.0)


@pytest.mark.parametrize(
    "product",
    [
        "linescan/worldview2_pair/wv_mvp_1.xml",
        "linescan/worldview2_pair/wv_mvp_2.xml",
        "linescan/pleiades1a",
        "linescan/spot6/SPOT6.XML",
    ],
)
def test_influence_is_what_a_real_products_model_does(real_data: Path, product: str) -> None:
    model = open_product(real_data / product).model
    assert isinstance(model, PushbroomModel)
    assert_influence(model, float(np.mean(model.height_range_m)))


def test_an_arcsecond_at_nadir_is_range_times_angle() -> None:
    model = SYNTHETIC["nadir"].model()
    moves = influence(model, [[999.5, 749.5]], 0.0)
    rays = model.rays([[999.5, 749.5]], 0.0)
    reach = np.linalg.norm(geodetic_to_ecef(moves.geodetic) - rays.origin_ecef_m) * ARCSEC_RAD
    turn = np.linalg.norm(moves.turn_orbit_m[0], axis=0) * ARCSEC_RAD
    np.testing.assert_allclose(turn[:2], reach, rtol=0.01)
    assert turn[2] < 0.01 * reach
    # A metre along track or to the left is that on the ground below, less the Earth's curve.
    size = np.linalg.norm(moves.position_m[0], axis=0)
    np.testing.assert_allclose(size[:2], 1.0, rtol=0.01)


def test_located_points_stay_on_their_height() -> None:
    """What T (2.11) does not: every movement but that of the height is horizontal."""
    model = SYNTHETIC["agile"].model()
    moves = influence(model, [[100.0, 200.0], [1500.0, 900.0]], 300.0)
    up = enu_axes(moves.geodetic)[:, :, 2]
    for columns in (moves.turn_body_m, moves.turn_orbit_m, moves.position_m):
        assert np.max(np.abs(np.einsum("ni,nij->nj", up, columns))) < 1e-6 * np.abs(columns).max()
    np.testing.assert_allclose(np.einsum("ni,ni->n", up, moves.height_m), 1.0, atol=1e-12)


@pytest.fixture(scope="module")
def models() -> list[PushbroomModel]:
    return views((-45.0, 45.0), (4000, 4000))


def test_the_pair_sees_common_ground(models: list[PushbroomModel]) -> None:
    ground = models[0].image_to_ground(np.array([[2000.0, 2000.0]]), 500.0).geodetic
    assert models[1].ground_to_image(ground).flag[0] == Flag.OK


@pytest.mark.parametrize("faulty", [0, 1])
@pytest.mark.parametrize("cause", ["turn", "orbit", "time"])
def test_effect_on_intersected_points_is_the_triangulations(
    models: list[PushbroomModel], faulty: int, cause: str
) -> None:
    ground = models[0].image_to_ground(np.array([[2000.0, 2000.0], [1700.0, 2300.0]]), 500.0)
    seen = [model.ground_to_image(ground.geodetic).image_px for model in models]
    image = seen[faulty]
    moves = influence(models[faulty], image, 500.0)
    rotvec, by = np.array([2.0, -1.0, 3.0]) * ARCSEC_RAD, moves.R_ecef_orbit[0] @ [3.0, 4.0, -6.0]
    if cause == "turn":
        moved = np.einsum("nij,j->ni", moves.turn_body_m, rotvec)
        wrong = turned_in_body(models[faulty], rotvec)
    elif cause == "orbit":
        moved = np.einsum("nij,nkj,k->ni", moves.position_m, moves.R_ecef_orbit, by)
        wrong = moved_in_ecef(models[faulty], by)
    else:
        moved = 5e-4 * moves.time_m
        wrong = late(models[faulty], 5e-4)
    gains, _, good = intersection_gains(models, ground.geodetic)
    assert np.all(good)
    expected = np.einsum("nij,nj->ni", gains[faulty], moved)
    all_models = list(models)
    all_models[faulty] = wrong
    found = triangulate(all_models, TiePoints.of_pair(*seen))
    assert np.all(found.flag == Flag.OK)
    off = geodetic_to_ecef(found.geodetic) - geodetic_to_ecef(ground.geodetic)
    for i in range(2):
        assert np.linalg.norm(off[i]) > 1.0
        assert_close(expected[i], off[i])


def test_an_rpc_like_model_has_pixels_and_height_alone() -> None:
    budget = image_budget(ParallelModel((0.1, 0.3)))
    assert [line.cause for line in budget.lines] == [
        "image row", "image column", "height of the surface"
    ]  # fmt: skip
    height = budget.lines[-1].enu_m
    assert height[2] == pytest.approx(1.0)
    assert budget.lines[-1].horizontal_m == pytest.approx(np.hypot(0.1, 0.3), rel=1e-3)


def test_budgets_of_one_image_and_of_a_pair(models: list[PushbroomModel]) -> None:
    one = image_budget(models[0])
    causes = {line.cause: line for line in one.lines}
    assert len(one.lines) == 3 + 3 + 3 + 1 + 2 + 1
    assert abs(causes["turn about orbit left"].enu_m[2]) < 1e-6
    assert causes["image row"].horizontal_m == pytest.approx(0.9, abs=0.3)
    both = pair_budget(models)
    assert both.images == 2
    assert len(both.lines) == 2 * (len(one.lines) - 1)
    # Pitch of one image is what changes heights: R 1" / (2 sin) for a symmetric pair.
    pitch = next(line for line in both.lines if line.cause == "turn about orbit left")
    reach = float(np.linalg.norm(influence(models[0], [[2000, 2000]], 500.0).turn_body_m[0, :, 1]))
    assert abs(pitch.enu_m[2]) == pytest.approx(0.5 * reach * ARCSEC_RAD / np.tan(0.52), rel=0.25)
    assert {"lines", "images", "lon_deg"} <= set(both.as_dict())
    far = scenes.build((2000, 1500), orbit=scenes.Orbit.over(1.2, 0.2)).model()
    with pytest.raises(GeometryError, match="common"):
        pair_budget([models[0], far])


def test_an_error_covariance_is_the_scatter_of_the_image_points() -> None:
    """Monte Carlo: turned and moved models see a ground point where the covariance says."""
    model = SYNTHETIC["agile"].model()
    image, height = np.array([[400.0, 1200.0]]), np.array([500.0])
    error = ModelError.of_sigmas(ARCSEC_RAD * np.array([1.0, 2.0, 5.0]), [3.0, 1.0, 2.0])
    stated = image_error_covariance(model, error, image, height)[0]
    ground = model.image_to_ground(image, height).geodetic
    axes = influence(model, image, height).R_ecef_orbit[0]
    rng = np.random.default_rng(1)
    seen = []
    for _ in range(24):
        turn = rng.normal(size=3) * ARCSEC_RAD * [1.0, 2.0, 5.0]
        wrong = moved_in_ecef(turned_in_body(model, turn), axes @ (rng.normal(size=3) * [3, 1, 2]))
        seen.append(wrong.ground_to_image(ground).image_px[0] - image[0])
    off = np.array(seen)
    nees = np.einsum("ni,ij,nj->n", off, np.linalg.inv(stated), off)
    low, high = chi2.ppf([0.005, 0.995], 2 * len(off)) / len(off)
    assert low < nees.mean() < high


def test_model_errors_that_are_none() -> None:
    with pytest.raises(ArgumentError, match="covariance"):
        ModelError(attitude_rad2=-np.eye(3))
    with pytest.raises(ArgumentError, match="expected"):
        ModelError(image_px2=np.eye(3))
    with pytest.raises(ArgumentError, match="sigma"):
        ModelError.of_sigmas(attitude_rad=[1.0, 2.0])
    with pytest.raises(ArgumentError, match="ground_m"):
        ModelError(ground_m=-1.0)
    parallel = ParallelModel((0.1, 0.3))
    error = ModelError.of_sigmas(attitude_rad=1e-6)
    with pytest.raises(ArgumentError, match="rigorous"):
        image_error_covariance(parallel, error, np.zeros((1, 2)), np.zeros(1))
    with pytest.raises(ArgumentError, match="rigorous"):
        influence(parallel, [[0.0, 0.0]], 0.0)  # type: ignore[arg-type]
    on_ground = image_error_covariance(
        parallel, ModelError(ground_m=2.0), np.array([[50.0, 50.0]]), np.zeros(1)
    )
    scale = image_scale_at(parallel, np.array([[50.0, 50.0]]), np.zeros(1))
    metres = scale.ground_per_px[0] @ on_ground[0] @ scale.ground_per_px[0].T
    assert np.trace(metres) == pytest.approx(2.0 * 2.0**2, rel=1e-3)
    with pytest.raises(ArgumentError, match="two or more"):
        intersection_gains([parallel], np.zeros((1, 3)))
