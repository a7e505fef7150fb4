"""RPC fits: the algebra, planted ratios, extreme scenes, motion, control points, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scenes import Jitter, Orbit, build
from test_rpc_model import example

from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import Flag
from geoposition.rpc.compare import compare
from geoposition.rpc.fit import fit_model, fit_samples
from geoposition.rpc.fit_basis import EXPONENTS, legendre, monomials, products, substitution
from geoposition.rpc.fit_columns import affine_parts
from geoposition.rpc.fit_control import fit_control
from geoposition.rpc.fit_grid import Normalisation, virtual_grid
from geoposition.rpc.fit_kernels import moments
from geoposition.rpc.fit_ratio import fit_inverse
from geoposition.rpc.fit_solve import SOUND, FitOptions, _Fit, fit_ratios
from geoposition.rpc.start import cubic_terms
from geoposition.sensor_model import GroundPoints


def cube(n: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (3, n))


def ratio_targets(x: np.ndarray) -> np.ndarray:
    """Two targets that are ratios of cubics, near x[0] and x[1]."""
    den = 1.0 + 0.02 * x[2] + 0.01 * x[0] * x[1] - 0.004 * x[1] ** 3
    other = 1.0 - 0.03 * x[1] + 0.01 * x[2] ** 2
    return np.stack([
        (x[0] + 0.05 * x[2] ** 2 - 0.02 * x[0] * x[1] * x[2]) / den,
        (x[1] + 0.1 * x[0] * x[2] + 0.03) / other,
    ])  # fmt: skip


# the algebra -------------------------------------------------------------------------------


def test_the_basis_is_orthonormal_over_the_cube() -> None:
    node, weight = leggauss(6)
    x = np.stack([g.ravel() for g in np.meshgrid(node, node, node, indexing="ij")])
    w = np.prod(np.meshgrid(weight, weight, weight, indexing="ij"), axis=0).ravel() / 8.0
    values = legendre(3) @ monomials(x)
    np.testing.assert_allclose((values * w) @ values.T, np.eye(20), atol=1e-13)


def test_the_first_twenty_monomials_are_rpc00bs() -> None:
    x = cube(50)
    np.testing.assert_allclose(monomials(x).T, cubic_terms(*x), rtol=1e-15)
    assert len(EXPONENTS) == len(set(EXPONENTS)) == 165


def test_products_and_substitutions_are_exact() -> None:
    x = cube(40)
    wide = monomials(x, 8)
    for i, j in ((5, 11), (19, 34), (34, 34)):
        np.testing.assert_allclose(wide[products(35, 35)[i, j]], wide[i] * wide[j], rtol=1e-12)
    rng = np.random.default_rng(5)
    matrix, shift, c = rng.normal(size=(3, 3)), rng.normal(size=3), rng.normal(size=20)
    there = c @ monomials(matrix @ x + shift[:, None])
    np.testing.assert_allclose((substitution(matrix, shift) @ c) @ monomials(x), there, atol=1e-11)


@pytest.mark.parametrize("newton", [False, True])
def test_moments_are_those_of_plain_sums(newton: bool) -> None:
    from geoposition.rpc.fit_basis import recipe

    x, rng = cube(1001), np.random.default_rng(1)
    target = ratio_targets(x)
    weight = rng.uniform(0.5, 2.0, target.shape)
    affine = affine_parts(x, target, np.ones(x.shape[1]))
    num, den = rng.normal(size=(2, 20)), 0.01 * rng.normal(size=(2, 20))
    den[:, 0] = 1.0
    sizes = np.array([165, 120, 84, 35, 20])
    sums, squares, extremes = moments(x, target, weight, affine, num, den, newton, *recipe(), sizes)
    mono = monomials(x, 8)
    for axis in range(2):
        d = den[axis] @ mono[:20] if newton else np.ones(x.shape[1])
        f = num[axis] @ mono[:20] / d if newton else target[axis]
        delta, e, p = f - affine[axis] @ mono[:4], target[axis] - f, weight[axis]
        plain = (p / d**2, p / d**2 * delta, p / d**2 * delta**2, p * e / d, p * e / d * delta)
        for i, w in enumerate(plain):
            np.testing.assert_allclose(
                sums[axis, i, : sizes[i]], mono[: sizes[i]] @ w, rtol=1e-10, atol=1e-9
            )
        assert squares[axis] == pytest.approx(np.sum(p * e * e), abs=1e-12)
        np.testing.assert_allclose(extremes[axis], [d.min(), d.max()], rtol=1e-13)


@pytest.mark.parametrize("denominators", ["separate", "equal"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_result_minimises_the_true_residual_and_the_damping(
    denominators: str, degree: int
) -> None:
    """Finite differences of Σ e² + λ |D − 1|² about the result, in every parameter."""
    x = cube(3000)
    rng = np.random.default_rng(2)
    target = ratio_targets(x) + 1e-3 * rng.normal(size=(2, 3000))
    unit = np.array([1000.0, 700.0])
    options = FitOptions(degree=degree, denominators=denominators, minimise_maximum=False)  # type: ignore[arg-type]
    fit = _Fit(x, target, unit, options, np.ones(3000))
    fit.least[:] = 1e3
    weights = np.ones((2, 3000))
    for _ in range(3):
        fit.iterate(weights)
    mono = monomials(x)

    def objective(parameters: list[np.ndarray], of: dict[int, np.ndarray]) -> float:
        total = 0.0
        for i in of:
            num, den = fit.columns[i].ratio(parameters[i])
            e = target[i] - (num @ mono) / (den @ mono)
            total += unit[i] ** 2 * np.mean(e * e)
        return total + fit.strength[next(iter(of))] * np.sum(parameters[next(iter(of))][free:] ** 2)

    free = int(fit.free.sum())
    for system, damped in zip(fit.systems, fit.damped(weights), strict=True):
        best = damped.solve(float(fit.strength[next(iter(system))]))
        steps = np.eye(len(best)) * 1e-6
        middle = objective({i: best[p] for i, p in system.items()}, system)  # type: ignore[arg-type]
        for step in steps:
            ups = [
                objective({i: (best + s * step)[p] for i, p in system.items()}, system)  # type: ignore[arg-type]
                for s in (1.0, -1.0)
            ]
            curvature = (ups[0] + ups[1] - 2.0 * middle) / 1e-12
            slope = (ups[0] - ups[1]) / 2e-6
            # The minimum is within a hundredth of what moves the mean square by its own size.
            assert abs(slope) <= 0.01 * np.sqrt(max(curvature, 1e-9) * middle)


def test_a_planted_ratio_comes_back() -> None:
    x = cube(4000)
    fit = fit_ratios(x, ratio_targets(x), np.array([1e4, 1e4]), FitOptions())
    # The damping may cost `floor` in the rms, and ten times as much at the corners.
    assert np.sqrt(np.mean(fit.residual**2)) * 1e4 < 2.0 * FitOptions().floor
    assert np.abs(fit.residual).max() * 1e4 < 20.0 * FitOptions().floor
    assert np.all(fit.den_range > SOUND[0])
    assert np.all(fit.den_range < SOUND[1])


def test_the_damping_keeps_what_is_not_needed_out() -> None:
    """An affine camera has no denominators, and gets none."""
    x = cube(4000)
    target = np.stack([x[0] + 0.1 * x[2], x[1]])
    fit = fit_ratios(x, target, np.array([1e4, 1e4]), FitOptions())
    np.testing.assert_allclose(fit.den_range, 1.0, atol=1e-9)


def test_the_covariance_is_the_scatter() -> None:
    """Predicted places scatter, over noisy fits, as the coefficients' covariance says."""
    ground, rng = cube(400), np.random.default_rng(11)
    image = ratio_targets(ground)
    unit, sigma = np.array([1000.0, 1000.0]), 2e-3
    options = FitOptions(degree=2, minimise_maximum=False, least_strength=1.0)
    at = monomials(cube(6, seed=8))
    places, predicted = [], []
    for _ in range(150):
        fitted = fit_inverse(ground, image + sigma * rng.normal(size=image.shape), unit, options)
        values = (fitted.num @ at) / (fitted.den @ at)
        places.append(values)
        by_num = at / (fitted.den @ at)[:, None]
        rows = np.concatenate([by_num, -(values[:, None] * by_num)[:, 1:]], axis=1)
        predicted.append(np.einsum("akn,akl,aln->an", rows, fitted.covariance, rows))
    ratio = np.var(places, axis=0, ddof=1) / np.mean(predicted, axis=0)
    # 150 runs: a variance is known to 12 %.
    assert np.all((ratio > 0.65) & (ratio < 1.5)), ratio


