"""Covariances of intersected points against the scatter; weak geometry; wrong rays found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from stereo_scenes import views

from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.error_budget import ModelError
from geoposition.error_budget.influence import ARCSEC_RAD
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.observations import TiePoints, diagonal_covariance
from geoposition.orbit_frame import inertial_velocity_ecef, zenith_orbit_axes
from geoposition.pushbroom import PushbroomModel
from geoposition.triangulate import relative_bias, triangulate, triangulate_pairs_weighted

RUNS = 500
SIGMA_PX = 0.3
ATTITUDE_RAD = ARCSEC_RAD * np.array([0.4, 0.6, 2.0])
POSITION_M = np.array([0.8, 0.5, 0.6])
ERROR = ModelError.of_sigmas(ATTITUDE_RAD, POSITION_M)


@pytest.fixture(scope="module")
def strong() -> list[PushbroomModel]:
    """Forward, backward, nadir: convergence of some 50° between the first two."""
    return views((-45.0, 45.0, 0.0))


@pytest.fixture(scope="module")
def weak() -> list[PushbroomModel]:
    """Convergence of 3.6° between the outer two."""
    return views((-2.5, 2.5, 0.0))


def ground_of(models: list[PushbroomModel], n: int, seed: int) -> np.ndarray:
    """Ground points (n, 3) that all images show."""
    rng = np.random.default_rng(seed)
    image = rng.uniform((600.0, 300.0), (1400.0, 1200.0), (n, 2))
    ground = models[0].image_to_ground(image, rng.uniform(450.0, 550.0, n)).geodetic
    for model in models:
        assert np.all(model.ground_to_image(ground).flag == Flag.OK)
    return ground


def seen_wrongly(
    model: PushbroomModel, ground: np.ndarray, turn_rad: np.ndarray, shift_m: np.ndarray
) -> np.ndarray:
    """Where points show in an image whose attitude is R exp(d) and which is elsewhere.

    `turn_rad` in the body, `shift_m` along the orbit's axes, one for each point. The stated
    model sees there the direction R exp(−d) Rᵀ (P − S − shift).
    """
    image = model.ground_to_image(ground).image_px
    time = model.camera.timing.time_s(image[:, 0])
    camera, attitude, ephemeris = model.camera, model.attitude, model.ephemeris
    R = attitude.rotation(time + (camera.timing.epoch - attitude.epoch))
    at = time + (camera.timing.epoch - ephemeris.epoch)
    place, speed = ephemeris.position_m(at), ephemeris.velocity_m_s(at)
    axes = zenith_orbit_axes(place, inertial_velocity_ecef(place, speed))
    sight = geodetic_to_ecef(ground) - place - np.einsum("nij,nj->ni", axes, shift_m)
    turned = (R * Rotation.from_rotvec(-turn_rad) * R.inv()).apply(sight)
    seen = model.ground_to_image(ecef_to_geodetic(place + turned))
    assert np.all(seen.flag <= Flag.OUTSIDE_IMAGE)
    return seen.image_px


def ties_of(images: list[np.ndarray]) -> TiePoints:
    n = len(images[0])
    return TiePoints(
        np.tile(np.arange(n), len(images)),
        np.repeat(np.arange(len(images)), n),
        np.concatenate(images),
    )


def enu_error(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    off = geodetic_to_ecef(found) - geodetic_to_ecef(truth)
    return np.einsum("nji,nj->ni", enu_axes(truth), off)


def assert_nees(off: np.ndarray, covariance: np.ndarray) -> None:
    """Mean normalised squared error within its 95 % band."""
    n = len(off)
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)
    low, high = chi2.ppf([0.025, 0.975], 3 * n) / n
    assert low < nees.mean() < high


@pytest.mark.parametrize("rays", [2, 3])
@pytest.mark.parametrize("geometry", ["strong", "weak"])
def test_covariance_of_noisy_image_points_and_attitudes(
    request: pytest.FixtureRequest, geometry: str, rays: int
) -> None:
    """500 runs, each with its own noise, attitude and orbit error of every image."""
    models = request.getfixturevalue(geometry)[:rays]
    ground = ground_of(models, RUNS, 1)
    rng = np.random.default_rng(2)
    images = []
    for model in models:
        turn = rng.normal(size=(RUNS, 3)) * ATTITUDE_RAD
        shift = rng.normal(size=(RUNS, 3)) * POSITION_M
        seen = seen_wrongly(model, ground, turn, shift)
        images.append(seen + rng.normal(0.0, SIGMA_PX, seen.shape))
    found = triangulate(models, ties_of(images), SIGMA_PX, errors=[ERROR] * rays,
                        blunder_factor=np.inf)  # fmt: skip
    assert np.all(found.flag == Flag.OK)
    off = enu_error(found.geodetic, ground)
    assert_nees(off, found.covariance_enu_m2)
    if rays == 2:
        fast = triangulate_pairs_weighted(*models, *images, SIGMA_PX, (ERROR, ERROR))
        assert_nees(enu_error(fast.geodetic, ground), fast.covariance_enu_m2)
    # Attitude and orbit dominate, and without them the statement is far off.
    alone = triangulate(models, ties_of(images), SIGMA_PX, blunder_factor=np.inf)
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(alone.covariance_enu_m2), off)
    assert nees.mean() > 6.0


def test_fast_pairs_are_what_the_slow_way_gives(strong: list[PushbroomModel]) -> None:
    models = [strong[0], strong[2]]
    ground = ground_of(models, 1000, 3)
    rng = np.random.default_rng(4)
    images = [m.ground_to_image(ground).image_px + rng.normal(0, 0.4, (1000, 2)) for m in models]
    images[0][7] = np.nan
    for errors in ((None, None), (ERROR, ModelError.of_sigmas(image_px=[2.0, 0.5]))):
        slow = triangulate(models, ties_of(images), (0.4, 0.9), errors=errors)
        fast = triangulate_pairs_weighted(*models, *images, (0.4, 0.9), errors)
        assert fast.flag[7] == slow.flag[7] == Flag.BAD_INPUT
        assert np.all(np.isnan(fast.covariance_enu_m2[7]))
        good = np.arange(1000) != 7
        assert np.all(fast.flag[good] == Flag.OK)
        assert np.max(np.abs(enu_error(fast.geodetic[good], slow.geodetic[good]))) < 2e-3
        np.testing.assert_allclose(
            fast.covariance_enu_m2[good], slow.covariance_enu_m2[good], rtol=2e-3, atol=2e-4
        )


def test_common_and_random_parts_are_told_apart(strong: list[PushbroomModel]) -> None:
    """Many points of two images with one error each: what they share, and what scatters."""
    models = strong[:2]
    n = 2000
    ground = ground_of(models, n, 5)
    rng = np.random.default_rng(6)
    shared = []
    for _ in range(40):
        images = []
        for model in models:
            turn = np.tile(rng.normal(size=3) * ATTITUDE_RAD, (n, 1))
            shift = np.tile(rng.normal(size=3) * POSITION_M, (n, 1))
            seen = seen_wrongly(model, ground, turn, shift)
            images.append(seen + rng.normal(0.0, SIGMA_PX, seen.shape))
        found = triangulate(models, ties_of(images), SIGMA_PX, errors=[ERROR, ERROR])
        off = enu_error(found.geodetic, ground)
        shared.append(off.mean(axis=0))
        # The rest is noise; the attitude's error varies over the image by far less.
        np.testing.assert_allclose(
            np.cov((off - off.mean(axis=0)).T), found.random_enu_m2.mean(axis=0), atol=0.02
        )
    assert_nees(np.array(shared), np.tile(found.systematic_enu_m2.mean(axis=0), (40, 1, 1)))


def test_no_stated_error_no_systematic_part(strong: list[PushbroomModel]) -> None:
    images = [m.ground_to_image(ground_of(strong, 30, 7)).image_px for m in strong]
    for errors in (None, [None] * 3, [ModelError()] * 3):
        found = triangulate(strong, ties_of(images), errors=errors)
        assert not np.any(found.systematic_enu_m2)
        np.testing.assert_array_equal(found.random_enu_m2, found.covariance_enu_m2)
    with pytest.raises(ArgumentError, match="one for each of 3"):
        triangulate(strong, ties_of(images), errors=[ERROR])


def test_weak_geometry_is_said_and_has_numbers(
    strong: list[PushbroomModel], weak: list[PushbroomModel]
) -> None:
    for models, expected in ((strong[:2], False), ([weak[0], weak[2]], True)):
        images = [m.ground_to_image(ground_of(models, 20, 8)).image_px for m in models]
        found = triangulate(models, ties_of(images))
        np.testing.assert_array_equal(found.weak, expected)
        assert np.all(found.flag == Flag.OK)
        limited = triangulate(models, ties_of(images), min_convergence_rad=0.05)
        flag = Flag.WEAK_GEOMETRY if expected else Flag.OK
        np.testing.assert_array_equal(limited.flag, flag)


@pytest.mark.parametrize("count", [5, 300])
def test_the_wrong_ray_of_three_is_found_and_left_out(
    strong: list[PushbroomModel], count: int
) -> None:
    """A common bias of two images is no blunder where there are points enough to tell."""
    ground = ground_of(strong, count, 9)
    rng = np.random.default_rng(10)
    images = [m.ground_to_image(ground).image_px + rng.normal(0, 0.2, (count, 2)) for m in strong]
    if count > 100:
        images[1] += (0.5, 3.0)
    # Across the track, where the middle image alone disagrees with two that agree.
    for k, point in ((0, 1), (1, 2), (2, 4)):
        images[k][point] += (12.0, 15.0)
    found = triangulate(strong, ties_of(images), 0.2)
    wrong = np.zeros(3 * count, dtype=bool)
    wrong[[1, count + 2, 2 * count + 4]] = True
    np.testing.assert_array_equal(found.rejected, wrong)
    assert np.all(found.flag == Flag.OK)
    np.testing.assert_array_equal(found.rays[[1, 2, 4]], 2)
    assert np.all(np.isnan(found.image_residual_px[wrong]))
    off = enu_error(found.geodetic, ground)
    assert np.max(np.abs(off[[1, 2, 4]])) < (2.0 if count < 100 else 6.0)
    # What is left out does not trouble the estimate of the bias.
    assert all(np.isfinite(bias.bias_px).all() for bias in relative_bias(ties_of(images), found))
    none = triangulate(strong, ties_of(images), 0.2, blunder_factor=np.inf)
    assert not none.rejected.any()


def test_two_wrong_rays_of_five(strong: list[PushbroomModel]) -> None:
    models = [*strong, *views((-20.0, 20.0))]
    ground = ground_of(models, 60, 11)
    rng = np.random.default_rng(12)
    images = [m.ground_to_image(ground).image_px + rng.normal(0, 0.2, (60, 2)) for m in models]
    images[0][3] += (15.0, -20.0)
    images[3][3] += (-25.0, 18.0)
    found = triangulate(models, ties_of(images), 0.2)
    np.testing.assert_array_equal(np.flatnonzero(found.rejected), [3, 183])
    assert found.rays[3] == 3
    assert np.max(np.abs(enu_error(found.geodetic, ground)[3])) < 1.5


def test_without_blunders_none_is_found(strong: list[PushbroomModel]) -> None:
    ground = ground_of(strong, 4000, 13)
    rng = np.random.default_rng(14)
    images = [m.ground_to_image(ground).image_px + rng.normal(0, 0.3, (4000, 2)) for m in strong]
    covariance = diagonal_covariance(0.3, 12000, 2)
    ties = ties_of(images)
    for given in (ties, TiePoints(ties.ids, ties.product, ties.image_px, covariance)):
        found = triangulate(strong, given, 0.3)
        assert np.sum(found.flag == Flag.BLUNDER) <= 1
        assert np.sum(found.rejected) <= 1
