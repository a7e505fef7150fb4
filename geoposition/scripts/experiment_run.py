"""Experiments: run, print their tables beside the seed documents' figures, write results."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from geoposition.errors import ProductError
from geoposition.scripts.report import KeyFigure, Report, Section, Table, provenance, render
from geoposition.scripts.results import plain, print_json, progress_bar
from geoposition.scripts.scratch import require_folder
from geoposition.scripts.tables import whole_file

_TURNED = 3
"""Tables of up to so many rows are printed with a column for each."""


def run(name: str, runs: int, seed: int | None, folder: Path | None, json: bool) -> None:
    """Run the experiment `name`, print its tables or one JSON object, fill `folder` if given."""
    if folder is not None:
        _make(folder)
    module = import_module(f"geoposition.scripts.experiments.{name.replace('-', '_')}")
    more = {} if seed is None else {"seed": seed}
    begun = time.perf_counter()
    with progress_bar(name, json) as progress:
        found = module.run(runs, progress=progress, **more)
    result: dict[str, Any] = {
        "experiment": name,
        **plain(found.as_json()),
    }
    if folder is not None:
        _write(folder, name, result)
        result["output"] = str(folder)
    result["elapsed_s"] = round(time.perf_counter() - begun, 2)
    if json:
        print_json(result)
    else:
        _print(name, result)


def flat_tables(result: Mapping[str, Any]) -> dict[str, tuple[list[str], list[list[str]]]]:
    """Header and cells of every table of a result, by its number in the document."""
    tables = {str(name): _cells(rows) for name, rows in result.get("tables", {}).items() if rows}
    if result.get("consistency"):
        tables["consistency"] = _cells(result["consistency"])
    return tables


def _cells(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    header = [name for name in rows[0] if name != "table"]
    header = [name for name in header if any(row.get(name) is not None for row in rows)]
    return header, [[_cell(row.get(name)) for name in header] for row in rows]


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return " ".join(f"{item:.3f}" if isinstance(item, float) else str(item) for item in value)
    return str(value)


def _print(name: str, result: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table as RichTable

    console = Console()
    for number, (header, rows) in flat_tables(result).items():
        title = f"table {number}" if number[:1].isdigit() else number
        table = RichTable(title=f"{name}, {title}", title_justify="left", box=None)
        if len(rows) <= _TURNED:
            # Few methods with many figures each: a terminal is higher than wide.
            cells = list(zip(header, *rows, strict=True))
            header, rows = list(cells[0]), [list(row) for row in cells[1:]]
        for k, column in enumerate(header):
            table.add_column(column, justify="left" if k == 0 else "right", overflow="fold")
        for row in rows:
            table.add_row(*row)
        console.print(table)
        console.print()
    if result.get("finding"):
        console.print(str(result["finding"]))
    console.print(f"{result.get('runs', '')} runs in {result['elapsed_s']} s")


def _make(folder: Path) -> None:
    require_folder(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ProductError(folder, "", f"a writable folder expected ({error.strerror})") from None


def _write(folder: Path, name: str, result: Mapping[str, Any]) -> None:
    import json

    with whole_file(folder / f"{name}.json") as temporary:
        temporary.write_text(json.dumps(result, indent=1, ensure_ascii=False), encoding="utf-8")
    sections = [
        Section(
            f"Table {number}" if number[:1].isdigit() else number.capitalize(),
            [Table(f"{name}, {number}", header, rows)],
        )
        for number, (header, rows) in flat_tables(result).items()
    ]
    keys = [
        KeyFigure(f"{sum(values) / 3.0:.3f}", "″", f"{method}, rms, mean of the axes",
                  _beside(result, method))
        for method, values in result.get("rms_arcsec", {}).items()
    ]  # fmt: skip
    page = render(
        Report(
            f"Experiment {name}",
            f"{result.get('runs', '')} Monte Carlo runs; arc seconds, roll, pitch and yaw. "
            + str(result.get("finding", "")),
            keys,
            sections,
            provenance({"experiment": name}),
        )
    )
    with whole_file(folder / f"{name}.html") as temporary:
        temporary.write_text(page, encoding="utf-8")


def _beside(result: Mapping[str, Any], method: str) -> str:
    bound = result.get("bound_arcsec", {}).get(method)
    return "" if bound is None else f"bound {sum(bound) / 3.0:.3f}″"
