"""GCRS to ITRS against Orekit, against the equinox-based chain by hand, against itself."""

from __future__ import annotations

import json
from pathlib import Path

import erfa
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.constants import EARTH_RATE_RAD_S
from geoposition.earth_orientation import FixedOrientation, OrientationTable
from geoposition.errors import ArgumentError, EarthOrientationError
from geoposition.frames import (
    R_eme2000_gcrs,
    R_gcrs_body,
    R_itrs_body,
    R_itrs_gcrs,
    earth_rate_itrs,
    gcrs_from_itrs,
    itrs_from_gcrs,
    matrix_itrs_gcrs,
)
from geoposition.timescale import Epoch

OREKIT = json.loads((Path(__file__).parent / "reference" / "orekit_frames.json").read_text())
CASES = pytest.mark.parametrize("case", OREKIT["frames"], ids=lambda case: case["utc"])
EPOCH = Epoch.from_utc("2014-06-19T18:52:50.787577Z")
LEAPS_AND_YEAR_ENDS = [
    "1972-07-01T00:00:00Z",
    "1999-12-31T23:59:59.9Z",
    "2012-06-30T23:59:60.5Z",
    "2016-12-31T23:59:59Z",
    "2016-12-31T23:59:60.9Z",
    "2017-01-01T00:00:00Z",
    "2020-02-29T12:00:00Z",
    "2026-12-31T23:59:59.999Z",
]


def angle_rad(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a @ np.swapaxes(b, -1, -2) - np.eye(3)) / np.sqrt(2))


def stated(case: dict[str, float], epoch: Epoch) -> FixedOrientation:
    """The orientation Orekit itself used."""
    return FixedOrientation(
        case["ut1_minus_tai_s"] + epoch.tai_minus_utc_s,
        case["xp_rad"],
        case["yp_rad"],
        case["dx_rad"],
        case["dy_rad"],
    )


@CASES
def test_the_models_are_orekits(case: dict[str, float]) -> None:
    epoch = Epoch.from_utc(str(case["utc"]))
    found = matrix_itrs_gcrs(epoch, 0.0, stated(case, epoch))
    assert angle_rad(found, np.array(case["matrix_itrs_gcrs"])) < 1e-11


@CASES
def test_the_whole_chain_is_orekits(case: dict[str, float]) -> None:
    """With the tables: 1e-9 rad leaves room for what IERS may yet revise in recent days."""
    epoch = Epoch.from_utc(str(case["utc"]))
    assert angle_rad(matrix_itrs_gcrs(epoch, 0.0), np.array(case["matrix_itrs_gcrs"])) < 1e-9
    assert earth_rate_itrs(epoch, 0.0) == pytest.approx(case["rate_itrs_rad_s"], abs=5e-13)
    position, velocity = itrs_from_gcrs(
        OREKIT["position_gcrs_m"], OREKIT["velocity_gcrs_m_s"], epoch, 0.0
    )
    assert position == pytest.approx(case["position_itrs_m"], abs=5e-3)
    assert velocity == pytest.approx(case["velocity_itrs_m_s"], abs=1e-5)


@pytest.mark.parametrize("utc", LEAPS_AND_YEAR_ENDS)
def test_the_equinox_based_chain_by_hand(utc: str) -> None:
    """Sidereal time and the classical matrix instead of the CIO: another road, same place."""
    epoch = Epoch.from_utc(utc)
    values = OrientationTable.shipped().at(epoch, 0.0)
    tt = epoch.jd_tt()
    jd_day, jd_tai = epoch.jd_tai()
    ut1 = jd_day, jd_tai + float(values.ut1_minus_tai_s) / 86400.0
    without_offsets = FixedOrientation(
        float(values.ut1_minus_tai_s) + epoch.tai_minus_utc_s,
        float(values.xp_rad),
        float(values.yp_rad),
    )
    pole = erfa.pom00(float(values.xp_rad), float(values.yp_rad), erfa.sp00(*tt))
    true_equator = erfa.pnm06a(*tt)
    sidereal_rad = erfa.gst06(*ut1, *tt, true_equator)
    by_hand = pole @ erfa.rz(sidereal_rad, np.eye(3)) @ true_equator
    assert angle_rad(matrix_itrs_gcrs(epoch, 0.0, without_offsets), by_hand) < 1e-13
    direct = erfa.c2t06a(*tt, *ut1, float(values.xp_rad), float(values.yp_rad))
    assert angle_rad(matrix_itrs_gcrs(epoch, 0.0, without_offsets), direct) < 1e-13
    # The celestial pole offsets are what remains: their size, seen from the pole.
    offsets = angle_rad(matrix_itrs_gcrs(epoch, 0.0), by_hand)
    assert offsets == pytest.approx(float(np.hypot(values.dx_rad, values.dy_rad)), rel=1e-3)