# scenes ------------------------------------------------------------------------------------

SCENES = {
    "plain": {},
    "steep": {"roll_deg": 35.0, "shape": (20000, 12000)},
    "steep both ways": {"roll_deg": 35.0, "pitch_deg": 25.0, "shape": (20000, 12000)},
    "long strip": {"shape": (100_000, 12_000)},
    "long coarse strip": {"shape": (100_000, 12_000), "gsd_m": 2.0},
    "tiny crop": {"shape": (500, 500)},
    "tiny steep crop": {"shape": (500, 500), "roll_deg": 35.0, "pitch_deg": 20.0},
    "narrow strip": {"shape": (40_000, 500), "roll_deg": 30.0, "yaw_deg": 40.0},
    "latitude 80": {"orbit": Orbit.over(0.2, np.radians(80.0)), "shape": (20000, 12000)},
    "latitude 89": {
        "orbit": Orbit.over(0.2, np.radians(89.0), inclination_rad=np.radians(90.0)),
        "shape": (20000, 12000),
    },
    "antimeridian": {"orbit": Orbit.over(np.pi, 0.3), "shape": (20000, 12000)},
    "slew": {"pitch_rate_rad_s": np.radians(1.0), "shape": (20000, 12000)},
    "wide swath": {"shape": (20000, 12000), "gsd_m": 20.0},
}  # fmt: skip


