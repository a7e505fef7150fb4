"""The tables on the terminal and the JSON file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from rich.console import Console
from rich.table import Table

from geoposition.scripts.bench.growth import Growth
from geoposition.scripts.bench.limits import Limit, Machine, limit_of
from geoposition.scripts.bench.measure import CaseResult, Row, Spread

HEADINGS = (
    "Mpoint/s", "per core-second", "ours is × faster", "per core-second ×", "of the limit",
    "differs", "peak MB", "points",
)  # fmt: skip


@dataclass(slots=True)
class Report:
    """All that a run found: on what machine, how fast, how it grows."""

    environment: dict[str, object]
    data: str
    cases: list[CaseResult] = field(default_factory=list)
    growth: dict[str, Growth] = field(default_factory=dict)
    times_s: dict[str, Spread] = field(default_factory=dict)
    copy_gb_s: dict[int, float] = field(default_factory=dict)
    gflop_s: float = 0.0

    @property
    def machine(self) -> Machine:
        """What the machine could do at most."""
        return Machine(max(self.copy_gb_s.values(), default=0.0), self.gflop_s)

    def facts(self) -> str:
        """One line about machine and versions."""
        return ", ".join(f"{name} {value}" for name, value in self.environment.items())

    def bounds(self) -> str:
        """One line about what the limits are reckoned from."""
        copies = ", ".join(
            f"{threads} thread(s) {rate:.1f} GB/s" for threads, rate in self.copy_gb_s.items()
        )
        return (
            f"memory to memory (read + written): {copies}; "
            f"64-bit arithmetic (BLAS): {self.gflop_s:.0f} Gflop/s"
        )


def show(report: Report, console: Console) -> None:
    """Print everything."""
    console.print(f"[bold]{report.facts()}[/bold]", highlight=False)
    console.print(report.bounds(), highlight=False)
    if report.cases:
        console.print(_table(report))
    for growth in report.growth.values():
        console.print(_growth(growth))
    if report.times_s:
        times = Table(title="times, s", title_justify="left")
        for heading in ("what", "least", "median", "most"):
            times.add_column(heading, justify="left" if heading == "what" else "right")
        for name, spread in report.times_s.items():
            times.add_row(name, *(f"{v:.3g}" for v in (spread.low, spread.median, spread.high)))
        console.print(times)


def _table(report: Report) -> Table:
    table = Table(title="Mpoint/s: least / median / most", title_justify="left", show_lines=False)
    table.add_column("work, who")
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    table.add_column("")
    colours = {"met": "[green]met[/green]", "not met": "[red]not met[/red]"}
    for result in report.cases:
        limit = limit_of(result.case, report.machine)
        text = " ".join([goal_of(result, colours), limit_text(limit)]).strip()
        table.add_row(f"[bold]{result.case.title}[/bold]", *[""] * len(HEADINGS), text)
        for row in result.rows:
            name, *figures, note = cells(row, result.case.unit, limit)
            note = f"[yellow]{note}[/yellow]" if row.reason else note
            table.add_row(f"  {name}", *figures, note)
        table.add_section()
    return table


def goal_of(result: CaseResult, words: Mapping[str, str] | None = None) -> str:
    """Target of a case, and whether its best repetition reached it."""
    target = result.case.target_mpoint_s
    if target is None or result.met is None:
        return ""
    verdict = "met" if result.met else "not met"
    return f"wanted ≥ {number(target)}: {verdict if words is None else words[verdict]}."


def limit_text(limit: Limit | None) -> str:
    """Say what would be possible at most, and why no more."""
    return "" if limit is None else f"{limit.what} would allow {number(limit.mpoint_s)}"


def cells(row: Row, unit: str, limit: Limit | None) -> tuple[str, ...]:
    """Name, a text for each of `HEADINGS`, note."""
    if row.reason:
        return (row.name, "—", *[""] * (len(HEADINGS) - 1), row.reason)
    share = ""
    if limit is not None and row.mpoint_s is not None:
        share = f"{number(100.0 * row.mpoint_s.median / limit.mpoint_s)} %"
    return (
        row.name,
        _spread(row.mpoint_s),
        "" if row.mpoint_core_s is None else number(row.mpoint_core_s.median),
        _spread(row.ratio),
        "" if row.ratio_core is None else number(row.ratio_core.median),
        share,
        "" if row.difference is None else f"{row.difference:.1e} {unit}",
        "" if row.peak_bytes is None else f"{row.peak_bytes / 1e6:.0f}",
        f"{row.points:,}",
        row.note,
    )


def _spread(spread: Spread | None) -> str:
    if spread is None:
        return ""
    return " / ".join(number(value) for value in (spread.low, spread.median, spread.high))


def number(value: float) -> str:
    """Three digits, or all before the point."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def _growth(growth: Growth) -> Table:
    table = Table(title=f"{growth.title}, by {growth.size}", title_justify="left")
    table.add_column("")
    for size in growth.sizes:
        table.add_column(f"{size:,}", justify="right")
    for name, figures in growth.rows.items():
        table.add_row(name, *(number(figure) for figure in figures))
    return table


def as_json(report: Report) -> dict[str, object]:
    """Everything measured, for a file."""
    cases = []
    for result in report.cases:
        case, limit = result.case, limit_of(result.case, report.machine)
        cases.append(
            {
                "key": case.key,
                "title": case.title,
                "unit": case.unit,
                "target_mpoint_s": case.target_mpoint_s,
                "met": result.met,
                "bytes_per_point": case.bytes_per_point,
                "limit": None if limit is None else asdict(limit),
                "rows": [asdict(row) for row in result.rows],
            }
        )
    return {
        "environment": report.environment,
        "data": report.data,
        "copy_gb_s": {str(threads): rate for threads, rate in report.copy_gb_s.items()},
        "gflop_s": report.gflop_s,
        "growth": {name: asdict(growth) for name, growth in report.growth.items()},
        "times_s": {name: asdict(spread) for name, spread in report.times_s.items()},
        "cases": cases,
    }
