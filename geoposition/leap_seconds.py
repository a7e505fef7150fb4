"""The leap seconds of UTC, as pyerfa carries them: TAI − UTC and the days it changed.

One of the three doors to outside time and Earth tables, beside `frames` (pyerfa's models) and
`earth_orientation` (the IERS tables): leap seconds stand on a lower floor, because `Epoch`
needs them. After the last change the present difference is kept: a leap second not yet
announced when the installed pyerfa was made is unknown here.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from datetime import date
from functools import cache
from typing import Final

import erfa

DAY_S: Final = 86400
_DAY_ZERO: Final = date(2000, 1, 1).toordinal()


def day_number(year: int, month: int, day: int) -> int:
    """Days from 2000-01-01 to a Gregorian date; `ValueError` when there is no such date."""
    return date(year, month, day).toordinal() - _DAY_ZERO


def day_date(number: int) -> date:
    """Gregorian date of a day number; the inverse of `day_number`."""
    return date.fromordinal(number + _DAY_ZERO)


@dataclass(frozen=True, slots=True)
class LeapSeconds:
    """TAI − UTC since 1972: `offset_s[i]` holds from the UTC day number `day[i]` on."""

    day: tuple[int, ...]
    offset_s: tuple[int, ...]
    tai_s: tuple[int, ...]
    """Seconds of TAI since 2000-01-01T00:00:00 TAI at which each offset begins."""

    def offset_on_day_s(self, number: int) -> int | None:
        """TAI − UTC on a UTC day, its leap second included; None before 1972."""
        i = bisect_right(self.day, number) - 1
        return None if i < 0 else self.offset_s[i]

    def day_length_s(self, number: int) -> int:
        """Seconds in a UTC day: 86400, or 86401 when it ends in a leap second."""
        i = bisect_right(self.day, number)
        if i == 0 or i == len(self.day) or self.day[i] != number + 1:
            return DAY_S
        return DAY_S + self.offset_s[i] - self.offset_s[i - 1]

    def utc_of_tai(self, tai_s: int) -> tuple[int, int] | None:
        """UTC (day number, second of that day) of a second of TAI; None before 1972.

        The second of the day reaches 86400 within a leap second.
        """
        i = bisect_right(self.tai_s, tai_s) - 1
        if i < 0:
            return None
        number, second = divmod(tai_s - self.offset_s[i], DAY_S)
        if i + 1 < len(self.day) and number >= self.day[i + 1]:
            return number - 1, second + DAY_S
        return number, second


@cache
def leap_seconds() -> LeapSeconds:
    """Leap seconds of pyerfa from 1972-01-01 on, where UTC took its present form."""
    rows = [
        (day_number(int(year), int(month), 1), round(float(offset)))
        for year, month, offset in erfa.leap_seconds.get()
        if year >= 1972
    ]
    return LeapSeconds(
        day=tuple(number for number, _ in rows),
        offset_s=tuple(offset for _, offset in rows),
        tai_s=tuple(number * DAY_S + offset for number, offset in rows),
    )
