"""How much of the real chains is done: all of it, or what a minute allows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from geoposition.matching import MatchOptions


@dataclass(frozen=True, slots=True)
class Size:
    """Surveys repeated, how images are matched, and whether each step has a report of its own."""

    runs: int
    matching: MatchOptions
    reports: bool


FULL: Final = Size(60, MatchOptions(), True)
QUICK: Final = Size(8, MatchOptions(tile_features=8000), False)
"""A third of the features: half the matches, in two thirds of the time."""
