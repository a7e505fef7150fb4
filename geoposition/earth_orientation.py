"""How the Earth stands in space beyond the models: UT1, the pole and the celestial pole offsets.

The only door to the IERS tables, read offline from the files of astropy-iers-data: the final
series (C04, from 1962, used here from 1972) and, after its end, Bulletin A with its
predictions of about a year. UT1 is kept as UT1 − TAI, which has no leap seconds.

Between the daily values a cubic through the four nearest days serves. The diurnal and
semi-diurnal tides of the ocean, which the daily series leave out, are not added: they move the
Earth by up to about 0.03 ms in UT1 (14 mm at the equator) and 0.4 mas in the pole (12 mm).

Source: IERS Conventions (2010), 5.5.1 and chapter 8; IERS Gazette 13 for the interpolation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, Protocol, Self

import numpy as np
from astropy_iers_data import IERS_A_FILE, IERS_B_FILE
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ArgumentError, EarthOrientationError, ProductError
from geoposition.leap_seconds import DAY_S, leap_seconds
from geoposition.timescale import Epoch

_ARCSEC_RAD: Final = np.pi / 648000.0
_MJD_2000: Final = 51544


@dataclass(frozen=True, slots=True)
class OrientationValues:
    """Earth orientation at some times: every array has their shape (...).

    `ut1_minus_tai_s` and its `ut1_rate` (change per second), the pole `xp_rad`, `yp_rad`, and
    the celestial pole offsets `dx_rad`, `dy_rad` against IAU 2006/2000A.
    """

    ut1_minus_tai_s: FloatArray
    ut1_rate: FloatArray
    xp_rad: FloatArray
    yp_rad: FloatArray
    dx_rad: FloatArray
    dy_rad: FloatArray


class EarthOrientation(Protocol):
    """Anything that knows the Earth's orientation at given times."""

    def at(self, epoch: Epoch, times_s: ArrayLike) -> OrientationValues:
        """Values at `times_s` (...) seconds after `epoch`."""
        ...


@dataclass(frozen=True, slots=True)
class FixedOrientation:
    """Constant UT1 − UTC and pole, such as a product's own metadata give for its scene.

    TAI − UTC is taken once, at the epoch, so a leap second after it does no harm. Good for
    the day the values are of: UT1 − UTC drifts by up to 2 ms a day (1 m at the equator).
    """

    ut1_minus_utc_s: float
    xp_rad: float = 0.0
    yp_rad: float = 0.0
    dx_rad: float = 0.0
    dy_rad: float = 0.0

    def __post_init__(self) -> None:
        if not abs(self.ut1_minus_utc_s) <= 1.0:
            raise ArgumentError(f"UT1 − UTC: at most 1 s expected, got {self.ut1_minus_utc_s} s")
        rest = np.array([self.xp_rad, self.yp_rad, self.dx_rad, self.dy_rad])
        if not np.all(np.abs(rest) <= 10.0 * _ARCSEC_RAD):
            raise ArgumentError("pole coordinates: radians, at most 10 arcseconds, expected")

    @classmethod
    def without_tables(cls) -> Self:
        """UT1 = UTC and the pole at the reference pole: for times outside every table.

        Error on the ground: below 420 m along the equator from UT1 (|UT1 − UTC| < 0.9 s by
        the definition of UTC), below 20 m from the pole, below 0.1 m from the celestial pole.
        A position in the Earth-fixed frame carries it whole; differences within one scene
        do not.
        """
        return cls(0.0)

    def at(self, epoch: Epoch, times_s: ArrayLike) -> OrientationValues:
        """Values, all the same, at `times_s` (...) seconds after `epoch`."""
        shape = np.shape(times_s)
        return OrientationValues(
            ut1_minus_tai_s=np.full(shape, self.ut1_minus_utc_s - epoch.tai_minus_utc_s),
            ut1_rate=np.zeros(shape),
            xp_rad=np.full(shape, self.xp_rad),
            yp_rad=np.full(shape, self.yp_rad),
            dx_rad=np.full(shape, self.dx_rad),
            dy_rad=np.full(shape, self.dy_rad),
        )


