from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.errors import ArgumentError, MissingFileError, ProductError, UnsupportedError
from geoposition.interpolation import LagrangeCurve
from geoposition.sensors.readers import csm
from geoposition.sensors.readers.csm_focal_plane import CubicDirections, FocalPlane
from geoposition.sensors.readers.csm_interpolation import CsmLagrangeCurve
from geoposition.sensors.readers.source import Source

NAME = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
LINES, SAMPLES = 200, 101


def state() -> dict[str, Any]:
    """A camera 500 km above (0, 0) flying north, looking straight down, 2e-6 rad a pixel."""
    times = -1.0 + 0.1 * np.arange(21)
    angle = 1e-3 * times
    position = 6878137.0 * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)
    # Camera x east, y south, z down: columns of the rotation camera to ECEF at t = 0.
    down = Rotation.from_matrix(np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))
    quats = (Rotation.from_rotvec(np.outer(-angle, [0.0, 1.0, 0.0])) * down).as_quat()
    return {
        "m_modelName": NAME,
        "m_nLines": LINES,
        "m_nSamples": SAMPLES,
        "m_platformFlag": 1,
        "m_intTimeLines": [1.0],
        "m_intTimeStartTimes": [-0.1],
        "m_intTimes": [1e-3],
        "m_startingEphemerisTime": 6e8,
        "m_centerEphemerisTime": 6e8 + 0.1,
        "m_detectorSampleSumming": 1.0,
        "m_detectorLineSumming": 1.0,
        "m_startingDetectorSample": 0.0,
        "m_startingDetectorLine": 0.0,
        "m_focalLength": 5e5,
        "m_zDirection": 1.0,
        "m_distortionType": 0,
        "m_opticalDistCoeffs": [0.0, 0.0, 0.0],
        "m_iTransS": [0.0, 1.0, 0.0],
        "m_iTransL": [0.0, 0.0, 1.0],
        "m_detectorSampleOrigin": 50.5,
        "m_detectorLineOrigin": 0.0,
        "m_majorAxis": 6378137.0,
        "m_minorAxis": 6356752.314245179,
        "m_platformIdentifier": "PLATFORM",
        "m_sensorIdentifier": "SENSOR",
        "m_minElevation": -10000.0,
        "m_maxElevation": 10000.0,
        "m_dtEphem": 0.1,
        "m_t0Ephem": -1.0,
        "m_dtQuat": 0.1,
        "m_t0Quat": -1.0,
        "m_numPositions": 63,
        "m_numQuaternions": 84,
        "m_positions": position.ravel().tolist(),
        "m_velocities": [0.0] * 63,
        "m_quaternions": quats.ravel().tolist(),
        "m_currentParameterValue": [0.0] * 16,
    }


def write(path: Path, data: dict[str, Any], name: str = NAME) -> Path:
    path.write_text((f"{name}\n" if name else "") + json.dumps(data, indent=1))
    return path


def isd() -> dict[str, Any]:
    """The same camera as support data: over a body that turns against J2000."""
    times = -1.0 + 0.1 * np.arange(21)
    spin = Rotation.from_rotvec(np.outer(7e-5 * times, [0.0, 0.0, 1.0]))
    given = state()
    position = spin.inv().apply(np.reshape(given["m_positions"], (-1, 3)))
    to_fixed = Rotation.from_quat(np.reshape(given["m_quaternions"], (-1, 4)))
    to_sensor = (spin.inv() * to_fixed).inv()

    def wxyz(rotation: Rotation) -> list[list[float]]:
        return np.roll(rotation.as_quat(), 1, axis=1).tolist()

    stamps = (1000.0 + times).tolist()
    return {
        "name_model": NAME,
        "name_platform": "PLATFORM",
        "name_sensor": "SENSOR",
        "center_ephemeris_time": 1000.0,
        "starting_ephemeris_time": 999.9,
        "line_scan_rate": [[1.0, -0.1, 1e-3]],
        "detector_sample_summing": 1,
        "detector_line_summing": 1,
        "focal2pixel_lines": [0.0, 0.0, 1.0],
        "focal2pixel_samples": [0.0, 1.0, 0.0],
        "focal_length_model": {"focal_length": 5e5},
        "image_lines": LINES,
        "image_samples": SAMPLES,
        "detector_center": {"line": 0.0, "sample": 50.5},
        "optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}},
        "radii": {"semimajor": 6378.137, "semiminor": 6356.752314245179, "unit": "km"},
        "reference_height": {"maxheight": 1000, "minheight": -1000, "unit": "m"},
        "instrument_position": {
            "unit": "km",
            "positions": (position / 1000).tolist(),
            "ephemeris_times": [*stamps],
        },
        "instrument_pointing": {"quaternions": wxyz(to_sensor), "ephemeris_times": [*stamps]},
        "body_rotation": {"quaternions": wxyz(spin), "ephemeris_times": [*stamps]},
        "starting_detector_line": 0,
        "starting_detector_sample": 0,
    }


