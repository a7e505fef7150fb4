"""The RPC model against plain formulas, finite differences, its own inverse and bad points."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.rpc.kernels_inverse import _locate_stubborn
from geoposition.rpc.model import RAY_ALTITUDE_M, RpcModel
from geoposition.sensor_model import SensorModel


def example(seed: int = 0, size: float = 1e-3, **changes: object) -> RpcModel:
    """A camera like those in orbit: nearly affine, oblique, with every coefficient at work."""
    rng = np.random.default_rng(seed)
    line_num, samp_num, line_den, samp_den = size * rng.normal(size=(4, 20))
    line_num[:4] += 0.0, 0.05, -1.05, 0.01
    samp_num[:4] += 0.0, 1.02, 0.02, -0.03
    line_den[0] = samp_den[0] = 1.0
    fields: dict[str, object] = {
        "line_off_px": 11999.5, "line_scale_px": 11999.5,
        "samp_off_px": 17999.5, "samp_scale_px": 17999.5,
        "lon_off_deg": 5.28, "lon_scale_deg": 0.13,
        "lat_off_deg": 44.13, "lat_scale_deg": 0.09,
        "height_off_m": 600.0, "height_scale_m": 700.0,
        "line_num": line_num, "line_den": line_den, "samp_num": samp_num, "samp_den": samp_den,
        "image_shape": (24000, 36000),
    }  # fmt: skip
    return RpcModel(**(fields | changes))  # type: ignore[arg-type]


def pixels(model: RpcModel, n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Random image points with the image's corners and edges among them, random heights."""
    rng = np.random.default_rng(seed)
    high = np.array(model.shape) - 0.5
    image = rng.uniform(-0.5, high, (n, 2))
    image[:4] = [[-0.5, -0.5], [-0.5, high[1]], [high[0], -0.5], high]
    image[4:20, 0] = -0.5
    image[20:40, 1] = high[1]
    return image, rng.uniform(*model.height_range_m, n)


# The powers of (L, P, H) of each term, written out from the table of RPC00B.
POWERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (2, 0, 0),
          (0, 2, 0), (0, 0, 2), (1, 1, 1), (3, 0, 0), (1, 2, 0), (1, 0, 2), (2, 1, 0), (0, 3, 0),
          (0, 1, 2), (2, 0, 1), (0, 2, 1), (0, 0, 3)]  # fmt: skip


def by_the_book(model: RpcModel, lon_deg: float, lat_deg: float, height_m: float) -> list[float]:
    """Project one point term by term, in degrees, in plain Python."""
    L = (lon_deg - model.lon_off_deg) / model.lon_scale_deg
    P = (lat_deg - model.lat_off_deg) / model.lat_scale_deg
    H = (height_m - model.height_off_m) / model.height_scale_m

    def cubic(c: np.ndarray) -> float:
        return sum(float(c[k]) * L**i * P**j * H**m for k, (i, j, m) in enumerate(POWERS))

    return [
        model.line_off_px + model.line_scale_px * cubic(model.line_num) / cubic(model.line_den),
        model.samp_off_px + model.samp_scale_px * cubic(model.samp_num) / cubic(model.samp_den),
    ]


def test_projection_is_the_ratio_of_cubics() -> None:
    model = example(size=1e-2)
    rng = np.random.default_rng(2)
    geodetic = np.stack(
        [rng.uniform(5.15, 5.41, 300), rng.uniform(44.04, 44.22, 300), rng.uniform(0, 1200, 300)],
        axis=1,
    )
    expected = np.array([by_the_book(model, *point) for point in geodetic])
    geodetic[:, :2] = np.radians(geodetic[:, :2])
    got = model.ground_to_image(geodetic)
    np.testing.assert_allclose(got.image_px, expected, rtol=0, atol=1e-7)
    assert set(np.unique(got.flag)) <= {Flag.OK, Flag.OUTSIDE_IMAGE}


def test_affine_model_has_a_closed_form_in_both_directions() -> None:
    zeros = np.zeros(20)
    line_num, samp_num, one = zeros.copy(), zeros.copy(), zeros.copy()
    line_num[2], samp_num[1], samp_num[3], one[0] = -1.0, 1.0, 0.25, 1.0
    model = example(line_num=line_num, line_den=one, samp_num=samp_num, samp_den=one)
    ground = model.image_to_ground([[0.0, 0.0], [11999.5, 17999.5]], 950.0)
    lat_deg = 44.13 + 0.09 * np.array([1.0, 0.0])
    lon_deg = 5.28 + 0.13 * (np.array([-1.0, 0.0]) - 0.25 * 0.5)
    np.testing.assert_allclose(np.degrees(ground.geodetic[:, 0]), lon_deg, rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.degrees(ground.geodetic[:, 1]), lat_deg, rtol=0, atol=1e-13)
    assert np.all(ground.geodetic[:, 2] == 950.0)