def test_sofa_cookbook() -> None:
    """SOFA Tools for Earth Attitude, 5.5: 2007 April 5, 12h UTC, IAU 2006/2000A, CIO based."""
    arcsec_rad = np.pi / 648000
    orientation = FixedOrientation(
        -0.072073685,
        xp_rad=0.0349282 * arcsec_rad,
        yp_rad=0.4833163 * arcsec_rad,
        dx_rad=0.1750e-3 * arcsec_rad,
        dy_rad=-0.2259e-3 * arcsec_rad,
    )
    printed = [
        [0.973104317697535, 0.230363826239128, -0.000703163482198],
        [-0.230363800456037, 0.973104570632801, 0.000118545366625],
        [0.000711560162668, 0.000046626403995, 0.999999745754024],
    ]
    found = matrix_itrs_gcrs(Epoch.from_utc("2007-04-05T12:00:00Z"), 0.0, orientation)
    # A day's fraction rounds to 7e-16 rad of Earth rotation, several times over.
    assert np.abs(found - printed).max() < 1e-14


def test_many_times_are_single_times() -> None:
    rng = np.random.default_rng(1)
    times_s = rng.uniform(-40_000.0, 40_000.0, 3000)
    many = matrix_itrs_gcrs(EPOCH, times_s)
    for i in range(0, 3000, 300):
        assert angle_rad(many[i], matrix_itrs_gcrs(EPOCH, times_s[i])) < 1e-12
        assert angle_rad(many[i], matrix_itrs_gcrs(EPOCH + times_s[i], 0.0)) < 1e-12


def test_the_hourly_grid_leaves_less_than_a_picoradian() -> None:
    from geoposition.frames import _celestial_pole

    times_s = np.sort(np.random.default_rng(0).uniform(0.0, 86400.0, 400))
    jd_day, jd_tt = EPOCH.jd_tt()
    exact = np.stack(erfa.xys06a(jd_day, jd_tt + times_s / 86400.0), axis=-1)
    assert np.abs(_celestial_pole(EPOCH, times_s) - exact).max() < 1e-14


def test_shapes() -> None:
    assert matrix_itrs_gcrs(EPOCH, np.zeros((2, 5))).shape == (2, 5, 3, 3)
    assert matrix_itrs_gcrs(EPOCH, []).shape == (0, 3, 3)
    assert R_itrs_gcrs(EPOCH, 0.0).as_matrix().shape == (3, 3)
    assert R_itrs_gcrs(EPOCH, [0.0, 1.0]).as_quat().shape == (2, 4)
    matrix = matrix_itrs_gcrs(EPOCH, np.linspace(0, 9e4, 1000))
    assert np.abs(matrix @ np.swapaxes(matrix, -1, -2) - np.eye(3)).max() < 1e-14


def test_there_and_back() -> None:
    rng = np.random.default_rng(3)
    times_s = np.linspace(0.0, 6000.0, 50)
    position = 7e6 * rng.normal(size=(50, 3))
    velocity = 7e3 * rng.normal(size=(50, 3))
    back = gcrs_from_itrs(*itrs_from_gcrs(position, velocity, EPOCH, times_s), EPOCH, times_s)
    assert np.abs(back[0] - position).max() < 2e-8
    assert np.abs(back[1] - velocity).max() < 2e-11


