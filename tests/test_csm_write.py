from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from csm_scene import EPOCH, LINES, SAMPLES, grid, orbit, quaternions, scene
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation

from geoposition.attitude import Attitude, QuaternionCurve, RotationSplineCurve
from geoposition.corrections import (
    ALL_CORRECTIONS,
    NO_CORRECTIONS,
    Corrections,
    Refraction,
)
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ProductError, UnsupportedError
from geoposition.interpolation import SplineCurve
from geoposition.sensors.directions import CollinearDirections, PolynomialDirections
from geoposition.sensors.line_camera import Ccd
from geoposition.sensors.readers import csm
from geoposition.sensors.readers.source import Source
from geoposition.sensors.timing import ConstantLineRate, LineTimeTable
from geoposition.sensors.writers.csm import write_csm

PIXEL = 2e-6

# Keys that usgscsm's replaceModelState takes without a default.
DEMANDED = [
    "m_modelName",
    "m_imageIdentifier",
    "m_sensorName",
    "m_nLines",
    "m_nSamples",
    "m_platformFlag",
    "m_intTimeLines",
    "m_intTimeStartTimes",
    "m_intTimes",
    "m_startingEphemerisTime",
    "m_centerEphemerisTime",
    "m_detectorSampleSumming",
    "m_detectorLineSumming",
    "m_startingDetectorSample",
    "m_startingDetectorLine",
    "m_ikCode",
    "m_focalLength",
    "m_zDirection",
    "m_distortionType",
    "m_opticalDistCoeffs",
    "m_iTransS",
    "m_iTransL",
    "m_detectorSampleOrigin",
    "m_detectorLineOrigin",
    "m_majorAxis",
    "m_minorAxis",
    "m_platformIdentifier",
    "m_sensorIdentifier",
    "m_minElevation",
    "m_maxElevation",
    "m_dtEphem",
    "m_t0Ephem",
    "m_dtQuat",
    "m_t0Quat",
    "m_numPositions",
    "m_numQuaternions",
    "m_positions",
    "m_velocities",
    "m_quaternions",
    "m_currentParameterValue",
    "m_parameterType",
    "m_referencePointXyz",
    "m_sunPosition",
    "m_sunVelocity",
    "m_gsd",
    "m_flyingHeight",
    "m_halfSwath",
    "m_halfTime",
    "m_covariance",
    "m_logFile",
]


