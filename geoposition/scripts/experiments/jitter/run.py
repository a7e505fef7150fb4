"""The experiment from P's table of scenes to its two tables of accuracy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from geoposition.scripts.evaluate import run as evaluate_run
from geoposition.scripts.experiments.jitter.accuracy import (
    evaluated,
    listed_scenes,
    write_lists,
    write_reports,
)
from geoposition.scripts.experiments.jitter.cases import FULL, QUICK, Case, Size, cases
from geoposition.scripts.experiments.jitter.chain import SceneResult, run_scene
from geoposition.scripts.experiments.jitter.ground import Ground, make_ground
from geoposition.scripts.experiments.jitter.outcome import Outcome, Scene
from geoposition.scripts.experiments.jitter.scene import planned_model, sight
from geoposition.scripts.experiments.jitter.truth import attainable
from geoposition.scripts.processes import cores, process_pool
from geoposition.scripts.results import Progress

DEFAULT_SEED: Final = 1

_Made = TypeVar("_Made")
_Imaged = tuple[SceneResult, dict[str, evaluate_run.SceneResult]]


def run(
    folder: Path,
    progress: Progress,
    *,
    numbers: Sequence[int] = (),
    seed: int = DEFAULT_SEED,
    quick: bool = False,
) -> Outcome:
    """Make all files in `folder` and evaluate them; the same seed gives the same numbers."""
    return run_sized(folder, progress, cases(seed, numbers), seed, QUICK if quick else FULL)


def run_sized(
    folder: Path,
    progress: Progress,
    wanted: Sequence[Case],
    seed: int,
    size: Size,
    processes: int | None = None,
) -> Outcome:
    """Run the `wanted` cases, and the first of them with ZY-3's slow line, at some size.

    On `processes` processes, as many as there are processors: a scene is the work of one.
    """
    every = [*wanted, wanted[0].with_slow_line()]
    fields = list(dict.fromkeys(case.field for case in every))
    write_lists(folder, every)
    total, done = len(fields) + len(every), 0

    def told(parts: int) -> None:
        progress(done + parts, total)

    count = min(processes or cores(), len(every))
    own = {name: [case for case in wanted if case.field == name] for name in fields}
    made = _all_of([partial(_field, folder, own[name], size, seed) for name in fields], count, told)
    grounds = dict(zip(fields, made, strict=True))
    done = len(fields)
    results = _all_of(
        [
            partial(_scene, folder, case, size, grounds[case.field], k)
            for k, case in enumerate(every)
        ],
        count,
        told,
    )
    write_reports(folder, [found for _, found in results])
    joined = [
        Scene(result, found["before"].evaluation, found["after"].evaluation)
        for result, found in results
    ]
    bound = attainable(results[0][0].told)
    return Outcome(size, seed, tuple(joined[:-1]), joined[-1], bound)


def _all_of(
    work: Sequence[Callable[[], _Made]], processes: int, told: Callable[[int], None]
) -> list[_Made]:
    """Results of all of `work`, in its order."""
    if processes == 1:
        out = []
        for each in work:
            out.append(each())
            told(len(out))
        return out
    with process_pool(processes, max(1, cores() // processes)) as pool:
        tasks = [pool.submit(each) for each in work]
        for k, task in enumerate(as_completed(tasks)):
            task.result()
            told(k + 1)
        return [task.result() for task in tasks]


def _field(folder: Path, own: Sequence[Case], size: Size, seed: int) -> Ground:
    name = own[0].field
    models = [planned_model(case, size) for case in own]
    return make_ground(folder / "fields" / name, own, models, 10 * seed + _field_number(name))


def _scene(folder: Path, case: Case, size: Size, ground: Ground, number: int) -> _Imaged:
    """Everything about one scene, its two matches too."""
    seen = sight(case, size)
    result = run_scene(seen, seen.true_model(), ground, folder / case.name)
    return result, evaluated(listed_scenes(folder, number))


def _field_number(name: str) -> int:
    return sorted({case.field for case in cases(0)}).index(name)
