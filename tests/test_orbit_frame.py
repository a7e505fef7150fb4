"""Orbit axes by hand, roll, pitch and yaw by what the camera then sees."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoposition.constants import EARTH_RATE_RAD_S
from geoposition.errors import GeometryError
from geoposition.orbit_frame import (
    R_inertial_orbit,
    R_inertial_orbit_nadir,
    R_orbit_body,
    inertial_velocity_ecef,
    nadir_orbit_axes,
    orbit_angles,
    spot_orbit_axes,
    zenith_orbit_axes,
)

# Above the point (lon 0, lat 0), flying north and slightly climbing: left is west.
POSITION_M = np.array([7e6, 0.0, 0.0])
VELOCITY_M_S = np.array([12.0, 0.0, 7500.0])
UP, WEST, NORTH = np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), np.array([0, 0, 1.0])


@pytest.mark.parametrize(
    ("axes", "x", "y", "z"),
    [
        (zenith_orbit_axes, NORTH, WEST, UP),
        (nadir_orbit_axes, NORTH, -WEST, -UP),
        (spot_orbit_axes, -WEST, NORTH, UP),
    ],
)
def test_axes_above_the_equator_flying_north(axes, x, y, z) -> None:  # type: ignore[no-untyped-def]
    found = axes(POSITION_M, VELOCITY_M_S)
    assert np.allclose(found, np.stack([x, y, z], axis=-1), atol=1e-15)
    assert np.linalg.det(found) == pytest.approx(1.0, abs=1e-15)


def test_spot_axes_are_the_printed_formula() -> None:
    rng = np.random.default_rng(1)
    position, velocity = 7e6 * rng.normal(size=(9, 3)), 7e3 * rng.normal(size=(9, 3))
    z = position / np.linalg.norm(position, axis=-1, keepdims=True)
    x = np.cross(velocity, z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    expected = np.stack([x, np.cross(z, x), z], axis=-1)
    assert np.allclose(spot_orbit_axes(position, velocity), expected, atol=1e-14)


def test_rotations_are_the_axes_and_broadcast() -> None:
    rng = np.random.default_rng(2)
    position, velocity = 7e6 * rng.normal(size=(2, 4, 3)), 7e3 * rng.normal(size=(4, 3))
    for rotation, axes in (
        (R_inertial_orbit, zenith_orbit_axes),
        (R_inertial_orbit_nadir, nadir_orbit_axes),
    ):
        matrices = axes(position, velocity)
        assert matrices.shape == (2, 4, 3, 3)
        assert np.allclose(rotation(position, velocity).as_matrix(), matrices, atol=1e-15)
        assert np.allclose(matrices @ np.swapaxes(matrices, -1, -2), np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("angles", "zenith_sees", "nadir_sees"),
    [
        ({"roll_rad": 0.1}, WEST, WEST),
        ({"pitch_rad": 0.1}, -NORTH, NORTH),
    ],
)
def test_where_the_camera_looks(angles, zenith_sees, nadir_sees) -> None:  # type: ignore[no-untyped-def]
    turn = R_orbit_body(**{"roll_rad": 0.0, "pitch_rad": 0.0, "yaw_rad": 0.0, **angles})
    down = np.array([0.0, 0.0, 1.0])
    zenith = R_inertial_orbit(POSITION_M, VELOCITY_M_S) * turn
    assert zenith.apply(-down) == pytest.approx(
        -np.cos(0.1) * UP + np.sin(0.1) * zenith_sees, abs=1e-15
    )
    nadir = R_inertial_orbit_nadir(POSITION_M, VELOCITY_M_S) * turn
    assert nadir.apply(down) == pytest.approx(
        -np.cos(0.1) * UP + np.sin(0.1) * nadir_sees, abs=1e-15
    )


def test_where_the_nose_points() -> None:
    turn = R_orbit_body(0.0, 0.0, 0.1)
    nose = np.array([1.0, 0.0, 0.0])
    left = np.cos(0.1) * NORTH + np.sin(0.1) * WEST
    right = np.cos(0.1) * NORTH - np.sin(0.1) * WEST
    assert (R_inertial_orbit(POSITION_M, VELOCITY_M_S) * turn).apply(nose) == pytest.approx(left)
    assert (R_inertial_orbit_nadir(POSITION_M, VELOCITY_M_S) * turn).apply(nose) == (
        pytest.approx(right)
    )


small = st.floats(-1.5, 1.5)


@given(small, small, st.floats(-3.1, 3.1))
def test_angles_come_back(roll: float, pitch: float, yaw: float) -> None:
    found = orbit_angles(R_orbit_body(roll, pitch, yaw))
    assert not found.singular
    got = [float(found.roll_rad), float(found.pitch_rad), float(found.yaw_rad)]
    assert got == pytest.approx([roll, pitch, yaw], abs=1e-11)


def test_ninety_degrees_of_roll_is_flagged_and_the_rest_kept() -> None:
    found = orbit_angles(R_orbit_body([np.pi / 2, 0.2], [0.3, np.pi / 2], [0.1, 0.1]))
    assert found.singular.tolist() == [True, False]
    assert found.pitch_rad[1] == pytest.approx(np.pi / 2)


def test_inertial_velocity_of_a_ground_point_is_the_earths_spin() -> None:
    velocity = inertial_velocity_ecef([6378137.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    assert velocity == pytest.approx([0.0, 6378137.0 * EARTH_RATE_RAD_S, 0.0])


@pytest.mark.parametrize(
    ("position", "velocity"),
    [
        ([0.0, 0.0, 0.0], [0.0, 7e3, 0.0]),
        ([7e6, 0.0, 0.0], [7e3, 0.0, 0.0]),
        ([7e6, 0.0, 0.0], [0.0, 0.0, 0.0]),
        ([7e6, np.nan, 0.0], [0.0, 7e3, 0.0]),
    ],
)
def test_no_orbit_no_frame(position: list[float], velocity: list[float]) -> None:
    with pytest.raises(GeometryError):
        zenith_orbit_axes(position, velocity)
