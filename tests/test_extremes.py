"""Where numbers go wrong first: poles, ±180°, the horizon, odd clocks, odd shapes of images."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import erfa
import numpy as np
import pytest
import scenes
import shapely
from scenes import Orbit, Scene, build

from geoposition.calib_fields.synthetic import synthetic_terrain
from geoposition.datum import to_crs
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.error_budget import image_budget
from geoposition.errors import EarthOrientationError, GeometryError, GeopositionError
from geoposition.flags import Flag
from geoposition.frames import matrix_itrs_gcrs
from geoposition.intersect import intersect_pairs
from geoposition.locate import locate
from geoposition.longitudes import middle_of, unbroken
from geoposition.pushbroom import PushbroomModel
from geoposition.rays import Rays
from geoposition.reimage.ortho_grid import OrthoGrid
from geoposition.rpc.fit import fit_model
from geoposition.scripts.cli import run
from geoposition.scripts.footprint import footprint
from geoposition.sensors.writers.model_file import write_model_file
from geoposition.surface import map_extent, near_degrees
from geoposition.terrain import ConstantTerrain, RasterTerrain
from geoposition.timescale import Epoch

SHAPE = (700, 600)
HALF_TURN = np.pi
POLAR = np.radians(90.0)


def pole(lat_deg: float, **more: float) -> Scene:
    return build(SHAPE, orbit=Orbit.over(0.5, np.radians(lat_deg), inclination_rad=POLAR), **more)


SCENES = {
    "nadir": lambda: build(SHAPE),
    "latitude 82, inclination 97.8": lambda: build(SHAPE, orbit=Orbit.over(0.5, np.radians(82.15))),
    "towards the pole from inclination 97.8": lambda: build(
        SHAPE, orbit=Orbit.over(0.5, np.radians(82.1)), roll_deg=-50.0
    ),
    "latitude 89.9": lambda: pole(89.9),
    "across the north pole": lambda: pole(89.9999, gsd_m=2.0),
    "across the south pole": lambda: pole(-89.9999, gsd_m=2.0),
    "across the antimeridian": lambda: build(SHAPE, orbit=Orbit.over(HALF_TURN, 0.3)),
    "antimeridian at latitude 82": lambda: build(
        SHAPE, orbit=Orbit.over(HALF_TURN, np.radians(82.0))
    ),
    "60 degrees to the right": lambda: build(SHAPE, roll_deg=-60.0),
    "60 degrees to the left": lambda: build(SHAPE, roll_deg=60.0),
    "60 degrees ahead": lambda: build(SHAPE, pitch_deg=60.0),
    "one row": lambda: build((1, 600)),
    "one column": lambda: build((700, 1)),
    "one pixel": lambda: build((1, 1)),
}
REFUSED_BY_RPC = {
    "across the north pole": "around a pole",
    "across the south pole": "around a pole",
}


@pytest.fixture(scope="module")
def scenes_by_name() -> dict[str, PushbroomModel]:
    return {name: make().model() for name, make in SCENES.items()}


@pytest.fixture(scope="module", params=SCENES)
def named(request: pytest.FixtureRequest, scenes_by_name: dict[str, PushbroomModel]):  # type: ignore[no-untyped-def]
    return request.param, scenes_by_name[request.param]


def grid(
    shape: tuple[int, int], heights_m: tuple[float, ...], n: int = 9
) -> tuple[np.ndarray, ...]:
    axes = [np.linspace(0.0, size - 1.0, n) for size in shape]
    line, sample, height = np.meshgrid(*axes, heights_m, indexing="ij")
    return np.stack([line, sample], axis=-1), height


# Image to ground to image ---------------------------------------------------------------------


def test_there_and_back_at_sea_level_and_at_9000_m(named: tuple[str, PushbroomModel]) -> None:
    name, model = named
    image, height = grid(model.shape, (0.0, 9000.0))
    ground = model.image_to_ground(image, height)
    assert (ground.flag == Flag.OK).all()
    np.testing.assert_array_equal(ground.geodetic[..., 2], height)
    assert np.abs(ground.geodetic[..., 0]).max() <= np.pi
    assert np.abs(ground.geodetic[..., 1]).max() <= 0.5 * np.pi
    back = model.ground_to_image(ground.geodetic)
    assert (back.flag == Flag.OK).all()
    assert np.abs(back.image_px - image).max() <= 1e-6, name


def test_a_longitude_may_be_written_with_more_turns(named: tuple[str, PushbroomModel]) -> None:
    image, height = grid(named[1].shape, (500.0,), 4)
    ground = named[1].image_to_ground(image, height).geodetic
    for turns in (-1.0, 1.0):
        back = named[1].ground_to_image(ground + [2.0 * np.pi * turns, 0.0, 0.0])
        assert (back.flag == Flag.OK).all()
        assert np.abs(back.image_px - image).max() <= 2e-6


def test_steps_on_the_ground_are_even(named: tuple[str, PushbroomModel]) -> None:
    """No jump between neighbours: not at ±180°, not at a pole."""
    model = named[1]
    image, height = grid(model.shape, (0.0,), 33)
    place = geodetic_to_ecef(model.image_to_ground(image, height).geodetic)[:, :, 0]
    for axis, size in enumerate(model.shape):
        steps = np.linalg.norm(np.diff(place, axis=axis), axis=-1)
        if size > 1:
            assert steps.min() > 0.0
            assert steps.max() / steps.min() < 1.1


def test_rays_meet_the_points(named: tuple[str, PushbroomModel]) -> None:
    image, height = grid(named[1].shape, (0.0, 9000.0), 4)
    rays = named[1].rays(image, height)
    place = geodetic_to_ecef(named[1].image_to_ground(image, height).geodetic)
    off = place - rays.origin_ecef_m
    aside = np.cross(off, rays.direction_ecef)
    assert np.abs(aside).max() < 1e-7 * np.linalg.norm(off, axis=-1).max() * 1e-2


def test_an_rpc_follows_or_is_refused_with_the_reason(named: tuple[str, PushbroomModel]) -> None:
    name, model = named
    if name in REFUSED_BY_RPC:
        with pytest.raises(GeometryError, match=REFUSED_BY_RPC[name]):
            fit_model(model, (0.0, 9000.0))
        return
    rpc = fit_model(model, (0.0, 9000.0)).model
    image, height = grid(model.shape, (0.0, 4500.0, 9000.0))
    ground = model.image_to_ground(image, height)
    found = rpc.ground_to_image(ground.geodetic)
    assert np.abs(found.image_px - image).max() < 0.02, name
    located = rpc.image_to_ground(image, height)
    again = rpc.ground_to_image(located.geodetic)
    assert np.abs(again.image_px - image).max() <= 1e-6, name
    assert np.abs(located.geodetic[..., 0]).max() <= np.pi + 1e-12


def test_the_budget_is_finite(named: tuple[str, PushbroomModel]) -> None:
    if min(named[1].shape) < 2:
        return
    for line in image_budget(named[1]).lines:
        assert np.isfinite(line.enu_m).all(), line
        assert line.most_m > 0.0


# The horizon ----------------------------------------------------------------------------------


def test_beyond_the_horizon_there_are_flags_not_numbers() -> None:
    # 600 km up the horizon is 66.07° from the nadir; the image looks from 63° to 69°
    model = build((40, 1200), roll_deg=66.0, gsd_m=50.0).model()
    image, height = grid(model.shape, (0.0,), 41)
    ground = model.image_to_ground(image, height)
    missed = ground.flag == Flag.NO_INTERSECTION
    assert missed.any()
    assert (ground.flag[~missed] == Flag.OK).all()
    assert np.isnan(ground.geodetic[missed]).all()
    assert np.isfinite(ground.geodetic[~missed]).all()
    # once beyond, always beyond
    beyond = missed[:, :, 0].astype(int)
    assert (np.abs(np.diff(beyond, axis=1)).sum(axis=1) <= 1).all()
    back = model.ground_to_image(ground.geodetic)
    told = back.flag == Flag.OK
    assert (back.flag[missed] == Flag.BAD_INPUT).all()
    assert np.isnan(back.image_px[~told]).all()
    sights = model.rays(image, 0.0).direction_ecef
    up = geodetic_to_ecef(ground.geodetic)
    up /= np.linalg.norm(up, axis=-1, keepdims=True)
    steep = -np.sum(sights * up, axis=-1) > 0.2  # 12° above the horizon and more
    assert steep.any()
    assert np.abs((back.image_px - image)[steep & ~missed]).max() < 1e-4


def test_looking_past_the_earth_is_refused() -> None:
    with pytest.raises(GeometryError, match="miss the Earth"):
        build(SHAPE, roll_deg=75.0).model()


# The clock ------------------------------------------------------------------------------------


def seconds_of_erfa(first: tuple[float, ...], last: tuple[float, ...]) -> float:
    """TAI seconds between two UTC calendar times, by SOFA."""
    tai = [erfa.utctai(*erfa.dtf2d("UTC", *t[:5], float(t[5]))) for t in (first, last)]
    return float(((tai[1][0] - tai[0][0]) + (tai[1][1] - tai[0][1])) * 86400.0)


@pytest.mark.parametrize(
    ("first", "last", "elapsed"),
    [
        ("2016-12-31T23:59:58.5Z", "2017-01-01T00:00:01.5Z", 4.0),
        ("2016-12-31T23:59:60.25Z", "2017-01-01T00:00:00.75Z", 1.5),
        ("2012-06-30T23:59:59Z", "2012-07-01T00:00:00Z", 2.0),
        ("2019-12-31T23:59:58Z", "2020-01-01T00:00:02Z", 4.0),
        ("2020-02-28T23:59:59Z", "2020-02-29T00:00:01Z", 2.0),
    ],
)
def test_leap_seconds_and_year_ends_last_what_they_last(
    first: str, last: str, elapsed: float
) -> None:
    duration = Epoch.from_utc(last) - Epoch.from_utc(first)
    assert duration == pytest.approx(elapsed, abs=1e-9)
    calendar = [
        (*map(int, text[:10].split("-")), *map(int, text[11:16].split(":")), float(text[17:-1]))
        for text in (first, last)
    ]
    assert duration == pytest.approx(seconds_of_erfa(*calendar), abs=1e-9)


def test_a_scene_over_a_leap_second_is_a_scene_like_any_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Line times and geometry know nothing of it; the names of instants do."""
    usual = build(SHAPE).model()
    monkeypatch.setattr(scenes, "EPOCH", Epoch.from_utc("2016-12-31T23:59:60Z"))
    leap = build(SHAPE).model()
    image, height = grid(SHAPE, (0.0, 9000.0), 4)
    np.testing.assert_allclose(
        leap.image_to_ground(image, height).geodetic,
        usual.image_to_ground(image, height).geodetic,
        rtol=0,
        atol=1e-15,
    )
    write_model_file(leap, tmp_path / "leap.toml")
    assert run(["info", str(tmp_path / "leap.toml"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    # t = 0 is the middle: the scene begins within second 59 and ends within second 60
    assert facts["first_line_utc"].startswith("2016-12-31T23:59:59.9")
    assert facts["last_line_utc"].startswith("2016-12-31T23:59:60.0")
    lasts = Epoch.from_utc(facts["last_line_utc"]) - Epoch.from_utc(facts["first_line_utc"])
    assert lasts == pytest.approx(facts["line_period_s"] * (SHAPE[0] - 1), abs=2e-6)


def test_times_outside_the_earths_tables_are_refused() -> None:
    for utc in ("2090-01-01T00:00:00Z", "2060-06-30T12:00:00Z"):
        with pytest.raises(EarthOrientationError, match=utc[:4]) as caught:
            matrix_itrs_gcrs(Epoch.from_utc(utc), 0.0)
        assert "\n" not in str(caught.value)


# Single precision -----------------------------------------------------------------------------


def test_float32_points_are_taken_as_the_doubles_they_stand_for(
    scenes_by_name: dict[str, PushbroomModel],
) -> None:
    model = scenes_by_name["nadir"]
    image, height = grid(SHAPE, (0.0, 9000.0), 5)
    single, heights = image.astype(np.float32), height.astype(np.float32)
    ground = model.image_to_ground(single, heights)
    assert ground.geodetic.dtype == np.float64
    np.testing.assert_array_equal(
        ground.geodetic,
        model.image_to_ground(single.astype(np.float64), heights.astype(np.float64)).geodetic,
    )
    # a float32 longitude is known to some 0.4 m only: so is the pixel, and no worse
    rough = ground.geodetic.astype(np.float32)
    found = model.ground_to_image(rough)
    np.testing.assert_array_equal(
        found.image_px, model.ground_to_image(rough.astype(np.float64)).image_px
    )
    assert np.abs(found.image_px - image).max() < 2.0


# Long strips ----------------------------------------------------------------------------------


def test_a_strip_of_a_million_rows() -> None:
    """A hundred seconds of flight; one interpolant for all, memory of megabytes."""
    rows = 1_000_000
    tracemalloc.start()
    model = build((rows, 2000), attitude_step_s=0.25, ephemeris_step_s=5.0).model()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6
    line = np.concatenate([np.linspace(0.0, rows - 1.0, 4001), [0.25, rows - 1.25]])
    image = np.stack([line, np.resize([0.0, 1999.0, 777.3], len(line))], axis=-1)
    for height_m in (0.0, 9000.0):
        ground = model.image_to_ground(image, height_m)
        assert (ground.flag == Flag.OK).all()
        back = model.ground_to_image(ground.geodetic)
        assert (back.flag == Flag.OK).all()
        assert np.abs(back.image_px - image).max() <= 1e-6
    # an RPC over 700 km follows it to its stated limit, or fit_model would have refused
    rpc = fit_model(model, (0.0, 1000.0), limit_px=1.0).model
    for height_m in (0.0, 1000.0):
        ground = model.image_to_ground(image, height_m).geodetic
        assert np.abs(rpc.ground_to_image(ground).image_px - image).max() < 1.0


# Maps and footprints --------------------------------------------------------------------------


def test_longitudes_follow_each_other() -> None:
    lon = np.radians([179.9, -179.9, np.nan, 179.8, -179.7])
    whole = np.degrees(unbroken(lon))
    assert np.nanmax(whole) - np.nanmin(whole) == pytest.approx(0.5)
    points = np.column_stack([lon, np.full(5, 0.1), np.full(5, 7.0)])
    middle = middle_of(points)
    assert abs(np.degrees(middle[0])) == pytest.approx(180.0, abs=0.11)
    np.testing.assert_allclose(middle[1:], [0.1, 7.0])


@pytest.mark.parametrize(
    ("name", "polygons"),
    [("nadir", 1), ("across the antimeridian", 2),
     ("across the north pole", 1), ("across the south pole", 1), ("latitude 89.9", 1)],
)  # fmt: skip
def test_footprints_are_valid_and_hold_the_image(
    scenes_by_name: dict[str, PushbroomModel], name: str, polygons: int
) -> None:
    model = scenes_by_name[name]
    found = footprint(model)
    shape = shapely.from_geojson(json.dumps(found["geojson"]))
    assert shape.is_valid
    assert len(shapely.get_parts(shape)) == polygons
    west, south, east, north = shape.bounds
    assert (west >= -180.0, east <= 180.0, south >= -90.0, north <= 90.0) == (True,) * 4
    inside, height = grid(SHAPE, (float(np.mean(model.height_range_m)),), 7)
    places = np.degrees(model.image_to_ground(inside, height).geodetic[..., :2]).reshape(-1, 2)
    assert shapely.contains(shape, shapely.points(places)).all()
    # a map of equal areas: no band around the Earth, no hole at the pole
    equal = shapely.transform(
        shapely.segmentize(shape, 0.001 if "antimeridian" in name else 0.5),
        lambda xy: to_crs("EPSG:6933", np.column_stack([np.radians(xy), np.zeros(len(xy))]))[:, :2],
    )
    step = geodetic_to_ecef(model.image_to_ground([[0, 0], [0, 599], [699, 0]], height[0, 0, 0])
                            .geodetic)  # fmt: skip
    area = np.prod(np.linalg.norm(step[1:] - step[0], axis=-1))
    assert equal.area == pytest.approx(area, rel=0.02)


def test_no_footprint_where_the_image_misses_the_earth() -> None:
    model = build((40, 1200), roll_deg=66.0, gsd_m=50.0).model()
    assert footprint(model)["geojson"] is None


def test_maps_go_on_beyond_the_antimeridian_or_are_refused(
    scenes_by_name: dict[str, PushbroomModel],
) -> None:
    model, flat = scenes_by_name["across the antimeridian"], ConstantTerrain(100.0)
    degrees = OrthoGrid.around(model, flat, "EPSG:4326", 1e-5)
    assert degrees.shape[1] < 2000
    assert degrees.left < 180.0 < degrees.left + degrees.shape[1] * 1e-5 < 181.0
    centre = degrees.geodetic(np.array(0.5 * degrees.shape[0]), np.array(0.5 * degrees.shape[1]),
                              100.0)  # fmt: skip
    seen = model.ground_to_image(centre)
    assert seen.flag == Flag.OK
    np.testing.assert_allclose(seen.image_px, [350.0, 300.0], atol=30.0)
    assert OrthoGrid.around(model, flat, "EPSG:32660", 1.0).shape[1] < 2000
    with pytest.raises(GeometryError, match="breaks within the scene"):
        OrthoGrid.around(model, flat, "EPSG:3857", 1.0)
    polar = scenes_by_name["across the north pole"]
    assert max(OrthoGrid.around(polar, flat, "EPSG:3413", 2.0).shape) < 2000
    for crs in ("EPSG:4326", "EPSG:3857"):
        with pytest.raises(GeopositionError, match=r"pole|breaks|too many"):
            OrthoGrid.around(polar, flat, crs, 2.0 if crs.endswith("57") else 1e-5)


def test_map_coordinates_in_degrees_come_near() -> None:
    place = near_degrees(np.array([[-179.9, 1.0], [179.9, 2.0]]), 179.5)
    np.testing.assert_allclose(place, [[180.1, 1.0], [179.9, 2.0]])
    low, high = map_extent("EPSG:4326", np.radians([[179.9, 1, 0], [-179.9, 2, 0]]))
    np.testing.assert_allclose([low, high], [[179.9, 1.0], [180.1, 2.0]])


# Terrain and intersection ---------------------------------------------------------------------


@pytest.mark.parametrize("west_of", [0.0, -2.0 * np.pi])
def test_terrain_across_the_antimeridian(tmp_path: Path, west_of: float) -> None:
    """A raster from 179.98 to 180.02, or from -180.02: the same ground."""
    model = build(SHAPE, orbit=Orbit.over(HALF_TURN, 0.3)).model()
    middle = model.image_to_ground([350.0, 300.0], 500.0).geodetic
    lon = float(np.remainder(middle[0], 2.0 * np.pi)) + west_of
    synthetic_terrain(
        lon, middle[1], 4000.0, 4000.0, seed=3, lowest_m=300.0, highest_m=700.0,
        step_rad=float(np.radians(0.5 / 3600.0)), shortest_m=300.0,
    ).write(tmp_path / "dem.tif")  # fmt: skip
    terrain = RasterTerrain(tmp_path / "dem.tif")
    image, _ = grid(SHAPE, (0.0,), 31)
    ground = locate(model, image, terrain)
    assert (ground.flag == Flag.OK).all()
    lon_deg = np.degrees(ground.geodetic[..., 0])
    assert lon_deg.min() < -179.0
    assert lon_deg.max() > 179.0
    under = terrain.height_at(ground.geodetic)
    assert np.abs(under.height_m - ground.geodetic[..., 2]).max() < 1e-3
    assert np.abs(model.ground_to_image(ground.geodetic).image_px - image).max() <= 1e-6


@pytest.mark.parametrize(
    "orbit",
    [Orbit.over(HALF_TURN, 0.3), Orbit.over(0.5, np.radians(89.9999), inclination_rad=POLAR)],
    ids=["antimeridian", "pole"],
)
def test_pairs_intersect(orbit: Orbit) -> None:
    model = build(SHAPE, orbit=orbit).model()
    image, height = (part.reshape(-1, *part.shape[3:]) for part in grid(SHAPE, (300.0,), 5))
    truth = model.image_to_ground(image, height).geodetic
    fore = model.rays(image, height)
    place = geodetic_to_ecef(truth)
    # a second camera 300 km ahead
    ahead = fore.origin_ecef_m + 3e5 * np.cross(fore.direction_ecef[0], place[0] / 6.4e6)
    ahead += [0.0, 3e5, 1e3]
    sight = place - ahead
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    found = intersect_pairs(fore, Rays(ahead, sight, fore.flag))
    assert (found.flag == Flag.OK).all()
    assert np.linalg.norm(geodetic_to_ecef(found.geodetic) - place, axis=-1).max() < 1e-6
    assert found.miss_m.max() < 1e-6
    assert np.abs(found.geodetic[:, 0]).max() <= np.pi
