"""Orbital axes, prolongation, midnight, and a whole synthetic SPOT 4 scene, in closed form."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pytest

from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ProductError
from geoposition.flags import Flag
from geoposition.product import Product
from geoposition.sensors.readers import dimap_v1
from geoposition.sensors.readers.dimap_attitude import (
    polynomial_attitude,
    quaternion_list_attitude,
)
from geoposition.sensors.readers.dimap_orbit import Orbit, OrbitAxesCurve
from geoposition.sensors.readers.source import Source
from geoposition.timescale import Epoch
from geoposition.xmlfile import XmlNode

RADIUS_M = 7.2e6
RATE_RAD_S = np.sqrt(3.986004418e14 / RADIUS_M**3)
EARTH_RATE_RAD_S = 7.292115e-5
EPOCH = Epoch.from_utc("1998-05-01T10:00:00")


def circle(times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Polar circle in inertial axes, seen on Earth-fixed ones that agree at time 0.

    Position and *inertial* velocity, both on Earth-fixed axes, as SPOT 1-4 products have them.
    """
    angle, turn = RATE_RAD_S * times_s, -EARTH_RATE_RAD_S * times_s
    zero = np.zeros_like(angle)
    position = RADIUS_M * np.stack([np.cos(angle), zero, np.sin(angle)], axis=-1)
    velocity = RADIUS_M * RATE_RAD_S * np.stack([-np.sin(angle), zero, np.cos(angle)], axis=-1)

    def earth_fixed(v: np.ndarray) -> np.ndarray:
        x = np.cos(turn) * v[..., 0] - np.sin(turn) * v[..., 1]
        y = np.sin(turn) * v[..., 0] + np.cos(turn) * v[..., 1]
        return np.stack([x, y, v[..., 2]], axis=-1)

    return earth_fixed(position), earth_fixed(velocity)


