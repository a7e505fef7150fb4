"""Forward intersection of rays: closed forms, invariances, scatter against covariance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.intersect import MIN_CONVERGENCE_RAD, intersect_pairs, intersect_rays
from geoposition.rays import Rays

PLACE = np.array([0.6, 0.7, 400.0])
CENTRE = geodetic_to_ecef(PLACE)
R_ECEF_ENU = enu_axes(PLACE)
SKY_KM = np.array([[0.0, -280.0, 700.0], [60.0, 250.0, 690.0], [-150.0, 20.0, 705.0]])


def rays_from(origin: np.ndarray, target: np.ndarray) -> Rays:
    direction = target - origin
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return Rays(origin, direction, np.zeros(len(origin), dtype=np.uint8))


def scene(n: int, seed: int) -> tuple[np.ndarray, list[Rays]]:
    """Ground points (n, 3) and their rays from three places in the sky."""
    rng = np.random.default_rng(seed)
    ground = CENTRE + rng.uniform(-8e3, 8e3, (n, 3)) @ R_ECEF_ENU.T
    skies = [CENTRE + R_ECEF_ENU @ (1e3 * sky) + rng.normal(0, 500, (n, 3)) for sky in SKY_KM]
    return ground, [rays_from(sky, ground) for sky in skies]


def bundled(bundle: list[Rays]) -> tuple[Rays, np.ndarray]:
    """Rays of one origin after the other, by point."""
    origin = np.stack([rays.origin_ecef_m for rays in bundle], axis=1).reshape(-1, 3)
    direction = np.stack([rays.direction_ecef for rays in bundle], axis=1).reshape(-1, 3)
    flag = np.stack([rays.flag for rays in bundle], axis=1).reshape(-1)
    n = len(bundle[0].flag)
    return Rays(origin, direction, flag), len(bundle) * np.arange(n + 1)


def turned(rays: Rays, angle_rad: np.ndarray) -> Rays:
    direction = Rotation.from_rotvec(angle_rad).apply(rays.direction_ecef)
    return Rays(rays.origin_ecef_m, direction, rays.flag)


def test_skew_lines_meet_in_the_middle_of_their_perpendicular() -> None:
    """Two rays whose common perpendicular is known by construction: from P − d n to P + d n."""
    east, north, up = R_ECEF_ENU.T
    miss = 3.0
    a = rays_from((CENTRE + 5e5 * up - miss * east)[None], (CENTRE - miss * east)[None])
    b_target = CENTRE + miss * east
    b = rays_from((b_target + 5e5 * up + 2e5 * north)[None], b_target[None])
    found = intersect_pairs(a, b)
    np.testing.assert_allclose(geodetic_to_ecef(found.geodetic)[0], CENTRE, atol=1e-7)
    assert found.miss_m[0] == pytest.approx(2.0 * miss, abs=1e-8)
    # Variances 1 : 4 divide the perpendicular 1 : 4, nearer to the better ray.
    found = intersect_pairs(a, b, sigma_a_m=1.0, sigma_b_m=2.0)
    expected = CENTRE - miss * east + 2.0 * miss * east / 5.0
    np.testing.assert_allclose(geodetic_to_ecef(found.geodetic)[0], expected, atol=1e-7)


def test_pairs_in_closed_form_equal_least_squares() -> None:
    _, (a, b, _) = scene(400, 1)
    rng = np.random.default_rng(2)
    b = turned(b, rng.normal(0.0, 3e-6, (400, 3)))
    for sigma_b in (1.0, 2.5):
        pairs = intersect_pairs(a, b, 1.0, sigma_b)
        rays, start = bundled([a, b])
        many = intersect_rays(rays, start, np.tile([1.0, sigma_b], 400))
        assert np.all(pairs.flag == Flag.OK)
        np.testing.assert_allclose(
            geodetic_to_ecef(pairs.geodetic), geodetic_to_ecef(many.geodetic), atol=2e-8
        )
        residual = many.residual_m.reshape(-1, 2)
        np.testing.assert_allclose(residual.sum(axis=1), pairs.miss_m, atol=1e-8)
        np.testing.assert_allclose(
            residual[:, 1], sigma_b**2 * residual[:, 0], rtol=1e-6, atol=1e-9
        )


def test_rays_that_meet_satisfy_the_thesis_equations() -> None:
    """T (2.4)–(2.6), with the minus signs that K lost, solved by NumPy."""
    ground, bundle = scene(20, 3)
    rays, start = bundled(bundle[:2])
    found = geodetic_to_ecef(intersect_rays(rays, start).geodetic)
    for i in range(20):
        rows, right = [], []
        for k in range(start[i], start[i + 1]):
            (x, y, z), (ux, uy, uz) = rays.origin_ecef_m[k], rays.direction_ecef[k]
            rows += [[uz, 0.0, -ux], [0.0, uz, -uy]]
            right += [uz * x - ux * z, uz * y - uy * z]
        thesis = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
        np.testing.assert_allclose(found[i], thesis, atol=1e-6)
        np.testing.assert_allclose(found[i], ground[i], atol=1e-7)


def test_bundles_of_any_size_equal_numpy() -> None:
    rng = np.random.default_rng(4)
    counts = np.array([2, 7, 3, 2, 5])
    start = np.concatenate([[0], np.cumsum(counts)])
    ground = CENTRE + rng.uniform(-5e3, 5e3, (5, 3)) @ R_ECEF_ENU.T
    total = int(start[-1])
    sky = rng.uniform((-3e5, -3e5, 5e5), (3e5, 3e5, 7e5), (total, 3))
    target = np.repeat(ground, counts, axis=0)
    rays = turned(rays_from(CENTRE + sky @ R_ECEF_ENU.T, target), rng.normal(0, 4e-6, (total, 3)))
    sigma = rng.uniform(0.3, 3.0, total)
    found = intersect_rays(rays, start, sigma)
    for i in range(5):
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for k in range(start[i], start[i + 1]):
            across = np.eye(3) - np.outer(rays.direction_ecef[k], rays.direction_ecef[k])
            normal += across / sigma[k] ** 2
            right += across @ (rays.origin_ecef_m[k] - CENTRE) / sigma[k] ** 2
        expected = CENTRE + np.linalg.solve(normal, right)
        np.testing.assert_allclose(geodetic_to_ecef(found.geodetic[i]), expected, atol=1e-7)
        turn = enu_axes(found.geodetic[i])
        covariance = turn.T @ np.linalg.inv(normal) @ turn
        np.testing.assert_allclose(found.covariance_enu_m2[i], covariance, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(found.rays, counts)


@settings(max_examples=40)
@given(st.permutations(range(3)), st.integers(0, 10_000))
def test_order_of_the_rays_does_not_matter(order: list[int], seed: int) -> None:
    _, bundle = scene(3, seed)
    rng = np.random.default_rng(seed)
    bundle = [turned(rays, rng.normal(0.0, 5e-6, (3, 3))) for rays in bundle]
    straight = intersect_rays(*bundled(bundle))
    other = intersect_rays(*bundled([bundle[k] for k in order]))
    np.testing.assert_allclose(
        geodetic_to_ecef(other.geodetic), geodetic_to_ecef(straight.geodetic), atol=2e-8
    )
    np.testing.assert_allclose(other.covariance_enu_m2, straight.covariance_enu_m2, rtol=1e-8)
    np.testing.assert_array_equal(other.convergence_rad, straight.convergence_rad)


@settings(max_examples=40)
@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.integers(0, 10_000))
def test_turning_the_frame_turns_the_point(turn: tuple[float, ...], seed: int) -> None:
    _, bundle = scene(4, seed)
    rng = np.random.default_rng(seed)
    bundle = [turned(rays, rng.normal(0.0, 5e-6, (4, 3))) for rays in bundle]
    R = Rotation.from_rotvec(turn)

    def all_turned(rays: Rays) -> Rays:
        return Rays(R.apply(rays.origin_ecef_m), R.apply(rays.direction_ecef), rays.flag)

    pairs = intersect_pairs(bundle[0], bundle[1])
    pairs_turned = intersect_pairs(all_turned(bundle[0]), all_turned(bundle[1]))
    np.testing.assert_allclose(
        geodetic_to_ecef(pairs_turned.geodetic),
        R.apply(geodetic_to_ecef(pairs.geodetic)),
        atol=5e-8,
    )
    many = intersect_rays(*bundled(bundle))
    many_turned = intersect_rays(*bundled([all_turned(rays) for rays in bundle]))
    np.testing.assert_allclose(
        geodetic_to_ecef(many_turned.geodetic), R.apply(geodetic_to_ecef(many.geodetic)), atol=5e-8
    )
    np.testing.assert_allclose(
        np.trace(many_turned.covariance_enu_m2, axis1=1, axis2=2),
        np.trace(many.covariance_enu_m2, axis1=1, axis2=2),
        rtol=1e-8,
    )


@pytest.mark.parametrize("rays_per_point", [2, 3])
def test_scatter_agrees_with_covariance(rays_per_point: int) -> None:
    n, sigma = 6000, np.array([0.4, 0.9, 0.6])[:rays_per_point]
    ground, bundle = scene(n, 5)
    rng = np.random.default_rng(6)
    noisy = []
    for rays, s in zip(bundle[:rays_per_point], sigma, strict=True):
        shift = rng.normal(0.0, s, (n, 3))
        u = rays.direction_ecef
        shift -= np.sum(shift * u, axis=1, keepdims=True) * u
        noisy.append(Rays(rays.origin_ecef_m + shift, u, rays.flag))
    found = intersect_rays(*bundled(noisy), np.tile(sigma, n))
    off = geodetic_to_ecef(found.geodetic) - ground
    off = np.einsum("nji,nj->ni", enu_axes(found.geodetic), off)
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(found.covariance_enu_m2), off)
    low, high = chi2.ppf([0.025, 0.975], 3 * n) / n
    assert low < nees.mean() < high
    assert np.mean(nees < chi2.ppf(0.95, 3)) == pytest.approx(0.95, abs=0.01)


def test_expected_misses_are_flagged_and_touch_nothing_else() -> None:
    ground, (a, b, c) = scene(6, 7)
    b_direction = b.direction_ecef.copy()
    b_direction[0] = a.direction_ecef[0] + 0.5 * MIN_CONVERGENCE_RAD * R_ECEF_ENU[:, 0]
    b_direction[0] /= np.linalg.norm(b_direction[0])
    b_direction[1] = -b.direction_ecef[1]
    b_flag = np.array([0, 0, Flag.OUTSIDE_MODEL, Flag.OUTSIDE_IMAGE, 0, 0], dtype=np.uint8)
    b_direction[2] = np.nan
    bad = Rays(b.origin_ecef_m, b_direction, b_flag)
    expected = [Flag.WEAK_GEOMETRY, Flag.NO_INTERSECTION, Flag.OUTSIDE_MODEL]
    expected += [Flag.OUTSIDE_IMAGE, Flag.OK, Flag.OK]
    pairs = intersect_pairs(a, bad)
    many = intersect_rays(*bundled([a, bad]))
    for found in (pairs, many):
        np.testing.assert_array_equal(found.flag, expected)
        assert np.all(np.isnan(found.geodetic[:3]))
        np.testing.assert_allclose(geodetic_to_ecef(found.geodetic[3:]), ground[3:], atol=1e-7)
    assert np.all(np.isnan(pairs.miss_m[:3]))
    assert np.all(np.isnan(many.residual_m[:6]))
    # A third ray saves the point whose second one is lost.
    three = intersect_rays(*bundled([a, bad, c]))
    assert three.flag[2] == Flag.OK
    assert three.rays[2] == 2
    assert np.isnan(three.residual_m[7])
    np.testing.assert_allclose(geodetic_to_ecef(three.geodetic[2]), ground[2], atol=1e-7)


def test_too_few_rays() -> None:
    _, (a, b, _) = scene(1, 8)
    rays, _ = bundled([a, b])
    found = intersect_rays(rays, [0, 0, 1, 2])
    np.testing.assert_array_equal(found.flag, [Flag.TOO_FEW_RAYS] * 3)
    np.testing.assert_array_equal(found.rays, [0, 1, 1])
    lone = intersect_rays(
        Rays(rays.origin_ecef_m, rays.direction_ecef, np.array([0, 3], dtype=np.uint8)), [0, 2]
    )
    assert lone.flag[0] == Flag.BAD_INPUT
    assert (
        len(intersect_rays(Rays(np.empty((0, 3)), np.empty((0, 3)), lone.flag[:0]), [0]).flag) == 0
    )


def test_geodetic_coordinates_all_over_the_earth_in_one_batch() -> None:
    """The pair kernel's own conversion, across the date line, at poles, far apart and together."""
    rng = np.random.default_rng(9)
    near = np.column_stack(
        [
            rng.uniform(3.13, 3.15, 3000),
            rng.uniform(-0.02, 0.02, 3000),
            rng.uniform(-5e3, 9e3, 3000),
        ]
    )
    everywhere = np.column_stack(
        [
            rng.uniform(-np.pi, np.pi, 3000),
            np.arcsin(rng.uniform(-1, 1, 3000)),
            rng.uniform(-5e3, 9e3, 3000),
        ]
    )
    polar = np.column_stack(
        [
            rng.uniform(-np.pi, np.pi, 500),
            0.5 * np.pi - np.abs(rng.normal(0, 1e-3, 500)),
            np.zeros(500),
        ]
    )
    ground = geodetic_to_ecef(np.concatenate([near, everywhere, polar]))
    up = ground / np.linalg.norm(ground, axis=1, keepdims=True)
    side = np.cross(up, [0.3, -0.5, 0.8])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    a = rays_from(ground + 6e5 * up + 2e5 * side, ground)
    b = rays_from(ground + 6e5 * up - 2e5 * side, ground)
    found = intersect_pairs(a, b)
    assert np.all(found.flag == Flag.OK)
    expected = ecef_to_geodetic(ground)
    np.testing.assert_allclose(geodetic_to_ecef(found.geodetic), ground, atol=3e-8)
    np.testing.assert_allclose(found.geodetic[:, 2], expected[:, 2], atol=2e-8)
    assert np.all(np.abs(found.geodetic[:, 0]) <= np.pi)


def test_arguments_that_are_none() -> None:
    _, (a, b, _) = scene(3, 10)
    short = Rays(b.origin_ecef_m[:2], b.direction_ecef[:2], b.flag[:2])
    with pytest.raises(ArgumentError, match="equal length"):
        intersect_pairs(a, short)
    with pytest.raises(ArgumentError, match="positive sigmas"):
        intersect_pairs(a, b, sigma_a_m=0.0)
    for start in ([0, 2], [1, 3], [0, 2, 1, 3]):
        with pytest.raises(ArgumentError, match="start"):
            intersect_rays(a, start)
    with pytest.raises(ArgumentError, match="sigma_m"):
        intersect_rays(a, [0, 3], np.array([1.0, -1.0, 1.0]))
