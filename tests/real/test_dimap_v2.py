"""Pleiades-1A and SPOT 6 against what their makers say: the vendor RPC, the corners."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.flags import Flag
from geoposition.product import Product
from geoposition.sensors.readers import dimap_v2, open_product
from geoposition.sensors.readers.source import Source

VOLUME = "linescan/pleiades1a/VOL_PHR.XML"
SPOT6 = "linescan/spot6/SPOT6.XML"
EARTH_RATE_RAD_S = 7.292115e-5


def read(path: Path) -> Product:
    source = Source.of(path)
    assert dimap_v2.recognises(source)
    return dimap_v2.read(source)


@pytest.fixture
def pleiades(real_data: Path) -> Product:
    return read(real_data / VOLUME)


@pytest.fixture
def spot6(real_data: Path) -> Product:
    return read(real_data / SPOT6)


def scene_grid(product: Product, n: int, margin_px: float = 0.0) -> np.ndarray:
    lines, samples = product.model.shape
    line = np.linspace(-margin_px, lines - 1 + margin_px, n)
    sample = np.linspace(-margin_px, samples - 1 + margin_px, n)
    return np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1)


def test_pleiades_rigorous_model_is_the_vendor_rpc_up_to_a_constant(pleiades: Product) -> None:
    assert pleiades.vendor_rpc is not None
    image = scene_grid(pleiades, 21)[:, :, None, :]
    heights = np.linspace(*pleiades.vendor_rpc.height_range_m, 5)
    ground = pleiades.model.image_to_ground(image, heights)
    assert np.all(ground.flag == Flag.OK)
    difference = pleiades.vendor_rpc.ground_to_image(ground.geodetic).image_px - image
    mean = difference.mean(axis=(0, 1, 2))
    np.testing.assert_allclose(mean, [0.093, -0.021], atol=1e-3)
    rest = difference - mean
    assert np.max(rest.std(axis=(0, 1, 2))) <= 1e-3
    assert np.max(np.abs(rest)) <= 1e-3


def test_volume_leads_to_the_panchromatic_image(pleiades: Product, real_data: Path) -> None:
    assert pleiades.path.name.startswith("DIM_PHR1A_P_")
    assert pleiades.sensor == "Pleiades-1A"
    assert pleiades.model.shape == (15169, 32824)
    assert pleiades.start is not None
    assert pleiades.start.utc_iso(7) == "2021-08-27T15:49:30.4152185Z"
    direct = read(pleiades.path)
    np.testing.assert_array_equal(
        direct.model.image_to_ground([10.0, 20.0], 5.0).geodetic,
        pleiades.model.image_to_ground([10.0, 20.0], 5.0).geodetic,
    )


def test_lineage_files_and_rpc_are_not_taken_for_the_product(real_data: Path) -> None:
    folder = real_data / "linescan/pleiades1a/IMG_PHR1A_P_001"
    rpc = next(folder.glob("RPC_*.XML"))
    source = Source.of(rpc)
    assert not dimap_v2.recognises(source)
    for path in (folder / "LINEAGE").glob("*.XML"):
        with pytest.raises(ValueError, match=r"METADATA_SUBPROFILE: PRODUCT expected"):
            read(path)


def test_pleiades_velocity_in_the_file_is_not_the_one_used(pleiades: Product) -> None:
    """The file's 30 s velocities are inertial: some 500 m/s off the positions' rate."""
    assert pleiades.details["velocities_in_file"] == "inertial-on-itrs-axes"
    ephemeris = pleiades.model.ephemeris
    at = pleiades.model.camera.timing.time_s(7000.0)
    inertial_at_49_23 = np.array([-550.5330205645878, -2575.570735951886, -7030.877383719664])
    position = ephemeris.position_m(at)
    turning = np.cross([0.0, 0.0, EARTH_RATE_RAD_S], position)
    velocity = ephemeris.velocity_m_s(at) + turning
    assert np.linalg.norm(turning) > 450.0
    # 8 s earlier the satellite flew 8 s * 8 m/s^2 of gravity differently, no more.
    assert np.linalg.norm(velocity - inertial_at_49_23) < 70.0


@pytest.mark.parametrize("name", ["pleiades", "spot6"])
def test_there_and_back_over_the_scene_and_its_outer_edges(
    name: str, request: pytest.FixtureRequest
) -> None:
    product: Product = request.getfixturevalue(name)
    image = scene_grid(product, 15, margin_px=0.5)
    for height in (-100.0, 800.0, 4000.0):
        ground = product.model.image_to_ground(image, height)
        assert np.all(ground.flag <= Flag.OUTSIDE_IMAGE)
        back = product.model.ground_to_image(ground.geodetic)
        assert np.max(np.abs(back.image_px - image)) <= 1e-5


def test_spot6_corners_at_836_m(spot6: Product) -> None:
    corners = spot6.details["corners"]
    assert isinstance(corners, list)
    assert len(corners) == 4
    for corner in corners:
        ground = spot6.model.image_to_ground([corner["row"], corner["col"]], 836.0)
        assert ground.flag == Flag.OK
        lon_rad, lat_rad = np.radians([corner["lon_deg"], corner["lat_deg"]])
        metres = 6378137.0 * (ground.geodetic[:2] - [lon_rad, lat_rad])
        assert abs(metres[1]) <= 0.02
        assert abs(metres[0]) * np.cos(lat_rad) <= 0.15


def test_spot6_line_period_is_in_its_own_unit(spot6: Product) -> None:
    assert spot6.details["line_period_s"] == pytest.approx(229.110269e-6, rel=1e-12)
    assert spot6.details["velocities_in_file"] == "earth-fixed"
    assert any("is not there" in note for note in spot6.details["notes"])


def test_spot6_tables_go_on_smoothly_past_the_first_and_last_line(spot6: Product) -> None:
    """Tables begin and end with the image: a line beyond, the steps go on."""
    lines = spot6.model.shape[0]
    for first in (-0.9, lines - 2.1):
        line = first + np.arange(3) * 1.0
        image = np.stack([line, np.full(3, 12000.0)], axis=-1)
        ecef = geodetic_to_ecef(spot6.model.image_to_ground(image, 0.0).geodetic)
        steps = np.diff(ecef, axis=0)
        assert np.linalg.norm(steps[1] - steps[0]) < 1e-3 * np.linalg.norm(steps[0])
    beyond = spot6.model.image_to_ground([[-3.0, 0.0], [lines + 2.0, 0.0]], 0.0)
    assert np.all(beyond.flag == Flag.OUTSIDE_MODEL)


@pytest.mark.parametrize(
    ("place", "sensor"),
    [
        ("linescan/pleiades1a", "Pleiades-1A"),
        ("linescan/pleiades1a/IMG_PHR1A_P_001", "Pleiades-1A"),
        (VOLUME, "Pleiades-1A"),
        ("linescan/spot6", "SPOT 6"),
        ("linescan/spot5_hrs", "SPOT5 HRS1"),
    ],
)
def test_a_folder_or_a_file_is_enough(real_data: Path, place: str, sensor: str) -> None:
    assert open_product(real_data / place).sensor == sensor