def test_earth_fixed_velocity_is_the_derivative_of_the_position() -> None:
    """A circular orbit, differenced in ITRS; the pole's own drift is all that is left out."""
    radius_m, rate = 7e6, 1.08e-3
    step_s = 2.0

    def state(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u = rate * t
        along = np.stack([np.cos(u), 0.1 * np.sin(u), np.sqrt(0.99) * np.sin(u)], axis=-1)
        across = np.stack([-np.sin(u), 0.1 * np.cos(u), np.sqrt(0.99) * np.cos(u)], axis=-1)
        return radius_m * along, radius_m * rate * across

    t = np.linspace(0.0, 5000.0, 40)
    at = {
        k: itrs_from_gcrs(*state(t + k * step_s), EPOCH, t + k * step_s)[0] for k in (-2, -1, 1, 2)
    }
    slope = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * step_s)
    velocity = itrs_from_gcrs(*state(t), EPOCH, t)[1]
    assert np.abs(slope - velocity).max() < 3e-6


def test_the_earths_rate() -> None:
    rate = earth_rate_itrs(EPOCH, [0.0, 100.0])
    assert np.linalg.norm(rate, axis=-1) == pytest.approx(EARTH_RATE_RAD_S, rel=1e-7)
    # It points to the celestial pole: in ITRS at (xp, −yp), IERS Conventions (2010), 5.4.1.
    values = OrientationTable.shipped().at(EPOCH, 0.0)
    assert rate[0, 0] / EARTH_RATE_RAD_S == pytest.approx(float(values.xp_rad), abs=2e-7)
    assert rate[0, 1] / EARTH_RATE_RAD_S == pytest.approx(-float(values.yp_rad), abs=2e-7)


def test_attitude_goes_to_the_earth_fixed_frame_and_back() -> None:
    times_s = np.array([0.0, 10.0, 20.0])
    inertial = Rotation.from_rotvec([[0.1, 0.2, 0.3], [0.4, -0.5, 0.6], [2.0, 0.1, 0.2]])
    fixed = R_itrs_body(inertial, EPOCH, times_s)
    axis = np.array([0.0, 0.0, 1.0])
    expected = itrs_from_gcrs(inertial.apply(axis), np.zeros((3, 3)), EPOCH, times_s)[0]
    assert fixed.apply(axis) == pytest.approx(expected, abs=1e-15)
    back = R_gcrs_body(fixed, EPOCH, times_s)
    assert np.abs((back.inv() * inertial).as_rotvec()).max() < 1e-15


def test_frame_bias() -> None:
    bias = R_eme2000_gcrs()
    assert angle_rad(bias.as_matrix(), np.array(OREKIT["matrix_eme2000_gcrs"])) < 1e-14
    assert bias.magnitude() * 648000 / np.pi == pytest.approx(0.0231, abs=2e-4)


def test_outside_the_tables_is_refused_unless_stated() -> None:
    future = Epoch.from_utc("2090-01-01T00:00:00Z")
    with pytest.raises(EarthOrientationError, match="2090-01-01"):
        matrix_itrs_gcrs(future, 0.0)
    matrix = matrix_itrs_gcrs(future, 0.0, FixedOrientation.without_tables())
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-14)


def test_without_tables_keeps_its_stated_accuracy() -> None:
    years = [f"{year}-03-15T00:00:00Z" for year in range(1975, 2026, 2)]
    equator_m = 6378137.0
    for utc in years:
        epoch = Epoch.from_utc(utc)
        rough = matrix_itrs_gcrs(epoch, 0.0, FixedOrientation.without_tables())
        assert angle_rad(rough, matrix_itrs_gcrs(epoch, 0.0)) * equator_m < 440.0


def test_misuse() -> None:
    with pytest.raises(ArgumentError):
        matrix_itrs_gcrs(EPOCH, np.nan, FixedOrientation.without_tables())
    with pytest.raises(ArgumentError):
        itrs_from_gcrs(np.zeros((3, 3)), np.zeros((3, 3)), EPOCH, np.zeros(2))