def test_image_to_ground_to_image() -> None:
    model = example(size=1e-2)
    image, height = pixels(model, 20_000)
    ground = model.image_to_ground(image, height)
    back = model.ground_to_image(ground.geodetic)
    assert not ground.flag.any()
    assert np.abs(back.image_px - image).max() < 1e-7


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**31),
    size=st.floats(0.0, 5e-3),
    signs=st.tuples(*[st.sampled_from([-1.0, 1.0])] * 5),
    lon_off_deg=st.floats(-180.0, 180.0),
    lat_off_deg=st.floats(-80.0, 80.0),
)
def test_round_trip_of_any_sane_model(
    seed: int,
    size: float,
    signs: tuple[float, ...],
    lon_off_deg: float,
    lat_off_deg: float,
) -> None:
    model = example(
        seed, size, lon_off_deg=lon_off_deg, lat_off_deg=lat_off_deg,
        line_scale_px=11999.5 * signs[0], samp_scale_px=17999.5 * signs[1],
        lon_scale_deg=0.13 * signs[2], lat_scale_deg=0.09 * signs[3],
        height_scale_m=700.0 * signs[4],
    )  # fmt: skip
    image, height = pixels(model, 200, seed=seed)
    ground = model.image_to_ground(image, height)
    back = model.ground_to_image(ground.geodetic)
    assert not ground.flag.any()
    assert np.abs(back.image_px - image).max() < 1e-6
    assert np.all(np.abs(ground.geodetic[:, 0]) <= np.pi)


def test_far_above_the_fitted_heights_the_inverse_still_holds() -> None:
    model = example(size=5e-3)
    image, _ = pixels(model, 2000)
    ground = model.image_to_ground(image, 3000.0)
    assert not ground.flag.any()
    assert np.abs(model.ground_to_image(ground.geodetic).image_px - image).max() < 1e-6


def test_step_control_ends_where_the_fast_path_does() -> None:
    model = example(size=1e-2)
    image, height = pixels(model, 200)
    ground = np.degrees(model.image_to_ground(image, height).geodetic[:, :2])
    for (line, samp), h, (lon, lat) in zip(image, height, ground, strict=True):
        L, P, done = _locate_stubborn(model._coefficients, model._parameters, line, samp, h)
        assert done
        assert lon == pytest.approx(5.28 + 0.13 * L, abs=1e-12)
        assert lat == pytest.approx(44.13 + 0.09 * P, abs=1e-12)


def test_jacobian_against_finite_differences() -> None:
    model = example(size=1e-2)
    image, height = pixels(model, 500)
    geodetic = model.image_to_ground(image, height).geodetic
    unbounded = example(size=1e-2, image_shape=None)
    steps = np.array([1e-7, 1e-7, 0.1])
    numeric = np.empty((500, 2, 3))
    for k in range(3):
        move = np.zeros(3)
        move[k] = steps[k]
        ahead = unbounded.ground_to_image(geodetic + move).image_px
        behind = unbounded.ground_to_image(geodetic - move).image_px
        numeric[:, :, k] = (ahead - behind) / (2.0 * steps[k])
    analytic = model.jacobian(geodetic)
    # In pixels per step (about a pixel for the angles).
    np.testing.assert_allclose(analytic * steps, numeric * steps, rtol=0, atol=1e-7)
    assert model.jacobian(geodetic[0]).shape == (2, 3)


def test_rays_go_through_their_point_along_the_curve_of_sight() -> None:
    model = example()
    image, height = pixels(model, 300)
    rays = model.rays(image, height)
    point = geodetic_to_ecef(model.image_to_ground(image, height).geodetic)
    along = np.einsum("ni,ni->n", point - rays.origin_ecef_m, rays.direction_ecef)
    assert np.abs(rays.at(along) - point).max() < 1e-7
    np.testing.assert_allclose(np.linalg.norm(rays.direction_ecef, axis=1), 1.0, atol=1e-15)
    # The chord between two heights around the point has the tangent's direction.
    upper = geodetic_to_ecef(model.image_to_ground(image, height + 0.5).geodetic)
    lower = geodetic_to_ecef(model.image_to_ground(image, height - 0.5).geodetic)
    chord = lower - upper
    chord /= np.linalg.norm(chord, axis=1, keepdims=True)
    assert np.abs(chord - rays.direction_ecef).max() < 1e-7
    up = enu_axes(model.image_to_ground(image, height).geodetic)[..., 2]
    above = np.einsum("ni,ni->n", rays.origin_ecef_m - point, up)
    np.testing.assert_allclose(above, RAY_ALTITUDE_M, rtol=0, atol=1e-6)
    assert np.all(np.einsum("ni,ni->n", rays.direction_ecef, up) < 0)
    assert np.all(ecef_to_geodetic(rays.origin_ecef_m)[:, 2] > RAY_ALTITUDE_M)