@pytest.mark.parametrize("heights", [(-400.0, 9000.0), (0.0, 0.0)], ids=["relief", "sea level"])
@pytest.mark.parametrize("name", SCENES)
def test_every_smooth_scene_is_followed(name: str, heights: tuple[float, float]) -> None:
    model = build(**SCENES[name]).model()  # type: ignore[arg-type]
    fit = fit_model(model, heights)
    check = fit.check
    assert check is not None
    assert check.missed == 0
    # IKONOS-era bound: 0.04 px; none comes near it.
    assert check.largest_px < 0.01
    assert check.direct is not None
    assert max(axis.max for axis in check.direct) < 0.02
    assert check.den_range[:, 0].min() > 0.5
    assert check.cube_range[:, 0].min() > 0.0
    for part in ("line_den", "samp_den"):
        assert getattr(fit.model, part)[0] == 1.0
        assert np.abs(getattr(fit.model, part)[1:]).max() < 0.3
    assert fit.warnings == ()
    again = compare(
        model, fit.model, heights_m=np.linspace(*fit.region.height_m, 4), grid=(9, 9, 4)
    )
    assert max(again.row.max, again.col.max) < 0.01


@pytest.mark.parametrize("name", ["plain", "steep", "antimeridian", "latitude 80"])
def test_one_denominator_serves_both_axes(name: str) -> None:
    fit = fit_model(build(**SCENES[name]).model(), denominators="equal")  # type: ignore[arg-type]
    assert fit.check is not None
    assert fit.check.largest_px < 0.04
    np.testing.assert_array_equal(fit.model.line_den, fit.model.samp_den)


def test_lower_degrees_are_worse_and_say_so() -> None:
    model = build((20000, 12000)).model()
    largest = []
    for degree in (3, 2, 1):
        fit = fit_model(model, degree=degree, limit_px=1e3)
        assert fit.check is not None
        largest.append(fit.check.largest_px)
        beyond = {1: slice(4, None), 2: slice(10, None), 3: slice(20, None)}[degree]
        assert not np.any(fit.model.line_num[beyond])
        assert not np.any(fit.model.samp_den[beyond])
    assert largest[0] < largest[1] < largest[2]
    with pytest.raises(GeometryError, match="misses the model by up to"):
        fit_model(model, degree=1, limit_px=0.5 * largest[2])


