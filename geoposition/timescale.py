"""One instant, kept in TAI; UTC, GPS and TT exist at the doors only.

Every other time in the toolkit is float seconds from one `Epoch`. UT1 is no clock but the
Earth's angle: it lives in `frames`.

Source: IERS Conventions (2010), chapter 10 (TT = TAI + 32.184 s); IS-GPS-200, 3.3.4
(GPS time began at 1980-01-06T00:00:00 UTC, 19 s behind TAI).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final, overload

from geoposition.errors import ArgumentError
from geoposition.leap_seconds import DAY_S, day_date, day_number, leap_seconds

TT_MINUS_TAI_S: Final = 32.184
TAI_MINUS_GPS_S: Final = 19
_GPS_ZERO_TAI_S: Final = day_number(1980, 1, 6) * DAY_S + TAI_MINUS_GPS_S
_WEEK_S: Final = 7 * DAY_S
_JD_2000: Final = 2451544.5
"""Julian date of 2000-01-01T00:00:00, in the scale of the clock read."""

_ISO = re.compile(
    r"(\d{4})-(\d{2})-(\d{2})[T ](\d{2}):(\d{2})(?::(\d{2})(?:[.,](\d+))?)?(?:Z|[+-]00:?00)?",
    re.ASCII,
)


@dataclass(frozen=True, slots=True, order=True)
class Epoch:
    """One instant: `tai_s` whole seconds since 2000-01-01T00:00:00 TAI, plus `fraction`.

    `fraction` is in [0, 1), so an epoch is kept to 1e-16 s. Epochs compare, hash, differ
    (`e1 - e2` in seconds of TAI) and move (`e + seconds`).
    """

    tai_s: int
    fraction: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.tai_s, int) or not 0.0 <= self.fraction < 1.0:
            raise ArgumentError(
                f"Epoch: whole seconds and a fraction in [0, 1) expected, "
                f"got {self.tai_s!r} and {self.fraction!r}"
            )

    # Doors in ---------------------------------------------------------------------------

    @classmethod
    def from_utc(cls, text: str) -> Epoch:
        """Epoch of an ISO 8601 UTC time such as `2014-06-19T18:52:50.787577Z`.

        The `Z` may be missing, the seconds may have any number of digits, and `23:59:60` is
        accepted on the days that had a leap second. Anything else, times before 1972 and
        offsets from UTC included, is an `ArgumentError`.
        """
        match = _ISO.fullmatch(text.strip()) if isinstance(text, str) else None
        if match is None:
            raise ArgumentError(f"time {text!r}: UTC like 2014-06-19T18:52:50.787577Z expected")
        year, month, day, hour, minute = (int(part) for part in match.groups()[:5])
        second = int(match[6] or 0)
        fraction = float(f"0.{match[7] or 0}")
        return cls._from_calendar(year, month, day, hour, minute, second, fraction, text)

    @classmethod
    def from_utc_parts(
        cls, year: int, month: int, day: int, hour: int = 0, minute: int = 0, second: float = 0.0
    ) -> Epoch:
        """Epoch of a UTC date and time of day; `second` reaches 61 within a leap second."""
        text = f"{year}-{month}-{day} {hour}:{minute}:{second}"
        if not math.isfinite(second):
            raise ArgumentError(f"time {text}: finite seconds expected")
        whole = math.floor(second)
        return cls._from_calendar(year, month, day, hour, minute, whole, second - whole, text)

    @classmethod
    def _from_calendar(
        cls,
        year: int,
        month: int,
        day: int,
        hour: int,
        minute: int,
        second: int,
        fraction: float,
        text: str,
    ) -> Epoch:
        try:
            number = day_number(year, month, day)
        except (ValueError, TypeError):
            raise ArgumentError(f"time {text!r}: there is no such date") from None
        offset_s = leap_seconds().offset_on_day_s(number)
        if offset_s is None:
            raise ArgumentError(f"time {text!r}: UTC from 1972 on expected")
        minute_s = 60
        if (hour, minute) == (23, 59):
            minute_s += leap_seconds().day_length_s(number) - DAY_S
        if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < minute_s):
            raise ArgumentError(f"time {text!r}: there is no such time on that day")
        whole = number * DAY_S + hour * 3600 + minute * 60 + second + offset_s
        return cls._carried(whole, fraction)

    @classmethod
    def from_gps(cls, week: int, seconds: float) -> Epoch:
        """Epoch of a full GPS week number (no roll-over at 1024) and seconds into the week."""
        return cls(_GPS_ZERO_TAI_S + int(week) * _WEEK_S) + seconds

    @classmethod
    def from_gps_seconds(cls, seconds: float) -> Epoch:
        """Epoch of seconds since 1980-01-06T00:00:00 UTC, leap seconds not counted."""
        return cls(_GPS_ZERO_TAI_S) + seconds

    @classmethod
    def from_tai(cls, seconds: float) -> Epoch:
        """Epoch of seconds of TAI since 2000-01-01T00:00:00 TAI."""
        return cls(0) + seconds

    @classmethod
    def from_tt(cls, seconds: float) -> Epoch:
        """Epoch of seconds of TT since 2000-01-01T00:00:00 TT (J2000.0 is 43200)."""
        return cls(0) + seconds + -TT_MINUS_TAI_S

    @classmethod
    def _carried(cls, whole: int, fraction: float) -> Epoch:
        """Epoch of `whole` + `fraction` (any finite size), the fraction brought to [0, 1)."""
        carry = math.floor(fraction)
        fraction -= carry
        if fraction >= 1.0:  # −1e-20 is carried to 1.0 − 1e-20, which rounds to 1.0
            carry, fraction = carry + 1, 0.0
        return cls(whole + carry, fraction)

    # Arithmetic -------------------------------------------------------------------------

    def __add__(self, seconds: float) -> Epoch:
        try:
            value = float(seconds)
        except (TypeError, ValueError):
            return NotImplemented
        if not math.isfinite(value):
            raise ArgumentError(f"Epoch + {value}: finite seconds expected")
        whole = math.floor(value)
        return self._carried(self.tai_s + whole, self.fraction + (value - whole))

    @overload
    def __sub__(self, other: Epoch) -> float: ...
    @overload
    def __sub__(self, other: float) -> Epoch: ...
    def __sub__(self, other: Epoch | float) -> float | Epoch:
        if isinstance(other, Epoch):
            return math.fsum((self.tai_s - other.tai_s, self.fraction, -other.fraction))
        return self + -other

    # Doors out --------------------------------------------------------------------------

    @property
    def tai_minus_utc_s(self) -> int:
        """TAI − UTC; within a leap second still the value before it."""
        number, _ = self._utc_day_second()
        offset_s = leap_seconds().offset_on_day_s(number)
        assert offset_s is not None
        return offset_s

    @property
    def gps_seconds(self) -> float:
        """Seconds since 1980-01-06T00:00:00 UTC, leap seconds not counted."""
        return math.fsum((self.tai_s - _GPS_ZERO_TAI_S, self.fraction))

    @property
    def gps_week(self) -> tuple[int, float]:
        """Full GPS week number and seconds into it."""
        week, second = divmod(self.tai_s - _GPS_ZERO_TAI_S, _WEEK_S)
        return week, second + self.fraction

    def utc_iso(self, digits: int = 6) -> str:
        """UTC as ISO 8601 with `digits` decimals, rounded, and a final Z.

        A leap second reads `23:59:60`; before 1972 there is no such UTC: `ArgumentError`.
        """
        scaled = round(self.fraction * 10**digits)
        carry, decimals = divmod(scaled, 10**digits)
        number, second = Epoch(self.tai_s + carry)._utc_day_second()
        minutes = min(second // 60, 24 * 60 - 1)
        text = (
            f"{day_date(number).isoformat()}T{minutes // 60:02d}:{minutes % 60:02d}"
            f":{second - 60 * minutes:02d}"
        )
        return f"{text}.{decimals:0{digits}d}Z" if digits else f"{text}Z"

    def jd_tai(self) -> tuple[float, float]:
        """Julian date of TAI in two parts: a day's start, and the fraction since."""
        days, second = divmod(self.tai_s, DAY_S)
        return _JD_2000 + days, (second + self.fraction) / DAY_S

    def jd_tt(self) -> tuple[float, float]:
        """Julian date of TT in two parts; the second may slightly exceed 1."""
        days, second = divmod(self.tai_s, DAY_S)
        return _JD_2000 + days, (second + self.fraction + TT_MINUS_TAI_S) / DAY_S

    def jd_utc(self) -> tuple[float, float]:
        """Quasi Julian date of UTC in two parts, as SOFA has it.

        The second part is the elapsed share of the UTC day, whose length is 86401 s on days
        with a leap second.
        """
        number, second = self._utc_day_second()
        return _JD_2000 + number, (second + self.fraction) / leap_seconds().day_length_s(number)

    def _utc_day_second(self) -> tuple[int, int]:
        found = leap_seconds().utc_of_tai(self.tai_s)
        if found is None:
            raise ArgumentError(f"Epoch {self.tai_s} s: UTC exists from 1972 on")
        return found

    def __str__(self) -> str:
        return self.utc_iso(9) if self.tai_s >= leap_seconds().tai_s[0] else repr(self)