def test_antimeridian() -> None:
    west, east = example(lon_off_deg=-179.95), example(lon_off_deg=0.0)
    image, height = pixels(west, 500)
    there = west.image_to_ground(image, height)
    plain = east.image_to_ground(image, height)
    lon_deg = np.degrees(there.geodetic[:, 0])
    assert lon_deg.min() < -179.9
    assert lon_deg.max() > 179.9
    moved = np.degrees(plain.geodetic[:, 0]) - 179.95
    assert np.abs((lon_deg - moved + 180.0) % 360.0 - 180.0).max() < 1e-12
    assert np.abs(west.ground_to_image(there.geodetic).image_px - image).max() < 1e-6
    turned = there.geodetic + np.array([2.0 * np.pi, 0.0, 0.0])
    assert np.abs(west.ground_to_image(turned).image_px - image).max() < 1e-6


def test_a_batch_keeps_its_good_points() -> None:
    model = example()
    good = model.image_to_ground([100.0, 200.0], 500.0).geodetic
    outside = model.image_to_ground([-40.0, 200.0], 500.0).geodetic
    rows = [
        good,
        outside,
        good * [np.nan, 1, 1],
        good * [1, 1, np.inf],
        good + np.array([np.pi, 0, 0]),
        good - np.array([0, 0.3, 0]),
        [good[0], 2.0, 0.0],
        [good[0], -1.6, 0.0],
        good + np.array([0, 0, 1e6]),
        good,
    ]
    got = model.ground_to_image(np.array(rows))
    assert got.flag.tolist() == [
        Flag.OK, Flag.OUTSIDE_IMAGE, Flag.BAD_INPUT, Flag.BAD_INPUT, Flag.OUTSIDE_MODEL,
        Flag.OUTSIDE_MODEL, Flag.BAD_INPUT, Flag.BAD_INPUT, Flag.OUTSIDE_MODEL, Flag.OK,
    ]  # fmt: skip
    np.testing.assert_allclose(got.image_px[[0, 9]], [[100.0, 200.0]] * 2, atol=1e-7)
    np.testing.assert_allclose(got.image_px[1], [-40.0, 200.0], atol=1e-7)
    assert np.isnan(got.image_px[2:9]).all()


def test_bad_image_points_are_flagged() -> None:
    model = example()
    image = [[0.0, 0.0], [-0.51, 0.0], [23999.5, 35999.5], [23999.6, 0], [np.nan, 0], [0, np.inf]]
    got = model.image_to_ground([*image, [0.0, 0.0]], [0, 0, 0, 0, 0, 0, np.nan])
    assert got.flag.tolist() == [
        Flag.OK, Flag.OUTSIDE_IMAGE, Flag.OK, Flag.OUTSIDE_IMAGE,
        Flag.BAD_INPUT, Flag.BAD_INPUT, Flag.BAD_INPUT,
    ]  # fmt: skip
    assert np.isfinite(got.geodetic[:4]).all()
    assert np.isnan(got.geodetic[4:]).all()
    far = model.image_to_ground([1e7, 0.0], 0.0)
    assert far.flag in (Flag.OUTSIDE_MODEL, Flag.NOT_CONVERGED)
    rays = model.rays(image, 0.0)
    assert np.isnan(rays.origin_ecef_m[4:]).all()
    assert np.isnan(rays.direction_ecef[4:]).all()
    assert rays.flag.tolist() == got.flag[:6].tolist()


def test_image_points_that_no_ground_has_do_not_converge() -> None:
    line_num, line_den = np.zeros(20), np.zeros(20)
    line_num[2], line_den[0], line_den[8] = 1.0, 1.0, 0.25
    # The normalised line, P / (1 + P²/4), is at most 1: nothing on the ground has line 26000.
    model = example(line_num=line_num, line_den=line_den, image_shape=None)
    got = model.image_to_ground([[11999.5, 17999.5], [26000.0, 17999.5]], 600.0)
    assert got.flag.tolist() == [Flag.OK, Flag.NOT_CONVERGED]


def test_vanishing_denominator_is_outside_the_model() -> None:
    line_den = np.zeros(20)
    line_den[0], line_den[2] = 1.0, -0.8
    model = example(line_den=line_den)
    lat_deg = model.lat_off_deg + model.lat_scale_deg * np.array([0.0, 1.25, 1.5])
    geodetic = np.radians(np.stack([np.full(3, 5.28), lat_deg, np.zeros(3)], axis=1))
    geodetic[:, 2] = 600.0
    flags = model.ground_to_image(geodetic).flag
    assert flags.tolist() == [Flag.OK, Flag.OUTSIDE_MODEL, Flag.OUTSIDE_MODEL]


