"""`python -m geoposition.scripts.fuzz`: feed mutated inputs to every reader, and say what came."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from geoposition.scripts.results import plain, print_json, progress_bar


def main() -> int:
    """Run a campaign; exit 1 if there are findings."""
    parser = argparse.ArgumentParser(prog="python -m geoposition.scripts.fuzz", description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of real products to mutate as well")
    parser.add_argument("--inputs", type=int, default=100_000, help="in all; 100000")
    parser.add_argument("--products", type=int, default=0, help="mutated products to commands")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="targets whose name holds this")
    parser.add_argument("--guided", metavar="TARGET", help="guided by coverage, with atheris")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-findings"), help="their folder")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.guided is not None:
        return _guided(given)
    from geoposition.scripts.fuzz import campaign, commands

    with progress_bar("inputs", given.json) as progress:
        tallies = campaign.run(
            given.data, given.inputs, given.processes, given.seed, given.only, given.keep, progress
        )
    if given.products and given.data is not None:
        with progress_bar("products", given.json) as progress:
            tallies.append(commands.run(given.data, given.products, given.seed, progress))
            campaign.save(given.keep, tallies[-1])
    facts = campaign.summary(tallies)
    if given.json:
        print_json(facts)
    else:
        _show(facts)
    return 1 if facts["findings"] else 0


def _guided(given: argparse.Namespace) -> int:
    from geoposition.errors import GeopositionError
    from geoposition.scripts.fuzz import guided

    try:
        facts = guided.run(given.data, given.guided, given.inputs, given.seed, given.keep)
    except GeopositionError as error:
        print(error, file=sys.stderr)
        return 2
    if given.json:
        print_json(facts)
    else:
        _show(facts)
    return 1 if facts["findings"] else 0


def _show(facts: dict[str, object]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{facts['inputs']} inputs, {facts['findings']} findings")
    for name in ("target", "inputs", "read", "refused", "findings", "seconds"):
        table.add_column(name, justify="left" if name == "target" else "right")
    for target, counts in plain(facts)["targets"].items():
        table.add_row(target, *(str(value) for value in counts.values()))
    Console().print(table)


if __name__ == "__main__":
    raise SystemExit(main())
