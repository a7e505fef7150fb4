"""asgard."""

from __future__ import annotations

from pathlib import Path

from geoposition.scripts.bench.measure import Contender, Missing
from geoposition.scripts.bench.work import RigorousWork

NAME = "asgard"


def direct(work: RigorousWork, wanted: int) -> Contender | Missing:
    return Missing(NAME, "todo")


def inverse(work: RigorousWork, wanted: int) -> Contender | Missing:
    return Missing(NAME, "todo")


def on_dem(work: RigorousWork, dem: Path, wanted: int) -> Contender | Missing:
    return Missing(NAME, "todo")
