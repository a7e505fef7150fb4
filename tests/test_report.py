"""Reports stand alone, are well formed, and say what they are given; figures repeat."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from html.parser import HTMLParser

import numpy as np
import pytest

from geoposition.errors import ArgumentError
from geoposition.scripts import figures
from geoposition.scripts.report import (
    Commands,
    Image,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    Text,
    number,
    provenance,
    render,
)

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Outline(HTMLParser):
    """Checks that tags nest, and keeps references, ids and text."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.references: list[str] = []
        self.ids: list[str] = []
        self.words: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "action", "poster"):
                self.references.append(value or "")
            if name == "id":
                self.ids.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def outline(html: str) -> Outline:
    """Parse `html`, whose tags must nest and all be closed."""
    parser = Outline()
    parser.feed(html)
    parser.close()
    assert parser.open == []
    return parser


def assert_stands_alone(html: str) -> Outline:
    """No reference leaves the page, and links within it have a target."""
    found = outline(html)
    for reference in found.references:
        assert reference.startswith(("data:image/png;base64,", "#")), reference[:60]
        if reference.startswith("#"):
            assert reference[1:] in found.ids
    assert "script" not in found.tags
    style = re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)
    assert not re.search(r"https?:|//[a-z]|@import|url\(", style)
    assert len(found.ids) == len(set(found.ids))
    return found


@pytest.fixture(scope="module")
def png() -> bytes:
    return figures.histograms({"a": np.linspace(-1.0, 1.0, 50)}, unit="m")


def make(png: bytes) -> Report:
    return Report(
        "Title <b>",
        "What was found & how.",
        (KeyFigure("1.5", "m", "RMSE", "of all"), KeyFigure("2", "px", "bias")),
        (
            Section(
                "First part: a/b",
                (
                    Text("<script>alert(1)</script>"),
                    Table(
                        "Caption.", ("name", "value"), (("x < y", "1"), ("z", "−2")), strong=(1,)
                    ),
                    Image(png, "Figure's caption.", 'alt "text"'),
                ),
            ),
            Section("Second", (Note("Take care."), Commands((("run -o out.csv", "Do it:"),)))),
        ),
        {"version": "0", "option": "a & b"},
    )


def test_report_stands_alone_and_is_well_formed(png: bytes) -> None:
    html = render(make(png))
    assert html.startswith("<!DOCTYPE html>")
    found = assert_stands_alone(html)
    words = " ".join(" ".join(found.words).split())
    for text in ("Title <b>", "found & how", "<script>alert(1)</script>", "x < y", "a & b"):
        assert text in words
    assert found.tags.count("img") == 1
    assert found.ids == ["first-part-a-b", "second", "provenance"]
    for start in ("Figure 1.", "Table 1."):
        assert start in words


def test_report_reads_on_paper_and_in_the_dark(png: bytes) -> None:
    html = render(make(png))
    assert "@media print" in html
    assert "prefers-color-scheme: dark" in html
    assert "break-inside: avoid" in html


def test_report_without_provenance_has_none() -> None:
    found = assert_stands_alone(render(Report("T", "S", (), ())))
    assert found.ids == []


def test_pieces_refuse_what_does_not_fit(png: bytes) -> None:
    with pytest.raises(ArgumentError, match="2 cells a row"):
        Table("T", ("a", "b"), (("1",),))
    with pytest.raises(ArgumentError, match="PNG bytes"):
        _ = Image(b"GIF89a", "c", "a").size_px
    width, height = Image(png, "c", "a").size_px
    assert width > height > 100


@pytest.mark.parametrize(
    ("value", "digits", "sign", "text"),
    [
        (1.005, 1, False, "1.0"),
        (-1.26, 1, False, "−1.3"),
        (1.26, 1, True, "+1.3"),
        (-0.001, 2, True, "0.00"),
        (0.001, 2, True, "0.00"),
        (float("nan"), 2, False, "–"),
        (float("inf"), 2, False, "–"),
    ],
)
def test_numbers(value: float, digits: int, sign: bool, text: str) -> None:
    assert number(value, digits, sign=sign) == text


def test_provenance_names_version_date_and_packages() -> None:
    import geoposition

    facts = provenance({"seed": 5}, datetime(2020, 1, 2, 3, 4, 5, tzinfo=UTC))
    assert facts["geoposition"] == geoposition.__version__
    assert facts["created"] == "2020-01-02 03:04:05 UTC"
    assert facts["seed"] == "5"
    assert f"numpy {np.__version__}" in facts["packages"]


def test_figures_are_png_and_repeat() -> None:
    rng = np.random.default_rng(1)
    heights = figures.HeightMap(rng.normal(size=(30, 40)), (10.0, 10.4, 45.0, 45.3))
    holes = figures.HeightMap(np.where(rng.random((30, 40)) > 0.3, 1.0, np.nan), heights.extent_deg)
    place, vector = rng.uniform(0, 10, (50, 2)), rng.normal(size=(50, 2))
    panels = [
        figures.VectorPanel("a", place, vector),
        figures.VectorPanel("b", place, vector, vector[:, 0]),
    ]
    outline_deg = np.array([[10.1, 45.1], [10.3, 45.1], [10.3, 45.2], [10.1, 45.1]])

    def draw() -> list[bytes]:
        return [
            figures.footprints(heights, {"one": outline_deg}, outline_deg, "points"),
            figures.height_and_difference(holes, {"difference": holes}, "m"),
            figures.vectors(
                panels, unit="px", place_labels=("x", "y"), down=True, colour_label="m"
            ),
            figures.series(
                np.arange(9.0), {"a": np.arange(9.0)}, unit="m", time_label="s",
                intervals={"i": (1.0, 2.0)},
            ),
            figures.histograms({"a": place[:, 0]}, unit="m", limit=5.0),
        ]  # fmt: skip

    first = draw()
    for image in first:
        assert image[:8] == b"\x89PNG\r\n\x1a\n"
    assert first == draw()
