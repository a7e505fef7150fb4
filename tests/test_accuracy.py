"""Error statistics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, norm

from geoposition.accuracy import (
    NMAD_FACTOR,
    axis_statistics,
    circular_error_m,
    enu_errors_m,
    error_ellipsoids,
    linear_error_m,
    normalised_rms,
    point_statistics,
    xyz_errors_m,
)
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef, meridian_radius_m
from geoposition.errors import ArgumentError

PLACE = np.array([np.radians(113.0), np.radians(34.5), 800.0])


def moved(enu_m: np.ndarray) -> np.ndarray:
    """Geodetic points at `enu_m` (n, 3) from PLACE."""
    return ecef_to_geodetic(geodetic_to_ecef(PLACE) + enu_m @ enu_axes(PLACE).T)


def test_one_to_five() -> None:
    found = axis_statistics([1.0, 2.0, 3.0, 4.0, 5.0])
    assert (found.count, found.mean, found.median) == (5, 3.0, 3.0)
    assert found.std == pytest.approx(np.sqrt(2.5), rel=1e-15)
    assert found.rmse == pytest.approx(np.sqrt(11.0), rel=1e-15)
    assert (found.minimum, found.maximum) == (1.0, 5.0)
    mixed = axis_statistics([-3.0, 0.5, 2.0])
    assert (mixed.minimum, mixed.maximum, mixed.least, mixed.most) == (-3.0, 2.0, 0.5, 3.0)
    assert found.nmad == pytest.approx(1.4826022185, rel=1e-10)


def test_nmad_factor_is_the_normal_distributions() -> None:
    assert pytest.approx(1.0 / norm.ppf(0.75), rel=1e-15) == NMAD_FACTOR


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=40))
def test_rmse_is_mean_and_spread(errors: list[float]) -> None:
    found = axis_statistics(errors)
    n = found.count
    spread = found.std**2 * (n - 1) / n
    assert found.rmse**2 == pytest.approx(found.mean**2 + spread, rel=1e-9, abs=1e-9)
    assert found.minimum <= found.median <= found.maximum


def test_nan_is_left_out_and_one_error_has_no_spread() -> None:
    found = axis_statistics([np.nan, -2.0, np.inf])
    assert (found.count, found.mean, found.rmse) == (1, -2.0, 2.0)
    assert np.isnan(found.std)
    with pytest.raises(ArgumentError, match="at least one finite"):
        axis_statistics([np.nan])


def test_nmad_is_deaf_to_blunders() -> None:
    errors = np.random.default_rng(1).normal(0.0, 2.0, 20_001)
    blunders = np.concatenate([errors, np.full(200, 1e4)])
    assert axis_statistics(blunders).nmad == pytest.approx(2.0, rel=0.03)
    assert axis_statistics(blunders).std > 900.0


def test_percentiles_are_empirical() -> None:
    # sizes 1 .. 11: nine tenths of the way from the first to the eleventh is the tenth
    sizes = np.arange(1.0, 12.0)
    assert linear_error_m(-sizes) == 10.0
    east = np.stack([0.6 * sizes, -0.8 * sizes], axis=1)
    assert circular_error_m(east) == pytest.approx(10.0, rel=1e-15)
    assert linear_error_m(sizes, 0.5) == 6.0
    with pytest.raises(ArgumentError, match="probability"):
        linear_error_m(sizes, 1.0)


def test_ce90_and_le90_of_normal_errors() -> None:
    errors = np.random.default_rng(2).normal(0.0, 3.0, (400_000, 3))
    factor = np.sqrt(chi2.ppf(0.9, 2))
    assert factor == pytest.approx(2.1460, abs=1e-4)
    assert circular_error_m(errors[:, :2]) == pytest.approx(3.0 * factor, rel=0.005)
    assert linear_error_m(errors[:, 2]) == pytest.approx(3.0 * 1.6449, rel=0.005)


def test_a_bias_is_in_ce90() -> None:
    assert circular_error_m(np.full((50, 2), [3.0, 4.0])) == 5.0


def test_axes_of_the_errors() -> None:
    north = PLACE + [0.0, 1e-6, 0.0]
    error = enu_errors_m(north, PLACE)
    assert error[1] == pytest.approx(1e-6 * (meridian_radius_m(PLACE[1]) + 800.0), rel=1e-6)
    assert np.abs(error[[0, 2]]).max() < 1e-5
    up = enu_errors_m(PLACE + [0.0, 0.0, 2.5], PLACE)
    assert up == pytest.approx([0.0, 0.0, 2.5], abs=1e-8)
    east = enu_errors_m(PLACE + [1e-6, 0.0, 0.0], PLACE)
    assert east[0] > 5.0
    xyz = xyz_errors_m(PLACE + [1e-6, 0.0, 0.0], PLACE)
    # east at 113 degrees of longitude points to −X and −Y
    assert xyz[0] < 0
    assert xyz[1] < 0
    assert abs(xyz[2]) < 1e-8


def test_point_statistics_in_both_systems() -> None:
    enu = np.random.default_rng(3).normal([1.0, -2.0, 3.0], [0.5, 0.7, 1.5], (500, 3))
    truth = np.repeat(PLACE[None], 501, axis=0)
    found = np.concatenate([moved(enu), [[np.nan] * 3]])
    result = point_statistics(found, truth)
    for k, axis in enumerate((result.e, result.n, result.u)):
        assert axis.count == 500
        assert axis.rmse == pytest.approx(np.sqrt(np.mean(enu[:, k] ** 2)), abs=1e-7)
        assert axis.mean == pytest.approx(enu[:, k].mean(), abs=1e-7)
    xyz = enu @ enu_axes(PLACE).T
    for k, axis in enumerate((result.x, result.y, result.z)):
        assert axis.std == pytest.approx(np.std(xyz[:, k], ddof=1), abs=1e-7)
    assert result.rmse_3d_m == pytest.approx(np.sqrt(np.mean(np.sum(enu**2, axis=1))), abs=1e-7)
    squares = sum(axis.rmse**2 for axis in (result.x, result.y, result.z))
    assert result.rmse_3d_m**2 == pytest.approx(squares, rel=1e-9)
    assert result.horizontal_rmse_m == pytest.approx(np.hypot(result.e.rmse, result.n.rmse))
    assert result.ce90_m == pytest.approx(np.quantile(np.hypot(*enu[:, :2].T), 0.9), abs=1e-7)
    named = result.as_dict()
    assert set(named) == {*"enuxyz", "horizontal_rmse_m", "rmse_3d_m", "ce90_m", "le90_m"}


def test_point_statistics_refuse_other_shapes() -> None:
    with pytest.raises(ArgumentError, match="one true point per point"):
        point_statistics(np.zeros((3, 3)), np.zeros((2, 3)))


def test_normalised_rms_is_one_where_sigma_is_right() -> None:
    rng = np.random.default_rng(4)
    sigma = rng.uniform(0.1, 10.0, 50_000)
    errors = sigma * rng.standard_normal(50_000)
    assert normalised_rms(errors, sigma) == pytest.approx(1.0, abs=4 / np.sqrt(1e5))
    assert normalised_rms([2.0, np.nan], [1.0, 1.0]) == 2.0
    with pytest.raises(ArgumentError, match="finite"):
        normalised_rms([np.nan], [1.0])


def test_ellipsoids_have_the_axes_they_were_made_of() -> None:
    """Semi-axes 3, 2, 1 m; the longest at azimuth 30° and 40° above the horizon."""
    azimuth, elevation = np.radians([30.0, 40.0])
    first = np.array(
        [
            np.cos(elevation) * np.sin(azimuth),
            np.cos(elevation) * np.cos(azimuth),
            np.sin(elevation),
        ]
    )
    second = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    axes = np.stack([first, second, np.cross(first, second)], axis=1)
    covariance = axes @ np.diag([9.0, 4.0, 1.0]) @ axes.T
    found = error_ellipsoids(np.stack([covariance, np.full((3, 3), np.nan)]))
    np.testing.assert_allclose(found.semi_axis_m[0], [3.0, 2.0, 1.0], atol=1e-12)
    assert found.azimuth_deg[0, 0] == pytest.approx(30.0, abs=1e-9)
    assert found.elevation_deg[0, 0] == pytest.approx(40.0, abs=1e-9)
    assert found.elevation_deg[0, 1] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(
        np.abs(np.einsum("ij,ij->j", found.direction_enu[0], axes)), 1.0, atol=1e-12
    )
    assert np.all(np.isnan(found.semi_axis_m[1]))
    assert np.all(np.isnan(found.elevation_deg[1]))
