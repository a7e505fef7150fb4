"""`experiment jitter`: run it in a folder of its own, write its report, print its tables."""

from __future__ import annotations

import json as json_module
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from geoposition.errors import ArgumentError, ProductError
from geoposition.scripts.experiments.jitter.report import build
from geoposition.scripts.experiments.jitter.run import run as run_experiment
from geoposition.scripts.report import render
from geoposition.scripts.results import plain, print_json, progress_bar
from geoposition.scripts.scratch import require_folder

_MARK: Final = "jitter.json"
"""Written last: a folder with it holds a run that came to its end."""
_OURS: Final = (
    "0[1-5]-*", "fields", "before.toml", "after.toml", "evaluation-before", "evaluation-after",
    "report.html", _MARK,
)  # fmt: skip


def run(numbers: Sequence[int], seed: int, quick: bool, output: Path | None, json: bool) -> None:
    """Run the experiment, fill the folder `output` if given, print tables or one JSON object."""
    begun = time.perf_counter()
    with _folder(output) as folder:
        with progress_bar("jitter", json) as progress:
            outcome = run_experiment(folder, progress, numbers=numbers, seed=seed, quick=quick)
        found: dict[str, Any] = {"experiment": "jitter", "quick": quick}
        found |= plain(outcome.as_json())
        page = render(build(outcome, found))
        (folder / "report.html").write_text(page, encoding="utf-8")
        text = json_module.dumps(found, indent=1, ensure_ascii=False, allow_nan=False)
        (folder / _MARK).write_text(text + "\n", encoding="utf-8")
    if output is not None:
        found["output"] = str(output)
    found["elapsed_s"] = round(time.perf_counter() - begun, 1)
    if json:
        print_json(found)
    else:
        _print(found)


@contextmanager
def _folder(output: Path | None) -> Iterator[Path]:
    """Give the folder to fill, empty; where filling it fails, nothing is left in it.

    Without `output` it is a fleeting one. A folder that is there already must be empty or a
    former run's, ended or not, whose files go while others stay. It is filled in its place, since
    many files name each other.
    """
    if output is None:
        with TemporaryDirectory(prefix="geoposition-jitter-") as name:
            yield Path(name)
        return
    require_folder(output)
    new = not output.exists()
    ours = {path for pattern in _OURS for path in output.glob(pattern)}
    if not new and not (output / _MARK).is_file() and set(output.iterdir()) - ours:
        raise ArgumentError(f"{output}: a new folder, an empty one or a former run's expected")
    try:
        output.mkdir(parents=True, exist_ok=True)
        _clear(output)
    except OSError as error:
        raise ProductError(output, "", f"a writable folder expected ({error.strerror})") from None
    try:
        yield output
    except BaseException:
        _clear(output)
        if new and not any(output.iterdir()):
            output.rmdir()
        raise


def _clear(folder: Path) -> None:
    """Remove what a run makes, and nothing else."""
    for path in [path for pattern in _OURS for path in folder.glob(pattern)]:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _print(found: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    titles = {"1": "on-board attitude", "2": "stars and angular displacement fused"}
    for number, title in titles.items():
        rows = found["tables"][number]
        table = Table(title=f"P table {number}: {title}, pixels", title_justify="left", box=None)
        for name in rows[0]:
            table.add_column(name.replace("_", " "), justify="right")
        for row in rows:
            table.add_row(*(f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()))
        console.print(table)
        console.print()
    bound = found["bound"]
    console.print(
        f"expected at best {bound['relative_px']:.3f} px against the truth; worst of all: "
        + ", ".join(
            f"{name.replace('_', ' ')} {goal['worst']:.2g} (goal {goal['goal']:g})"
            for name, goal in found["goals"].items()
        )
    )
    where = f"{found['output']}/report.html, " if "output" in found else ""
    console.print(f"{where}{found['elapsed_s']} s")
