"""Epochs: leap seconds, parsing, arithmetic, outside clocks."""

from __future__ import annotations

import json
import math
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import erfa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoposition.errors import ArgumentError
from geoposition.leap_seconds import leap_seconds
from geoposition.timescale import Epoch

OREKIT = json.loads((Path(__file__).parent / "reference" / "orekit_frames.json").read_text())

LEAP_DAYS = [("2012-06-30", 34), ("2015-06-30", 35), ("2016-12-31", 36), ("1972-06-30", 10)]

datetimes = st.datetimes(datetime(1972, 1, 1), datetime(2099, 12, 31))
seconds = st.floats(-1e9, 1e9)
epochs = st.builds(
    Epoch, st.integers(-800_000_000, 3_000_000_000), st.floats(0, 1, exclude_max=True)
)


def test_the_zero_is_the_year_2000_in_tai() -> None:
    assert Epoch.from_utc("1999-12-31T23:59:28Z") == Epoch(0)


@pytest.mark.parametrize(("day", "before"), LEAP_DAYS)
def test_a_leap_second_is_one_second_long_and_has_its_own_name(day: str, before: int) -> None:
    last = Epoch.from_utc(f"{day}T23:59:59Z")
    leap = Epoch.from_utc(f"{day}T23:59:60Z")
    assert leap - last == 1.0
    assert leap.utc_iso(0) == f"{day}T23:59:60Z"
    assert (leap + 0.75).utc_iso(2) == f"{day}T23:59:60.75Z"
    midnight = leap + 1.0
    assert midnight.utc_iso(0).endswith("-01T00:00:00Z")
    assert (last.tai_minus_utc_s, leap.tai_minus_utc_s) == (before, before)
    assert midnight.tai_minus_utc_s == before + 1


def test_rounding_carries_into_and_out_of_a_leap_second() -> None:
    assert Epoch.from_utc("2016-12-31T23:59:59.9999999Z").utc_iso(6) == (
        "2016-12-31T23:59:60.000000Z"
    )
    assert Epoch.from_utc("2016-12-31T23:59:60.9999999Z").utc_iso(6) == (
        "2017-01-01T00:00:00.000000Z"
    )


@pytest.mark.parametrize("text", ["2014-12-31T23:59:60Z", "2016-12-31T22:59:60Z"])
def test_second_60_exists_only_in_leap_seconds(text: str) -> None:
    with pytest.raises(ArgumentError, match="no such time"):
        Epoch.from_utc(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "yesterday",
        "2014-06-19",
        "2014-06-19T18:52:50+02:00",
        "2014-02-29T00:00:00Z",
        "2014-13-01T00:00:00Z",
        "2014-06-19T24:00:00Z",
        "2014-06-19T10:60:00Z",
        "2016-12-31T23:59:61Z",
        "2014-06-19T18:52:5\u0660Z",
        "1971-12-31T23:59:59Z",
        "0000-01-01T00:00:00Z",
        None,
        20140619,
    ],
)
def test_what_is_no_utc_is_refused_in_one_line(text: object) -> None:
    with pytest.raises(ArgumentError) as caught:
        Epoch.from_utc(text)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_one_instant_has_many_spellings() -> None:
    reference = Epoch.from_utc("2014-06-19T18:52:50.5Z")
    for text in (
        "2014-06-19T18:52:50.5",
        " 2014-06-19 18:52:50.500000000000 ",
        "2014-06-19T18:52:50,50Z",
        "2014-06-19T18:52:50.5+00:00",
    ):
        assert Epoch.from_utc(text) == reference
    assert Epoch.from_utc_parts(2014, 6, 19, 18, 52, 50.5) == reference
    assert Epoch.from_utc("2014-06-19T18:52").utc_iso(0) == "2014-06-19T18:52:00Z"


def test_digits_beyond_a_double_carry_instead_of_failing() -> None:
    text = f"2014-12-31T23:59:59.{'9' * 30}Z"
    assert Epoch.from_utc(text) == Epoch.from_utc("2015-01-01T00:00:00Z")


@given(datetimes, st.integers(0, 10**9 - 1))
def test_iso_round_trip_to_the_nanosecond(day: datetime, nanoseconds: int) -> None:
    text = f"{day:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"
    assert Epoch.from_utc(text).utc_iso(9) == text


