"""Triangulation from image points: recovery, weights, flags, scatter, relative bias."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2
from synthetic_models import PLACE, ParallelModel

from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.observations import TiePoints, diagonal_covariance
from geoposition.sensor_model import SensorModel
from geoposition.triangulate import points as module
from geoposition.triangulate import triangulate, triangulate_pairs
from geoposition.triangulate.bias import relative_bias
from geoposition.triangulate.start import height_start

FORWARD = ParallelModel((0.05, 0.40))
NADIR = ParallelModel((0.10, 0.02), turn_rad=0.3)
BACKWARD = ParallelModel((0.02, -0.35), pixel_m=0.7, turn_rad=-0.2)
MODELS = [FORWARD, NADIR, BACKWARD]


def ground(n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    local = rng.uniform((-600.0, -600.0, 0.0), (600.0, 600.0, 900.0), (n, 3))
    points = ecef_to_geodetic(geodetic_to_ecef(PLACE) + local @ enu_axes(PLACE).T)
    return points


def seen(models: list[SensorModel], points: np.ndarray) -> list[np.ndarray]:
    return [model.ground_to_image(points).image_px for model in models]


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


def test_the_synthetic_model_is_one() -> None:
    points = ground(200, 0)
    for model in [*MODELS, ParallelModel((0.1, 0.3), bend_px=30.0)]:
        assert isinstance(model, SensorModel)
        image = model.ground_to_image(points).image_px
        back = model.image_to_ground(image, points[:, 2]).geodetic
        np.testing.assert_allclose(enu_error(back, points), 0.0, atol=1e-6)
        rays = model.rays(image, points[:, 2])
        lower = ecef_to_geodetic(rays.at(np.full(200, 100e3 + 1.0)))
        assert np.max(np.abs(model.ground_to_image(lower).image_px - image)) < 1e-4


@pytest.mark.parametrize("count", [2, 3])
def test_exact_image_points_give_the_ground_back(count: int) -> None:
    points = ground(500, 1)
    found = triangulate(MODELS[:count], ties_of(seen(MODELS[:count], points)))
    assert np.all(found.flag == Flag.OK)
    assert np.max(np.abs(enu_error(found.geodetic, points))) < 1e-6
    assert np.max(found.residual_px) < 1e-6
    np.testing.assert_array_equal(found.rays, count)


def test_points_keep_their_order_and_their_names() -> None:
    points = ground(4, 2)
    images = seen(MODELS, points)
    names = ["d", "a", "c", "b"]
    ids = np.array(["d", "b", "a", "d", "c", "a", "b", "c", "d"])
    product = np.array([2, 1, 0, 0, 1, 2, 0, 0, 1])
    order = {"d": 0, "a": 1, "c": 2, "b": 3}
    image = np.array([images[k][order[i]] for i, k in zip(ids, product, strict=True)])
    found = triangulate(MODELS, TiePoints(ids, product, image))
    appearance = ["d", "b", "a", "c"]
    assert list(found.ids) == appearance
    truth = points[[names.index(name) for name in appearance]]
    assert np.max(np.abs(enu_error(found.geodetic, truth))) < 1e-6
    np.testing.assert_array_equal(found.rays, [3, 2, 2, 2])
    assert list(found.ids[found.point]) == list(ids)


def test_bent_sight_is_followed_to_the_models_own_projection() -> None:
    """A strongly bent line of sight, as that of an RPC, and heights far from the first guess."""
    bent = [ParallelModel((0.05, 0.4), bend_px=40.0), ParallelModel((0.1, -0.3), bend_px=-25.0)]
    points = ground(300, 3)
    images = seen(bent, points)
    images[1] = images[1] + np.random.default_rng(4).normal(0.0, 0.3, images[1].shape)
    found = triangulate(bent, ties_of(images))
    assert np.all(found.flag == Flag.OK)
    for k, model in enumerate(bent):
        projected = model.ground_to_image(found.geodetic).image_px
        rows = slice(300 * k, 300 * (k + 1))
        np.testing.assert_allclose(found.image_residual_px[rows], images[k] - projected, atol=1e-6)

    # Least squares: no small move of a point lessens its residuals.
    def squares(geodetic: np.ndarray) -> np.ndarray:
        total = np.zeros(300)
        for k, model in enumerate(bent):
            total += np.sum((images[k] - model.ground_to_image(geodetic).image_px) ** 2, axis=1)
        return total

    least = squares(found.geodetic)
    for step in 0.05 * np.vstack([np.eye(3), -np.eye(3)]):
        moved = ecef_to_geodetic(geodetic_to_ecef(found.geodetic) + step)
        assert np.all(squares(moved) > least)
    residual = np.sqrt(least / 2.0)
    np.testing.assert_allclose(found.residual_px, residual, atol=1e-6)


@pytest.mark.parametrize("count", [2, 3])
def test_scatter_agrees_with_covariance(count: int) -> None:
    n, models = 5000, MODELS[:count]
    points = ground(n, 5)
    rng = np.random.default_rng(6)
    root = np.array([[0.4, 0.0], [0.3, 0.8]])
    images = [image + rng.normal(size=image.shape) @ root.T for image in seen(models, points)]
    exact = ties_of(images)
    covariance = np.broadcast_to(root @ root.T, (len(exact), 2, 2))
    ties = TiePoints(exact.ids, exact.product, exact.image_px, covariance)
    found = triangulate(models, ties, blunder_factor=np.inf)
    off = enu_error(found.geodetic, points)
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(found.covariance_enu_m2), off)
    low, high = chi2.ppf([0.025, 0.975], 3 * n) / n
    assert low < nees.mean() < high
    # Whitened residuals have the redundancy that was stated: 2 rays − 3 unknowns.
    inverse = np.linalg.inv(root @ root.T)
    squares = np.einsum("ni,ij,nj->n", found.image_residual_px, inverse, found.image_residual_px)
    freedom = 2 * count - 3
    low, high = chi2.ppf([0.025, 0.975], freedom * n)
    assert low < squares.sum() < high
    trace = np.trace(found.redundancy, axis1=1, axis2=2)
    np.testing.assert_allclose(np.bincount(found.point, trace), freedom, atol=1e-6)


def test_the_better_image_decides() -> None:
    points = ground(50, 7)
    images = seen(MODELS[:2], points)
    images[1] = images[1] + (3.0, 0.0)
    ties = ties_of(images)
    sigma = np.repeat([0.01, 1.0], 50)
    covariance = diagonal_covariance(sigma[:, None], 100, 2)
    found = triangulate(MODELS[:2], TiePoints(ties.ids, ties.product, ties.image_px, covariance))
    residual = np.hypot(*found.image_residual_px.T).reshape(2, 50)
    assert np.max(residual[0]) < 1e-3 * np.min(residual[1])


def test_bad_points_are_flagged_and_the_others_are_what_they_were() -> None:
    points = ground(60, 8)
    images = seen(MODELS[:2], points)
    clean = triangulate(MODELS[:2], ties_of(images))
    spoilt = [image.copy() for image in images]
    spoilt[0][3] = np.nan
    spoilt[1][7] = (1e9, 0.0)
    spoilt[1][11] += 60.0 * np.array([np.cos(0.3), -np.sin(0.3)])
    spoilt[1][13] += 60.0 * np.array([np.sin(0.3), np.cos(0.3)])
    ties = ties_of(spoilt)
    alone = TiePoints(
        np.append(ties.ids, 99),
        np.append(ties.product, 0),
        np.vstack([ties.image_px, [[5.0, 5.0]]]),
    )
    found = triangulate(MODELS[:2], alone)
    assert found.flag[3] == Flag.BAD_INPUT
    assert found.flag[7] == Flag.OUTSIDE_MODEL
    assert found.flag[60] == Flag.TOO_FEW_RAYS
    np.testing.assert_array_equal(found.rays[[3, 7, 60]], 1)
    # A wrong match across the chords is a blunder; along them it is a wrong height.
    assert {int(flag) for flag in found.flag[[11, 13]]} <= {Flag.OK, Flag.BLUNDER}
    assert Flag.BLUNDER in found.flag[[11, 13]]
    lost = np.isin(np.arange(61), [3, 7, 60]) | (found.flag == Flag.BLUNDER)
    assert np.all(np.isnan(found.geodetic[lost]))
    assert np.all(np.isnan(found.sigma_enu_m[lost]))
    good = np.setdiff1d(np.arange(60), [3, 7, 11, 13])
    np.testing.assert_array_equal(found.geodetic[good], clean.geodetic[good])
    np.testing.assert_array_equal(found.flag[good], Flag.OK)


def test_a_bad_image_point_of_three_is_left_out() -> None:
    points = ground(5, 9)
    images = seen(MODELS, points)
    images[1][2] = np.nan
    found = triangulate(MODELS, ties_of(images))
    assert np.all(found.flag == Flag.OK)
    np.testing.assert_array_equal(found.rays, [3, 3, 2, 3, 3])
    assert np.max(np.abs(enu_error(found.geodetic, points))) < 1e-6
    assert np.all(np.isnan(found.image_residual_px[5 + 2]))


def test_image_points_outside_the_image_count_and_are_said() -> None:
    model = [ParallelModel((0.0, 0.4), shape=(400, 400)), ParallelModel((0.0, -0.4), (400, 400))]
    points = ecef_to_geodetic(
        geodetic_to_ecef(PLACE) + np.array([[0.0, 0.0, 5.0], [110.0, 0.0, 5.0]]) @ enu_axes(PLACE).T
    )
    found = triangulate(model, ties_of(seen(model, points)))
    np.testing.assert_array_equal(found.flag, [Flag.OK, Flag.OUTSIDE_IMAGE])
    assert np.max(np.abs(enu_error(found.geodetic, points))) < 1e-6


def test_the_same_view_twice_is_weak_geometry() -> None:
    points = ground(10, 10)
    twice = [NADIR, ParallelModel(NADIR.lean, turn_rad=-1.0)]
    found = triangulate(twice, ties_of(seen(twice, points)))
    np.testing.assert_array_equal(found.flag, Flag.WEAK_GEOMETRY)
    pairs = triangulate_pairs(*twice, *seen(twice, points))
    np.testing.assert_array_equal(pairs.flag, Flag.WEAK_GEOMETRY)


def test_chunks_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    points = ground(100, 11)
    rng = np.random.default_rng(12)
    ties = ties_of([image + rng.normal(0, 0.5, image.shape) for image in seen(MODELS, points)])
    ties = ties.selected(np.sort(rng.permutation(300)[:260]))
    whole = triangulate(MODELS, ties)
    done: list[tuple[int, int]] = []
    monkeypatch.setattr(module, "_CHUNK", 17)
    parts = triangulate(MODELS, ties, progress=lambda at, total: done.append((at, total)))
    for name in ("geodetic", "covariance_enu_m2", "residual_px", "redundancy", "flag"):
        np.testing.assert_allclose(
            getattr(parts, name), getattr(whole, name), rtol=1e-12, atol=1e-12
        )
    assert done[-1][0] == done[-1][1] == len(whole.ids)
    assert len(done) == -(-len(whole.ids) // 17)


def test_dense_pairs_give_the_ground_back() -> None:
    points = ground(2000, 13)
    images = seen(MODELS[:2], points)
    images[0][5] = np.nan
    found = triangulate_pairs(*MODELS[:2], *images)
    assert found.flag[5] == Flag.BAD_INPUT
    good = np.arange(2000) != 5
    assert np.all(found.flag[good] == Flag.OK)
    assert np.max(np.abs(enu_error(found.geodetic[good], points[good]))) < 1e-6
    # Without a first height the rays are made anew at the heights found.
    bent = [ParallelModel((0.05, 0.4), bend_px=40.0), ParallelModel((0.1, -0.3), bend_px=-25.0)]
    points[:, 2] += 4000.0
    high = ParallelModel((0.05, 0.4), bend_px=3.0, height_range_m=(0.0, 10.0), margin_px=1e5)
    other = ParallelModel((0.05, -0.4), bend_px=1.0, height_range_m=(0.0, 10.0), margin_px=1e5)
    found = triangulate_pairs(high, other, *seen([high, other], points))
    assert np.max(np.abs(enu_error(found.geodetic, points))) < 0.05
    assert np.all(triangulate_pairs(*bent, *seen(bent, ground(9, 14))).flag == Flag.OK)


def test_first_heights_are_close() -> None:
    bent = [ParallelModel((0.05, 0.4), bend_px=4.0), ParallelModel((0.1, -0.3), turn_rad=1.0)]
    start = height_start(*bent)
    assert start is not None
    points = ground(300, 15)
    first, second = seen(bent, points)
    assert np.max(np.abs(start.heights_m(first, second) - points[:, 2])) < 0.5
    wild = start.heights_m(np.array([[0.0, 0.0]] * 3), np.array([[1e9, 0], [-1e9, 0], [np.nan, 0]]))
    assert np.all((wild >= start.low_m) & (wild <= start.high_m))
    apart = ParallelModel((0.1, -0.3), shift_px=(9000.0, 0.0))
    assert height_start(bent[0], apart) is None


def test_relative_bias_of_a_pair_is_found_where_it_shows() -> None:
    """A constant error of one image: its part across the chords is found, to either image."""
    points = ground(2000, 16)
    rng = np.random.default_rng(17)
    planted = np.array([5.0, -8.0])
    images = [image + rng.normal(0, 0.2, image.shape) for image in seen(MODELS[:2], points)]
    ties = ties_of([images[0] + planted, images[1]])
    bad = rng.permutation(2000)[:100]
    image = ties.image_px.copy()
    image[bad] += rng.uniform(-400, 400, (100, 2))
    ties = TiePoints(ties.ids, ties.product, image)
    found = triangulate(MODELS[:2], ties, 0.2)
    first, second = relative_bias(ties, found)
    assert (first.product, second.product) == (0, 1)
    # The chord in image 0 is where a ray of image 1 appears: the difference of the leans.
    step = FORWARD.matrix @ np.array([*NADIR.lean, 1.0])
    across = np.array([-step[1], step[0]]) / np.hypot(*step)
    assert len(first.observable) == len(second.observable) == 1
    assert abs(first.observable[0] @ across) == pytest.approx(1.0, abs=1e-3)
    expected = (planted @ across) * across
    np.testing.assert_allclose(first.bias_px, expected, atol=0.05)
    assert np.all(np.abs(first.bias_px - expected) < 4.0 * first.bias_sigma_px + 1e-3)
    np.testing.assert_allclose(first.residual_px, 0.5 * expected, atol=0.05)
    assert first.noise_px == pytest.approx(0.2, rel=0.1)
    # Taken from either image the rays meet; what is left is noise.
    for bias in (first, second):
        mended = triangulate(MODELS[:2], ties.shifted(bias.product, -bias.bias_px), 0.2)
        for rest in relative_bias(ties, mended):
            assert np.hypot(*rest.residual_px) < 0.03


def test_relative_bias_of_three_images_shows_in_full() -> None:
    points = ground(1500, 18)
    rng = np.random.default_rng(19)
    models = [*MODELS, ParallelModel((0.4, 0.0)), ParallelModel((-0.4, 0.1))]
    images = [image + rng.normal(0, 0.2, image.shape) for image in seen(models, points)]
    images[2] = images[2] + (1.5, -2.5)
    ties = ties_of(images)
    bias = relative_bias(ties, triangulate(models, ties, 0.2))[2]
    assert len(bias.observable) == 2
    np.testing.assert_allclose(bias.bias_px, (1.5, -2.5), atol=0.05)


def test_relative_bias_without_points_is_nan() -> None:
    ties = TiePoints(np.array([1]), np.array([0]), np.array([[5.0, 5.0]]))
    (bias,) = relative_bias(ties, triangulate(MODELS, ties))
    assert bias.count == 0
    assert np.all(np.isnan(bias.bias_px))


def test_arguments_that_are_none() -> None:
    ties = ties_of(seen(MODELS, ground(3, 20)))
    with pytest.raises(ArgumentError, match="product 2 of point"):
        triangulate(MODELS[:2], ties)
    with pytest.raises(ArgumentError, match="sigma_px"):
        triangulate(MODELS, ties, 0.0)
    with pytest.raises(ArgumentError, match="as many points"):
        triangulate_pairs(*MODELS[:2], np.zeros((2, 2)), np.zeros((3, 2)))
    blind = ParallelModel((0.0, 0.1), margin_px=-1e4)
    with pytest.raises(GeometryError, match="sees no ground"):
        triangulate([blind, NADIR], ties_of(seen(MODELS[:2], ground(3, 20))))
    nothing = triangulate(
        MODELS, TiePoints(np.array([], dtype=str), np.array([], dtype=int), np.empty((0, 2)))
    )
    assert len(nothing.ids) == 0
