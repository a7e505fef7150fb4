"""Reports: one HTML page that stands alone, from plain pieces that a command fills in.

The page holds its figures and style inside, asks nothing of the network, follows the reader's
light or dark setting and prints on A4 or letter.
"""

from __future__ import annotations

import os
import platform
import sys
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import ClassVar, TypeAlias

import jinja2
import numpy as np

import geoposition
from geoposition.errors import ArgumentError

_PACKAGES = ("numpy", "scipy", "numba", "pyerfa", "astropy-iers-data", "pyproj", "rasterio")


@dataclass(frozen=True, slots=True)
class KeyFigure:
    """A number that a reader should take away: `value` with its unit, what it is, a remark."""

    value: str
    unit: str
    label: str
    remark: str = ""


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True, slots=True)
class Note:
    """A paragraph that qualifies what is shown."""

    kind: ClassVar[str] = "note"
    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of ready-made cells under `header`; the first `text_columns` are words.

    Rows whose index is in `strong` are set off.
    """

    kind: ClassVar[str] = "table"
    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    text_columns: int = 1
    strong: Sequence[int] = ()

    def __post_init__(self) -> None:
        if any(len(row) != len(self.header) for row in self.rows):
            raise ArgumentError(f"table {self.caption!r}: {len(self.header)} cells a row expected")


@dataclass(frozen=True, slots=True)
class Image:
    """A figure: PNG bytes, a caption with units, and words for those who do not see it."""

    kind: ClassVar[str] = "image"
    png: bytes
    caption: str
    alternative: str

    @property
    def data_uri(self) -> str:
        """The figure as a link into itself."""
        return "data:image/png;base64," + b64encode(self.png).decode("ascii")

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height, from the PNG header."""
        if self.png[:8] != b"\x89PNG\r\n\x1a\n":
            raise ArgumentError(f"figure {self.caption!r}: PNG bytes expected")
        return int.from_bytes(self.png[16:20], "big"), int.from_bytes(self.png[20:24], "big")


@dataclass(frozen=True, slots=True)
class Commands:
    """Commands to run next, each with what it is for."""

    kind: ClassVar[str] = "commands"
    lines: Sequence[tuple[str, str]]


Block: TypeAlias = Text | Note | Table | Image | Commands


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands below it."""

    title: str
    blocks: Sequence[Block]

    @property
    def anchor(self) -> str:
        """The title as a link's target."""
        return "-".join("".join(c if c.isalnum() else " " for c in self.title.lower()).split())


@dataclass(frozen=True, slots=True)
class Report:
    """A page: title, one paragraph that says what was found, key figures, sections, provenance."""

    title: str
    summary: str
    key_figures: Sequence[KeyFigure]
    sections: Sequence[Section]
    provenance: Mapping[str, str] = field(default_factory=dict)


def render(report: Report) -> str:
    """HTML of `report`; all text is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("report.html").render(report=report)


def provenance(facts: Mapping[str, object], created: datetime | None = None) -> dict[str, str]:
    """Version, date, command line, packages and machine, with `facts` of the run before them."""
    when = (created or datetime.now(UTC)).astimezone(UTC)
    packages = []
    for name in _PACKAGES:
        try:
            packages.append(f"{name} {version(name)}")
        except PackageNotFoundError:  # pragma: no cover - all are requirements
            packages.append(f"{name} ?")
    return {
        "geoposition": geoposition.__version__,
        "created": when.strftime("%Y-%m-%d %H:%M:%S UTC"),
        **{name: str(value) for name, value in facts.items()},
        "packages": ", ".join(packages),
        "python": f"{platform.python_implementation()} {'.'.join(map(str, sys.version_info[:3]))}",
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
    }


def number(value: float, digits: int = 2, *, sign: bool = False) -> str:
    """`value` with so many decimals, a true minus sign, and a dash for what is no number."""
    if not np.isfinite(value):
        return "–"
    text = f"{value:+.{digits}f}" if sign else f"{value:.{digits}f}"
    if float(text) == 0.0:
        text = text.lstrip("+-")
    return text.replace("-", "−")