@given(datetimes)
def test_tai_minus_utc_is_erfas(day: datetime) -> None:
    if day.year > 2026:
        return
    epoch = Epoch.from_utc(day.isoformat(timespec="microseconds"))
    assert epoch.tai_minus_utc_s == erfa.dat(day.year, day.month, day.day, 0.0)
    labelled = (day - datetime(2000, 1, 1)).total_seconds()
    assert epoch - Epoch(0) == pytest.approx(labelled + epoch.tai_minus_utc_s, abs=2e-6)


@given(epochs, epochs)
def test_a_difference_is_rounded_once(a: Epoch, b: Epoch) -> None:
    exact = Fraction(a.tai_s) + Fraction(a.fraction) - Fraction(b.tai_s) - Fraction(b.fraction)
    assert a - b == float(exact)
    assert (a < b) == (exact < 0)


@given(epochs, seconds)
def test_moving_and_coming_back(epoch: Epoch, step: float) -> None:
    moved = epoch + step
    assert 0.0 <= moved.fraction < 1.0
    assert moved - epoch == pytest.approx(step, abs=4e-16 + abs(step) * 2.3e-16)
    assert abs((moved - step) - epoch) <= 4e-16


def test_a_tiny_step_back_keeps_the_fraction_below_one() -> None:
    assert Epoch(5, 0.0) + -1e-20 == Epoch(5, 0.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_steps_are_finite(bad: float) -> None:
    with pytest.raises(ArgumentError):
        Epoch(0) + bad
    with pytest.raises(ArgumentError):
        Epoch.from_utc_parts(2014, 1, 1, second=bad)


def test_fields_are_checked_and_equal_epochs_hash_alike() -> None:
    with pytest.raises(ArgumentError):
        Epoch(0, 1.0)
    with pytest.raises(ArgumentError):
        Epoch(0.5)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        Epoch(0) + "1 s"  # type: ignore[operator]
    assert len({Epoch(1, 0.5), Epoch(1) + 0.5, Epoch.from_tai(1.5)}) == 1


def test_gps_time() -> None:
    assert Epoch.from_gps_seconds(0.0).utc_iso(0) == "1980-01-06T00:00:00Z"
    # The week number rolled over for the second time on 2019-04-07.
    rollover = Epoch.from_gps(2048, 0.0)
    assert rollover.utc_iso(0) == "2019-04-06T23:59:42Z"
    assert rollover.gps_week == (2048, 0.0)
    assert Epoch.from_gps(1800, 1234.25).gps_seconds == 1800 * 604800 + 1234.25


def test_tt_and_julian_dates_are_erfas() -> None:
    epoch = Epoch.from_utc("2016-12-31T23:59:60.25Z")
    utc = erfa.dtf2d("UTC", 2016, 12, 31, 23, 59, 60.25)
    tai = erfa.utctai(*utc)
    tt = erfa.taitt(*tai)
    for ours, theirs in ((epoch.jd_utc(), utc), (epoch.jd_tai(), tai), (epoch.jd_tt(), tt)):
        difference = (ours[0] - theirs[0]) + (ours[1] - theirs[1])
        assert abs(difference) * 86400 < 1e-10
    assert Epoch.from_tt(43200.0).jd_tt() == pytest.approx((2451544.5, 0.5), abs=1e-15)


@pytest.mark.parametrize("case", OREKIT["frames"], ids=lambda case: case["utc"])
def test_orekit_counts_the_same_seconds(case: dict[str, float | str]) -> None:
    epoch = Epoch.from_utc(str(case["utc"]))
    assert epoch - Epoch(0) == pytest.approx(case["tai_s"], abs=1e-9)
    assert epoch.gps_seconds == pytest.approx(case["gps_s"], abs=1e-6)


def test_utc_begins_in_1972() -> None:
    first = Epoch.from_utc("1972-01-01T00:00:00Z")
    assert first.tai_minus_utc_s == 10
    with pytest.raises(ArgumentError):
        (first + -1.0).utc_iso()
    assert "tai_s" in str(first + -1.0)
    assert str(first) == "1972-01-01T00:00:00.000000000Z"
    assert leap_seconds().offset_on_day_s(-20000) is None
