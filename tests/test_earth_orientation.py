"""The shipped tables: span, interpolation, leap seconds; stated orientation instead."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from astropy_iers_data import IERS_A_FILE, IERS_B_FILE

from geoposition.earth_orientation import FixedOrientation, OrientationTable
from geoposition.errors import ArgumentError, EarthOrientationError, ProductError
from geoposition.timescale import Epoch

OREKIT = json.loads((Path(__file__).parent / "reference" / "orekit_frames.json").read_text())
ARCSEC_RAD = np.pi / 180 / 3600


@pytest.fixture(scope="module")
def table() -> OrientationTable:
    return OrientationTable.shipped()


def lines_of(path: str, start: str) -> list[str]:
    return [line for line in Path(path).read_text().splitlines() if line.startswith(start)]


def test_a_day_of_the_final_series(table: OrientationTable) -> None:
    (line,) = lines_of(IERS_B_FILE, "2014   6  19")
    x, y, ut1_minus_utc, dx, dy = (float(word) for word in line.split()[5:10])
    epoch = Epoch.from_utc("2014-06-19T00:00:00Z")
    found = table.at(epoch, 0.0)
    assert found.ut1_minus_tai_s + 35 == pytest.approx(ut1_minus_utc, abs=1e-9)
    got = np.array([found.xp_rad, found.yp_rad, found.dx_rad, found.dy_rad]) / ARCSEC_RAD
    assert got == pytest.approx([x, y, dx, dy], abs=1e-12)
    assert not table.is_predicted(epoch)
    assert 0 < table.ut1_uncertainty_s(epoch) < 1e-4


def test_a_predicted_day_of_bulletin_a(table: OrientationTable) -> None:
    predicted = [line for line in Path(IERS_A_FILE).read_text().splitlines() if line[57:58] == "P"]
    line = predicted[20]
    day = f"20{line[0:2]}-{line[2:4]}-{line[4:6]}".replace(" ", "0")
    epoch = Epoch.from_utc(f"{day}T00:00:00Z")
    found = table.at(epoch, 0.0)
    assert found.ut1_minus_tai_s + epoch.tai_minus_utc_s == pytest.approx(
        float(line[58:68]), abs=1e-9
    )
    assert found.xp_rad == pytest.approx(float(line[18:27]) * ARCSEC_RAD, abs=1e-15)
    assert found.dy_rad == pytest.approx(float(line[116:125]) * 1e-3 * ARCSEC_RAD, abs=1e-15)
    assert table.is_predicted(epoch)
    last = table.span[1]
    assert table.ut1_uncertainty_s(last) > 1e-3


@pytest.mark.parametrize("case", OREKIT["frames"], ids=lambda case: case["utc"])
def test_orekit_interpolates_the_same(table: OrientationTable, case: dict[str, float]) -> None:
    found = table.at(Epoch.from_utc(str(case["utc"])), 0.0)
    # Both put a cubic through four days of UT1; for the pole Orekit uses the rates as well.
    assert found.ut1_minus_tai_s == pytest.approx(case["ut1_minus_tai_s"], abs=1e-6)
    for name in ("xp_rad", "yp_rad", "dx_rad", "dy_rad"):
        assert getattr(found, name) == pytest.approx(case[name], abs=2e-10)


def test_ut1_goes_smoothly_through_a_leap_second(table: OrientationTable) -> None:
    epoch = Epoch.from_utc("2016-12-31T12:00:00Z")
    found = table.at(epoch, np.arange(0.0, 86400.0, 30.0))
    assert np.abs(np.diff(found.ut1_minus_tai_s)).max() < 1e-6


def test_the_rate_is_the_derivative(table: OrientationTable) -> None:
    epoch = Epoch.from_utc("2018-05-06T07:00:00Z")
    found = table.at(epoch, np.array([-1000.0, 0.0, 1000.0]))
    slope = (found.ut1_minus_tai_s[2] - found.ut1_minus_tai_s[0]) / 2000.0
    assert found.ut1_rate[1] == pytest.approx(slope, abs=1e-12)


def test_interpolation_leaves_little(table: OrientationTable) -> None:
    """Drop every other day and predict it: the daily error is then far below (1/16)."""
    keep = slice(14000, 18001, 2)
    thin = OrientationTable(
        table.tai_s[keep], table.values[keep], table.ut1_sigma_s[keep], table.predicted_from_s
    )
    days = table.tai_s[14011:17990:2]
    error = thin.at(Epoch(0), days).ut1_minus_tai_s - table.at(Epoch(0), days).ut1_minus_tai_s
    assert np.sqrt(np.mean(error**2)) < 60e-6
    assert np.sqrt(np.mean(error**2)) / 16 * 465.0 < 2e-3  # metres at the equator


def test_outside_the_span_is_refused_and_says_what_to_do(table: OrientationTable) -> None:
    first, last = table.span
    table.at(first, 0.0)
    table.at(last, 0.0)
    for epoch, times in ((first, -1.0), (last, [0.0, 1.0]), (first, np.nan), (last, 1e15)):
        with pytest.raises(EarthOrientationError, match="FixedOrientation") as caught:
            table.at(epoch, times)
        assert "\n" not in str(caught.value)
    with pytest.raises(EarthOrientationError):
        table.ut1_uncertainty_s(last + 1.0)


def test_stated_orientation_holds_at_all_times() -> None:
    epoch = Epoch.from_utc("2014-06-19T18:52:50Z")
    fixed = FixedOrientation(-0.3, xp_rad=1e-6, yp_rad=2e-6)
    found = fixed.at(epoch, np.zeros((2, 3)))
    assert found.ut1_minus_tai_s == pytest.approx(np.full((2, 3), -35.3))
    assert np.all(found.yp_rad == 2e-6)
    without = FixedOrientation.without_tables().at(epoch, 0.0)
    assert (float(without.ut1_minus_tai_s), float(without.xp_rad)) == (-35.0, 0.0)


@pytest.mark.parametrize("bad", [(2.0, 0.0), (np.nan, 0.0), (0.1, 0.2), (0.1, np.nan)])
def test_values_in_the_wrong_unit_are_refused(bad: tuple[float, float]) -> None:
    with pytest.raises(ArgumentError):
        FixedOrientation(bad[0], xp_rad=bad[1])


def test_a_broken_table_is_a_product_error(tmp_path: Path) -> None:
    from geoposition.earth_orientation import _c04

    broken = tmp_path / "eopc04"
    broken.write_text("2014   6  19   0  56827.00    0.1x9576    0.428343  -0.2953612\n")
    with pytest.raises(ProductError, match="Earth orientation"):
        _c04(broken)
