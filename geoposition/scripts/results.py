"""How a command speaks: one JSON object, or words and tables; progress on a terminal."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

import numpy as np

Progress = Callable[[int, int], None]

_DECIMALS: Final = 6


def unseen(done: int, total: int) -> None:
    """Progress that nobody looks at."""


def print_json(result: Mapping[str, object]) -> None:
    """Print `result` as one JSON object; NaN and infinity, which JSON lacks, become null."""
    print(json.dumps(plain(result), ensure_ascii=False, allow_nan=False))


def plain(value: object) -> Any:
    """Return `value` made of what JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return str(value)


def rounded(value: Any) -> Any:
    """Return plain `value` with all floats to six decimals: micrometres, millionths of a pixel.

    What is cut off is rounding: it differs with the instructions that the compiler chose.
    """
    if isinstance(value, float):
        return round(value, _DECIMALS)
    if isinstance(value, Mapping):
        return {name: rounded(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    return value


def print_facts(title: str, facts: Mapping[str, object]) -> None:
    """Print names and values as a two-column table under `title`."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, show_header=False, title_justify="left", box=None)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for name, value in facts.items():
        if not _empty(value):
            table.add_row(name, _words(value))
    Console().print(table)


def _empty(value: object) -> bool:
    """Whether there is nothing to say: no value or number, no entries, classes that count none."""
    if isinstance(value, Mapping):
        return value.get("count") == 0 or all(_empty(item) for item in value.values())
    if isinstance(value, (float, np.floating)):
        return bool(np.isnan(value))
    return value is None or (isinstance(value, (list, tuple)) and all(map(_empty, value)))


def _words(value: object) -> str:
    if isinstance(value, Mapping):
        parts = [f"{name}: {_line(item)}" for name, item in value.items() if not _empty(item)]
        return "\n".join(parts)
    if isinstance(value, (float, np.floating)):
        return f"{value:.10g}"
    if isinstance(value, (list, tuple)):
        if any(isinstance(item, Mapping) for item in value):
            # One line for each of several like things.
            return "\n".join(_line(item) for item in value if not _empty(item))
        return ", ".join(_words(item) for item in value)
    return str(value)


def _line(value: object) -> str:
    """One line for what stands below a name; classes that are alike keep a line each."""
    text = _words(value)
    return text.replace("\n", ", ") if isinstance(value, Mapping) else text


@contextmanager
def progress_bar(title: str, quiet: bool = False) -> Iterator[Progress]:
    """Give a `progress(done, total)` that shows a bar on a terminal, and nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield unseen
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