def test_the_pole_is_refused_with_the_reason() -> None:
    orbit = Orbit.over(0.2, np.radians(89.99), inclination_rad=np.radians(90.0))
    with pytest.raises(GeometryError, match="around a pole"):
        fit_model(build((20000, 12000), orbit=orbit).model())


def test_longitudes_do_not_break_at_the_antimeridian() -> None:
    model = build((20000, 12000), orbit=Orbit.over(np.pi, 0.3)).model()
    fit = fit_model(model)
    assert -180.0 <= fit.model.lon_off_deg <= 180.0
    assert fit.model.lon_scale_deg < 0.5
    first, last = fit.region.lon_deg
    assert first < last < first + 1.0
    image = np.array([[100.0, 50.0], [100.0, 11950.0], [19900.0, 50.0], [19900.0, 11950.0]])
    lon = model.image_to_ground(image, 500.0).geodetic[:, 0]
    assert lon.min() < -3.0 < 3.0 < lon.max()
    direct = fit.model.direct_image_to_ground(image, 500.0)
    np.testing.assert_allclose(direct[:, 0], lon, atol=1e-11)


def test_sea_level_alone_gets_heights_to_stand_on() -> None:
    fit = fit_model(build().model(), (0.0, 0.0))
    assert fit.region.height_m == (-50.0, 50.0)
    assert fit.model.height_range_m == (-50.0, 50.0)


def test_a_crop_and_a_whole_image_agree() -> None:
    """What a 500 px crop's RPC says is what the whole image's says there."""
    whole = build((8000, 6000)).model()
    rpc = fit_model(whole).model
    crop = rpc.cropped(3000, 2000, (500, 500))
    fit = fit_model(crop)
    assert fit.check is not None
    assert fit.check.largest_px < 1e-4
    px = np.array([[10.0, 20.0], [480.0, 470.0]])
    a = fit.model.image_to_ground(px, 1000.0).geodetic
    b = whole.image_to_ground(px + (3000.0, 2000.0), 1000.0).geodetic
    np.testing.assert_allclose(a, b, atol=1e-11)


# motion ------------------------------------------------------------------------------------

MOTION = (Jitter(0, 6e-7, 0.8, 0.3), Jitter(1, 4e-7, 1.1, 1.0))


def test_motion_shows_line_by_line_and_the_maximum_is_kept_low() -> None:
    model = build((30000, 8000), jitter=MOTION).model()
    fit = fit_model(model)
    check = fit.check
    assert check is not None
    assert check.largest_px > 0.1
    # The misfit depends on the line alone.
    mean = check.difference_px.mean(axis=(0, 2))
    np.testing.assert_allclose(
        check.difference_px, np.broadcast_to(mean[None, :, None], check.difference_px.shape),
        atol=0.1 * check.largest_px,
    )  # fmt: skip
    assert len(check.profile_line_px) > 10_000
    at = np.interp(check.line_px, check.profile_line_px, check.profile_px[:, 0])
    np.testing.assert_allclose(at[1:-1], mean[1:-1, 0], atol=0.1 * check.largest_px)
    assert check.den_range.min() > SOUND[0] - 0.02
    assert check.den_range.max() < SOUND[1] + 0.02
    samples = virtual_grid(model, model.height_range_m, (151, 11, 7))
    normal = Normalisation.of(samples, model.shape)
    plain = fit_inverse(
        normal.ground(samples), normal.image(samples), normal.image_scale_px,
        FitOptions(minimise_maximum=False),
    )  # fmt: skip
    squares = np.abs(plain.ratios.residual).max(axis=1) * normal.image_scale_px
    assert check.row.max <= squares[0] * 1.02
    assert check.col.max <= squares[1] * 1.02


# samples and control points ----------------------------------------------------------------