@dataclass(frozen=True, slots=True)
class OrientationTable:
    """Daily values at 0h UTC: `tai_s` (n,) since 2000, `values` (n, 5), `ut1_sigma_s` (n,).

    The columns of `values` are UT1 − TAI in seconds, xp, yp, dX, dY in radians. From
    `predicted_from_s` (seconds of TAI) on they are predictions: `ut1_sigma_s` tells how good.
    Times outside the span are an `EarthOrientationError`.
    """

    tai_s: FloatArray
    values: FloatArray
    ut1_sigma_s: FloatArray
    predicted_from_s: float

    def __post_init__(self) -> None:
        if len(self.tai_s) < 4 or self.values.shape != (len(self.tai_s), 5):
            raise ArgumentError("Earth orientation: a table of at least four days expected")

    @classmethod
    def shipped(cls) -> OrientationTable:
        """Return the table of the installed astropy-iers-data: C04, then Bulletin A (read once)."""
        return _shipped()

    @property
    def span(self) -> tuple[Epoch, Epoch]:
        """First and last instant the table serves."""
        return Epoch.from_tai(float(self.tai_s[0])), Epoch.from_tai(float(self.tai_s[-1]))

    def is_predicted(self, epoch: Epoch) -> bool:
        """Tell whether the values at `epoch` are predictions."""
        return epoch.tai_s >= self.predicted_from_s

    def ut1_uncertainty_s(self, epoch: Epoch) -> float:
        """Return the table's sigma of UT1 at `epoch`; 1 ms is 0.46 m at the equator."""
        self._day(np.array(epoch.tai_s + epoch.fraction))
        return float(np.interp(epoch.tai_s + epoch.fraction, self.tai_s, self.ut1_sigma_s))

    def at(self, epoch: Epoch, times_s: ArrayLike) -> OrientationValues:
        """Values at `times_s` (...) seconds after `epoch`, by cubics through four days."""
        tai_s = epoch.tai_s + (epoch.fraction + np.asarray(times_s, dtype=np.float64))
        first = np.clip(self._day(tai_s) - 1, 0, len(self.tai_s) - 4)
        # Days are 86400 s of TAI but for leap seconds: general nodes, in days about the first.
        nodes = (self.tai_s[first[..., None] + np.arange(4)] - self.tai_s[first, None]) / DAY_S
        u = (tai_s - self.tai_s[first]) / DAY_S
        weight, slope = _lagrange_weights(nodes, u)
        four = self.values[first[..., None] + np.arange(4)]
        value = np.einsum("...k,...kc->...c", weight, four)
        ut1_rate = np.einsum("...k,...k->...", slope, four[..., 0]) / DAY_S
        return OrientationValues(value[..., 0], ut1_rate, *np.moveaxis(value[..., 1:], -1, 0))

    def _day(self, tai_s: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
        """Index of the table's day that each time falls in; refuse times outside the span."""
        inside = (tai_s >= self.tai_s[0]) & (tai_s <= self.tai_s[-1])  # false for NaN
        if not np.all(inside):
            raise EarthOrientationError(
                f"Earth orientation is known from {self.span[0].utc_iso(0)} to "
                f"{self.span[1].utc_iso(0)}, times from {_label(np.min(tai_s))} to "
                f"{_label(np.max(tai_s))} asked: update astropy-iers-data, or state the "
                f"orientation with FixedOrientation"
            )
        return np.searchsorted(self.tai_s, tai_s, side="right") - 1


def _label(tai_s: float) -> str:
    try:
        return Epoch.from_tai(float(tai_s)).utc_iso(0)
    except (ArgumentError, OverflowError, ValueError):
        return f"{tai_s} s of TAI since 2000"


def _lagrange_weights(nodes: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights (..., 4) of the cubic through `nodes` (..., 4) at `u` (...), and of its slope."""
    weight = np.empty(nodes.shape)
    slope = np.empty(nodes.shape)
    for k in range(4):
        a, b, c = (nodes[..., j] for j in range(4) if j != k)
        n = nodes[..., k]
        scale = (n - a) * (n - b) * (n - c)
        weight[..., k] = (u - a) * (u - b) * (u - c) / scale
        slope[..., k] = ((u - a) * (u - b) + (u - a) * (u - c) + (u - b) * (u - c)) / scale
    return weight, slope


# The files ----------------------------------------------------------------------------------


@cache
def _shipped() -> OrientationTable:
    final = _c04(Path(IERS_B_FILE))
    rapid, predicted = _finals(Path(IERS_A_FILE))
    later = rapid[:, 0] > final[-1, 0]
    rows = np.concatenate([final, rapid[later]])
    mjd = rows[:, 0].astype(np.int64)
    if np.any(np.diff(mjd) != 1):
        raise ProductError(IERS_A_FILE, "", "daily values without gaps expected")
    offset = np.array([leap_seconds().offset_on_day_s(int(day) - _MJD_2000) for day in mjd], float)
    tai_s = (mjd - _MJD_2000) * float(DAY_S) + offset
    values = np.column_stack([rows[:, 1] - offset, rows[:, 2:6] * _ARCSEC_RAD])
    predicted_from_s = np.min(tai_s[mjd >= predicted], initial=np.inf)
    return OrientationTable(
        read_only(tai_s), read_only(values), read_only(rows[:, 6]), float(predicted_from_s)
    )


def _columns(path: Path, lines: list[str], columns: list[slice]) -> FloatArray:
    """Numbers of fixed-width columns; a blank one is 0."""
    try:
        return np.array([[float(line[part].strip() or 0) for part in columns] for line in lines])
    except ValueError as error:
        raise ProductError(path, "", f"a table of Earth orientation expected ({error})") from None


def _c04(path: Path) -> FloatArray:
    """MJD, UT1−UTC, x, y, dX, dY and sigma of UT1 (seconds, arcseconds) from an IERS C04 file."""
    lines = [line for line in path.read_text().splitlines() if line and line[0] != "#"]
    lines = [line for line in lines if int(line[:4]) >= 1972]
    places = [(16, 26), (50, 62), (26, 38), (38, 50), (62, 74), (74, 86), (146, 158)]
    return _columns(path, lines, [slice(*place) for place in places])


def _finals(path: Path) -> tuple[FloatArray, float]:
    """Like `_c04`, from finals2000A (Bulletin A columns), and the first predicted MJD.

    The celestial pole offsets are predicted for fewer days than UT1: then they are 0, an error
    below 1 mas (3 cm).
    """
    lines = [line for line in path.read_text().splitlines() if line[58:68].strip()]
    places = [(7, 15), (58, 68), (18, 27), (37, 46), (97, 106), (116, 125), (68, 78)]
    rows = _columns(path, lines, [slice(*place) for place in places])
    rows[:, 4:6] *= 1e-3
    predicted = [row[0] for row, line in zip(rows, lines, strict=True) if line[57] == "P"]
    return rows, float(predicted[0]) if predicted else float("inf")
