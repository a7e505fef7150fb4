"""The table on the terminal and the JSON file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from geoposition.scripts.bench.measure import CaseResult, Row, Spread


def show(report: Mapping[str, Any], results: Sequence[CaseResult], console: Console) -> None:
    """Print everything."""
    facts = ", ".join(f"{name} {value}" for name, value in report["environment"].items())
    console.print(f"[bold]{facts}[/bold]", highlight=False)
    copies = ", ".join(
        f"{threads} thread(s) {rate:.1f} GB/s" for threads, rate in report["copy_gb_s"].items()
    )
    console.print(f"memory to memory (read + written): {copies}", highlight=False)
    console.print(_table(results, max(report["copy_gb_s"].values())))
    if report.get("reimage"):
        console.print(_reimage(report["reimage"]))
    if report["growth"]:
        console.print(_growth(report["growth"]))
    times = Table(title="times, s", title_justify="left")
    for heading in ("what", "least", "median", "most"):
        times.add_column(heading, justify="left" if heading == "what" else "right")
    for name, spread in report["times_s"].items():
        times.add_row(name, *(f"{spread[key]:.3g}" for key in ("low", "median", "high")))
    console.print(times)


def _table(results: Sequence[CaseResult], copy_gb_s: float) -> Table:
    table = Table(title="Mpoint/s: least / median / most", title_justify="left", show_lines=False)
    table.add_column("work, who")
    headings = ("Mpoint/s", "per core-second", "ours is × faster", "differs", "peak MB", "points")
    for heading in headings:
        table.add_column(heading, justify="right")
    table.add_column("")
    for result in results:
        case = result.case
        wanted = "" if case.target_mpoint_s is None else f"wanted ≥ {case.target_mpoint_s:g}"
        verdict = {True: " [green]met[/green]", False: " [red]not met[/red]", None: ""}[result.met]
        limit = ""
        if case.bytes_per_point:
            limit = f"memory would allow {1e3 * copy_gb_s / case.bytes_per_point:.0f}"
        table.add_row(f"[bold]{case.title}[/bold]", *[""] * 6, f"{wanted}{verdict} {limit}".strip())
        for row in result.rows:
            table.add_row(*_cells(row, case.unit))
        table.add_section()
    return table


def _cells(row: Row, unit: str) -> tuple[str, ...]:
    if row.reason:
        return (f"  {row.name}", "—", "", "", "", "", "", f"[yellow]{row.reason}[/yellow]")
    return (
        f"  {row.name}",
        _spread(row.mpoint_s),
        "" if row.mpoint_core_s is None else _number(row.mpoint_core_s.median),
        _spread(row.ratio),
        "" if row.difference is None else f"{row.difference:.1e} {unit}",
        "" if row.peak_bytes is None else f"{row.peak_bytes / 1e6:.0f}",
        f"{row.points:,}",
        row.note,
    )


def _spread(spread: Spread | None) -> str:
    if spread is None:
        return ""
    return " / ".join(_number(value) for value in (spread.low, spread.median, spread.high))


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def _reimage(found: Mapping[str, Any]) -> Table:
    size = " x ".join(f"{n:,}" for n in found["size"])
    table = Table(title=f"re-imaging and ortho, {size}", title_justify="left")
    for name in ("what", "found", "target"):
        table.add_column(name)
    for name, value in found.items():
        if isinstance(value, float):
            target = found["targets"].get(name)
            table.add_row(name, _number(value), "" if target is None else _number(target))
    return table


def _growth(growth: Mapping[str, Mapping[str, float]]) -> Table:
    table = Table(title="direct, ellipsoid: best Mpoint/s by points a call", title_justify="left")
    table.add_column("product")
    counts = next(iter(growth.values()))
    for count in counts:
        table.add_column(f"{int(count):,}", justify="right")
    for name, rates in growth.items():
        table.add_row(name, *(f"{rate:.1f}" for rate in rates.values()))
    return table


def as_json(report: Mapping[str, Any], results: Sequence[CaseResult]) -> dict[str, Any]:
    """Everything measured, for a file."""
    cases = []
    for result in results:
        case = result.case
        cases.append(
            {
                "key": case.key,
                "title": case.title,
                "unit": case.unit,
                "target_mpoint_s": case.target_mpoint_s,
                "met": result.met,
                "bytes_per_point": case.bytes_per_point,
                "rows": [asdict(row) for row in result.rows],
            }
        )
    return {**report, "cases": cases}