def orbit(step_s: float = 60.0, points: int = 9) -> Orbit:
    times = (np.arange(points) - points // 2) * step_s
    return Orbit(EPOCH, times, *circle(times))


def test_orbital_axes_of_a_polar_orbit() -> None:
    """Northbound over lon 0, lat 0: Z = x_ecef; X = V x Z = z x x = y_ecef; Y = Z x X = z."""
    curve = OrbitAxesCurve(orbit().positions, orbit().velocities)
    R_ecef_orbit = curve.rotation(np.array([0.0])).as_matrix()[0]
    np.testing.assert_allclose(R_ecef_orbit, [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-9)
    at = np.array([-100.0, 33.0, 150.0])
    position, velocity = circle(at)
    axes = curve.rotation(at).as_matrix()
    np.testing.assert_allclose(
        axes[..., 2], position / np.linalg.norm(position, axis=-1, keepdims=True), atol=1e-9
    )
    assert np.max(np.abs(np.sum(axes[..., 0] * velocity, axis=-1))) < 1e-4
    assert np.all(np.sum(axes[..., 1] * velocity, axis=-1) > 7000.0)


def test_the_velocities_kind_is_told() -> None:
    assert orbit().velocity_kind == "inertial-on-itrs-axes"
    positions = orbit().positions
    fixed = Orbit(EPOCH, orbit().times_s, orbit().position_m, positions.rate(orbit().times_s))
    assert fixed.velocity_kind == "earth-fixed"
    assert orbit(points=6).velocity_kind.startswith("unknown")


def test_prolonged_orbit_is_the_same_inside_and_true_outside() -> None:
    dense = orbit(step_s=0.125, points=48)
    first, last = dense.times_s[0] - 3e-4, dense.times_s[-1] + 3e-4
    longer = dense.prolonged(first, last, 1e-3)
    assert longer.positions.span_s == (first, last)
    inside = np.linspace(dense.times_s[0], dense.times_s[-1], 301)
    np.testing.assert_allclose(
        longer.positions.value(inside), dense.positions.value(inside), atol=2e-6
    )
    ends = np.array([first, last])
    np.testing.assert_allclose(longer.positions.value(ends), circle(ends)[0], atol=1e-5)
    old_ends = dense.times_s[[0, -1]]
    np.testing.assert_allclose(
        longer.positions.rate(ends), dense.positions.rate(old_ends), atol=0.01
    )
    untouched = dense.prolonged(first - 1.0, last + 1.0, 1e-3)
    assert untouched.positions.span_s == dense.positions.span_s


def quaternion_node(times_s: np.ndarray, rate_rad_s: float) -> XmlNode:
    root = Element("Quaternion_List")
    for t in times_s:
        entry = SubElement(root, "Quaternion")
        half = 0.5 * rate_rad_s * t
        for i, q in enumerate((np.cos(half), 0.0, np.sin(half), 0.0)):
            SubElement(entry, f"Q{i}").text = repr(float(q))
        SubElement(entry, "TIME").text = (EPOCH + float(t)).utc_iso(9)
    return XmlNode(Path("x.xml"), "Quaternion_List", root)


def test_quaternion_list_goes_on_at_its_rate() -> None:
    rate = 0.01
    node = quaternion_node(np.arange(20) * 0.03125, rate)
    last = 19 * 0.03125 + 2e-4
    attitude = quaternion_list_attitude(node, EPOCH, -2e-4, last, 1e-3)
    assert attitude.span_s == (-2e-4, last)
    at = np.array([-2e-4, 0.1, 0.30017, last])
    np.testing.assert_allclose(
        attitude.rotation(at).as_rotvec(), np.outer(rate * at, [0, 1, 0]), atol=1e-9
    )
    kept = quaternion_list_attitude(node, EPOCH, -0.5, 5.0, 1e-3)
    assert kept.span_s == pytest.approx((0.0, 19 * 0.03125), abs=1e-9)


def polynomial_node(offset: float, scale: float = 2.0) -> XmlNode:
    root = Element("Polynomial_Quaternions")
    SubElement(root, "OFFSET").text = repr(offset)
    SubElement(root, "SCALE").text = repr(scale)
    for i, text in enumerate(("1 0", "0 0", "0 0.001", "0")):
        q = SubElement(root, f"Q{i}")
        SubElement(q, "DEGREE").text = str(len(text.split()) - 1)
        SubElement(q, "COEFFICIENTS").text = text
    return XmlNode(Path("x.xml"), "Polynomial_Quaternions", root)


@pytest.mark.parametrize("offset", [86399.5, -0.5])
def test_seconds_of_the_day_across_midnight(offset: float) -> None:
    """An image from 23:59:59.2 to 00:00:00.2, its offset told from either day's start."""
    epoch = Epoch.from_utc("2020-03-01T23:59:59.2Z")
    if offset < 0:
        epoch = Epoch.from_utc("2020-03-02T00:00:00.1Z")
    attitude, notes = polynomial_attitude(polynomial_node(offset), epoch, 0.0, 1.0)
    assert not notes
    zero_turn = Epoch.from_utc("2020-03-01T23:59:59.5Z") - epoch
    low, high = attitude.span_s
    assert (low, high) == pytest.approx((zero_turn - 2.0, zero_turn + 2.0), abs=1e-6)
    at = np.array([zero_turn, zero_turn + 1.0])
    turn = attitude.rotation(at).as_rotvec()[:, 1]
    np.testing.assert_allclose(turn, [0.0, 2 * np.arctan(0.0005)], atol=1e-9)


def test_polynomials_beyond_their_interval_are_noted_and_then_refused() -> None:
    epoch = Epoch.from_utc("2020-03-01T12:00:00Z")
    _, notes = polynomial_attitude(polynomial_node(43200.0), epoch, 1.0, 2.5)
    assert len(notes) == 1
    assert "beyond the interval" in notes[0]
    with pytest.raises(ProductError, match="near the image"):
        polynomial_attitude(polynomial_node(43200.0), epoch, 4.0, 5.0)


def spot4(
    psi_x: tuple[float, float], angles: tuple[float, float, float], columns: int = 3000
) -> str:
    """Text of a scene of 1001 lines with two detectors, two raw attitudes, 60 s orbit points."""
    yaw, pitch, roll = angles

    def tag(name: str, text: object) -> str:
        return f"<{name}>{text}</{name}>"

    def xyz(name: str, v: np.ndarray) -> str:
        return tag(name, "".join(tag(a, repr(float(c))) for a, c in zip("XYZ", v, strict=True)))

    times = orbit().times_s
    points = "".join(
        tag("Point", xyz("Location", p) + xyz("Velocity", v) + tag("TIME", (EPOCH + t).utc_iso(6)))
        for t, p, v in zip(times, *circle(times), strict=True)
    )
    attitudes = "".join(
        tag(
            "Angles",
            tag("TIME", (EPOCH + t).utc_iso(6)[:-1])
            + tag("YAW", yaw) + tag("PITCH", pitch) + tag("ROLL", roll)
            + tag("OUT_OF_RANGE", "N"),
        )
        for t in (-5.0, 5.0)
    )  # fmt: skip
    detectors = "".join(
        tag("Look_Angles", tag("DETECTOR_ID", i) + tag("PSI_X", psi) + tag("PSI_Y", 0.01))
        for i, psi in zip((1, columns), psi_x, strict=True)
    )
    return (
        "<Dimap_Document><Metadata_Id><METADATA_FORMAT version='1.1'>DIMAP</METADATA_FORMAT>"
        "<METADATA_PROFILE>SPOTSCENE_1A</METADATA_PROFILE></Metadata_Id><Dataset_Sources>"
        "<Source_Information><Scene_Source><MISSION>SPOT</MISSION><MISSION_INDEX>4</MISSION_INDEX>"
        "<INSTRUMENT>HRVIR</INSTRUMENT><INSTRUMENT_INDEX>1</INSTRUMENT_INDEX></Scene_Source>"
        "</Source_Information></Dataset_Sources><Raster_Dimensions><NCOLS>3000</NCOLS>"
        "<NROWS>1001</NROWS></Raster_Dimensions><Data_Processing>"
        "<PROCESSING_LEVEL>1A</PROCESSING_LEVEL></Data_Processing><Data_Strip><Ephemeris>"
        f"<Points>{points}</Points></Ephemeris><Satellite_Attitudes><Raw_Attitudes>"
        f"<Aocs_Attitude><Angles_List>{attitudes}</Angles_List></Aocs_Attitude></Raw_Attitudes>"
        "</Satellite_Attitudes><Sensor_Configuration><Time_Stamp><LINE_PERIOD>3.008e-3"
        "</LINE_PERIOD><SCENE_CENTER_TIME>1998-05-01T10:00:00.000000</SCENE_CENTER_TIME>"
        "<SCENE_CENTER_LINE>501</SCENE_CENTER_LINE></Time_Stamp><Instrument_Look_Angles_List>"
        f"<Instrument_Look_Angles><Look_Angles_List>{detectors}</Look_Angles_List>"
        "</Instrument_Look_Angles></Instrument_Look_Angles_List></Sensor_Configuration>"
        "</Data_Strip></Dimap_Document>"
    )


def read_v1(text: str, folder: Path) -> Product:
    path = folder / "METADATA.DIM"
    path.write_text(text)
    source = Source.of(path)
    assert dimap_v1.recognises(source)
    return dimap_v1.read(source)


def test_spot4_scene_against_the_handbooks_formulas(tmp_path: Path) -> None:
    psi_x, yaw, pitch, roll = (0.35, 0.42), 3e-3, -2e-3, 1e-3
    product = read_v1(spot4(psi_x, (yaw, pitch, roll)), tmp_path)
    assert product.sensor == "SPOT4 HRVIR1"
    assert product.details["velocities_in_file"] == "inertial-on-itrs-axes"
    assert any("raw attitudes" in note for note in product.details["notes"])
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (np.cos, np.sin))
    m_yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    m_roll = np.array([[cr, 0, -sr], [0, 1, 0], [sr, 0, cr]])
    m_pitch = np.array([[1, 0, 0], [0, cp, sp], [0, -sp, cp]])
    for line, sample in ((0, 0), (500, 1499.5), (1000, 2999), (700, 321)):
        psi = psi_x[0] + (psi_x[1] - psi_x[0]) * sample / 2999.0
        u1 = np.array([-np.tan(0.01), np.tan(psi), -1.0])
        t = (line - 500) * 3.008e-3
        position, velocity = circle(np.array(t))
        z = position / np.linalg.norm(position)
        x = np.cross(velocity, z)
        x /= np.linalg.norm(x)
        d = np.stack([x, np.cross(z, x), z], axis=-1) @ m_pitch @ m_roll @ m_yaw @ u1
        ground = product.model.image_to_ground([line, sample], 100.0)
        assert ground.flag == Flag.OK
        sight = geodetic_to_ecef(ground.geodetic) - position
        angle = np.linalg.norm(np.cross(sight, d)) / np.linalg.norm(sight) / np.linalg.norm(d)
        assert angle < 1e-9  # 1 mm on the ground
        assert sight @ d > 0


def test_spot4_sees_what_its_angles_say(tmp_path: Path) -> None:
    """No attitude, PSI_X > 0, northbound: u1's y is Y = Z x X, the way of flight: ahead.

    PSI_Y > 0 tilts to -X, that is west of a northbound track.
    """
    product = read_v1(spot4((0.05, 0.06), (0.0, 0.0, 0.0)), tmp_path)
    ground = product.model.image_to_ground([500.0, 0.0], 0.0).geodetic
    height = RADIUS_M - 6378137.0
    assert ground[1] == pytest.approx(np.tan(0.05) * height / 6378137.0, rel=0.02)
    assert ground[0] == pytest.approx(-np.tan(0.01) * height / 6378137.0, rel=0.02)


def test_detectors_that_do_not_fit_the_row(tmp_path: Path) -> None:
    with pytest.raises(ProductError, match="detector of column 3000 expected, got 300"):
        read_v1(spot4((0.05, 0.06), (0.0, 0.0, 0.0), columns=300), tmp_path)


def test_raw_attitudes_out_of_range_are_left_out(tmp_path: Path) -> None:
    text = spot4((0.05, 0.06), (0.0, 0.0, 0.0)).replace("NGE>N<", "NGE>Y<", 1)
    with pytest.raises(ProductError, match="2 or more attitude samples"):
        read_v1(text, tmp_path)


def test_of_several_bands_the_one_at_the_tie_points_is_taken(tmp_path: Path) -> None:
    text = spot4((0.05, 0.06), (0.0, 0.0, 0.0))
    product = read_v1(text, tmp_path)
    row, col = 400, 1200
    lon, lat, _ = np.degrees(product.model.image_to_ground([row - 1, col - 1], 0.0).geodetic)
    ties = (
        f"<Geoposition><Geoposition_Points><Tie_Point><TIE_POINT_CRS_X>{lon!r}</TIE_POINT_CRS_X>"
        f"<TIE_POINT_CRS_Y>{lat!r}</TIE_POINT_CRS_Y><TIE_POINT_CRS_Z>0</TIE_POINT_CRS_Z>"
        f"<TIE_POINT_DATA_X>{col}</TIE_POINT_DATA_X><TIE_POINT_DATA_Y>{row}</TIE_POINT_DATA_Y>"
        "</Tie_Point></Geoposition_Points></Geoposition>"
    ).replace("np.float64(", "").replace(")", "")  # fmt: skip
    start = text.index("<Instrument_Look_Angles>")
    end = text.index("</Instrument_Look_Angles_List>")
    right = text[start:end].replace(
        "<Look_Angles_List>", "<BAND_INDEX>2</BAND_INDEX><Look_Angles_List>"
    )
    wrong = right.replace("<BAND_INDEX>2<", "<BAND_INDEX>1<").replace("0.01<", "0.0101<")
    both = text[:start] + wrong + right + text[end:]
    product = read_v1(both.replace("<Data_Strip>", ties + "<Data_Strip>"), tmp_path)
    assert any("band 2" in note for note in product.details["notes"])
    assert product.details["tie_points_farthest_m"] < 1e-3