def test_pixel_below_the_satellite_and_its_neighbours(tmp_path: Path) -> None:
    product = csm.read(Source.of(write(tmp_path / "s.json", state())))
    # t = 0 at row 100; sample 50 (CSM 50.5) is the detector's centre: straight down at (0, 0).
    ground = product.model.image_to_ground([[100.0, 50.0], [100.0, 60.0], [110.0, 50.0]], 0.0)
    lon, lat = ground.geodetic[:, 0], ground.geodetic[:, 1]
    np.testing.assert_allclose([lon[0], lat[0]], 0.0, atol=1e-12)
    np.testing.assert_allclose(lon[1] * 6378137.0, 10 * 2e-6 * 500e3, rtol=1e-4)
    # 0.01 s later: 1e-5 rad farther north, geocentric.
    np.testing.assert_allclose(np.tan(lat[2]) * (6356752.314245179 / 6378137.0) ** 2, 1e-5, 1e-3)
    assert product.sensor == "PLATFORM SENSOR"
    assert product.model.height_range_m == (-500.0, 9000.0)
    assert product.start is not None
    assert abs(product.start.jd_tt()[0] + product.start.jd_tt()[1] - 2451545.0 - 6e8 / 86400) < 1e-8


def test_header_line_is_optional_and_so_is_facing_the_ground(tmp_path: Path) -> None:
    points = [[0.0, 0.0], [150.0, 90.0], [-0.5, 100.5]]
    ahead = csm.read_line_scanner(write(tmp_path / "a.json", state(), name=""))
    backward = state() | {"m_focalLength": -5e5, "m_iTransS": [0.0, -1.0, 0.0]}
    backward["m_iTransL"] = [0.0, 0.0, -1.0]
    behind = csm.read_line_scanner(write(tmp_path / "b.json", backward))
    np.testing.assert_allclose(behind.rays(points)[1], ahead.rays(points)[1], atol=1e-15)
    # The look vector -(x, y, f) of older support data: the same line, seen from behind.
    turned = state()
    quats = Rotation.from_quat(np.reshape(turned["m_quaternions"], (-1, 4)))
    flip = Rotation.from_rotvec([np.pi, 0.0, 0.0])
    turned["m_quaternions"] = (quats * flip).as_quat().ravel().tolist()
    away = csm.read_line_scanner(write(tmp_path / "c.json", turned))
    centre, direction = away.rays(points)
    assert np.all(np.sum(centre * direction, axis=1) < 0)


def test_support_data_give_the_same_rays_as_the_state(tmp_path: Path) -> None:
    a = csm.read_line_scanner(write(tmp_path / "a.json", state()))
    b = csm.read_line_scanner(write(tmp_path / "b.json", isd(), name=""))
    points = np.random.default_rng(3).uniform(-0.5, 100.0, (50, 2))
    np.testing.assert_allclose(a.rays(points)[0], b.rays(points)[0], atol=2e-8)
    np.testing.assert_allclose(a.rays(points)[1], b.rays(points)[1], atol=1e-12)
    assert b.height_range_m == (-1000.0, 1000.0)
    # A constant rotation before the varying one, and another body's axes.
    turned = isd()
    turn = Rotation.from_euler("z", 90, degrees=True)
    turned["body_rotation"]["constant_rotation"] = turn.as_matrix().ravel().tolist()
    c = csm.read_line_scanner(write(tmp_path / "c.json", turned, name=""))
    np.testing.assert_allclose(c.rays(points)[1], turn.apply(a.rays(points)[1]), atol=1e-12)