class UsgsCsm:
    """The line scanner's formulas anew, point by point, as an authority beside our reader."""

    def __init__(self, path: Path):
        name, _, text = path.read_text().partition("\n")
        assert name == "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
        self.s = json.loads(text)
        self.position = np.reshape(self.s["m_positions"], (-1, 3))
        self.quaternion = np.reshape(self.s["m_quaternions"], (-1, 4))

    def time(self, line: float) -> float:
        first = self.s["m_intTimeLines"]
        i = max(int(np.searchsorted(first, line, side="right")) - 1, 0)
        step = self.s["m_intTimes"][i]
        return self.s["m_intTimeStartTimes"][i] + step * (line - first[i] + 0.5)

    @staticmethod
    def lagrange(values: np.ndarray, t0: float, dt: float, time: float) -> np.ndarray:
        cell = (time - t0) / dt
        index = int(cell)
        # The image must lie where the stencils are full.
        assert 3 <= index < len(values) - 4
        nodes = np.arange(index - 3, index + 5)
        return BarycentricInterpolator(nodes - index, values[nodes])(cell - index)

    def centre(self, time: float) -> np.ndarray:
        return self.lagrange(self.position, self.s["m_t0Ephem"], self.s["m_dtEphem"], time)

    def rotation(self, time: float) -> Rotation:
        q = self.lagrange(self.quaternion, self.s["m_t0Quat"], self.s["m_dtQuat"], time)
        return Rotation.from_quat(q)

    def ray(self, line: float, sample: float) -> tuple[np.ndarray, np.ndarray]:
        s = self.s
        affine = np.array([s["m_iTransS"][1:], s["m_iTransL"][1:]])
        detector = [
            sample * s["m_detectorSampleSumming"]
            + s["m_startingDetectorSample"]
            - s["m_detectorSampleOrigin"]
            - s["m_iTransS"][0],
            s["m_startingDetectorLine"] - s["m_detectorLineOrigin"] - s["m_iTransL"][0],
        ]
        x, y = np.linalg.solve(affine, detector)
        c = s["m_opticalDistCoeffs"]
        if s["m_distortionType"] == 2:
            r = np.hypot(x, y)
            x = x + c[0] + c[1] + c[2] * r + c[3] * r**2 + c[4] * r**3
            y = y + c[5] + c[6] + c[7] * r + c[8] * r**2 + c[9] * r**3
        else:
            assert s["m_distortionType"] == 0
            assert not np.any(c)
        look = self.rotation(self.time(line)).apply([x, y, s["m_focalLength"]])
        return self.centre(self.time(line)), look / np.linalg.norm(look)

    def ground_to_image(self, ground: np.ndarray, line: float) -> tuple[float, int]:
        """CSM line of a ground point by its own steps from `line`, and how many it took."""
        s = self.s
        for step in range(1, 15):
            time = self.time(line)
            seen = self.rotation(time).inv().apply(ground - self.centre(time))
            x, y = s["m_focalLength"] * seen[:2] / seen[2]
            if s["m_distortionType"] == 2:
                c, seen_x, seen_y = s["m_opticalDistCoeffs"], x, y
                for _ in range(10):
                    r = np.hypot(x, y)
                    x = seen_x - (c[0] + c[1] + c[2] * r + c[3] * r**2 + c[4] * r**3)
                    y = seen_y - (c[5] + c[6] + c[7] * r + c[8] * r**2 + c[9] * r**3)
            off = s["m_iTransL"][0] + s["m_iTransL"][1] * x + s["m_iTransL"][2] * y
            line += off
            if abs(off) < 1e-3:
                return line, step
        return line, 99


def compare(model, path: Path, height_m: float) -> tuple[float, float]:
    """Greatest angle and distance of centres between the model and the state read back."""
    back = csm.read(Source.of(path)).model
    points = grid(*model.shape)
    ours, theirs = model.rays(points, height_m), back.rays(points, height_m)
    assert np.all(ours.flag == theirs.flag)
    angle = np.linalg.norm(np.cross(ours.direction_ecef, theirs.direction_ecef), axis=1)
    off = np.linalg.norm(ours.origin_ecef_m - theirs.origin_ecef_m, axis=1)
    return float(angle.max()), float(off.max())


TIMES = np.linspace(0.0, 6.0, 61)
SMOOTH = quaternions(TIMES, jitter_rad=1e-8)
CUBIC = PolynomialDirections(
    [0.003, 0.0, 1e-5, 2e-6], [0.0, 1500 * PIXEL, 3e-6, -1e-5], 1500.0, 1500.0
)
BENT = CollinearDirections(10.0, (-0.03, 0.001), (2e-5, 3e-7), 1e-3, (0.001, 0.0), (2e-2, 1e-1))
TABLE = LineTimeTable(EPOCH, [0.0, 1000.0, 2500.0, 3999.0], [1.0, 2.0, 3.4995, 5.0004])
CASES = {
    "slerp": {},
    "rotation spline": {"attitude": Attitude(EPOCH, RotationSplineCurve.through(TIMES, SMOOTH))},
    "quaternion lagrange": {"attitude": Attitude(EPOCH, QuaternionCurve.lagrange(TIMES, SMOOTH))},
    "cubic look angles": {"directions": CUBIC},
    "distorted lens": {"directions": BENT},
    "line times": {"timing": TABLE},
    "reverse scan": {"timing": ConstantLineRate(EPOCH, 5.0, -1e-3)},
    "spline orbit": {"ephemeris": Ephemeris(EPOCH, SplineCurve.through(TIMES, orbit(TIMES)[0]))},
    "corrections": {"corrections": ALL_CORRECTIONS},
    "refraction": {"corrections": Corrections(False, False, Refraction())},
}


