"""The push-broom camera: CCDs in a row, mounting, parameters by name."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import EPOCH, camera_directions, focal_plane
from scipy.spatial.transform import Rotation

from geoposition.camera import Camera, LineTiming
from geoposition.errors import ArgumentError
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.line_camera import Ccd, LineCamera, Mounting
from geoposition.sensors.timing import ConstantLineRate

TIMING: LineTiming = ConstantLineRate(EPOCH, 0.0, 1e-4)


def three_ccds() -> LineCamera:
    return LineCamera(100, TIMING, focal_plane(3, 50, 1e-6, 0.0, 20.0))


def test_ccds_stand_side_by_side() -> None:
    camera: Camera = three_ccds()
    assert camera.shape == (100, 150)
    ends = [(d.first_sample, d.last_sample) for d in camera.detectors]
    assert ends == [(0.0, 49.0), (50.0, 99.0), (100.0, 149.0)]
    # Without overlap the look angle runs on across the seams, and jumps along track.
    last, first = camera.tangents(0, 49.0), camera.tangents(1, 50.0)
    assert first[1] - last[1] == pytest.approx(1e-6, rel=1e-9)
    assert first[0] - last[0] == pytest.approx(20e-6, rel=1e-6)


def test_overlap_sees_the_same_ground_twice() -> None:
    camera = LineCamera(100, TIMING, focal_plane(2, 50, 1e-6, 8.0, 0.0))
    assert camera.shape == (100, 100)
    assert camera.tangents(0, 42.0)[1] == pytest.approx(camera.tangents(1, 50.0)[1], abs=1e-15)


def test_single() -> None:
    directions = camera_directions("table", 12000, 1e-6)
    camera = LineCamera.single((30, 12000), TIMING, directions)
    assert camera.shape == (30, 12000)
    (detector,) = camera.detectors
    assert len(detector.knots_sample) == 11998
    assert np.array_equal(camera.tangents(0, [3, 4]), directions.tangents([3, 4]))
    assert camera.R_body_camera.magnitude() == 0.0
    assert camera.lever_arm_body_m.tolist() == [0.0, 0.0, 0.0]


def test_parameters_by_name() -> None:
    camera = three_ccds()
    assert {"ccd0.x0", "ccd2.y1", "mounting_x_rad", "mounting_z_rad"} <= set(camera.parameters)
    moved = camera.with_parameters({"ccd1.x0": 5e-6, "mounting_z_rad": 1e-3})
    assert moved.parameters["ccd1.x0"] == 5e-6
    assert moved.parameters["ccd0.x0"] == camera.parameters["ccd0.x0"]
    assert moved.tangents(1, 60.0)[0] - camera.tangents(1, 60.0)[0] == pytest.approx(5e-6 - 20e-6)
    assert np.array_equal(moved.tangents(2, 120.0), camera.tangents(2, 120.0))
    assert moved.parameters["mounting_z_rad"] == 0.0
    assert np.allclose(moved.R_body_camera.as_rotvec(), [0, 0, 1e-3], atol=1e-15)
    assert camera.R_body_camera.magnitude() == 0.0


def test_mounting_turns_add_up_in_the_camera_frame() -> None:
    first = Rotation.from_euler("ZXY", [0.5, 0.1, -0.2])
    camera = LineCamera(10, TIMING, focal_plane(1, 50, 1e-6, 0, 0), Mounting(first, [1, 2, 3]))
    moved = camera.with_parameters({"mounting_x_rad": 0.01, "mounting_y_rad": -0.02})
    expected = first * Rotation.from_rotvec([0.01, -0.02, 0.0])
    assert (expected.inv() * moved.R_body_camera).magnitude() < 1e-15
    assert moved.lever_arm_body_m.tolist() == [1.0, 2.0, 3.0]


def test_ten_ccds_are_told_from_one() -> None:
    ccds = tuple(Ccd(10, PolynomialDirections([0.0], [i * 1e-5, 1e-6])) for i in range(12))
    camera = LineCamera(5, TIMING, ccds).with_parameters({"ccd1.x0": 1.0, "ccd10.x0": 2.0})
    assert [camera.parameters[f"ccd{i}.x0"] for i in (0, 1, 2, 10, 11)] == [0, 1, 0, 2, 0]


def test_misuse() -> None:
    camera = three_ccds()
    for name in ("ccd3.x0", "ccd0.x9", "x0", "mounting_x", ""):
        with pytest.raises(ArgumentError, match="no parameter"):
            camera.with_parameters({name: 0.0})
    with pytest.raises(ArgumentError, match="camera"):
        camera.with_parameters({"mounting_x_rad": np.nan})
    directions = PolynomialDirections([0.0], [0.0, 1e-6])
    for lines, ccds in ((0, (Ccd(5, directions),)), (5, ()), (5, (Ccd(0, directions),))):
        with pytest.raises(ArgumentError, match="at least one"):
            LineCamera(lines, TIMING, ccds)
    for arm in ([0.0, 1.0], [0.0, np.nan, 1.0], 0.0, np.zeros((1, 3))):
        with pytest.raises(ArgumentError, match="lever arm"):
            Mounting(lever_arm_body_m=arm)  # type: ignore[arg-type]


def test_cameras_compare_and_hash_without_raising() -> None:
    camera = three_ccds()
    assert camera == camera
    assert camera != three_ccds().with_parameters({"ccd0.x0": 1.0})
    assert len({camera, camera}) == 1