def test_samples_and_model_give_one_rpc() -> None:
    model = build((6000, 4000)).model()
    samples = virtual_grid(model, (-400.0, 9000.0), (40, 11, 7))
    fit = fit_samples(samples.image_px.T, samples.geodetic.T, shape=model.shape)
    found = compare(model, fit.model)
    assert max(found.row.max, found.col.max) < 1e-3
    assert fit.points == samples.image_px.shape[1]
    assert max(fit.rms_px) < 1e-4


def control(n: int, sigma_px: float, seed: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Points of a plain scene on rolling ground, measured with an error."""
    model, rng = build((6000, 4000), roll_deg=15.0).model(), np.random.default_rng(seed)
    image = rng.uniform(0.0, 1.0, (n, 2)) * model.shape
    height = 300.0 + 250.0 * np.sin(image[:, 0] / 900.0) * np.cos(image[:, 1] / 700.0)
    ground = model.image_to_ground(image, height).geodetic
    return image + sigma_px * rng.normal(size=image.shape), ground


@pytest.mark.parametrize("n", [12, 30, 100])
@pytest.mark.parametrize("denominators", ["separate", "equal"])
def test_control_points_give_a_tame_rpc_that_knows_its_error(n: int, denominators: str) -> None:
    image, ground = control(n, 0.3)
    found = fit_control(image, ground, shape=(6000, 4000), denominators=denominators)  # type: ignore[arg-type]
    check_image, check_ground = control(400, 0.0, seed=9)
    missed = found.fit.model.ground_to_image(check_ground).image_px - check_image
    true = np.sqrt(np.mean(missed**2))
    said = np.sqrt(np.mean(found.leave_one_out_px**2))
    # What is said includes the points' own errors of 0.3 px.
    assert 0.4 < said / np.hypot(true, 0.3) < 2.0
    assert np.sqrt(np.mean(found.residual_px**2)) < said
    back = image - found.fit.model.ground_to_image(ground).image_px
    np.testing.assert_allclose(back, found.residual_px, atol=1e-6)


@pytest.mark.parametrize(("n", "bound_px"), [(12, 1.0), (30, 0.5), (100, 0.25)])
@pytest.mark.parametrize("denominators", ["separate", "equal"])
def test_control_points_give_a_good_rpc_over_many_draws(
    n: int, bound_px: float, denominators: str
) -> None:
    """One draw of 12 noisy points scatters from 0.57 to 1.26 px: the bound is on their RMS."""
    check_image, check_ground = control(400, 0.0, seed=9)
    squares = []
    for seed in range(20):
        image, ground = control(n, 0.3, seed=seed)
        found = fit_control(image, ground, shape=(6000, 4000), denominators=denominators)  # type: ignore[arg-type]
        missed = found.fit.model.ground_to_image(check_ground).image_px - check_image
        squares.append(np.mean(missed**2))
    assert np.sqrt(np.mean(squares)) < bound_px


def test_leaving_a_point_out_is_fitting_without_it() -> None:
    image, ground = control(60, 0.5)
    image[7] += (6.0, -4.0)
    whole = fit_control(image, ground, degree=1)
    rest = np.arange(60) != 7
    without = fit_control(image[rest], ground[rest], degree=1)
    alone = image[7] - without.fit.model.ground_to_image(ground[7]).image_px
    np.testing.assert_allclose(whole.leave_one_out_px[7], alone, rtol=0.05)


def test_weights_turn_a_bad_point_off() -> None:
    image, ground = control(60, 0.05)
    image[3] += 50.0
    sigma = np.full(60, 0.05)
    sigma[3] = 1e3
    found = fit_control(image, ground, sigma)
    assert np.abs(found.residual_px[rest_of(60, 3)]).max() < 0.5
    assert np.abs(found.residual_px[3]).min() > 45.0


def rest_of(n: int, k: int) -> np.ndarray:
    return np.arange(n) != k


# refusals and statements ---------------------------------------------------------------------


def test_unusable_input_is_refused() -> None:
    model = build().model()
    for options in ({"degree": 4}, {"nodes": (4, 10, 10)}):
        with pytest.raises(ArgumentError):
            fit_model(model, **options)  # type: ignore[arg-type]
    for heights in ((100.0, 0.0), (np.nan, 1.0), (0.0, 2e5)):
        with pytest.raises(ArgumentError, match="heights"):
            fit_model(model, heights)
    image, ground = control(9, 0.0)
    with pytest.raises(ArgumentError, match="at least 10"):
        fit_control(image, ground)
    with pytest.raises(ArgumentError, match="at least 40"):
        fit_samples(image, ground)
    image, ground = control(50, 0.0)
    with pytest.raises(ArgumentError, match="sigma_px"):
        fit_control(image, ground, np.zeros(50))
    with pytest.raises(ArgumentError, match="finite"):
        fit_samples(np.full_like(image, np.nan), ground)
    with pytest.raises(ArgumentError, match="as many"):
        fit_samples(image[:45], ground)


def test_a_model_that_does_not_answer_is_refused_with_the_reason() -> None:
    model = build().model()

    class Blind:
        shape = model.shape
        height_range_m = model.height_range_m

        def image_to_ground(self, image_px: np.ndarray, height_m: np.ndarray) -> GroundPoints:
            found = model.image_to_ground(image_px, height_m)
            flag = found.flag.copy()
            flag[..., : flag.shape[-1] // 2] = Flag.NO_INTERSECTION
            return GroundPoints(found.geodetic, flag)

    with pytest.raises(GeometryError, match="no_intersection"):
        fit_model(Blind())  # type: ignore[arg-type]


def test_random_points_are_refused_or_tame() -> None:
    rng = np.random.default_rng(0)
    image = rng.uniform(0.0, 5000.0, (200, 2))
    ground = np.stack([rng.uniform(0.1, 0.101, 200), rng.uniform(0.5, 0.501, 200),
                       rng.uniform(0.0, 500.0, 200)], axis=1)  # fmt: skip
    try:
        fit = fit_samples(image, ground)
    except GeometryError:
        return
    assert np.abs(fit.model.line_den[1:]).max() < 1.0
    assert min(fit.rms_px) > 500.0


def test_the_region_is_stated_and_known() -> None:
    fit = fit_model(build((2000, 1500)).model(), (0.0, 1000.0))
    region = fit.region
    assert region.line_px == (-0.5, 1999.5)
    assert region.samp_px == (-0.5, 1499.5)
    assert region.height_m == (0.0, 1000.0)
    assert "heights 0 .. 1000 m" in region.statement()
    outside = region.outside([[10.0, 10.0], [10.0, 10.0], [-1.0, 10.0]], [500.0, 1500.0, 500.0])
    assert outside.tolist() == [False, True, True]
    assert fit.model.validity == region.validity
    assert fit.as_dict()["region"] == region.statement()


def test_normalisation_fits_fixed_width_fields_and_gives_the_size_back() -> None:
    for shape in ((2000, 1501), (501, 500)):
        fit = fit_model(build(shape).model(), (0.0, 500.0))
        model = fit.model
        assert replace(model, image_shape=None).shape == shape
        for name in ("line_off_px", "line_scale_px", "samp_off_px", "height_off_m"):
            assert getattr(model, name) == int(getattr(model, name))
        assert round(model.lat_off_deg * 1e4) / 1e4 == model.lat_off_deg


def test_an_rpc_is_fitted_like_any_model() -> None:
    reference = example()
    fit = fit_model(reference)
    assert fit.check is not None
    assert fit.check.largest_px < 1e-3


def test_the_benchmark_compares_before_it_times() -> None:
    from geoposition.scripts.bench.measure import measure
    from geoposition.scripts.bench.rpc_fit import QUICK_NODES, rpc_fit_case

    result = measure(rpc_fit_case(build((6000, 4000)).model(), "plain", QUICK_NODES), 2)
    ours, _, plain = result.rows
    assert ours.mpoint_s is not None
    assert plain.difference is not None
    assert plain.difference < 0.1