@pytest.mark.parametrize("n", [0, 1, 63, 64, 65, 128, 129, 8191, 8192, 8193, 20000])
def test_every_length_gives_what_single_points_give(n: int) -> None:
    model = example()
    image, height = pixels(model, 20000)
    whole = model.image_to_ground(image, height)
    part = model.image_to_ground(image[:n], height[:n])
    assert np.array_equal(part.geodetic, whole.geodetic[:n])
    back = model.ground_to_image(part.geodetic)
    assert back.image_px.shape == (n, 2)
    assert np.abs(back.image_px - image[:n]).max(initial=0.0) < 1e-6


def test_shapes_broadcast() -> None:
    model = example()
    image, height = pixels(model, 60)
    flat = model.image_to_ground(image, height)
    grid = model.image_to_ground(image.reshape(5, 12, 2), height.reshape(5, 12))
    assert np.array_equal(grid.geodetic.reshape(-1, 3), flat.geodetic)
    layers = model.image_to_ground(image[:, None], [0.0, 500.0])
    assert layers.geodetic.shape == (60, 2, 3)
    assert np.array_equal(layers.geodetic[:, 1], model.image_to_ground(image, 500.0).geodetic)
    assert model.image_to_ground(image[0], 0.0).flag.shape == ()
    strided = np.asfortranarray(np.repeat(flat.geodetic, 2, axis=0))[::2]
    assert np.abs(model.ground_to_image(strided).image_px - image).max() < 1e-6
    with pytest.raises(ArgumentError, match="height_m"):
        model.image_to_ground(image, [0.0, 1.0])
    with pytest.raises(ArgumentError, match="geodetic"):
        model.ground_to_image(image)


def test_unknown_shape_is_worked_out_and_flags_nothing() -> None:
    model = example(image_shape=None)
    assert not model.shape_known
    assert model.shape == (24000, 36000) == example().shape
    ground = model.image_to_ground([[-300.0, 5.0]], 500.0)
    assert ground.flag.tolist() == [Flag.OK]
    assert model.ground_to_image(ground.geodetic).flag.tolist() == [Flag.OK]
    assert model.with_shape((10, 20)).shape == (10, 20)
    assert model.height_range_m == (-100.0, 1300.0)


def test_crop_moves_the_pixels_and_clips_nothing() -> None:
    whole = example()
    crop = whole.cropped(20_000, 30_000, (500, 400))
    image, height = pixels(crop, 500)
    ours = crop.image_to_ground(image, height)
    theirs = whole.image_to_ground(image + np.array([20_000, 30_000]), height)
    assert np.abs(ours.geodetic - theirs.geodetic).max() < 1e-13 * 700.0
    assert crop.shape == (500, 400)
    # The same crop normalised to itself: normalised coordinates far outside ±1.
    tight = example(
        line_scale_px=119.995, line_num=100.0 * whole.line_num,
        samp_scale_px=179.995, samp_num=100.0 * whole.samp_num,
    ).cropped(20_000, 30_000, (500, 400))  # fmt: skip
    again = tight.image_to_ground(image, height)
    assert np.abs(again.geodetic - ours.geodetic)[:, :2].max() < 1e-14
    assert not again.flag.any()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"line_scale_px": 0.0}, "line_scale_px"),
        ({"height_off_m": np.nan}, "height_off_m"),
        ({"samp_num": np.zeros(19)}, "samp_num"),
        ({"line_den": np.full(20, np.inf)}, "line_den"),
        ({"samp_num": np.zeros(20)}, "inverse"),
        ({"line_den": np.zeros(20)}, "inverse"),
        ({"image_shape": (0, 5)}, "image_shape"),
    ],
)
def test_unusable_models_are_refused(changes: dict[str, object], named: str) -> None:
    with pytest.raises(ArgumentError, match=named):
        example(**changes)


def test_the_model_is_a_frozen_sensor_model() -> None:
    model = example()
    assert isinstance(model, SensorModel)
    with pytest.raises(AttributeError):
        model.line_off_px = 1.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        model.line_num[0] = 1.0
    image, height = pixels(model, 50)
    twin = pickle.loads(pickle.dumps(model))
    assert np.array_equal(
        twin.image_to_ground(image, height).geodetic, model.image_to_ground(image, height).geodetic
    )
    with pytest.raises(ArgumentError, match="direct"):
        model.direct_image_to_ground(image, height)