def test_line_times_of_several_segments(tmp_path: Path) -> None:
    data = state() | {
        "m_intTimeLines": [1.0, 101.0],
        "m_intTimeStartTimes": [-0.1, 0.0],
        "m_intTimes": [1e-3, 1.002e-3],
    }
    timing = csm.read_line_scanner(write(tmp_path / "s.json", data)).camera.timing
    np.testing.assert_allclose(timing.time_s([0, 100, 150]), [-0.1, 0.0, 0.0501], atol=1e-12)
    gap = data | {"m_intTimeStartTimes": [-0.1, 0.01]}
    with pytest.raises(UnsupportedError, match=r"m_intTimeStartTimes\[1\].*jump of 10 lines"):
        csm.read_line_scanner(write(tmp_path / "g.json", gap))


def test_radial_distortion_follows_its_formula(tmp_path: Path) -> None:
    k = [0.01, 1e-6, 2e-10]
    bent = csm.read_line_scanner(
        write(tmp_path / "s.json", state() | {"m_opticalDistCoeffs": k})
    ).camera
    sample = np.linspace(-0.5, 100.5, 9)
    x = sample - 50.0
    expected = x * (1 - k[0] - k[1] * x**2 - k[2] * x**4) / 5e5
    np.testing.assert_allclose(bent.tangents(0, sample)[:, 0], expected, rtol=1e-13, atol=1e-19)


def test_cubic_distortion_follows_its_formula_and_gives_its_parameters(tmp_path: Path) -> None:
    c = [0.5, 0.1, 1e-3, 2e-5, 3e-8, -0.5, 0.2, 2e-3, 1e-5, -1e-8]
    data = state() | {"m_distortionType": 2, "m_opticalDistCoeffs": c}
    directions = csm.read_line_scanner(write(tmp_path / "s.json", data)).camera.ccds[0].directions
    assert isinstance(directions, CubicDirections)
    sample = np.linspace(-0.5, 100.5, 9)
    x = sample - 50.0
    r = np.abs(x)
    expected_x = (x + 0.6 + 1e-3 * r + 2e-5 * r**2 + 3e-8 * r**3) / 5e5
    expected_y = (-0.3 + 2e-3 * r + 1e-5 * r**2 - 1e-8 * r**3) / 5e5
    np.testing.assert_allclose(
        directions.tangents(sample), np.stack([expected_x, expected_y], -1), atol=1e-18
    )
    np.testing.assert_allclose(directions.knots_sample, [50.0])
    assert directions.parameters["x3"] == 3e-8
    assert directions.with_parameters({"x3": 0.0}).parameters["x3"] == 0.0
    with pytest.raises(ArgumentError):
        directions.with_parameters({"nonsense": 0.0})


def test_other_bodies_have_rays_but_no_ground(tmp_path: Path) -> None:
    path = write(
        tmp_path / "moon.json", state() | {"m_majorAxis": 1737400.0, "m_minorAxis": 1737400.0}
    )
    assert csm.read_line_scanner(path).rays([0.0, 0.0])[0].shape == (3,)
    with pytest.raises(UnsupportedError, match=r"moon\.json: ellipsoid: WGS 84 expected"):
        csm.read(Source.of(path))


