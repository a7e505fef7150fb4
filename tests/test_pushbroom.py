"""The rigorous model: there and back, rays, flags, independence of points, finite geometry."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import EPOCH, JITTERED, Orbit, build, focal_plane
from scipy.spatial.transform import Rotation

from geoposition.attitude import Attitude
from geoposition.corrections import NO_CORRECTIONS
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, ConvergenceError, GeometryError
from geoposition.flags import Flag, has_result
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel
from geoposition.sensors.line_camera import Mounting

ROUND_TRIP_PX = 1e-5

FAST_JITTER = {"jitter": JITTERED, "attitude_step_s": 1e-3}
POLAR = np.pi / 2
SCENES = {
    "nadir": {},
    "roll 35": {"roll_deg": 35.0},
    "roll 55": {"roll_deg": -55.0},
    "roll, pitch, yaw, agile": {
        "roll_deg": 30.0,
        "pitch_deg": -25.0,
        "yaw_deg": 40.0,
        "pitch_rate_rad_s": 5e-3,
    },
    "reverse": {"timing": "reverse", "roll_deg": 10.0},
    "line table with kinks": {"timing": "table"},
    "reverse line table": {"timing": "reverse table", "roll_deg": -35.0},
    "jitter, slerp": FAST_JITTER,
    "jitter, spline": {**FAST_JITTER, "attitude": "spline", "roll_deg": 35.0},
    "jitter, lagrange": {**FAST_JITTER, "attitude": "lagrange", "timing": "reverse table"},
    "angles": {"camera": "angles"},
    "collinear": {"camera": "collinear", "roll_deg": -20.0},
    "spline camera": {"camera": "spline"},
    "table of 12000": {"camera": "table", "shape": (3000, 12000)},
    "north pole": {"orbit": Orbit.over(0.5, POLAR, inclination_rad=POLAR), "camera": "table"},
    "south pole": {"orbit": Orbit.over(-2.0, -POLAR, inclination_rad=POLAR), "roll_deg": 0.5},
    "antimeridian": {"orbit": Orbit.over(np.pi, -0.2), "shape": (3000, 3000)},
    "elliptic": {"orbit": Orbit.over(1.0, 0.4, 300e3, eccentricity=0.1)},
    "from 26600 km, e = 0.74": {"orbit": Orbit(26600e3, 0.74, 1.1, 0.2, 0.3, 0.02), "gsd_m": 5.0},
    "swath of 900 km": {"shape": (8000, 30000), "gsd_m": 30.0},
    "one line": {"shape": (1, 1500)},
    "one sample": {"shape": (1500, 1)},
    "10 x 10": {"shape": (10, 10)},
    "one pixel": {"shape": (1, 1)},
    "strip of 100,000 lines": {"shape": (100_000, 6000), "roll_deg": 20.0},
    "jittered strip": {"shape": (100_000, 6000), **FAST_JITTER},
    "strip of 1,000,000 lines": {"shape": (1_000_000, 12000)},
    "pixels of 1 cm": {"gsd_m": 0.01},
    "times far from the epoch": {"middle_s": 86400.0},
}


def round_trip(model: PushbroomModel, px: np.ndarray, heights: np.ndarray) -> float:
    """Worst pixel difference, image to ground to image; all points must be found."""
    located = model.image_to_ground(px, heights)
    assert np.all(has_result(located.flag)), np.unique(located.flag)
    back = model.ground_to_image(located.geodetic)
    assert np.array_equal(back.flag, located.flag)
    return float(np.abs(back.image_px - px).max())


@pytest.fixture(scope="module")
def nadir() -> PushbroomModel:
    return build().model()


@pytest.fixture(scope="module")
def oblique() -> PushbroomModel:
    return build(roll_deg=35.0, camera="table", **FAST_JITTER).model()  # type: ignore[arg-type]


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("margin_px", [0.0, 99.0])
def test_image_ground_image(name: str, margin_px: float) -> None:
    scene = build(**SCENES[name])  # type: ignore[arg-type]
    grid = scene.grid(19, margin_px)
    assert round_trip(scene.model(), grid.image_px, grid.height_m) < ROUND_TRIP_PX


@pytest.mark.parametrize("name", ["nadir", "roll 35", "jitter, slerp", "strip of 100,000 lines"])
def test_the_very_edge_of_the_margin(name: str) -> None:
    scene = build(**SCENES[name])  # type: ignore[arg-type]
    margin = max(100.0, 0.05 * scene.camera.shape[0])
    side = max(100.0, 0.05 * scene.camera.shape[1])
    line = np.linspace(-margin, scene.camera.shape[0] - 1 + margin, 41)
    sample = np.linspace(-side, scene.camera.shape[1] - 1 + side, 41)
    px = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1).reshape(-1, 2)
    assert round_trip(scene.model(), px, np.full(len(px), 100.0)) < ROUND_TRIP_PX


def test_image_edge_where_the_ephemeris_begins() -> None:
    # The orbit data begin with line 0 and end with the last line, to the bit.
    scene = build((500, 500))
    timing = scene.camera.timing
    times = timing.time_s(np.linspace(0.0, 499.0, 12))
    ephemeris = Ephemeris.lagrange(EPOCH, times, scene.orbit.earth_fixed(times)[0])
    model = PushbroomModel(
        scene.camera, ephemeris, scene.attitude, scene.corrections, scene.height_range_m
    )
    px = np.stack(np.meshgrid([0.0, 250.0, 499.0], np.arange(500.0)), axis=-1).reshape(-1, 2)
    assert round_trip(model, px, np.full(len(px), 0.0)) < ROUND_TRIP_PX
    assert np.all(model.image_to_ground([[-0.4, 1.0], [499.4, 1.0]], 0.0).flag == 2)


@settings(max_examples=25)
@given(
    roll=st.floats(-50, 50),
    pitch=st.floats(-35, 35),
    yaw=st.floats(-180, 180),
    longitude=st.floats(-np.pi, np.pi),
    latitude=st.floats(-1.4, 1.4),
    lines=st.integers(1, 3000),
    samples=st.integers(1, 3000),
    kind=st.sampled_from(["forward", "reverse", "table", "reverse table"]),
)
def test_any_scene_goes_there_and_back(
    roll: float,
    pitch: float,
    yaw: float,
    longitude: float,
    latitude: float,
    lines: int,
    samples: int,
    kind: str,
) -> None:
    scene = build(
        (lines, samples),
        orbit=Orbit.over(longitude, latitude),
        roll_deg=roll,
        pitch_deg=pitch,
        yaw_deg=yaw,
        timing=kind,  # type: ignore[arg-type]
    )
    grid = scene.grid(5, 20.0)
    model = scene.model()
    located = model.image_to_ground(grid.image_px, grid.height_m)
    # With the yaw near 90 degrees all pixels of the row lie one behind the other.
    if abs(np.cos(np.deg2rad(yaw))) > 0.2 and np.hypot(roll, pitch) < 58:
        assert round_trip(model, grid.image_px, grid.height_m) < ROUND_TRIP_PX
    height = ecef_to_geodetic(geodetic_to_ecef(located.geodetic))[:, 2]
    assert np.allclose(height, grid.height_m, atol=1e-6)


def test_ground_image_ground(oblique: PushbroomModel) -> None:
    rng = np.random.default_rng(3)
    px = rng.uniform(0, 1, (5000, 2)) * (np.array(oblique.shape) - 1)
    ground = oblique.image_to_ground(px, rng.uniform(-400, 9000, 5000)).geodetic
    ground = ground + rng.uniform(-1, 1, ground.shape) * [1e-6, 1e-6, 5.0]
    image = oblique.ground_to_image(ground)
    assert np.all(has_result(image.flag))
    again = oblique.image_to_ground(image.image_px, ground[:, 2])
    gap = geodetic_to_ecef(again.geodetic) - geodetic_to_ecef(ground)
    assert np.linalg.norm(gap, axis=-1).max() < 1e-5


# Several CCDs ------------------------------------------------------------------------------


@pytest.mark.parametrize("stagger_px", [0.0, 300.0])
def test_ccds_side_by_side(stagger_px: float) -> None:
    ccds = focal_plane(5, 400, 0.7 / 600e3, 0.0, stagger_px)
    scene = build((3000, 2000), ccds=ccds, roll_deg=15.0)
    grid = scene.grid(40, 50.0)
    located = scene.model().image_to_ground(grid.image_px, grid.height_m)
    back = scene.model().ground_to_image(located.geodetic)
    found = has_result(back.flag)
    # At a seam the field of view of a staggered CCD begins elsewhere at each height: a pixel
    # may be seen twice or its ground be lost; there it is checked on the ground.
    again = scene.model().image_to_ground(back.image_px[found], grid.height_m[found])
    gap = geodetic_to_ecef(again.geodetic) - geodetic_to_ecef(located.geodetic[found])
    assert np.linalg.norm(gap, axis=-1).max() < 1e-5
    near_seam = np.abs((grid.image_px[:, 1] + 0.5 + 200) % 400 - 200) < 3.0
    near_seam &= (grid.image_px[:, 1] > 100) & (grid.image_px[:, 1] < 1900)
    inner = found & ~near_seam
    assert np.all(found[~near_seam])
    assert np.abs(back.image_px - grid.image_px)[inner].max() < ROUND_TRIP_PX


def test_overlapping_ccds_return_a_pixel_that_sees_the_point() -> None:
    scene = build((2000, 5 * 400), ccds=focal_plane(5, 400, 0.7 / 600e3, 40.0, 100.0))
    grid = scene.grid(60)
    model = scene.model()
    located = model.image_to_ground(grid.image_px, grid.height_m)
    back = model.ground_to_image(located.geodetic)
    # Beyond the last line of one CCD the point may be seen by its neighbour only.
    assert np.all(has_result(back.flag))
    again = model.image_to_ground(back.image_px, grid.height_m)
    gap = geodetic_to_ecef(again.geodetic) - geodetic_to_ecef(located.geodetic)
    assert np.linalg.norm(gap, axis=-1).max() < 1e-5
    twice = np.abs(back.image_px - grid.image_px).max(axis=-1) > 1e-5
    assert 0 < twice.mean() < 0.25


def test_points_in_a_gap_between_ccds_are_lost_and_others_are_not() -> None:
    whole = build((1000, 2000), ccds=focal_plane(1, 2000, 0.7 / 600e3, 0.0, 0.0)).model()
    # Two CCDs of 900 and a gap of 200 between them.
    split = build((1000, 1800), ccds=focal_plane(2, 900, 0.7 / 600e3, -200.0, 0.0)).model()
    sample = np.linspace(0, 1999, 400)
    px = np.stack([np.full(400, 500.0), sample], axis=-1)
    ground = whole.image_to_ground(px, 0.0).geodetic
    image = split.ground_to_image(ground)
    in_gap = (sample > 899.6) & (sample < 1099.4)
    outside = (sample > 899.4) & (sample < 1099.6) & ~in_gap
    assert np.all(image.flag[in_gap] == Flag.OUTSIDE_MODEL)
    assert np.all(np.isnan(image.image_px[in_gap]))
    seen = ~in_gap & ~outside
    assert np.all(image.flag[seen] == Flag.OK)
    expected = np.where(sample < 1000, sample, sample - 200)
    # The centre of the two fields of view differs by nothing: 2000 pixels of width each.
    assert np.abs(image.image_px[seen, 1] - expected[seen]).max() < 1e-5


def test_many_narrow_ccds_over_a_long_strip() -> None:
    ccds = focal_plane(20, 150, 0.7 / 600e3, 0.0, 0.0)
    scene = build((200_000, 3000), ccds=ccds, jitter=JITTERED[2:])
    grid = scene.grid(50)
    inner = np.abs((grid.image_px[:, 1] + 0.5 + 75) % 150 - 75) > 0.6
    inner |= (grid.image_px[:, 1] < 10) | (grid.image_px[:, 1] > 2990)
    assert round_trip(scene.model(), grid.image_px[inner], grid.height_m[inner]) < ROUND_TRIP_PX


# Rays --------------------------------------------------------------------------------------


def test_rays_meet_the_located_points(oblique: PushbroomModel) -> None:
    rng = np.random.default_rng(4)
    px = rng.uniform(0, 1, (3000, 2)) * (np.array(oblique.shape) - 1)
    heights = rng.uniform(-400, 9000, 3000)
    rays = oblique.rays(px, heights)
    ground = geodetic_to_ecef(oblique.image_to_ground(px, heights).geodetic)
    assert np.all(rays.flag == Flag.OK)
    assert np.abs(np.linalg.norm(rays.direction_ecef, axis=-1) - 1).max() < 4e-16
    distance = np.linalg.norm(ground - rays.origin_ecef_m, axis=-1)
    assert np.abs(rays.at(distance) - ground).max() < 1e-8
    times = oblique.camera.timing.time_s(px[:, 0])
    assert np.abs(rays.origin_ecef_m - oblique.ephemeris.position_m(times)).max() < 2e-6
    up = enu_axes(oblique.image_to_ground(px, heights).geodetic)[..., 2]
    assert np.all(np.sum(up * rays.direction_ecef, axis=-1) < 0)


def test_ray_at_one_range(nadir: PushbroomModel) -> None:
    ray = nadir.rays([[10.0, 20.0]], 0.0)
    assert ray.at(1000.0).shape == (1, 3)  # type: ignore[arg-type]


def test_ray_of_one_height_is_good_at_others(oblique: PushbroomModel) -> None:
    # Straight against bent and dragged along: centimetres over 1 km of height.
    px = np.array([[100.0, 200.0]])
    ground = geodetic_to_ecef(oblique.image_to_ground(px, 1000.0).geodetic)
    ray = oblique.rays(px, 0.0)
    distance = np.sum((ground - ray.origin_ecef_m) * ray.direction_ecef, axis=-1)
    assert 0 < np.linalg.norm(ray.at(distance) - ground) < 0.5


# Flags -------------------------------------------------------------------------------------


def test_bad_image_points_and_heights(nadir: PushbroomModel) -> None:
    lines, samples = nadir.shape
    cases = [
        ([0.0, 0.0], 0.0, Flag.OK),
        ([-0.5, -0.5], 0.0, Flag.OK),
        ([-0.51, 0.0], 0.0, Flag.OUTSIDE_IMAGE),
        ([lines - 0.5, samples - 0.5], 0.0, Flag.OK),
        ([0.0, samples - 0.49], 0.0, Flag.OUTSIDE_IMAGE),
        ([-100.0, 0.0], 0.0, Flag.OUTSIDE_IMAGE),
        ([-100.01, 0.0], 0.0, Flag.OUTSIDE_MODEL),
        ([0.0, samples + 100.0], 0.0, Flag.OUTSIDE_MODEL),
        ([1e300, 0.0], 0.0, Flag.OUTSIDE_MODEL),
        ([np.nan, 0.0], 0.0, Flag.BAD_INPUT),
        ([0.0, np.inf], 0.0, Flag.BAD_INPUT),
        ([-np.inf, 0.0], 0.0, Flag.BAD_INPUT),
        ([0.0, 0.0], np.nan, Flag.BAD_INPUT),
        ([0.0, 0.0], -np.inf, Flag.BAD_INPUT),
        ([0.0, 0.0], 700e3, Flag.NO_INTERSECTION),
        ([0.0, 0.0], 1e300, Flag.NO_INTERSECTION),
        # No point on Earth, below what `ground_to_image` takes too.
        ([0.0, 0.0], -1.1e5, Flag.BAD_INPUT),
        ([0.0, 0.0], -6.4e6, Flag.BAD_INPUT),
        ([0.0, 0.0], -1e7, Flag.BAD_INPUT),
        ([0.0, 0.0], -1e300, Flag.BAD_INPUT),
        ([0.0, 0.0], -9e4, Flag.OK),
    ]
    px, heights, flags = (np.array(column) for column in zip(*cases, strict=True))
    located = nadir.image_to_ground(px, heights)
    assert located.flag.tolist() == flags.tolist()
    assert np.array_equal(np.isfinite(located.geodetic).all(axis=-1), has_result(located.flag))
    assert np.array_equal(np.isnan(located.geodetic).all(axis=-1), ~has_result(located.flag))
    rays = nadir.rays(px, heights)
    assert rays.flag.tolist() == flags.tolist()
    for numbers in (rays.origin_ecef_m, rays.direction_ecef):
        assert np.array_equal(np.isnan(numbers).all(axis=-1), ~has_result(rays.flag))
        assert np.array_equal(np.isfinite(numbers).all(axis=-1), has_result(rays.flag))


@pytest.mark.parametrize("first", [np.nan, np.inf, -1e300, -1e7])
def test_a_bad_first_height_spoils_no_other(first: float) -> None:
    # Without refraction too, where the atmosphere's factor is not computed point by point.
    for corrections in (NO_CORRECTIONS, build().corrections):
        model = build((50, 50), corrections=corrections).model()
        located = model.image_to_ground([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]], [first, 0.0, 10.0])
        assert located.flag[1:].tolist() == [Flag.OK, Flag.OK]
        assert not has_result(located.flag[0])


def test_bad_ground_points(nadir: PushbroomModel) -> None:
    centre = nadir.image_to_ground([1000.0, 750.0], 0.0).geodetic
    camera = ecef_to_geodetic(nadir.rays([1000.0, 750.0], 0.0).origin_ecef_m)
    antipode = np.array([centre[0] + np.pi, -centre[1], 0.0])
    cases = [
        (centre, Flag.OK),
        (centre + [2 * np.pi, 0, 0], Flag.OK),
        (centre - [4 * np.pi, 0, 0], Flag.OK),
        (centre + [0, 0.1, 0], Flag.OUTSIDE_MODEL),
        (centre + [0, 0.001, 0], Flag.OUTSIDE_MODEL),
        (centre + [1.0, 0, 0], Flag.OUTSIDE_MODEL),
        (centre + [np.pi, 0, 0], Flag.OUTSIDE_MODEL),
        (antipode, Flag.OUTSIDE_MODEL),
        (centre * [1, 1, np.nan], Flag.BAD_INPUT),
        (centre + [np.inf, 0, 0], Flag.BAD_INPUT),
        (centre * [np.nan, 1, 1], Flag.BAD_INPUT),
        (centre * [1, np.nan, 1], Flag.BAD_INPUT),
        (np.array([centre[0], 1.6, 0.0]), Flag.BAD_INPUT),
        (np.array([45.0, 45.0, 0.0]), Flag.BAD_INPUT),
        (np.array([centre[0], np.pi / 2, 0.0]), Flag.OUTSIDE_MODEL),
        (np.array([centre[0], -np.pi / 2, 0.0]), Flag.OUTSIDE_MODEL),
        (centre + [0, 0, 1e300], Flag.BAD_INPUT),
        (centre + [0, 0, -2e5], Flag.BAD_INPUT),
        (centre + [0, 0, -5e4], Flag.OK),
    ]
    geodetic = np.stack([point for point, _ in cases])
    image = nadir.ground_to_image(geodetic)
    assert image.flag.tolist() == [flag for _, flag in cases]
    assert np.array_equal(np.isfinite(image.image_px).all(axis=-1), has_result(image.flag))
    assert np.array_equal(np.isnan(image.image_px).all(axis=-1), ~has_result(image.flag))
    above = nadir.ground_to_image([camera, camera + [0, 0, 10.0], camera + [0, 0, 1e5]])
    assert not np.any(has_result(above.flag))


def test_the_far_side_of_the_earth_is_not_seen(nadir: PushbroomModel) -> None:
    # The point where the line of sight would leave the Earth again lies before the camera too.
    model = build(roll_deg=35.0, corrections=NO_CORRECTIONS).model()
    ray = model.rays([[1000.0, 750.0]], 0.0)
    far = np.linspace(3e6, 1.2e7, 2000)
    points = ecef_to_geodetic(ray.origin_ecef_m + far[:, None] * ray.direction_ecef)
    exits = points[np.argmin(np.abs(points[:, 2]))]
    assert abs(exits[2]) < 5e3
    exits[2] = max(exits[2], -9e4)
    image = model.ground_to_image(exits)
    assert not has_result(image.flag)


def test_random_points_all_over_the_globe_are_flagged(nadir: PushbroomModel) -> None:
    rng = np.random.default_rng(5)
    n = 20_000
    anywhere = np.stack(
        [rng.uniform(-4, 4, n), np.arcsin(rng.uniform(-1, 1, n)), rng.uniform(-500, 9000, n)],
        axis=-1,
    )
    for model in (nadir, build((100_000, 6000), roll_deg=-40.0).model()):
        image = model.ground_to_image(anywhere)
        found = has_result(image.flag)
        assert np.array_equal(np.isfinite(image.image_px).all(axis=-1), found)
        again = model.image_to_ground(image.image_px[found], anywhere[found, 2])
        gap = geodetic_to_ecef(again.geodetic) - geodetic_to_ecef(anywhere[found])
        assert found.mean() < 0.01
        assert np.all(np.abs(gap) < 1e-4)


def test_horizon() -> None:
    # A swath that begins on the ground and ends in the sky.
    model = build((500, 6000), roll_deg=62.0, gsd_m=20.0).model()
    px = np.stack([np.full(6000, 250.0), np.arange(6000.0)], axis=-1)
    flag = model.image_to_ground(px, 0.0).flag
    seen = has_result(flag)
    edges = np.flatnonzero(np.diff(seen.astype(int)))
    assert len(edges) == 1
    assert set(flag[~seen]) == {Flag.NO_INTERSECTION}


def test_looking_away_from_the_earth_is_refused() -> None:
    with pytest.raises(GeometryError, match="miss the Earth"):
        build((100, 100), roll_deg=180.0).model()
    with pytest.raises(GeometryError, match="miss the Earth"):
        build((100, 100), pitch_deg=75.0).model()


# Independence of the points ------------------------------------------------------------------


@pytest.mark.parametrize("n", [0, 1, 2, 7, 8, 255, 256, 257, 4095, 4096, 4097, 5000])
def test_every_number_of_points(oblique: PushbroomModel, n: int) -> None:
    rng = np.random.default_rng(6)
    px = rng.uniform(0, 1, (5000, 2)) * (np.array(oblique.shape) - 1)
    heights = rng.uniform(-400, 9000, 5000)
    whole = oblique.image_to_ground(px, heights)
    part = oblique.image_to_ground(px[:n], heights[:n])
    assert part.geodetic.shape == (n, 3)
    assert part.flag.shape == (n,)
    assert np.array_equal(part.geodetic, whole.geodetic[:n])
    image = oblique.ground_to_image(part.geodetic)
    assert np.array_equal(image.image_px, oblique.ground_to_image(whole.geodetic).image_px[:n])
    rays = oblique.rays(px[:n], heights[:n])
    assert np.array_equal(rays.direction_ecef, oblique.rays(px, heights).direction_ecef[:n])


@pytest.mark.parametrize("where", [0, 1, 3, 100, 254, 255, 256, 257, 511, 999])
def test_bad_neighbours_change_nothing(oblique: PushbroomModel, where: int) -> None:
    rng = np.random.default_rng(7)
    px = rng.uniform(0, 1, (1000, 2)) * (np.array(oblique.shape) - 1)
    heights = rng.uniform(-400, 9000, 1000)
    good = oblique.image_to_ground(px, heights)
    others = np.arange(1000) != where
    for bad_px, bad_height in (
        ([np.nan, 0.0], 0.0),
        ([np.inf, np.inf], np.inf),
        ([1e9, -1e9], 0.0),
        ([5.0, 5.0], 1e9),
        ([5.0, 5.0], np.nan),
    ):
        mixed_px, mixed_heights = px.copy(), heights.copy()
        mixed_px[where], mixed_heights[where] = bad_px, bad_height
        mixed = oblique.image_to_ground(mixed_px, mixed_heights)
        assert not has_result(mixed.flag[where])
        assert np.array_equal(mixed.geodetic[others], good.geodetic[others])
        assert np.array_equal(mixed.flag[others], good.flag[others])
        rays = oblique.rays(mixed_px, mixed_heights)
        assert np.array_equal(
            rays.direction_ecef[others], oblique.rays(px, heights).direction_ecef[others]
        )
    image = oblique.ground_to_image(good.geodetic)
    for bad_point in ([np.nan] * 3, [0.0, 0.0, 0.0], [9.0, 9.0, 9.0], [1.0, 1.0, 1e200]):
        ground = good.geodetic.copy()
        ground[where] = bad_point
        mixed_image = oblique.ground_to_image(ground)
        assert not has_result(mixed_image.flag[where])
        assert np.array_equal(mixed_image.image_px[others], image.image_px[others])
        assert np.array_equal(mixed_image.flag[others], image.flag[others])


def test_half_of_the_points_bad(oblique: PushbroomModel) -> None:
    rng = np.random.default_rng(8)
    px = rng.uniform(0, 1, (3000, 2)) * (np.array(oblique.shape) - 1)
    ground = oblique.image_to_ground(px, 50.0).geodetic
    image = oblique.ground_to_image(ground)
    bad = rng.random(3000) < 0.5
    ground[bad] = [[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0], [3.0, -1.0, 1e3]][1]
    mixed = oblique.ground_to_image(ground)
    assert np.array_equal(mixed.image_px[~bad], image.image_px[~bad])
    assert np.all(mixed.flag[bad] == Flag.OUTSIDE_MODEL)


# Shapes ------------------------------------------------------------------------------------


def test_shapes_broadcast(nadir: PushbroomModel) -> None:
    one = nadir.image_to_ground([3.0, 4.0], 10.0)
    assert one.geodetic.shape == (3,)
    assert one.flag.shape == ()
    assert nadir.ground_to_image(one.geodetic).image_px.shape == (2,)
    assert nadir.ground_to_image(one.geodetic).flag.shape == ()
    px = np.arange(24.0).reshape(3, 4, 2)
    table = nadir.image_to_ground(px, 10.0)
    assert table.geodetic.shape == (3, 4, 3)
    assert table.flag.shape == (3, 4)
    heights = np.array([0.0, 10.0, 20.0, 30.0])
    rows = nadir.image_to_ground(px, heights)
    assert np.array_equal(rows.geodetic[..., 2], np.broadcast_to(heights, (3, 4)))
    fan = nadir.image_to_ground([3.0, 4.0], heights)
    assert fan.geodetic.shape == (4, 3)
    columns = nadir.image_to_ground(px, heights[:3, None])
    assert np.array_equal(columns.geodetic[..., 2], np.broadcast_to(heights[:3, None], (3, 4)))
    many = nadir.image_to_ground(px[:, None], heights[:2, None])
    assert many.geodetic.shape == (3, 2, 4, 3)
    assert np.array_equal(many.geodetic[:, 1], nadir.image_to_ground(px, 10.0).geodetic)
    assert nadir.rays(px, 10.0).at(np.full((3, 4), 1e5)).shape == (3, 4, 3)
    assert nadir.image_to_ground(np.empty((0, 2)), np.empty(0)).geodetic.shape == (0, 3)
    assert nadir.image_to_ground(np.empty((2, 0, 2)), 0.0).flag.shape == (2, 0)
    assert nadir.ground_to_image(np.empty((0, 3))).image_px.shape == (0, 2)


def test_any_memory_layout_gives_the_same(nadir: PushbroomModel) -> None:
    px = np.stack(np.meshgrid(np.arange(20.0), np.arange(30.0)), axis=-1)
    expected = nadir.image_to_ground(px, 5.0).geodetic
    frozen = px.copy()
    frozen.setflags(write=False)
    for other in (np.asfortranarray(px), frozen, px.astype(np.float32), px.astype(int)):
        assert np.array_equal(nadir.image_to_ground(other, 5.0).geodetic, expected)
    assert np.array_equal(nadir.image_to_ground(px.tolist(), 5.0).geodetic, expected)
    strided = np.repeat(px, 2, axis=0)[::2]
    assert np.array_equal(nadir.image_to_ground(strided, np.full((30, 20), 5)).geodetic, expected)
    ground = np.asfortranarray(expected)
    back = nadir.ground_to_image(expected).image_px
    assert np.array_equal(nadir.ground_to_image(ground).image_px, back)


def test_the_arguments_are_left_alone(nadir: PushbroomModel) -> None:
    px, heights = np.array([[1.0, 2.0], [np.nan, 3.0]]), np.array([1.0, 2.0])
    kept = px.copy(), heights.copy()
    ground = nadir.image_to_ground(px, heights).geodetic
    kept_ground = ground.copy()
    nadir.ground_to_image(ground)
    assert np.array_equal(px, kept[0], equal_nan=True)
    assert np.array_equal(heights, kept[1])
    assert np.array_equal(ground, kept_ground, equal_nan=True)


def test_misuse_raises(nadir: PushbroomModel) -> None:
    with pytest.raises(ArgumentError, match="image points"):
        nadir.image_to_ground([1.0, 2.0, 3.0], 0.0)
    with pytest.raises(ArgumentError, match="image points"):
        nadir.image_to_ground(1.0, 0.0)
    with pytest.raises(ArgumentError, match="ground points"):
        nadir.ground_to_image([1.0, 2.0])
    with pytest.raises(ArgumentError, match="does not fit"):
        nadir.image_to_ground(np.zeros((4, 2)), np.zeros(3))
    scene = build((10, 10))
    for heights in ((1.0, 0.0), (np.nan, 0.0), (0.0, np.nan), (0.0, 1e6)):
        with pytest.raises(ArgumentError, match="height range"):
            PushbroomModel(
                scene.camera, scene.ephemeris, scene.attitude, scene.corrections, heights
            )
    inertial = Ephemeris(EPOCH, scene.ephemeris.curve, "gcrs")
    with pytest.raises(ArgumentError, match="Earth-fixed"):
        PushbroomModel(scene.camera, inertial, scene.attitude, scene.corrections, (0.0, 1.0))


def test_orbit_data_elsewhere_are_refused() -> None:
    scene = build((100, 100))
    later = Ephemeris(EPOCH + 3600.0, scene.ephemeris.curve)
    with pytest.raises(GeometryError, match="none of the image"):
        PushbroomModel(scene.camera, later, scene.attitude, scene.corrections, (0.0, 1.0))


def test_epochs_are_taken_into_account() -> None:
    scene = build((100, 100))
    times = np.arange(-6.0, 7.0)
    shifted = Ephemeris.lagrange(EPOCH + 0.25, times - 0.25, scene.orbit.earth_fixed(times)[0])
    attitude = Attitude(EPOCH, scene.attitude.curve)
    model = PushbroomModel(scene.camera, shifted, attitude, scene.corrections, scene.height_range_m)
    grid = scene.grid(3)
    gap = geodetic_to_ecef(
        model.image_to_ground(grid.image_px, grid.height_m).geodetic
    ) - geodetic_to_ecef(scene.model().image_to_ground(grid.image_px, grid.height_m).geodetic)
    assert np.abs(gap).max() < 1e-5


def test_seconds_too_large_for_the_clock_are_refused_at_once() -> None:
    # 1e9 s from the epoch, a double counts in steps of 1e-7 s: 0.9 mm of flight.
    with pytest.raises(ConvergenceError, match="too rough"):
        build((100, 100), middle_s=1e9).model()


# Mounting and lever arm against finite geometry ------------------------------------------------


def test_lever_arm_moves_the_camera(nadir: PushbroomModel) -> None:
    arm = np.array([1.0, -2.0, 3.0])
    px = np.array([[300.0, 400.0], [1500.0, 20.0]])
    bare = build(corrections=NO_CORRECTIONS)
    moved = build(corrections=NO_CORRECTIONS, mounting=Mounting(lever_arm_body_m=arm)).model()
    rays, moved_rays = bare.model().rays(px, 0.0), moved.rays(px, 0.0)
    R_ecef_body = bare.attitude.rotation(bare.camera.timing.time_s(px[:, 0]))
    offset = moved_rays.origin_ecef_m - rays.origin_ecef_m
    assert np.abs(offset - R_ecef_body.apply(arm)).max() < 2e-6
    assert np.abs(moved_rays.direction_ecef - rays.direction_ecef).max() < 3e-12
    assert not np.shares_memory(offset, arm)
    assert nadir.shape == moved.shape


def test_mounting_turns_the_line_of_sight() -> None:
    turn = Rotation.from_rotvec([0.01, -0.02, 0.3])
    px = np.array([[300.0, 400.0], [1500.0, 20.0]])
    bare = build(corrections=NO_CORRECTIONS)
    turned = build(corrections=NO_CORRECTIONS, mounting=Mounting(turn)).model()
    tangents = bare.camera.tangents(0, px[:, 1])
    looks = np.concatenate([tangents, np.ones((2, 1))], axis=1)
    R_ecef_body = bare.attitude.rotation(bare.camera.timing.time_s(px[:, 0]))
    expected = R_ecef_body.apply(turn.apply(looks / np.linalg.norm(looks, axis=1)[:, None]))
    assert np.abs(turned.rays(px, 0.0).direction_ecef - expected).max() < 3e-12


def test_roll_moves_the_ground_point_sideways() -> None:
    # 10 µrad of roll at 600 km: 6 m across, towards the left for a positive turn about x.
    delta = 1e-5
    scene = build((100, 100), orbit=Orbit.over(0.0, 0.0, inclination_rad=np.pi / 2))
    rolled = build(
        (100, 100),
        orbit=Orbit.over(0.0, 0.0, inclination_rad=np.pi / 2),
        mounting=Mounting(Rotation.from_rotvec([delta, 0, 0])),
    )
    px = np.array([[49.5, 49.5]])
    a, b = (s.model().image_to_ground(px, 0.0).geodetic for s in (scene, rolled))
    # Flying north over the equator, left is west.
    shift = geodetic_to_ecef(b) - geodetic_to_ecef(a)
    assert shift[0] @ enu_axes(a[0])[:, 0] == pytest.approx(-delta * 600e3, rel=2e-3)


def test_camera_parameters_reach_the_ground() -> None:
    scene = build((100, 100))
    turned = scene.camera.with_parameters({"mounting_y_rad": 1e-5})
    model = PushbroomModel(
        turned, scene.ephemeris, scene.attitude, scene.corrections, scene.height_range_m
    )
    by_mounting = build((100, 100), mounting=Mounting(Rotation.from_rotvec([0, 1e-5, 0]))).model()
    px = np.array([[10.0, 20.0]])
    a, b = (m.image_to_ground(px, 0.0).geodetic for m in (model, by_mounting))
    assert np.abs(geodetic_to_ecef(a) - geodetic_to_ecef(b)).max() < 1e-6


# Whole ---------------------------------------------------------------------------------------


def test_it_is_a_sensor_model(nadir: PushbroomModel) -> None:
    assert isinstance(nadir, SensorModel)
    assert nadir.height_range_m == (-400.0, 9000.0)


def test_one_height_range_is_enough() -> None:
    scene = build((300, 300), height_range_m=(0.0, 0.0))
    grid = scene.grid(9, 90.0)
    assert round_trip(scene.model(), grid.image_px, grid.height_m) < ROUND_TRIP_PX


_RUN = """
import hashlib, json, sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from scenes import build
model = build(roll_deg=20.0).model()
px = np.random.default_rng(1).uniform(0, 1, (20000, 2)) * 1400
ground = model.image_to_ground(px, 100.0)
image = model.ground_to_image(ground.geodetic)
both = (ground.geodetic, image.image_px)
print(json.dumps([hashlib.sha256(a.tobytes()).hexdigest() for a in both]))
"""


def test_the_number_of_threads_changes_nothing() -> None:
    digests = []
    for threads in ("1", "2"):
        run = subprocess.run(
            [sys.executable, "-c", _RUN, str(Path(__file__).parent)],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "NUMBA_NUM_THREADS": threads},
        )
        digests.append(json.loads(run.stdout))
    assert digests[0] == digests[1]
