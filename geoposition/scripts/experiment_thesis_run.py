"""`experiment thesis`: Monte Carlo, imaged chain and checks; report and one JSON object."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from json import dumps
from pathlib import Path
from typing import Any, Final

from geoposition.scripts.experiment_folder import experiment_folder
from geoposition.scripts.results import plain, print_json, progress_bar, rounded

MARK: Final = "thesis.json"
FULL_RUNS: Final = 200
QUICK_RUNS: Final = 16


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of the experiment."""

    runs: int
    seed: int
    quick: bool
    images: bool
    output: Path | None


def run(wanted: Request, json: bool) -> None:
    """Do all of it; print the result, and fill the output folder if one is given."""
    begun = time.perf_counter()
    with experiment_folder(wanted.output, MARK) as folder:
        result, text = _work(wanted, folder, json)
        (folder / "thesis.html").write_text(text, encoding="utf-8")
        # Without what differs from run to run, so that two runs of one seed are the same.
        found = dumps(result, indent=1, ensure_ascii=False)
        (folder / MARK).write_text(found, encoding="utf-8")
    if wanted.output is not None:
        result["output"] = str(wanted.output)
    result["elapsed_s"] = round(time.perf_counter() - begun, 2)
    if json:
        print_json(result)
    else:
        _print(result)


def _work(wanted: Request, folder: Path, quiet: bool) -> tuple[dict[str, Any], str]:
    """Return the result, fit for JSON, and the page."""
    from geoposition.scripts.experiments.thesis import claims, imaged, numerical, observability
    from geoposition.scripts.experiments.thesis.report import Checks, page
    from geoposition.scripts.experiments.thesis.tables import tables_of

    with progress_bar("Monte Carlo", quiet) as progress:
        done = numerical.simulate(wanted.runs, wanted.seed, progress)
    tables = tables_of(done)
    checks = Checks(
        [*claims.unmodelled_jitter(), *claims.steadiness(wanted.seed)],
        observability.observabilities(),
    )
    made = None
    if wanted.images:
        size = imaged.QUICK if wanted.quick else imaged.FULL
        with progress_bar("files and images", quiet) as progress:
            made = imaged.run_imaged(folder, size, wanted.seed, progress)
    result = {
        **tables.as_json(),
        "claims": [asdict(claim) for claim in checks.claims],
        "observability": [asdict(one) for one in checks.observability],
        **({} if made is None else {"imaged": made.as_json()}),
    }
    head = {"experiment": "thesis", "seed": wanted.seed}
    return head | rounded(plain(result)), page(done, tables, checks, made, folder, wanted.seed)


def _print(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table(
        title=f"thesis: RMSE at {result['points']['check']} check points, m", title_justify="left",
        box=None,
    )  # fmt: skip
    header = ("attitude", "before", "after", "X", "Y", "Z", "E", "N", "U")
    for name in header:
        table.add_column(name, justify="left" if name == "attitude" else "right")
    found = result["checkpoint_rmse_m"]
    for kind, axes in found["axes"].items():
        values = (found["before"][kind], found[kind], *(axes[name] for name in "xyzenu"))
        table.add_row(kind, *(f"{value:.2f}" for value in values))
    console.print(table)
    console.print(f"image noise alone leaves {result['limit_m']:.2f} m")
    for what, good in result["must_show"].items():
        console.print(f"{what}: {'yes' if good else 'no'}")
    where = f"; {result['output']}/thesis.html" if "output" in result else ""
    console.print(f"{result['runs']} runs in {result['elapsed_s']} s{where}")