def _set(key: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.__setitem__(key, value)


def _entry(key: str, index: int, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda data: data[key].__setitem__(index, value)


HOSTILE = [
    (lambda data: data.pop("m_t0Quat"), "m_t0Quat: this key is missing"),
    (lambda data: data.pop("m_positions"), "m_positions: this key is missing"),
    (_set("m_nLines", 0), "m_nLines: a positive whole number"),
    (_set("m_nLines", 12.5), "m_nLines: a positive whole number"),
    (_set("m_nSamples", "many"), "m_nSamples: a number expected"),
    (_set("m_nSamples", True), "m_nSamples: a number expected"),
    (_set("m_focalLength", 0), "m_focalLength: focal plane"),
    (_set("m_focalLength", 10**400), "m_focalLength: a finite number"),
    (_set("m_zDirection", 2), "m_zDirection: 1 or -1"),
    (_set("m_dtEphem", 0.0), "m_dtEphem: a positive time step"),
    (_set("m_dtQuat", -0.1), "m_dtQuat: a positive time step"),
    (_set("m_numPositions", 62), "m_numPositions: 63 expected"),
    (_set("m_positions", [1.0] * 10), "m_positions: .*two rows or more"),
    (_entry("m_positions", 7, None), r"m_positions\[7\]: a number expected"),
    (_entry("m_positions", 7, [1.0]), r"m_positions\[7\]: a number expected"),
    (_entry("m_positions", 7, 1e999), "JSON expected"),
    (_entry("m_quaternions", 8, 5.0), "m_quaternions: .*unit norm"),
    (_set("m_quaternions", [0.0] * 84), "m_quaternions: .*unit norm"),
    (_set("m_iTransS", [0.0, 1.0]), "m_iTransS: 3 entries"),
    (_set("m_iTransS", [0.0, 0.0, 2.0]), "m_iTransS.*parallel"),
    (_set("m_intTimes", []), "m_intTimes: 1 entries"),
    (_set("m_intTimes", [0.0]), "m_intTimes: line times other than 0"),
    (_set("m_intTimeLines", []), "m_intTimeLines: at least one"),
    (_set("m_intTimeStartTimes", [30.0]), "times: the image's lines are not covered"),
    (_set("m_distortionType", 3), r"m_distortionType: .*got 3 \(dawnfc\)"),
    (_set("m_distortionType", 99), "m_distortionType: .*got 99"),
    (_set("m_opticalDistCoeffs", [0.0]), "m_opticalDistCoeffs: 3 entries"),
    (_entry("m_currentParameterValue", 6, 1e-3), r"m_currentParameterValue\[6\]: no adjustment"),
    (_set("m_modelName", "USGS_ASTRO_FRAME_SENSOR_MODEL"), "m_modelName: .*FRAME"),
    (_set("m_minElevation", 20000.0), "elevation range"),
]


@pytest.mark.parametrize(("spoil", "message"), HOSTILE)
def test_hostile_state_is_one_error_that_names_the_key(
    spoil: Callable[[dict[str, Any]], None], message: str, tmp_path: Path
) -> None:
    data = state()
    spoil(data)
    path = write(tmp_path / "spoilt.json", data)
    with pytest.raises(ProductError, match=message) as caught:
        csm.read(Source.of(path))
    assert "spoilt.json" in str(caught.value)
    assert "\n" not in str(caught.value)


HOSTILE_ISD = [
    (lambda d: d.pop("radii"), "radii: this key is missing"),
    (lambda d: d["radii"].update(unit="mile"), "radii.unit: m or km"),
    (lambda d: d.update(line_scan_rate=[[1.0, 2.0]]), r"line_scan_rate\[0\]: 3 numbers"),
    (
        lambda d: d["instrument_position"]["ephemeris_times"].__setitem__(3, 0.0),
        "instrument_position.ephemeris_times: strictly increasing",
    ),
    (
        lambda d: d["instrument_position"]["ephemeris_times"].pop(),
        "instrument_position.ephemeris_times: 21 entries",
    ),
    (
        lambda d: d["instrument_position"]["ephemeris_times"].__setitem__(3, 999.35),
        "equal time steps",
    ),
    (
        lambda d: d["instrument_pointing"]["quaternions"].__setitem__(2, [1.0, 1.0, 0.0, 0.0]),
        "instrument_pointing.quaternions: .*unit norm",
    ),
    (
        lambda d: d["body_rotation"].update(
            quaternions=[[1.0, 0.0, 0.0, 0.0]] * 2, ephemeris_times=[1000.0, 1000.1]
        ),
        "body_rotation.ephemeris_times: .*expected to be covered",
    ),
    (
        lambda d: d["body_rotation"].update(constant_rotation=[1.0] * 9),
        "constant_rotation: a rotation matrix",
    ),
    (lambda d: d.update(optical_distortion={"dawnfc": {}}), "optical_distortion: radial alone"),
    (lambda d: d.update(detector_center=7), "detector_center: an object"),
]


@pytest.mark.parametrize(("spoil", "message"), HOSTILE_ISD)
def test_hostile_support_data_are_one_error(
    spoil: Callable[[dict[str, Any]], None], message: str, tmp_path: Path
) -> None:
    data = isd()
    spoil(data)
    path = write(tmp_path / "spoilt.json", data, name="")
    with pytest.raises(ProductError, match=message):
        csm.read(Source.of(path))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "JSON expected"),
        (b'{"m_modelName": "USGS', "JSON expected"),
        (b'{"m_modelName": NaN}', "NaN is no number"),
        (b"USGS_ASTRO_FRAME_SENSOR_MODEL\n{}", "first line: .*FRAME"),
        (NAME.encode() + b"\n[1, 2]", "a JSON object"),
        (b"\xff\xfe\x00{}", "UTF-8"),
        (b"[" * 200000, "nested too deeply|JSON expected"),
    ],
)
def test_no_json_is_one_error(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(ProductError, match=message):
        csm.read_line_scanner(path)
    with pytest.raises(MissingFileError):
        csm.read_line_scanner(tmp_path / "none.json")


def test_recognises_its_own_and_nothing_else(tmp_path: Path) -> None:
    assert csm.recognises(Source.of(write(tmp_path / "a.json", state())))
    assert csm.recognises(Source.of(write(tmp_path / "b.json", state(), name="")))
    assert csm.recognises(Source.of(write(tmp_path / "c.json", isd(), name="")))
    (tmp_path / "d.json").write_text('{"type": "FeatureCollection"}')
    (tmp_path / "e.xml").write_text("<isd>m_modelName</isd>")
    assert not csm.recognises(Source.of(tmp_path / "d.json"))
    assert not csm.recognises(Source.of(tmp_path / "e.xml"))


def test_lagrange_is_exact_for_polynomials_its_stencil_holds_and_narrows_at_the_ends() -> None:
    times = 2.0 + 0.5 * np.arange(20)
    coefficients = np.random.default_rng(2).normal(size=(8, 2)) / 5.0 ** np.arange(8)[:, None]
    polyval = np.polynomial.polynomial.polyval
    values = polyval(times - 6, coefficients).T
    curve = CsmLagrangeCurve(2.0, 0.5, values)
    inner = np.linspace(3.6, 9.4, 41)
    np.testing.assert_allclose(curve.value(inner), polyval(inner - 6, coefficients).T, atol=1e-10)
    # Equal to the centred 8-point curve inside, linear in the first cell.
    full = LagrangeCurve(times, values, 8)
    np.testing.assert_allclose(curve.value(inner), full.value(inner), atol=1e-10)
    np.testing.assert_allclose(curve.rate(inner), full.rate(inner), atol=1e-9)
    np.testing.assert_allclose(curve.value(2.2), values[0] + 0.4 * (values[1] - values[0]))
    np.testing.assert_allclose(curve.value([2.0, 11.5]), values[[0, -1]])
    with pytest.raises(ValueError, match="outside the span"):
        curve.value(1.9)
    for bad in ({"step_s": 0.0}, {"order": 6}, {"values": [[1.0]]}):
        with pytest.raises(ArgumentError):
            CsmLagrangeCurve(**({"start_s": 0.0, "step_s": 1.0, "values": values} | bad))


def test_rate_is_the_derivative() -> None:
    curve = CsmLagrangeCurve(0.0, 1.0, np.random.default_rng(4).normal(size=(12, 3)))
    times = np.arange(11) + 0.37
    step = 1e-6
    slope = (curve.value(times + step) - curve.value(times - step)) / (2 * step)
    np.testing.assert_allclose(curve.rate(times), slope, atol=1e-8)


def test_focal_plane_inverts_the_affine_transforms() -> None:
    plane = FocalPlane.from_affine(
        [0.3, 90.0, 4.0], [-0.7, 5.0, 110.0], (0.5, 8.0), (1.0, 3.0), 2.0, 50.0
    )
    for sample in (0.0, 17.0):
        x, y = plane.origin + plane.step * sample
        # usgscsm: plane to detector, with its half pixel and the summing of samples.
        assert np.isclose(0.3 + 90 * x + 4 * y + 8.0, (sample + 0.5) * 2.0 + 3.0)
        assert np.isclose(-0.7 + 5 * x + 110 * y + 0.5, 1.0)
