"""All real chains whose samples are there, one after the other."""

from __future__ import annotations

from itertools import count
from pathlib import Path

from geoposition.scripts.experiments.real import pairs, worldview
from geoposition.scripts.experiments.real.outcome import Outcome
from geoposition.scripts.experiments.real.size import Size
from geoposition.scripts.experiments.real.sources import WORLDVIEW, Found
from geoposition.scripts.results import Progress


def run(found: Found, folder: Path, progress: Progress, seed: int, size: Size) -> Outcome:
    """Make all files in `folder`; the same seed gives the same numbers."""
    wanted = [case for case in pairs.CASES if case.name in found.paths]
    with_model = WORLDVIEW in found.paths
    total = len(wanted) * pairs.STEPS + with_model * (worldview.STEPS + size.runs)
    counter = count(1)

    def step() -> None:
        progress(next(counter), total)

    progress(0, total)
    model = None
    if with_model:
        model = worldview.run_worldview(
            found.paths[WORLDVIEW], folder / WORLDVIEW, size, seed, step
        )
    done = [
        pairs.run_pair(case, found.paths[case.name], folder / case.name, size, step)
        for case in wanted
    ]
    return Outcome(seed, size, model, tuple(done), found.as_notes())
