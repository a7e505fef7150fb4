"""The tables for a page of the documentation, between two marks that the page holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from geoposition.scripts.bench.growth import Growth
from geoposition.scripts.bench.limits import limit_of
from geoposition.scripts.bench.report import HEADINGS, Report, cells, goal_of, limit_text, number

BEGIN: Final = "<!-- bench: begin -->"
END: Final = "<!-- bench: end -->"


def as_markdown(report: Report, command: str) -> str:
    """Give machine, command and all tables of a run."""
    parts = [
        f"```sh\n{command}\n```",
        f"Machine: {report.facts()}; {report.data} data. {report.bounds()}.",
        *_cases(report),
        *(_growth(growth) for growth in report.growth.values()),
    ]
    if report.times_s:
        rows = [
            (name, *(number(v) for v in (spread.low, spread.median, spread.high)))
            for name, spread in report.times_s.items()
        ]
        parts.append("**Times, s**\n\n" + _table(("", "least", "median", "most"), rows))
    return "\n\n".join(parts)


def placed(text: str, page: Path) -> str:
    """Content for `page`: its own with `text` between its marks, or `text` alone."""
    if page.is_file():
        old = page.read_text(encoding="utf-8")
        head, begin, rest = old.partition(BEGIN)
        _, end, tail = rest.partition(END)
        if begin and end:
            return f"{head}{BEGIN}\n\n{text}\n\n{END}{tail}"
    return text + "\n"


def _cases(report: Report) -> list[str]:
    parts = []
    for result in report.cases:
        limit = limit_of(result.case, report.machine)
        told = " ".join([goal_of(result), limit_text(limit)]).strip()
        rows = [cells(row, result.case.unit, limit) for row in result.rows]
        title = f"**{result.case.title[0].upper()}{result.case.title[1:]}**"
        parts.append(
            (f"{title} — {told}" if told else title) + "\n\n" + _table(("", *HEADINGS, ""), rows)
        )
    return parts


def _growth(growth: Growth) -> str:
    heads = (growth.size, *(f"{size:,}" for size in growth.sizes))
    rows = [(name, *(number(v) for v in figures)) for name, figures in growth.rows.items()]
    title = f"**{growth.title[0].upper()}{growth.title[1:]}, by {growth.size}**"
    return f"{title}\n\n{_table(heads, rows)}"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---", *["--:"] * (len(heads) - 1)], *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )
