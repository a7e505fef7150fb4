"""The scenes of P tables 1 and 2: when, where, how far to the side, and with which jitter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Final

from geoposition.calib_fields.catalog import PUBLISHED, PublishedScene, catalogued
from geoposition.errors import ArgumentError
from geoposition.sensors.jitter_scene import PAPER_LINES, ZY3_LINE, JitterLine

PIXEL_M: Final = 0.5
ALTITUDE_M: Final = 490e3
IFOV_RAD: Final = PIXEL_M / ALTITUDE_M
"""A pixel's angle, 0.210 arcsec. *Source*: P section 3."""
LINE_S: Final = 2.1 / 30_000

_BEIJING: Final = timedelta(hours=8)
_RELIEF_M: Final = {
    "Songshan": (150.0, 1300.0),
    "Yili": (600.0, 1600.0),
    "Anyang": (50.0, 450.0),
    "Dongying": (-12.0, 4.0),
}
"""Lowest and highest synthetic ground: mountains, a valley, hills, a delta."""


@dataclass(frozen=True, slots=True)
class Size:
    """Lines and samples of the images, and the seconds of telemetry around them."""

    lines: int
    samples: int
    telemetry_s: float

    @property
    def half_s(self) -> float:
        """Half the duration of an image."""
        return 0.5 * self.lines * LINE_S


FULL: Final = Size(30_000, 2048, 60.0)
QUICK: Final = Size(6000, 320, 20.0)


@dataclass(frozen=True, slots=True)
class Case:
    """One image: `number` from 1, P's scene, the jitter; `seed` is the scene's own."""

    number: int
    published: PublishedScene
    lines: tuple[JitterLine, ...]
    seed: int
    slow: bool = False

    @property
    def name(self) -> str:
        """Of the scene's folder."""
        return f"{self.number:02d}-{self.field}" + ("-zy3" if self.slow else "")

    @property
    def field(self) -> str:
        """Of the field's folder."""
        return self.published.region.lower()

    @property
    def epoch_utc(self) -> str:
        """Middle of the image. P's times are Beijing's: 14:08 is 13:40 by the sun of Songshan."""
        local = datetime.fromisoformat(self.published.date)
        return (local - _BEIJING).strftime("%Y-%m-%dT%H:%M:%SZ")

    @property
    def relief_m(self) -> tuple[float, float]:
        """Lowest and highest height of the field's ground."""
        return _RELIEF_M[self.published.region]

    @property
    def centre_deg(self) -> tuple[float, float]:
        """Longitude and latitude of the field's middle."""
        extent = catalogued(self.published.region).extent
        assert extent is not None
        return (
            0.5 * (extent.west_deg + extent.east_deg),
            0.5 * (extent.south_deg + extent.north_deg),
        )

    def with_slow_line(self) -> Case:
        """Return the same scene with ZY-3's line at 0.65 Hz on top. *Source*: T section 2.4."""
        return replace(self, lines=(*self.lines, ZY3_LINE), slow=True)


def cases(seed: int, numbers: Sequence[int] = ()) -> tuple[Case, ...]:
    """P's scenes by their `numbers` in its tables, from 1; all of them where none is given."""
    if seed < 0:
        raise ArgumentError(f"--seed: 0 or more expected, got {seed}")
    wanted = sorted(set(numbers)) or range(1, len(PUBLISHED) + 1)
    found = []
    for number in wanted:
        if not 1 <= number <= len(PUBLISHED):
            raise ArgumentError(f"--scenes: numbers from 1 to {len(PUBLISHED)}, got {number}")
        found.append(Case(number, PUBLISHED[number - 1], PAPER_LINES, 1000 * seed + number))
    return tuple(found)