@pytest.mark.parametrize("name", CASES)
def test_state_reads_back_to_the_same_rays(name: str, tmp_path: Path) -> None:
    model = scene(**CASES[name])
    report = write_csm(model, tmp_path / "state.json", height_m=700.0)
    angle, off = compare(model, tmp_path / "state.json", 700.0)
    assert angle < 1e-9
    assert off < 2e-5
    assert angle < 2.0 * report.max_angle_rad + 1e-12
    assert report.max_angle_px < 1e-3
    if CASES[name].get("corrections", NO_CORRECTIONS) == NO_CORRECTIONS:
        assert report.max_angle_rad < 3e-10
        assert report.max_shift_m < 1e-3


@pytest.mark.parametrize("name", ["slerp", "cubic look angles", "line times", "corrections"])
def test_usgscsm_formulas_give_the_models_rays(name: str, tmp_path: Path) -> None:
    model = scene(**CASES[name])
    write_csm(model, tmp_path / "state.json", height_m=700.0)
    state = UsgsCsm(tmp_path / "state.json")
    assert sorted(set(DEMANDED) - set(state.s)) == []
    points = grid()[::40]
    rays = model.rays(points, 700.0)
    for point, origin, direction in zip(
        points, rays.origin_ecef_m, rays.direction_ecef, strict=True
    ):
        centre, look = state.ray(point[0] + 0.5, point[1] + 0.5)
        np.testing.assert_allclose(centre, origin, rtol=0, atol=2e-5)
        np.testing.assert_allclose(look, direction, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["slerp", "reverse scan", "cubic look angles"])
def test_usgscsm_finds_the_line_of_a_ground_point(name: str, tmp_path: Path) -> None:
    model = scene(**CASES[name])
    write_csm(model, tmp_path / "state.json", height_m=700.0)
    state = UsgsCsm(tmp_path / "state.json")
    points = np.array([[900.0, 0.0], [2700.0, 3000.0], [1500.0, 2900.0], [1800.0, 1500.0]])
    ground = geodetic_to_ecef(model.image_to_ground(points, 700.0).geodetic)
    for point, at in zip(points, ground, strict=True):
        line, steps = state.ground_to_image(at, 1800.0)
        assert steps <= 8
        assert abs(line - 0.5 - point[0]) < 0.02


def test_state_holds_the_height_asked_and_reports_the_shift_at_others(tmp_path: Path) -> None:
    model = scene(corrections=ALL_CORRECTIONS)
    report = write_csm(model, tmp_path / "state.json", height_m=0.0)
    back = csm.read(Source.of(tmp_path / "state.json")).model
    points = grid()
    shifts = []
    for height in (0.0, 2000.0):
        ours, theirs = (
            geodetic_to_ecef(m.image_to_ground(points, height).geodetic) for m in (model, back)
        )
        shifts.append(np.linalg.norm(ours - theirs, axis=1).max())
    assert shifts[0] < 1e-3
    # Measured across the ray there, on the ground here: the same but for the slant.
    assert 0.5 * report.max_shift_m < shifts[1] < 1.5 * report.max_shift_m


def test_times_and_names_are_kept(tmp_path: Path) -> None:
    write_csm(scene(), tmp_path / "state.json", sensor="TESTSAT", image="scene 7")
    product = csm.read(Source.of(tmp_path / "state.json"))
    assert product.sensor == "TESTSAT"
    assert abs(product.start - (EPOCH + 1.0)) < 2e-7
    assert product.model.height_range_m == (0.0, 2000.0)
    assert product.model.shape == (LINES, SAMPLES)


def test_several_ccds_that_no_line_holds_are_refused(tmp_path: Path) -> None:
    left = PolynomialDirections([0.003], [-1500 * PIXEL, PIXEL])
    right = PolynomialDirections([0.0031], [-1500 * PIXEL, PIXEL])
    model = scene(ccds=(Ccd(1500, left), Ccd(1501, right)))
    with pytest.raises(UnsupportedError, match="focal plane"):
        write_csm(model, tmp_path / "state.json")
    assert list(tmp_path.iterdir()) == []


def test_unwritable_place_is_one_error_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ProductError, match="writable place"):
        write_csm(scene(), tmp_path / "missing" / "state.json")
    assert list(tmp_path.iterdir()) == []
