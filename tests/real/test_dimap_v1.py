"""SPOT 5 HRS against its own tie points, and its attitude against the handbook's matrices."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.flags import Flag
from geoposition.product import Product
from geoposition.sensors.readers import dimap_v1
from geoposition.sensors.readers.source import Source

SPOT5 = "linescan/spot5_hrs/spot_example1.xml"


def read(path: Path) -> Product:
    source = Source.of(path)
    assert dimap_v1.recognises(source)
    return dimap_v1.read(source)


@pytest.fixture
def spot5(real_data: Path) -> Product:
    return read(real_data / SPOT5)


def test_hrs_corners_at_column_1_within_a_metre(spot5: Product) -> None:
    """The tie points have six decimals of a degree, 0.06 m; they are met to that."""
    corners = {  # row -> lon, lat of column 1, height 0
        0: (-75.519946, -76.636309),
        96167: (-91.818476, -79.298919),
    }
    for row, lon_lat in corners.items():
        ground = spot5.model.image_to_ground([row, 0.0], 0.0)
        assert ground.flag == Flag.OK
        maker = geodetic_to_ecef(np.append(np.radians(lon_lat), 0.0))
        miss = np.linalg.norm(geodetic_to_ecef(ground.geodetic) - maker)
        assert miss <= 0.06
    assert spot5.details["tie_points_farthest_m"] <= 0.06


def test_attitude_is_the_handbooks_to_1e_12(spot5: Product, real_data: Path) -> None:
    root = ElementTree.parse(real_data / SPOT5).getroot()
    strip = root.find("Data_Strip")
    points = strip.findall("Ephemeris/Points/Point")
    samples = strip.findall("Satellite_Attitudes/Corrected_Attitudes/Corrected_Attitude/Angles")
    day = "2008-03-04T"

    def seconds(node: ElementTree.Element) -> float:
        text = node.findtext("TIME")
        assert text.startswith(day)
        hour, minute, second = text.removeprefix(day).split(":")
        return 3600.0 * int(hour) + 60.0 * int(minute) + float(second)

    def vectors(name: str) -> np.ndarray:
        return np.array([[float(p.findtext(f"{name}/{a}")) for a in "XYZ"] for p in points])

    def lagrange_8(t: float, table: np.ndarray) -> np.ndarray:
        first = min(max(np.searchsorted(times, t, side="right") - 4, 0), len(times) - 8)
        near = slice(first, first + 8)
        weights = [np.prod([(t - b) / (a - b) for b in times[near] if b != a]) for a in times[near]]
        return np.array(weights) @ table[near]

    times = np.array([seconds(p) for p in points])
    angle_times = np.array([seconds(s) for s in samples])
    angles = {
        tag: np.array([float(s.findtext(tag)) for s in samples]) for tag in ("YAW", "PITCH", "ROLL")
    }
    look = root.findall(".//Look_Angles")
    centre_s = 3600 * 12 + 60 * 31 + 39.349737
    for row, col in ((1000, 1), (48085, 150), (90000, 300)):
        t = centre_s + (row - 48085) * 7.5199705115e-04
        yaw, pitch, roll = (
            np.interp(t, angle_times, angles[tag]) for tag in ("YAW", "PITCH", "ROLL")
        )
        cy, sy, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(roll), np.sin(roll)
        cp, sp = np.cos(pitch), np.sin(pitch)
        m_yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        m_roll = np.array([[cr, 0, -sr], [0, 1, 0], [sr, 0, cr]])
        m_pitch = np.array([[1, 0, 0], [0, cp, sp], [0, -sp, cp]])
        psi_x = float(look[col - 1].findtext("PSI_X"))
        psi_y = float(look[col - 1].findtext("PSI_Y"))
        u1 = np.array([-np.tan(psi_y), np.tan(psi_x), -1.0])
        u2 = m_pitch @ m_roll @ m_yaw @ (u1 / np.linalg.norm(u1))
        position, velocity = lagrange_8(t, vectors("Location")), lagrange_8(t, vectors("Velocity"))
        z = position / np.linalg.norm(position)
        x = np.cross(velocity, z)
        x /= np.linalg.norm(x)
        expected = np.stack([x, np.cross(z, x), z], axis=-1) @ u2

        camera = spot5.model.camera
        tangents = camera.tangents(0, col - 1.0)
        d = camera.R_body_camera.apply([*tangents, 1.0])
        since_epoch = camera.timing.time_s(row - 1.0)
        d = spot5.model.attitude.rotation(since_epoch).apply(d)[0]
        np.testing.assert_allclose(d / np.linalg.norm(d), expected, atol=1e-12)
        np.testing.assert_allclose(
            spot5.model.ephemeris.position_m(since_epoch), position, atol=1e-6
        )


def test_a_short_look_angle_table_serves_its_columns_only(real_data: Path, tmp_path: Path) -> None:
    text = (real_data / SPOT5).read_text().replace("<NCOLS>300<", "<NCOLS>12000<")
    path = tmp_path / "METADATA.DIM"
    path.write_text(text)
    product = read(path)
    assert product.model.shape == (96168, 300)
    assert any("column 300 of 12000" in note for note in product.details["notes"])
    samples = np.array([0.0, 299.0, 310.0, 6000.0])
    ground = product.model.image_to_ground(np.stack([np.full(4, 500.0), samples], axis=-1), 0.0)
    np.testing.assert_array_equal(
        ground.flag, [Flag.OK, Flag.OK, Flag.OUTSIDE_IMAGE, Flag.OUTSIDE_MODEL]
    )


def test_attitude_is_prolonged_by_little_and_says_so(spot5: Product) -> None:
    """Line 1 lies 16 ms before the first attitude sample, the last 176 ms after the last."""
    assert any("prolonged by 0.017 s before" in note for note in spot5.details["notes"])
    assert any("0.177 s after" in note for note in spot5.details["notes"])
    low, high = spot5.model.attitude.span_s
    first, last = spot5.model.camera.timing.time_s([0.0, 96167.0])
    assert low <= first
    assert high >= last
    assert first - low < 0.002
    assert high - last < 0.002


def test_there_and_back_over_the_segment(spot5: Product) -> None:
    line, sample = np.linspace(-0.5, 96167.5, 41), np.linspace(-0.5, 299.5, 7)
    image = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1)
    ground = spot5.model.image_to_ground(image, 1000.0)
    assert np.all(ground.flag <= Flag.OUTSIDE_IMAGE)
    back = spot5.model.ground_to_image(ground.geodetic)
    assert np.max(np.abs(back.image_px - image)) <= 1e-5
