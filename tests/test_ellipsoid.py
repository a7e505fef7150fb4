"""WGS 84: authority numbers, two outside implementations, round trips."""

from __future__ import annotations

import json
from pathlib import Path

import erfa
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoposition.constants import WGS84_A_M, WGS84_B_M
from geoposition.ellipsoid import (
    CENTRE_RADIUS_M,
    ecef_to_geodetic,
    ecef_to_geodetic_scalar,
    enu_axes,
    geodetic_to_ecef,
    geodetic_to_ecef_scalar,
    meridian_radius_m,
    normal_radius_m,
)
from geoposition.errors import ArgumentError

OREKIT = json.loads((Path(__file__).parent / "reference" / "orekit_frames.json").read_text())
# One unit in the last place of a coordinate is 0.9 nm at the Earth's surface.
ROUNDING_M = 4e-9


def points(n: int, low_m: float, high_m: float) -> np.ndarray:
    rng = np.random.default_rng(20)
    return np.stack(
        [
            rng.uniform(-np.pi, np.pi, n),
            np.arcsin(rng.uniform(-1, 1, n)),
            rng.uniform(low_m, high_m, n),
        ],
        axis=-1,
    )


def offset_m(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """East, north, up distances between geodetic points."""
    radius = WGS84_A_M + np.abs(a[..., 2])
    lon = (a[..., 0] - b[..., 0] + np.pi) % (2 * np.pi) - np.pi
    return np.stack(
        [lon * radius * np.cos(a[..., 1]), (a[..., 1] - b[..., 1]) * radius, a[..., 2] - b[..., 2]],
        axis=-1,
    )


def test_authority_numbers() -> None:
    # NGA.STND.0036 (2014), tables 3.1 and 3.3: semi-minor axis, polar radius of curvature.
    assert pytest.approx(6356752.3142, abs=5e-5) == WGS84_B_M
    assert float(normal_radius_m(np.pi / 2)) == pytest.approx(6399593.6258, abs=5e-5)
    assert float(meridian_radius_m(np.pi / 2)) == pytest.approx(6399593.6258, abs=5e-5)
    assert float(normal_radius_m(0.0)) == WGS84_A_M


@pytest.mark.parametrize(
    ("low_m", "high_m", "scale"),
    [(-10e3, 20e3, 1.0), (1e5, 2e6, 1.4), (2e6, 5e7, 9.0), (-3e6, 0.0, 1.3)],
)
def test_round_trip_to_rounding(low_m: float, high_m: float, scale: float) -> None:
    geodetic = points(100_000, low_m, high_m)
    back = ecef_to_geodetic(geodetic_to_ecef(geodetic))
    assert np.abs(offset_m(geodetic, back)).max() < ROUNDING_M * scale


def test_erfa_agrees() -> None:
    geodetic = points(20_000, -10e3, 20e3)
    theirs = erfa.gd2gc(1, geodetic[:, 0], geodetic[:, 1], geodetic[:, 2])
    assert np.abs(geodetic_to_ecef(geodetic) - theirs).max() < 2e-9
    # ERFA's single Halley step is exact to rounding only near the surface.
    inverse = np.stack(erfa.gc2gd(1, theirs), axis=-1)
    assert np.abs(offset_m(ecef_to_geodetic(theirs), inverse)).max() < ROUNDING_M


def test_orekit_agrees() -> None:
    geodetic = np.array([case["geodetic"] for case in OREKIT["geodetic"]])
    ecef = np.array([case["ecef_m"] for case in OREKIT["geodetic"]])
    assert np.abs(geodetic_to_ecef(geodetic) - ecef).max() < 2e-9
    assert np.abs(offset_m(geodetic, ecef_to_geodetic(ecef))).max() < ROUNDING_M


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi / 2, np.pi / 2), st.floats(-10e3, 5e7))
def test_any_point_comes_back(lon: float, lat: float, height: float) -> None:
    there = geodetic_to_ecef_scalar(lon, lat, height)
    back = np.array(ecef_to_geodetic_scalar(*there))
    scale = 1.0 + abs(height) / WGS84_A_M
    assert np.abs(offset_m(np.array([lon, lat, height]), back)).max() < ROUNDING_M * scale


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_on_the_axis(sign: float) -> None:
    for height in (-10e3, 0.0, 500e3, 5e7):
        lon, lat, found = ecef_to_geodetic([0.0, 0.0, sign * (WGS84_B_M + height)])
        assert (lon, lat) == (0.0, sign * np.pi / 2)
        assert found == pytest.approx(height, abs=1e-8)


def test_within_a_nanometre_of_the_axis_and_of_the_equator() -> None:
    near = ecef_to_geodetic([[1e-9, 0.0, WGS84_B_M], [WGS84_A_M, 0.0, 1e-9]])
    assert near[0, 1] == pytest.approx(np.pi / 2, abs=1e-15)
    assert near[1, 1] == pytest.approx(1e-9 / float(meridian_radius_m(0.0)), rel=1e-6)


def test_no_place_is_nan_and_spares_the_others() -> None:
    inside = 0.9 * CENTRE_RADIUS_M
    ecef = [[0, 0, 0], [inside, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [WGS84_A_M, 0, 0]]
    found = ecef_to_geodetic(ecef)
    assert np.isnan(found[:4]).all()
    assert np.abs(found[4]).max() < 1e-9
    assert np.isnan(geodetic_to_ecef([np.nan, 0.0, 0.0])).any()


def test_shapes_and_strides() -> None:
    geodetic = points(24, 0.0, 100.0).reshape(2, 3, 4, 3)
    ecef = geodetic_to_ecef(geodetic)
    assert ecef.shape == geodetic.shape
    assert np.array_equal(geodetic_to_ecef(geodetic[::-1, ::2]), ecef[::-1, ::2])
    assert ecef_to_geodetic(np.empty((0, 3))).shape == (0, 3)
    assert geodetic_to_ecef([0, 0, 0]).shape == (3,)
    with pytest.raises(ArgumentError):
        geodetic_to_ecef([0.0, 1.0])


def test_local_axes_are_the_derivatives() -> None:
    geodetic = points(200, 0.0, 1000.0)
    geodetic[:, 1] *= 0.98
    axes = enu_axes(geodetic)
    assert np.abs(np.swapaxes(axes, -1, -2) @ axes - np.eye(3)).max() < 1e-15
    assert np.abs(np.linalg.det(axes) - 1.0).max() < 1e-14
    height = geodetic[:, 2]
    metres = [
        (normal_radius_m(geodetic[:, 1]) + height) * np.cos(geodetic[:, 1]),
        meridian_radius_m(geodetic[:, 1]) + height,
        np.ones(len(height)),
    ]
    for k, (step, scale) in enumerate(zip((1e-6, 1e-6, 1.0), metres, strict=True)):
        move = step * np.eye(3)[k]
        slope = (geodetic_to_ecef(geodetic + move) - geodetic_to_ecef(geodetic - move)) / (2 * step)
        assert np.abs(slope / scale[:, None] - axes[..., k]).max() < 1e-8
