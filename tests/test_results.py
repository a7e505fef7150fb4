"""What commands print for people: nested facts by line, nothing where there is nothing to say."""

from __future__ import annotations

import pytest

from geoposition.scripts.results import print_facts, rounded


def test_nested_facts_keep_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    facts = {
        "points": 3,
        "sigma": {"total": {"e": 0.5, "n": 0.25}, "models": {"e": 1.0, "n": 2.0}},
        "compared": {"by_slope": [{"class": "0-5", "nmad": 1.5}, {"class": "5-10", "nmad": 2.5}]},
        "cover": float("nan"),
        "warnings": [],
    }
    print_facts("title", facts)
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        "title",
        "points    3",
        "sigma     total: e: 0.5, n: 0.25",
        "models: e: 1, n: 2",
        "compared  by_slope: class: 0-5, nmad: 1.5",
        "class: 5-10, nmad: 2.5",
    ]


def test_rounding_leaves_words_and_counts() -> None:
    value = {"a": 1.23456789, "b": [2, "x", None, 1e-9], "c": {"d": True}}
    assert rounded(value) == {"a": 1.234568, "b": [2, "x", None, 0.0], "c": {"d": True}}
